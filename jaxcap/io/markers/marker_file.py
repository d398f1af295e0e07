"""Shared parts of the readers of marker files: labels, subjects, implausible units, regular frames."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...errors import InputError
from ...markers.segments.gaps import list_runs
from ...observe.marker_labels import group_by_subject
from ...observe.markers import MarkerFrames
from ...units import UNIT_NAMES, likely_units, unit_scale
from ..text import MAX_NUMBER, check_frame_rate

#: bounds in metres of the longest side of the markers of one frame
BODY_SIZE_RANGE = (0.2, 5.0)
#: points are far if they are this many times as far from the middle of a frame as this share of its points; a frame needs
#: a number of points for that, and the far ones are at most a share of all
FAR_RATIO, FAR_QUANTILE, MIN_POINTS, MAX_FAR = 5.0, 0.9, 5, 0.1
#: number of labels in a sentence
MAX_LISTED = 8
#: names of units in files, in lower case and without the plural s
_UNIT_WORDS = {
    "m": ("m", "meter", "metre"),
    "dm": ("dm", "decimeter", "decimetre"),
    "cm": ("cm", "centimeter", "centimetre"),
    "mm": ("mm", "millimeter", "millimetre"),
    "in": ("in", "inch", "inche", '"'),
    "ft": ("ft", "foot", "feet"),
}


class MarkerFile(NamedTuple):
    """The data of a marker file."""

    #: all markers; labels as in the file, with their subject's prefix
    frames: MarkerFrames
    #: metres in one unit of the file, and the unit's name there
    scale: float
    unit: str
    #: the number of the first frame in the file
    first_frame: int
    #: type -> labels of the points that are no markers: angles, forces, ...
    other_points: dict[str, tuple[str, ...]]
    #: repaired faults of the file, one sentence each
    warnings: tuple[str, ...]
    #: the vertical axis of the screen by the header, as in "z" or "-z"; empty if it is not stated
    up: str = ""
    #: time of the first frame, seconds
    start: float = 0.0


def parse_unit(word: str, default: str = "mm") -> str:
    """Return the unit that a file calls `word`; `default` if it is empty or unknown."""
    word = word.strip().lower()
    return next(
        (unit for unit, words in _UNIT_WORDS.items() if word in words or word.rstrip("s") in words), default
    )


def parse_screen_axis(word: str) -> str:
    """Return the axis, as "z" or "-z", that a file calls `word`, as in `+Z`; "" for another word."""
    sign, letter = ("-" if word.strip().startswith("-") else ""), word.strip().lstrip("+-").lower()
    return f"{sign}{letter}" if letter in ("x", "y", "z") else ""


def make_labels_unique(labels: Sequence[str], count: int) -> tuple[list[str], list[str]]:
    """Make `count` labels unique; return them with sentences on the changes.

    Surrounding blanks are removed. An empty label becomes `*7`, as capture programs name unlabelled points;
    the second `A` becomes `A_2`. Labels after the first `count` are dropped.
    """
    messages, names = [], [label.strip(" \t\r\n\0") for label in labels[:count]]
    names += [""] * (count - len(names))
    nameless = [i for i, name in enumerate(names) if not name]
    if nameless:
        messages.append(f"{len(nameless)} points have no label, the first is point {nameless[0] + 1}; they are labelled "
                    f"*{nameless[0] + 1} and so on.")  # fmt: skip
    names = [name or f"*{i + 1}" for i, name in enumerate(names)]
    taken, renamed = set(names), []
    counts: Counter[str] = Counter()
    for i, name in enumerate(names):
        counts[name] += 1
        if counts[name] > 1:
            number = counts[name]
            while f"{name}_{number}" in taken:
                number += 1
            names[i] = f"{name}_{number}"
            taken.add(names[i])
            renamed.append((name, names[i]))
    if renamed:
        listed = ", ".join(f"'{name}' ('{new}')" for name, new in renamed[:MAX_LISTED])
        messages.append(
            f"{len(renamed)} points have the label of an earlier one and are renamed: {listed}{', ...' if len(renamed) > MAX_LISTED else ''}."
        )
    return names, messages


def find_copies(labels: Sequence[str], positions: Float[np.ndarray, "F M 3"]) -> list[int]:
    """Find the points that have the label of an earlier point, and its positions in all frames."""
    first: dict[str, list[int]] = {}
    copies = []
    for index, label in enumerate(name.strip(" \t\r\n\0") for name in labels[: positions.shape[1]]):
        same = first.setdefault(label, [])
        if label and any(
            np.array_equal(positions[:, index], positions[:, one], equal_nan=True) for one in same
        ):
            copies.append(index)
        same.append(index)
    return copies


def select_subject(
    frames: MarkerFrames, where: str | Path, subject: str | None = None, option_hint: str = "subject='{}'"
) -> MarkerFrames:
    """Select the markers of one subject, and remove the prefix of their labels.

    With at most one subject in the file, these are all markers. With more, `subject` selects one, and markers
    without a prefix are dropped. `option_hint` is the advice on the choice in errors.

    **Raises:** `InputError` with the names of the subjects, if there are several and none is selected.
    """
    subjects = group_by_subject(frames.labels)
    if subject is not None and subject not in subjects:
        there = f"it has {_list_subjects(subjects)}" if subjects else "no label has a prefix such as 'Anna:'"
        raise InputError(f"{where}: the file has no subject '{subject}'; {there}.")
    if subject is None and len(subjects) > 1:
        raise InputError(
            f"{where}: the file has {len(subjects)} subjects, {_list_subjects(subjects)}; select one with "
            f"{option_hint.format(max(subjects, key=lambda name: len(subjects[name])))}."
        )
    if not subjects:
        return frames
    chosen = range(len(frames.labels)) if subject is None else subjects[subject]
    prefixed = {i for members in subjects.values() for i in members}
    short = [frames.labels[i].partition(":")[2] if i in prefixed else frames.labels[i] for i in chosen]
    labels, _ = make_labels_unique(short, len(short))
    index = np.asarray(list(chosen))
    return MarkerFrames(frames.positions[:, index], frames.visible[:, index], tuple(labels), frames.rate)


def frame_sides(frames: MarkerFrames) -> Float[np.ndarray, "N 3"]:
    """Compute the sides of the markers' bounding box, metres, in each frame that shows two markers."""
    seen = np.asarray(frames.visible)
    several = seen.sum(1) > 1
    places, seen = np.asarray(frames.positions, float)[several], seen[several][..., None]
    return np.where(seen, places, -np.inf).max(1) - np.where(seen, places, np.inf).min(1)


def median_extent(frames: MarkerFrames) -> float:
    """Compute the median over frames of the longest side of the markers' bounding box, in metres.

    NaN if no frame shows two markers.
    """
    sides = frame_sides(frames)
    return float(np.median(sides.max(1))) if len(sides) else float("nan")


def check_marker_extent(
    frames: MarkerFrames,
    where: str | Path,
    scale: float,
    size: tuple[float, float] = BODY_SIZE_RANGE,
    option_hint: str = "pass unit='{}', or another size if the unit is right",
) -> tuple[MarkerFrames, tuple[str, ...]]:
    """Check that the markers have the size of a body, for a file unit of `scale` metres; return them with sentences on changes.

    If the markers extend too far because of a few points that are much farther away than the others, such as reflections on
    a wall, these points become gaps. `option_hint` is the advice on the unit in errors.

    **Raises:** `InputError` with the likely unit.
    """
    extent = median_extent(frames)
    if np.isnan(extent) or size[0] <= extent <= size[1]:
        return frames, ()
    far = _far_points(frames) if extent > size[1] else np.zeros(np.shape(frames.visible), bool)
    if 0 < far.sum() <= MAX_FAR * np.asarray(frames.visible).sum():
        near = MarkerFrames(
            np.where(far[..., None], 0.0, frames.positions), frames.visible & ~far, frames.labels, frames.rate
        )
        if size[0] <= median_extent(near) <= size[1]:
            return near, (_describe_far(frames.labels, far),)
    length = extent / scale
    likely = likely_units(length, *size)
    hint = (
        f"this looks like {UNIT_NAMES[likely[0]]}: {option_hint.format(likely[0])}"
        if likely
        else "check the unit"
    )
    raise InputError(
        f"{where}: the markers of a frame extend over {extent:.4g} m; expected {size[0]:g} to "
        f"{size[1]:g} m for a body; {hint}."
    )


def _far_points(frames: MarkerFrames) -> Bool[np.ndarray, "F M"]:
    """Find the points that are much farther from the middle of a frame than nine tenths of its points; any unit."""
    seen = np.asarray(frames.visible)
    counts = seen.sum(1)
    places = np.where(seen[..., None], np.asarray(frames.positions, float), np.nan)
    middle = np.zeros((len(seen), 1, 3))
    middle[counts > 0, 0] = np.nanmedian(places[counts > 0], axis=1)
    away = np.where(seen, np.linalg.norm(places - middle, axis=2), np.inf)
    rank = np.maximum(np.floor(FAR_QUANTILE * (counts - 1)).astype(int), 0)
    usual = np.take_along_axis(np.sort(away, axis=1), rank[:, None], 1)
    return seen & (counts >= MIN_POINTS)[:, None] & (away > FAR_RATIO * usual)


def _describe_far(labels: Sequence[str], far: Bool[np.ndarray, "F M"]) -> str:
    columns = np.flatnonzero(far.any(0))
    names = ", ".join(f"'{labels[i]}'" for i in columns[:MAX_LISTED])
    return (
        f"points of {names}{', ...' if len(columns) > MAX_LISTED else ''} are more than {FAR_RATIO:g} times as far away as the other "
        f"markers, and are left out, in frames {list_runs(np.asarray(far.any(1)))}."
    )


def make_marker_file(
    where: str | Path,
    positions: Float[np.ndarray, "F M 3"],
    labels: Sequence[str],
    rate: float,
    unit: str | float,
    *,
    first_frame: int = 1,
    other_points: dict[str, tuple[str, ...]] | None = None,
    warnings: Sequence[str] = (),
    up: str = "",
    start: float | None = None,
) -> MarkerFile:
    """Build a `MarkerFile` from positions in the file's `unit`, NaN for gaps.

    `start` is the time of the first frame, seconds; by default that of its number.

    A position of zero in all three coordinates is a gap as well, as many programs write gaps in this form.

    **Raises:** `InputError` if there are no markers or frames, none is ever visible, or the rate is invalid.
    """
    if positions.shape[1] == 0:
        more = f"; it contains only {_list_point_types(other_points)}" if other_points else ""
        raise InputError(f"{where}: the file has no markers{more}; give a file of marker trajectories.")
    if len(positions) == 0:
        raise InputError(f"{where}: the file has no frames; give a file of marker trajectories.")
    copies = find_copies(labels, positions)
    kept = [index for index in range(positions.shape[1]) if index not in copies]
    positions = positions[:, kept]
    names, changed = make_labels_unique([labels[index] for index in kept if index < len(labels)], len(kept))
    if copies:
        changed.append(
            f"{len(copies)} points are copies of earlier ones with the same labels, the first of '{labels[copies[0]].strip()}', and are left out."
        )
    lost = np.isnan(positions).any(2) | (positions == 0).all(2)
    if lost.all():
        raise InputError(
            f"{where}: none of its {len(names)} markers is visible in any of {len(positions)} frames."
        )
    scale = unit_scale(unit)
    beyond = ~lost & ~(np.abs(np.where(lost[..., None], 0.0, positions)) * scale <= MAX_NUMBER).all(2)
    if beyond.sum() > MAX_FAR * (~lost).sum():
        raise InputError(
            f"{where}: markers are too far away, at 1e15 m or more, in frames {list_runs(beyond.any(1))}; check the numbers and the unit."
        )
    if beyond.any():
        label = names[int(np.flatnonzero(beyond.any(0))[0])]
        changed.append(
            f"{int(beyond.sum())} positions are at 1e15 m or more, the first of '{label}', and are left out, in frames "
            f"{list_runs(beyond.any(1))}."
        )
        lost |= beyond
    check_frame_rate(rate, str(where))
    # `check_marker_extent` checks the unit, as it knows other units
    frames = MarkerFrames(np.where(lost[..., None], 0.0, positions * scale), ~lost, tuple(names), float(rate))
    said = unit if isinstance(unit, str) else f"{unit:g} m"
    start = max(first_frame - 1, 0) / rate if start is None else start
    return MarkerFile(frames, scale, said, first_frame, other_points or {}, (*warnings, *changed), up, start)


def shift_from_origin(frames: MarkerFrames) -> tuple[Float[np.ndarray, "F M 3"], Bool[np.ndarray, "F M"]]:
    """Return positions and visibility for writing; a marker exactly at the origin is moved by a nanometre.

    Zeros in files are gaps.
    """
    positions, seen = np.array(frames.positions, float), np.asarray(frames.visible)
    positions[seen & (positions == 0).all(2), 0] = 1e-9
    return positions, seen


def fill_missing_frames(
    where: str | Path, times: Float[np.ndarray, "R"], positions: Float[np.ndarray, "R M 3"], what: str
) -> tuple[float, Float[np.ndarray, "F M 3"]]:
    """Place rows with times on regular frames; return the rate (1 over the unit of times) and positions.

    Frames without a row are NaN.

    **Raises:** `InputError` if times do not increase, or are not regular.
    """
    steps = np.diff(times)
    if (steps <= 0).any():
        row = int(np.argmax(steps <= 0))
        raise InputError(
            f"{where}: {what} goes from {times[row]:g} to {times[row + 1]:g} in row {row + 2}; expected increasing values."
        )
    # rounded times come in steps of two lengths, and their mean is the right one
    usual = float(np.mean(steps[steps < 1.5 * np.median(steps)]))
    # in floats until they are known to fit integers
    with np.errstate(over="ignore", invalid="ignore"):
        at = np.rint((times - times[0]) / usual)
        rate = at[-1] / (times[-1] - times[0])
        at = np.rint((times - times[0]) * rate)
    if (
        not at[-1] <= 20 * len(at)
        or np.abs((times - times[0]) * rate - at).max() > 0.26
        or (np.diff(at) < 1).any()
    ):
        raise InputError(f"{where}: {what} has unequal steps; resample the file to a constant rate.")
    at = at.astype(int)
    full = np.full((at[-1] + 1, *positions.shape[1:]), np.nan)
    full[at] = positions
    return float(f"{rate:.9g}"), full


def _list_subjects(subjects: dict[str, list[int]]) -> str:
    names = [f"'{name}' ({len(members)} markers)" for name, members in subjects.items()]
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _list_point_types(others: dict[str, tuple[str, ...]]) -> str:
    return " and ".join(f"{len(labels)} {kind}" for kind, labels in others.items())
