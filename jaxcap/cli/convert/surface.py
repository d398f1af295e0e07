"""The surface of a body as meshes: at rest, or in each frame of a motion."""

from pathlib import Path

import equinox as eqx
import numpy as np

from ...body.body import Body, pose_body
from ...body.pose import Motion
from ...errors import InputError
from ...io.meshes.mesh import Mesh, write_mesh
from ...io.system.paths import numbered_path
from ..console.console import pluralise, progress, say
from ..outputs import check_absent

_posed_vertices = eqx.filter_jit(lambda body, pose: pose_body(body, pose).vertices)


def check_single(target: Path) -> None:
    """Check that the name of a single mesh has no number of a frame. Raises `InputError`."""
    if numbered_path(target, 0) is not None:
        raise InputError(
            f"{target}: the name has a frame number, but there is no motion; give --motion, or a name without a number."
        )


def write_surface(
    target: Path, body: Body, motion: Motion | None, unit: str | None, overwrite: bool = False
) -> None:
    """Write the surface of a body at rest, or in each frame of a motion to files with the numbers of the frames.

    **Raises:** `InputError` if a motion of several frames has a target without a number, or a body at rest has one, or a file cannot
    be written.
    """
    faces = np.asarray(body.faces)
    if motion is None:
        check_single(target)
        write_mesh(target, Mesh(np.asarray(body.vertices), faces), unit or "m")
        say(f"{target}: {len(body.vertices)} vertices, {len(faces)} faces, at rest")
        return
    count = motion.num_frames
    if count > 1 and numbered_path(target, 0) is None:
        raise InputError(
            f"{target}: the motion has {count} frames, and a mesh is one of them; give a name with the number of the frame, such as "
            f"{target.stem}_%04d{target.suffix}."
        )
    paths = [numbered_path(target, frame) or target for frame in range(count)]
    check_absent(paths, overwrite)
    for frame, path in enumerate(progress(paths, count, label="writing", noun="meshes")):
        write_mesh(path, Mesh(np.asarray(_posed_vertices(body, motion[frame])), faces), unit or "m")
    say(f"{target}: {pluralise(count, 'mesh', 'meshes')}, {len(body.vertices)} vertices, {len(faces)} faces")
