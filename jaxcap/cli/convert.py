"""`jaxcap convert`: the same content in another format."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ..errors import InputError
from ..io.mesh import SUFFIXES, read_mesh, write_mesh
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
from .options import Flag, OptionalUnit, arg
from .say import say


@dataclass
class Convert:
    """Write a motion (bvh, npz, amc with its asf beside it), a mesh or a skeleton in another format.

    Suffixes say what is what."""

    source: tyro.conf.Positional[Annotated[Path, arg(metavar="SOURCE")]]
    """The file to read."""
    target: tyro.conf.Positional[Annotated[Path, arg(metavar="TARGET")]]
    """The file to write."""
    unit: OptionalUnit = None
    """Unit of the source's lengths; metres where not given, centimetres in BVH."""
    target_unit: OptionalUnit = None
    """Unit of the target's lengths; metres where not given, centimetres in BVH."""
    overwrite: Flag = False
    """Replace the target where it is there."""

    def run(self) -> None:
        here, there = self.source.suffix.lower(), self.target.suffix.lower()
        if self.target.exists() and not self.overwrite:
            raise InputError(f"{self.target}: this file is there already; give --overwrite to replace it.")
        if not self.source.is_file():
            raise InputError(f"{self.source}: there is no such file; check the path.")
        if here in SUFFIXES:
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
                f"{', '.join(MOTION_READERS)} and written as {', '.join(MOTION_WRITERS)}, skeletons as .skl."
            )
