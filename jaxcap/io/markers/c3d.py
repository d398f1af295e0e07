"""C3D, the files of optical motion capture (c3d.org), by ezc3d.

Marker trajectories share their table with computed quantities: angles, forces, moments, powers, segment axes.
These are identified by the lists in the POINT group (`POINT:ANGLES`, ...; `POINT:TYPE_GROUPS` names more of
them) and, if a program omitted these, by the names of Plug-in Gait outputs.
"""

import re
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...observe.markers import MarkerFrames
from ...units import unit_scale
from ..system.atomic import atomic_path
from .c3d_child import load_c3d
from .c3d_header import read_header, read_layout, read_points
from .marker_file import MarkerFile, make_marker_file, parse_screen_axis, parse_unit, shift_from_origin

#: lists in the POINT group of points that are no markers
POINT_TYPE_GROUPS = (
    "ANGLES",
    "FORCES",
    "MOMENTS",
    "POWERS",
    "SCALARS",
    "REACTIONS",
    "MODELED_MARKERS",
    "MODEL_OUTPUTS",
    "GRFS",
    "BONES",
    "LENGTHS",
    "VELOCITIES",
    "ACCELERATIONS",
)
#: patterns of the names of model outputs
_MODEL_OUTPUT_PATTERNS = {
    "angles": r".*Angles?",
    "forces": r".*(Force|GRF|GroundReactionForce)",
    "moments": r".*(Moment|GRM|GroundReactionMoment)",
    "powers": r".*Power",
    "model outputs": r"CentreOf(Mass|MassFloor|Pressure)|CenterOf(Mass|MassFloor|Pressure)",
}
#: largest number of frames in the header's 16 bits
MAX_FRAMES = 65535


def read_c3d_file(path: str | Path, unit: str | float | None = None) -> MarkerFile:
    """Read the markers of a C3D file; a negative residual, NaN, or a position of zeros marks a gap.

    **Arguments:** `unit` of lengths, which overrides `POINT:UNITS`; the default without both is millimetres.

    **Raises:** `InputError` if there is no such file, it is no C3D file or cut short, or it has no markers or
    no frames.
    """
    path = Path(path)
    first, declared = read_header(path)
    layout, size = read_layout(path), path.stat().st_size
    needed = layout.file_size(declared)
    try:
        loaded = load_c3d(path)
    except InputError:
        if size < needed:
            raise InputError(
                f"{path}: the file is cut short: it ends before the last of its {declared} frames; copy it again."
            ) from None
        raise
    points, residuals, words = loaded.points, loaded.residuals, loaded.text_parameters
    messages = []
    if loaded.analog_values != layout.analog_values and _is_padded(size, needed):
        # ezc3d takes the layout of the parameters, and would read each frame at a wrong place
        points, residuals = read_points(path, layout, declared)
        messages.append(
            f"its parameters announce {loaded.analog_values:g} analogue values in each frame, and its header {layout.analog_values}, with which the "
            "file has its size; the header is used."
        )
    if points.shape[1] and points.shape[2] < declared:
        raise InputError(
            f"{path}: the file is cut short: it contains {points.shape[2]} of the {declared} frames of its header; "
            "copy it again."
        )
    labels = _read_string_list(words, "LABELS")
    count = points.shape[1]
    if len(labels) > count:
        messages.append(
            f"there are {len(labels)} labels for {count} points; the last {len(labels) - count} are dropped."
        )
    labels = [label.strip(" \t\r\n\0") for label in labels[:count]] + [""] * (count - len(labels))
    kinds = point_kinds(labels, words)
    others: dict[str, tuple[str, ...]] = {}
    for label, kind in zip(labels, kinds, strict=True):
        if kind:
            others[kind] = (*others.get(kind, ()), label)
    markers = [i for i, kind in enumerate(kinds) if not kind]
    positions = np.transpose(points[:, markers], (2, 1, 0)).copy()
    positions[(residuals[markers] < 0).T] = np.nan
    _check_finite(path, positions, [labels[i] for i in markers])
    said = " ".join(_read_string_list(words, "UNITS")[:1])
    if unit is None and not parse_unit(said, ""):
        messages.append(f"its unit is {repr(said) if said else 'missing'}; lengths are read as millimetres.")
    rate = loaded.rates[0] if loaded.rates and loaded.rates[0] > 0 else loaded.header_rate
    return make_marker_file(
        path,
        positions,
        # a point without a label is named by its index in the file
        [labels[i] or f"*{i + 1}" for i in markers],
        # the rate is stored in single precision
        float(f"{rate:.7g}"),
        parse_unit(said) if unit is None else unit,
        first_frame=first,
        other_points=others,
        warnings=messages,
        up=parse_screen_axis(" ".join(words.get("Y_SCREEN", ())[:1])),
    )


def _is_padded(size: int, needed: int) -> bool:
    """Test if a file has the size that it needs, in whole blocks."""
    return needed <= size < needed + 512


def _check_finite(path: Path, positions: np.ndarray, labels: list[str]) -> None:
    """Check that no coordinate is infinite; NaN is a gap. Raises `InputError`."""
    wrong = np.isinf(positions).any(2)
    if wrong.any():
        frame, marker = np.unravel_index(int(wrong.argmax()), wrong.shape)
        raise InputError(
            f"{path}: {wrong.sum()} marker positions are infinite, first that of '{labels[marker]}' in frame "
            f"{frame + 1}; copy or export it again."
        )


def write_c3d(path: str | Path, frames: MarkerFrames, unit: str | float = "mm") -> None:
    """Write markers or joint centres as C3D with 4-byte numbers; gaps have zeros and residual -1.

    **Raises:** `InputError` if the file cannot be written, or for more than 65,535 frames, which the format's
    header cannot count.
    """
    import ezc3d

    path, metres = Path(path), unit_scale(unit)
    if len(frames) > MAX_FRAMES:
        raise InputError(
            f"{path}: the motion has {len(frames)} frames; a C3D file can contain at most {MAX_FRAMES}; write several files."
        )
    positions, seen = shift_from_origin(frames)
    values = np.ones((4, positions.shape[1], len(positions)))
    values[:3] = np.transpose(np.where(seen[..., None], positions / metres, 0), (2, 1, 0))
    file = ezc3d.c3d()
    group = file["parameters"]["POINT"]
    group["RATE"]["value"] = [frames.rate]
    group["UNITS"]["value"] = [unit if isinstance(unit, str) else f"{unit:g} m"]
    group["LABELS"]["value"] = list(frames.labels)
    file["data"]["points"] = values
    file["data"]["meta_points"]["residuals"] = np.where(seen, 0.0, -1.0).T[None]
    with atomic_path(path) as beside:
        # ezc3d appends a lower-case suffix to names without it
        lower = beside.with_suffix(".c3d")
        try:
            file.write(str(lower))
            lower.replace(beside)
        finally:
            if lower != beside:
                lower.unlink(missing_ok=True)


def point_kinds(labels: list[str], group: dict[str, list[str]]) -> list[str]:
    """Assign a type to each point: "" for a marker, otherwise such as `angles` or `forces`."""
    named: dict[str, str] = {}
    groups = [*POINT_TYPE_GROUPS, *(word.strip().upper() for word in _read_string_list(group, "TYPE_GROUPS"))]
    for kind in dict.fromkeys(groups):
        if kind and kind not in ("LABELS", "DESCRIPTIONS", "UNITS", "MARKERS", "TYPE_GROUPS"):
            for label in _read_string_list(group, kind):
                named.setdefault(label.strip(" \0"), kind.lower().replace("_", " "))
    bare = [label.partition(":")[2] or label for label in labels]
    axes = _segment_axes(bare)
    return [
        (label and (named.get(label) or named.get(short)))
        or ("segment axes" if short in axes else _type_from_name(short))
        for label, short in zip(labels, bare, strict=True)
    ]


def _type_from_name(label: str) -> str:
    return next((kind for kind, ending in _MODEL_OUTPUT_PATTERNS.items() if re.fullmatch(ending, label)), "")


def _segment_axes(labels: list[str]) -> set[str]:
    """Find the points of Plug-in Gait segments, four for each, such as PELO, PELP, PELA and PELL.

    The first is the segment's origin, and the others are on its axes.
    """
    there = set(labels)
    stems = {label[:3] for label in there if len(label) == 4 and label.endswith("O")}
    return {stem + end for stem in stems if {stem + end for end in "OPAL"} <= there for end in "OPAL"}


def _read_string_list(group: dict[str, list[str]], name: str) -> list[str]:
    """Return a list of words that continues in NAME2, NAME3, ..., as lists of more than 255 do."""
    words: list[str] = []
    number = 1
    while (key := name if number == 1 else f"{name}{number}") in group:
        words += group[key]
        number += 1
    return words
