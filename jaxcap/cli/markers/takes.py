"""Input takes of the marker verbs: shared options, fragmented trajectories, and the up axis."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
import tyro

from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ...errors import InputError
from ...io.markers.marker_file import check_marker_extent, select_subject
from ...io.markers.up_axis import UpAxis, find_up_axis
from ...io.registry import MARKER_WRITERS, read_marker_file, write_markers
from ...markers.human.static_pose import MAX_SWAY
from ...markers.motion.gap_filling import joint_frames
from ...markers.segments.gaps import find_pieces, join_pieces, split_unlabelled
from ...markers.segments.rigid_motion import displacement
from ...markers.subjects.split_subjects import find_named_groups, select_members
from ...observe.marker_labels import group_by_subject
from ...observe.markers import MarkerFrames
from ..console.console import pluralise, say, warn
from ..console.options import arg
from ..outputs import check_absent, check_parent
from ..sources import Up, up_rotation

TakesSpec = tyro.conf.Positional[Annotated[tuple[str, ...], arg(metavar="FILES...", help_behavior_hint="")]]
OptionalSubject = Annotated[str | None, arg(metavar="NAME", help_behavior_hint="")]
OptionalUp = Annotated[Up | None, arg(metavar="{x,y,z,-x,-y,-z}", help_behavior_hint="")]
OptionalFolder = Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")]
Files = Annotated[tuple[Path, ...], arg(metavar="FILE...", help_behavior_hint="")]
#: treatment of trajectories that look like one under several names
Pieces = Literal["refuse", "join", "keep"]
#: least number of markers of a subject whose extent is that of a body
MIN_BODY_MARKERS = 6
#: the advice to the user if a unit looks wrong
UNIT_ASKED = "give --unit {} if it is"


class Take(NamedTuple):
    """The markers of a file, the time of its first frame, seconds, and its up axis."""

    frames: MarkerFrames
    start: float
    #: the up axis of the frames, if it is known
    up: str | None


def read_take(
    path: str,
    unit: str | None,
    subject: str | None,
    up: Up | None,
    pieces: Pieces,
    *,
    several: bool = False,
) -> Take:
    """Read the markers of a file, rotated to y up if `up` gives the up axis.

    With `several` the markers of all subjects are read if none is given, and keep their prefixes.

    **Raises:** `InputError` if the file is invalid, or has fragmented trajectories that are to be refused.
    """
    file = read_marker_file(path, unit)
    frames, left_out = choose_subject(file.frames, path, subject, several), ()
    if not find_named_groups(file.frames):
        frames, left_out = check_marker_extent(frames, path, file.scale, option_hint=UNIT_ASKED)
    for one in largest_subject(file.frames):
        check_marker_extent(one, path, file.scale, option_hint=UNIT_ASKED)
    if pieces != "keep":
        frames = _whole(frames, path, pieces == "join")
    # several people side by side are wider than they are tall
    found = find_up_axis(file._replace(frames=next(iter(largest_subject(frames)), frames)))
    if up is not None:
        turn = up_rotation(up).astype(np.asarray(frames.positions).dtype)
        frames = MarkerFrames(
            np.asarray(frames.positions) @ turn.T, frames.visible, frames.labels, frames.rate
        )
    for sentence in (*file.warnings, *left_out):
        warn(f"{Path(path).name}: {sentence}")
    shown = 100 * np.asarray(frames.visible).mean()
    say(
        f"{Path(path).name}: {pluralise(len(frames), 'frame')} at {frames.rate:g} frames per second, {pluralise(len(frames.labels), 'marker')}, "
        f"{shown:.{1 if shown < 99.9 else 3}f} % seen; {describe_up(found, up)}"
    )
    return Take(frames, file.start, "y" if up is not None else None if found is None else found.axis)


def separate_static(
    takes: Sequence[MarkerFrames], paths: Sequence[str]
) -> tuple[MarkerFrames | None, list[MarkerFrames]]:
    """Find the first take in which nothing moves, if others do; return it and the others."""
    still = [number for number, take in enumerate(takes) if displacement(take) < MAX_SWAY]
    if not still or len(still) == len(takes):
        return None, list(takes)
    say(f"{paths[still[0]]}: the person stands still, so this is the static trial")
    return takes[still[0]], [take for number, take in enumerate(takes) if number != still[0]]


def choose_subject(frames: MarkerFrames, path: str, subject: str | None, several: bool) -> MarkerFrames:
    """Select the markers of a subject by a prefix or a suffix of the labels; with `several` all, where none is given."""
    if subject is None and several and len(group_by_subject(frames.labels)) > 1:
        return frames
    if subject is not None and subject not in group_by_subject(frames.labels):
        named = find_named_groups(frames)
        if subject in named:
            return select_members(frames, named[subject])
    return select_subject(frames, path, subject, "--subject {}")


def largest_subject(frames: MarkerFrames) -> list[MarkerFrames]:
    """Select the subject with most markers, of several, which shows the unit; a small prop may have any size."""
    named = find_named_groups(frames)
    if not named:
        return []
    most = max(named.values(), key=len)
    return [select_members(frames, most)] if len(most) >= MIN_BODY_MARKERS else []


def describe_up(found: UpAxis | None, given: Up | None) -> str:
    """Describe the up axis of a file, `found` in it or `given` by the user, and of the results."""
    if given is not None:
        other = "" if found is None or found.axis == given else f" ({describe_source(found)})"
        return f"{given} is up by --up{other}" + ("" if given == "y" else ", converted to y")
    if found is None:
        return "the up axis is unknown and is kept (if it is not y, --up converts it to y)"
    kept = "" if found.axis == "y" else f" and is kept (--up {found.axis} converts it to y)"
    return f"{describe_source(found)}{kept}"


def describe_source(found: UpAxis) -> str:
    """Describe the up axis of a file and its source."""
    return f"{found.axis} is up by the header" if found.is_stated else f"{found.axis} is probably up"


def _whole(frames: MarkerFrames, path: str, join: bool) -> MarkerFrames:
    parts = split_unlabelled(frames)
    chains = find_pieces(parts)
    if len(chains) == 0:
        return frames
    names = [", ".join(parts.labels[i] for i in chain) for chain in chains]
    if not join:
        more = f", and {len(chains) - 1} more trajectories are in pieces" if len(chains) > 1 else ""
        raise InputError(
            f"{path}: {names[0]} look like one trajectory in {len(chains[0])} pieces{more}; give --pieces join to make "
            "each one marker, or --pieces keep if they are separate markers."
        )
    for name in names:
        warn(f"{Path(path).name}: {name} are joined to one marker.")
    return join_pieces(parts, chains)


def check_points(paths: Sequence[Path], what: str) -> None:
    """Check that files of points can be written. Raises `InputError`."""
    for path in paths:
        if path.suffix.lower() not in MARKER_WRITERS:
            raise InputError(
                f"{path}: {what} are not written as '{path.suffix}' files; use {', '.join(MARKER_WRITERS)}."
            )
        check_parent(path)


def check_folder(folder: Path | None) -> None:
    """Check that a folder exists or can be made; it is made with the results. Raises `InputError`."""
    above = folder
    while above is not None and not above.exists() and above != above.parent:
        above = above.parent
    if above is not None and not above.is_dir():
        raise InputError(f"{folder}: {above} is a file, so the folder cannot be created; give another one.")
    if above is not None and not os.access(above, os.W_OK):
        raise InputError(f"{folder}: this folder cannot be written to; give another one.")


def check_new(paths: Sequence[Path], overwrite: bool) -> None:
    """Check that no file is replaced without --overwrite, and no two results are one file. Raises
    `InputError`."""
    check_absent(paths, overwrite)
    places = [path.absolute() for path in paths]
    twice = [path for path, place in zip(paths, places, strict=True) if places.count(place) > 1]
    if twice:
        raise InputError(f"{twice[0]}: two results would be this same file; give each a different name.")


def write_joints(
    paths: Sequence[Path], skeleton: Skeleton, motion: Motion, lost: np.ndarray | None = None
) -> None:
    """Write the joint centres as points with the joints' names."""
    if paths:
        centres = joint_frames(skeleton, motion, lost)
        for path in paths:
            write_markers(path, centres)
            say(f"joint centres: {path}")
