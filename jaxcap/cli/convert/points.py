"""Points to convert: the unit of markers, and the paths of a motion's joint centres and of vertices of its body."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ...body.body import Body
from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ...errors import InputError
from ...io.markers.marker_file import MarkerFile, check_marker_extent, select_subject
from ...io.meshes.vertex_list import read_vertex_list
from ...io.registry import write_markers
from ...markers.body_shape.vertex_markers import vertex_frames
from ...markers.motion.gap_filling import joint_frames
from ...observe.marker_labels import group_by_subject
from ...observe.markers import make_markers
from ..console.console import pluralise, say
from ..markers.takes import UNIT_ASKED


def read_labels(words: Sequence[str]) -> dict[str, int]:
    """Parse marker labels with their vertices, from `NUMBER`, `NAME=NUMBER`, or files of these. Raises
    `InputError`."""
    found: dict[str, int] = {}
    for word in words:
        name, _, number = word.rpartition("=")
        if number.isdecimal():
            new = {name or f"v{int(number)}": int(number)}
        elif Path(word).is_file():
            new = read_vertex_list(word)
        else:
            raise InputError(
                f"'{word}' is neither a vertex, such as 88 or LFHD=88, nor a file of names and vertices."
            )
        twice = set(found) & set(new)
        if twice:
            raise InputError(
                f"--vertices has two markers named '{min(twice)}'; give each marker a different name."
            )
        found |= new
    return found


def check_marker_unit(file: MarkerFile, path: Path) -> None:
    """Check that the markers of each subject have the size of a body in the unit of the file, which the user did
    not give. Raises `InputError`."""
    hint = f"{UNIT_ASKED}, or --unit {file.unit} if the size is right"
    for subject in group_by_subject(file.frames.labels) or (None,):
        check_marker_extent(select_subject(file.frames, path, subject), path, file.scale, option_hint=hint)


def write_points(
    target: Path,
    skeleton: Skeleton,
    motion: Motion,
    body: Body | None,
    labels: Mapping[str, int],
    unit: str | None,
) -> None:
    """Write the paths of joint centres, followed by markers at vertices of the body, if any.

    **Raises:** `InputError` if the body has no such vertex, a marker has the name of a joint, or the file
    cannot be written.
    """
    frames = joint_frames(skeleton, motion)
    if body is not None and labels:
        beyond = [name for name, vertex in labels.items() if vertex >= len(body.vertices)]
        if beyond:
            raise InputError(
                f"--vertices: '{beyond[0]}' is vertex {labels[beyond[0]]}, but the vertices of the body are "
                f"0 to {len(body.vertices) - 1}."
            )
        alike = set(labels) & set(skeleton.names)
        if alike:
            raise InputError(
                f"--vertices: a joint already has the name '{min(alike)}'; give the marker another name."
            )
        markers = vertex_frames(body, motion, list(labels.values()), list(labels))
        places = np.concatenate([np.asarray(frames.positions), np.asarray(markers.positions)], 1)
        frames = make_markers(places, (*frames.labels, *markers.labels), motion.rate)
    write_markers(target, frames, unit)
    more = f" and {len(labels)} markers" if labels else ""
    say(
        f"{target}: {skeleton.num_joints} joint centres{more}, {pluralise(len(frames), 'frame')} at {frames.rate:g} frames per second"
    )
