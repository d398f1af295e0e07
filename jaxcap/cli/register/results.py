"""The output of `jaxcap register`: one `.npz`, or a folder of meshes."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from ...adapt.registration.collect import RegisteredMeshes
from ...adapt.registration.register_scans import RegisteredScan
from ...errors import InputError
from ...geometry.mesh import vertex_normals
from ...io.meshes.meshes import save_meshes
from ...io.meshes.obj import write_obj
from ...io.meshes.ply import write_ply
from ..console.console import say, warn
from ..outputs import check_npz, make_folder

MeshKind = Literal["ply", "obj"]
#: largest number of frames that are listed with their reasons
NAMED = 20
#: least share of a body's surface that some scan shows
MIN_SEEN_SHARE = 0.9


def is_folder(out: Path) -> bool:
    """Test if meshes are written to a folder: a name without a suffix."""
    return out.is_dir() or not out.suffix


def check_out(out: Path, overwrite: bool) -> None:
    """Check that registered meshes can be written, and make their folder. Raises `InputError`."""
    if not is_folder(out):
        check_npz(out, overwrite, "a sequence of registered meshes")
        return
    make_folder(out)
    there = _meshes_in(out)
    if there and not overwrite:
        raise InputError(f"{out}: this folder contains registered meshes; give --overwrite to replace them.")


def write_registered(out: Path, found: RegisteredMeshes, names: Sequence[str], kind: MeshKind) -> None:
    """Write meshes with the names of their scans, and for each vertex its distance and whether it is seen, or a folder of
    mesh files, numbered by frame."""
    if not is_folder(out):
        extra = {
            "frames": np.array(found.frames, int),
            "seen": found.seen,
            "distances": found.distances.astype(np.float32),
        }
        save_meshes(out, found.meshes, [Path(names[frame]).name for frame in found.frames], extra)
        return
    for path in _meshes_in(out):
        path.unlink()
    faces = np.asarray(found.meshes.faces)
    for frame, mesh in zip(found.frames, found.meshes.vertices, strict=True):
        path, vertices = out / f"registered_{frame:04d}.{kind}", np.asarray(mesh, float)
        if kind == "ply":
            write_ply(path, vertices, np.asarray(vertex_normals(vertices, faces)), faces=faces)
        else:
            write_obj(path, vertices, faces)


def print_registered(
    out: Path, found: RegisteredMeshes, scans: Sequence[RegisteredScan], names: Sequence[str]
) -> None:
    """Print the result, and warn of frames that failed and of parts whose guide was poor."""
    distance = 1000 * float(np.median(found.median_distances))
    worst = 1000 * float(found.median_distances.max())
    ever = found.seen.any(0)
    say(
        f"{out}: {len(found.frames)} of {len(scans)} scans as meshes of {found.seen.shape[1]} vertices; {distance:.2f} mm from scan to "
        f"surface, median, and {worst:.2f} mm in the worst scan; {found.seen.mean():.0%} of the vertices are seen in a scan, {ever.mean():.0%} in some"
    )
    _warn_of(
        f"{len(found.failures)} of {len(scans)} scans are left out:",
        dict(sorted(found.failures.items())),
        names,
    )
    poor = {scan.frame: scan.poor_parts for scan in scans if scan.poor_parts and scan.frame in found.frames}
    _warn_of(
        f"the body was far from {len(poor)} of {len(scans)} scans before its vertices moved; check the vertices there:",
        {
            frame: ", ".join(f"{name} {1000 * shift:.0f} mm" for name, shift in parts)
            for frame, parts in poor.items()
        },
        names,
    )
    if ever.mean() < MIN_SEEN_SHARE:
        warn(f"{1 - ever.mean():.0%} of the vertices are seen in no scan; they have the shape of the body")


def _warn_of(sentence: str, reasons: dict[int, str], names: Sequence[str]) -> None:
    if not reasons:
        return
    warn(sentence)
    for frame, reason in list(reasons.items())[:NAMED]:
        warn(f"  {Path(names[frame]).name}: {reason}")
    if len(reasons) > NAMED:
        warn(f"  and {len(reasons) - NAMED} more: frames {', '.join(map(str, list(reasons)[NAMED:]))}")


def _meshes_in(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if re.fullmatch(r"registered_\d{4,}\.(ply|obj)", path.name)]
