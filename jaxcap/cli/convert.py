"""`jaxcap convert`: the same content in another format."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ..edit.linearise import linear_motion, linearise
from ..edit.sample import sample_poses
from ..errors import InputError
from ..io.gltf import write_gltf
from ..io.mesh import SUFFIXES, read_mesh, write_mesh
from ..io.npz import load_body
from ..io.registry import (
    MOTION_READERS,
    MOTION_WRITERS,
    SKELETON_READERS,
    SKELETON_WRITERS,
    read_motion,
    read_skeleton,
    write_motion,
    write_skeleton,
)
from .evaluate import read_motion_of
from .options import Flag, OptionalFile, OptionalUnit, arg
from .say import say, warn


@dataclass
class Convert:
    """Write a motion (bvh, npz, amc with its asf beside it), a mesh or a skeleton in another format,
    or a body .npz with its motion as a skinned, animated .glb.

    Suffixes say what is what."""

    source: tyro.conf.Positional[Annotated[Path, arg(metavar="SOURCE")]]
    """The file to read."""
    target: tyro.conf.Positional[Annotated[Path, arg(metavar="TARGET")]]
    """The file to write."""
    unit: OptionalUnit = None
    """Unit of the source's lengths; metres where not given, centimetres in BVH."""
    target_unit: OptionalUnit = None
    """Unit of the target's lengths; metres where not given, centimetres in BVH."""
    motion: OptionalFile = None
    """Motion (.npz, .bvh) of a body that becomes a .glb."""
    tolerance: float = 0.001
    """How far, in metres, a .glb may be from a body that does not blend linearly; virtual bones bring it there."""
    influences: int = 4
    """Bones that move one vertex of a .glb at most; many programs read no more than 4."""
    overwrite: Flag = False
    """Replace the target where it is there."""

    def run(self) -> None:
        here, there = self.source.suffix.lower(), self.target.suffix.lower()
        if self.target.exists() and not self.overwrite:
            raise InputError(f"{self.target}: this file is there already; give --overwrite to replace it.")
        if not self.source.is_file():
            raise InputError(f"{self.source}: there is no such file; check the path.")
        if self.motion is not None and (here, there) != (".npz", ".glb"):
            raise InputError(f"{self.motion}: --motion is for a body .npz that becomes a .glb.")
        if (here, there) == (".npz", ".glb"):
            self.write_body()
        elif here in SUFFIXES:
            mesh = read_mesh(self.source, self.unit or "m")
            write_mesh(self.target, mesh, self.target_unit or "m")
            say(f"{self.target}: {len(mesh.vertices)} vertices, {len(mesh.faces)} faces")
        elif there in SKELETON_WRITERS and here in SKELETON_READERS:
            skeleton = read_skeleton(self.source, self.unit)
            write_skeleton(self.target, skeleton, self.target_unit)
            say(f"{self.target}: {skeleton.num_joints} joints")
        elif here in MOTION_READERS and there in MOTION_WRITERS:
            skeleton, motion = read_motion(self.source, self.unit)
            write_motion(self.target, skeleton, motion, self.target_unit)
            say(f"{self.target}: {motion.num_frames} frames at {motion.rate:g} a second")
        else:
            raise InputError(
                f"{self.source}: '{here}' files cannot become '{there}' files; motions are read from "
                f"{', '.join(MOTION_READERS)} and written as {', '.join(MOTION_WRITERS)}, skeletons as .skl, "
                "bodies as .glb."
            )

    def write_body(self) -> None:
        body = load_body(self.source)
        motion = None if self.motion is None else read_motion_of(body, self.motion)
        poses = sample_poses(body.skeleton) if motion is None else motion.poses
        linearised = linearise(body, poses, self.tolerance, influences=self.influences)
        linear, joints = linearised.body, body.skeleton.num_joints
        write_gltf(self.target, linear, None if motion is None else linear_motion(linearised, motion))
        virtual, count = linear.skeleton.num_joints - joints, poses.rotations.shape[0]
        say(
            f"{self.target}: {len(linear.vertices)} vertices, {joints} joints, {virtual} virtual bones; "
            f"within {1000 * linearised.error:.2g} mm of the body, {1000 * linearised.mean_error:.2g} mm on "
            f"average, over {count} {'sampled poses' if motion is None else 'frames'}"
        )
        if linearised.error > self.tolerance:
            warn(
                f"{self.target}: {1000 * linearised.error:.2g} mm at the worst vertex is more than the tolerance of "
                f"{1000 * self.tolerance:.2g} mm; more --influences come nearer"
            )
