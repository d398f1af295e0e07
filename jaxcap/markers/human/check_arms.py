"""A check that the markers of the arms are on the sides of their labels, in any pose."""

from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...errors import InputError
from ...geometry.sampling import even_indices
from ...observe.markers import MarkerFrames
from ..marker_sets.landmarks import mirror_landmark
from ..marker_sets.recognise import MarkerSet
from ..subject import Subject

#: largest standard deviation of a marker on a landmark, metres
MAX_DEVIATION = 0.03
#: number of frames that are looked at
NUM_FRAMES = 100
#: landmarks of one side by the level of the arm that they are at, from the trunk on
LEVELS = {
    "shoulders": ("acromion", "acromioclavicular", "acromial_angle", "shoulder_front", "shoulder_back", "shoulder_centre"),
    "elbows": ("elbow_lateral", "elbow_medial", "olecranon", "elbow_centre"),
    "wrists": ("wrist_radial", "wrist_ulnar", "wrist_dorsal", "wrist_centre"),
    "hands": ("hand_dorsal", "hand_2nd_knuckle", "hand_3rd_knuckle", "hand_5th_knuckle"),
}  # fmt: skip
#: landmarks of the thorax in front and behind, above and below, and of the pelvis on both sides
FRONT, BACK = ("jugular_notch", "sternum", "xiphoid"), ("c7", "t1", "t2", "t3", "t4", "t5", "t6", "t7", "t8")
HIGH, LOW = (
    ("c7", "jugular_notch", "t1", "t2"),
    ("t8", "t9", "t10", "t12", "xiphoid", "l1", "l3", "l5", "sacrum"),
)
PELVIS = ("asis", "psis", "iliac_crest", "hip_lateral", "hip_centre")
#: least sine of the angle between up and forward in the thorax
MIN_SINE = 0.3
#: share of the distance between the shoulders by which they have to be on the wrong side
MIN_SHARE = 0.3
#: landmarks of the head in front and behind, from which its direction is known if the trunk has no markers that show it
HEAD_FRONT = ("head_front", "nose", "nose_bridge", "chin")
HEAD_BACK = ("head_back", "occiput")
HEAD_SIDES = (
    ("left head_front_lateral", "right head_front_lateral"),
    ("left head_back_lateral", "right head_back_lateral"),
    ("left ear", "right ear"),
)
#: how far the distances of neighbouring levels have to be from usual, metres, and the share of that that exchanged labels leave
MIN_MISFIT, EXCHANGED_SHARE = 0.05, 0.5
#: how much the distances of neighbouring levels have to vary over the frames, metres, and the share of that that exchanged labels leave:
#: the ends of one bone keep their distance
MIN_RANGE, CONSTANT_SHARE = 0.08, 0.35
#: percentiles that the variation is between
RANGE_PERCENTILES = (5, 95)


class ArmSides(NamedTuple):
    """Evidence that levels of the arms have the labels of the other side."""

    #: distance of the left shoulder from the right one to the person's left, as a share of the distance, NaN where unknown
    shoulders: Float[np.ndarray, "F"]
    #: misfits of the distances from each level to the next one along the arms, metres, as labelled and with the labels of the next
    #: one exchanged; NaN where unknown
    chain: Float[np.ndarray, "L 2"]
    #: how much these distances vary over the frames, metres: as labelled, of the arm in which they vary less, and exchanged, of that in which they
    #: vary more
    ranges: Float[np.ndarray, "L 2"]


def measure_arm_sides(template: Subject, known: MarkerSet, frames: MarkerFrames) -> ArmSides:
    """Measure on which side of the trunk the shoulders are, and to which side each further level of the arms belongs.

    The left of the thorax is `up x forward`, from markers in its midline, and else the left of the pelvis by its labels, or that of the head. Along the arm, the distance
    from the shoulder to the elbow is that of the `template` at rest, in any pose, and so on: arms may be crossed.
    """
    some = even_indices(len(frames), NUM_FRAMES, nearest=True)
    positions, seen = np.asarray(frames.positions, float)[some], np.asarray(frames.visible)[some]
    observed = _landmark_means(known, np.where(seen[..., None], positions, np.nan))
    rest = _landmark_means(known, _rest_positions(template, known)[None])
    levels = [tuple(_level(observed, side, level) for side in ("left", "right")) for level in LEVELS]
    left, right = levels[0]
    away = np.linalg.norm(left - right, axis=1)
    shoulders = np.einsum("fa,fa->f", left - right, _left_of_trunk(observed)) / np.maximum(away, 1e-9)
    usual = [_level(rest, "left", level) for level in LEVELS]
    chain = [
        _misfits(levels[inner], levels[outer], float(_distance(usual[inner], usual[outer])[0]))
        for inner, outer in pairwise(range(len(LEVELS)))
    ]
    ranges = [_ranges(inner, outer) for inner, outer in pairwise(levels)]
    return ArmSides(shoulders, np.array(chain), np.array(ranges))


def exchanged_levels(sides: ArmSides) -> tuple[str, ...]:
    """Find the levels of the arms that have the labels of the other side."""
    shown = sides.shoulders[np.isfinite(sides.shoulders)]
    exchanged = bool(len(shown)) and bool(np.median(shown) < -MIN_SHARE)
    found = ["shoulders"] if exchanged else []
    for level, (own, other), (varying, constant) in zip(
        list(LEVELS)[1:], sides.chain, sides.ranges, strict=True
    ):
        is_far = own > MIN_MISFIT and other < EXCHANGED_SHARE * own
        # folded arms, with each wrist as far from the other elbow as from its own
        if is_far or (varying > MIN_RANGE and constant < CONSTANT_SHARE * varying):
            exchanged = not exchanged
        if exchanged and np.isfinite(own):
            found.append(level)
    return tuple(found)


def check_arms(template: Subject, known: MarkerSet, frames: MarkerFrames) -> None:
    """Check that the arms, or their lower parts, are not labelled with each other's sides. Raises `InputError`."""
    found = exchanged_levels(measure_arm_sides(template, known, frames))
    if not found:
        return
    names = {f"{side} {name}" for level in found for name in LEVELS[level] for side in ("left", "right")}
    labels = [label for label, name in zip(known.labels, known.names, strict=True) if name in names]
    reason = (
        "seen from the trunk, the left one is on the right"
        if found[0] == "shoulders"
        else "they keep the distances from the other arm that they should keep from their own"
    )
    raise InputError(
        f"Left and right of the {_list_words(found)} are exchanged: {reason} ({', '.join(labels[:8])}"
        f"{', ...' if len(labels) > 8 else ''}). Correct these labels, and those of other markers on the same bones."
    )


def _list_words(words: tuple[str, ...]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def _landmark_means(
    known: MarkerSet, positions: Float[np.ndarray, "F M 3"]
) -> dict[str, Float[np.ndarray, "F 3"]]:
    """Collect the positions of exact landmarks by name."""
    return {
        str(name): positions[:, column]
        for column, name in enumerate(known.names)
        if name is not None and known.deviations[column] <= MAX_DEVIATION
    }


def _rest_positions(template: Subject, known: MarkerSet) -> Float[np.ndarray, "M 3"]:
    """Order the positions of a template's markers as those of a marker set; NaN where it has none."""
    places = np.full((len(known.labels), 3), np.nan)
    for label, place in zip(template.labels, np.asarray(template.offsets, float), strict=True):
        places[known.labels.index(label)] = place
    return places


def _level(at: Mapping[str, Float[np.ndarray, "F 3"]], side: str, level: str) -> Float[np.ndarray, "F 3"]:
    """Average the landmarks of a level that both sides have."""
    names = [f"{side} {name}" for name in LEVELS[level]]
    return _average(at, [name for name in names if mirror_landmark(name) in at])


def _average(at: Mapping[str, Float[np.ndarray, "F 3"]], names: list[str]) -> Float[np.ndarray, "F 3"]:
    """Average landmarks; NaN in frames in which one of them is not visible, and where there is none."""
    some = [at[name] for name in names if name in at]
    return np.mean(some, axis=0) if some else np.full((len(next(iter(at.values()), ())), 3), np.nan)


def _left_of_trunk(at: Mapping[str, Float[np.ndarray, "F 3"]]) -> Float[np.ndarray, "F 3"]:
    """Compute the direction to the person's left: of the thorax by its midline, else of the pelvis by its labels, else of the head."""
    forward = _average(at, list(FRONT)) - _average(at, list(BACK))
    up = _average(at, list(HIGH)) - _average(at, list(LOW))
    thorax = np.cross(up, forward)
    areas = np.linalg.norm(up, axis=1) * np.linalg.norm(forward, axis=1)
    is_plane = np.linalg.norm(thorax, axis=1) > MIN_SINE * areas
    both = [name for name in PELVIS if f"left {name}" in at and f"right {name}" in at]
    pelvis = _average(at, [f"left {name}" for name in both]) - _average(
        at, [f"right {name}" for name in both]
    )
    left = np.where(is_plane[:, None], thorax, pelvis)
    left = np.where(np.isfinite(left), left, _left_of_head(at))
    return left / np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-9)


def _left_of_head(at: Mapping[str, Float[np.ndarray, "F 3"]]) -> Float[np.ndarray, "F 3"]:
    """Compute the direction to the left of the head: `up x forward` by its midline, with up from the shoulders, else by its labels."""
    front, back = _average(at, list(HEAD_FRONT)), _average(at, list(HEAD_BACK))
    shoulders = 0.5 * (_level(at, "left", "shoulders") + _level(at, "right", "shoulders"))
    midline = np.cross(0.5 * (front + back) - shoulders, front - back)
    both = [pair for pair in HEAD_SIDES if all(name in at for name in pair)]
    labelled = _average(at, [left for left, _ in both]) - _average(at, [right for _, right in both])
    return np.where(np.isfinite(midline), midline, labelled)


def _distance(one: Float[np.ndarray, "F 3"], other: Float[np.ndarray, "F 3"]) -> Float[np.ndarray, "F"]:
    return np.linalg.norm(one - other, axis=1)


def _misfits(
    inner: tuple[Float[np.ndarray, "F 3"], ...], outer: tuple[Float[np.ndarray, "F 3"], ...], usual: float
) -> tuple[float, float]:
    """Compute the misfits of the distances between two levels, as labelled and exchanged: the smaller one of both sides, and the larger one."""
    own = [_median_misfit(_distance(inner[side], outer[side]), usual) for side in (0, 1)]
    other = [_median_misfit(_distance(inner[side], outer[1 - side]), usual) for side in (0, 1)]
    return min(own), max(other)


def _ranges(
    inner: tuple[Float[np.ndarray, "F 3"], ...], outer: tuple[Float[np.ndarray, "F 3"], ...]
) -> tuple[float, float]:
    """Compute how much the distances between two levels vary, as labelled and exchanged: the smaller one of both sides, and the larger one."""
    own = [_range(_distance(inner[side], outer[side])) for side in (0, 1)]
    other = [_range(_distance(inner[side], outer[1 - side])) for side in (0, 1)]
    return min(own), max(other)


def _range(distances: Float[np.ndarray, "F"]) -> float:
    shown = distances[np.isfinite(distances)]
    return float(np.ptp(np.percentile(shown, RANGE_PERCENTILES))) if len(shown) else float("nan")


def _median_misfit(distances: Float[np.ndarray, "F"], usual: float) -> float:
    shown = distances[np.isfinite(distances)]
    return float(np.median(np.abs(shown - usual))) if len(shown) else float("nan")
