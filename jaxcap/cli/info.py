"""`jaxcap info`: what is in a file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from ..body.body import Body
from ..body.pose import Motion
from ..body.skeleton import Skeleton
from ..errors import InputError
from ..io.clouds import read_clouds
from ..io.limits import KIND as LIMITS
from ..io.limits import load_limits
from ..io.mesh import SUFFIXES, check_mesh, read_mesh
from ..io.meshes import KIND as MESHES
from ..io.meshes import read_meshes
from ..io.npz import load_arrays, load_body
from ..io.prior import KIND as PRIOR
from ..io.prior import load_prior
from ..io.registry import (
    MOTION_READERS,
    SKELETON_READERS,
    SKINNED_READERS,
    is_skinned,
    read_motion,
    read_skeleton,
    read_skinned,
)
from ..io.subject import KIND as SUBJECT
from ..io.subject import load_subject
from .options import OptionalUnit, arg
from .say import say
from .sources import load_body as load_any_body
from .sources import names_human


@dataclass
class Info:
    """Say what is in a file: a mesh, a body, a skeleton, a motion, a subject, limits, a prior, or clouds."""

    file: tyro.conf.Positional[Annotated[str, arg(metavar="FILE")]]
    """A file, a printf pattern or a folder of clouds, or `human`."""
    unit: OptionalUnit = None
    """Unit of the file's lengths, where it does not say it: m, dm, cm, mm, in or ft."""

    def run(self) -> None:
        path = Path(self.file)
        suffix = path.suffix.lower()
        if names_human(self.file):
            _body(load_any_body(self.file)[0])
        elif path.is_dir() or not path.is_file():
            _clouds(self.file, self.unit or "m")
        elif is_skinned(path):
            body, motion = read_skinned(path)
            if motion is not None:
                _motion(motion)
            _body(body)
        elif suffix in SUFFIXES:
            _mesh(path, self.unit or "m")
        elif suffix == ".npz":
            self._arrays(path)
        elif suffix in MOTION_READERS:
            skeleton, motion = read_motion(path, self.unit)
            _motion(motion)
            _skeleton(skeleton)
        elif suffix in SKELETON_READERS:
            _skeleton(read_skeleton(path, self.unit))
        else:
            known = sorted({*SUFFIXES, *SKINNED_READERS, *MOTION_READERS, *SKELETON_READERS})
            raise InputError(f"{path}: '{suffix}' files are not known; give one of {', '.join(known)}.")

    def _arrays(self, path: Path) -> None:
        arrays = load_arrays(path)
        kind = str(arrays["format"]) if "format" in arrays else ""
        if kind == "jaxcap body":
            _body(load_body(path))
        elif kind == "jaxcap motion":
            skeleton, motion = read_motion(path)
            _motion(motion)
            _skeleton(skeleton)
        elif kind == SUBJECT:
            subject = load_subject(path)
            held = int((np.asarray(subject.weights) > 0).sum())
            say(f"subject: {subject.num_markers} markers, {held} of them on its bones")
            _skeleton(subject.skeleton)
        elif kind == MESHES:
            sequence = read_meshes(path, self.unit or "m")
            say(
                f"registered meshes: {len(sequence)} of {sequence.vertices.shape[1]} vertices and "
                f"{len(sequence.faces)} triangles, the first {_metres(np.ptp(np.asarray(sequence[0]), axis=0))}"
            )
        elif kind == LIMITS:
            for surface in load_limits(path).surfaces:
                keyframes, primitives = surface.centres.shape[:2]
                coupled = "" if surface.parent is None else f", {keyframes} keyframes of {surface.parent}"
                say(
                    f"limits of {surface.joint}: {surface.chart.dimension} angles, {primitives} primitives in voxels from "
                    f"{np.degrees(4 * float(surface.unit)):.2g} degrees{coupled}"
                )
        elif kind == PRIOR:
            prior = load_prior(path)
            for (parent, child), weights in zip(prior.pairs, np.asarray(prior.weights), strict=True):
                say(f"prior of {parent} and {child}: {int((weights > 0).sum())} components")
        elif {"points", "vertices"} & set(arrays):
            _clouds(str(path), self.unit or "m")
        else:
            for name, values in arrays.items():
                say(f"{name}: {values.dtype} {values.shape}")


def _body(body: Body) -> None:
    size = np.ptp(np.asarray(body.vertices), axis=0)
    say(
        f"body: {len(body.vertices)} vertices, {len(body.faces)} faces, {_metres(size)}, {type(body.skin).__name__}"
    )
    _skeleton(body.skeleton)


def _skeleton(skeleton: Skeleton) -> None:
    kinds = [f"{skeleton.kinds.count(kind)} {kind}" for kind in dict.fromkeys(skeleton.kinds)]
    say(f"skeleton: {skeleton.num_joints} joints ({', '.join(kinds)}), {skeleton.num_dofs} parameters")
    for name, parent, kind, depth in zip(
        skeleton.names, skeleton.parents, skeleton.kinds, skeleton.depths, strict=True
    ):
        above = "" if parent < 0 else f" on {skeleton.names[parent]}"
        say(f"{'  ' * (int(depth) + 1)}{name} ({kind}{above})")


def _motion(motion: Motion) -> None:
    count = motion.num_frames
    say(f"motion: {count} frames at {motion.rate:g} a second, {count / motion.rate:.2f} s")


def _mesh(path: Path, unit: str) -> None:
    mesh = read_mesh(path, unit)
    what = "mesh" if len(mesh.faces) else "cloud"
    normals = ", with normals" if mesh.normals is not None else ""
    say(
        f"{what}: {len(mesh.vertices)} vertices, {len(mesh.faces)} faces, {_metres(np.ptp(mesh.vertices, axis=0))}{normals}"
    )
    if len(mesh.faces):
        try:
            check_mesh(mesh, path)
        except InputError as error:
            say(f"not a surface for a body: {error}")


def _clouds(source: str, unit: str) -> None:
    scans = read_clouds(source, unit=unit)
    first = scans[0]
    normals = "with" if first.normals is not None else "without"
    say(
        f"clouds: {len(scans)} frames; the first has {len(first.points)} points {normals} normals, "
        f"{_metres(np.ptp(first.points, axis=0))}"
    )


def _metres(size: np.ndarray) -> str:
    return " x ".join(f"{length:.3g}" for length in size) + " m"
