"""A check that the markers of the legs are on the sides of their labels, in any pose."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...errors import InputError
from ...geometry.sampling import even_indices
from ...observe.markers import MarkerFrames
from ..marker_sets.recognise import MarkerSet

#: largest standard deviation of a marker on a landmark, metres
MAX_DEVIATION = 0.03
#: number of frames that are looked at
NUM_FRAMES = 100
#: landmarks of one side, by their part of the foot and the leg
TOES = ("toe_tip", "big_toe", "foot_1st_head", "foot_2nd_head", "foot_3rd_head", "foot_5th_head")
HEELS = ("heel", "heel_high")
ANKLES = ("ankle_lateral", "ankle_medial", "ankle_centre")
KNEES = ("knee_lateral", "knee_medial", "patella", "fibula_head", "tibial_tuberosity", "knee_centre")
#: pairs of a lateral and a medial landmark of one bone, or of a lateral one and one in the middle of the foot
ACROSS = (
    ("knee_lateral", "knee_medial"), ("ankle_lateral", "ankle_medial"), ("foot_5th_head", "foot_1st_head"),
    ("heel_lateral", "heel_medial"), ("ankle_lateral", "heel"),
)  # fmt: skip
#: distance to the wrong side that is evidence, metres: of a leg against the other one, and of a lateral landmark
MIN_LEG_OFFSET, MIN_LATERAL_OFFSET = 0.03, 0.01
#: share of the frames in which a leg has to be on the wrong side, if no lateral landmarks show it
MIN_SHARE = 0.9


class LegSides(NamedTuple):
    """How far landmarks are to the person's left, metres, NaN where unknown."""

    #: the left leg from the right one, positive if it is to the left of both feet
    legs: Float[np.ndarray, "F"]
    #: the lateral landmarks of each leg from its medial ones, or from the line of the foot, positive if they are lateral
    lateral: Float[np.ndarray, "F 2"]


def measure_leg_sides(known: MarkerSet, frames: MarkerFrames) -> LegSides:
    """Measure on which side the legs and their lateral landmarks are.

    A person's left is `up x forward`: up is from the ankle to the knee, and forward from the heel to the toes, of each leg by
    itself. Both hold for people who stand, walk or sit.
    """
    some = even_indices(len(frames), NUM_FRAMES, nearest=True)
    positions, seen = np.asarray(frames.positions, float)[some], np.asarray(frames.visible)[some]
    places = np.where(seen[..., None], positions, np.nan)
    at = {
        str(name): places[:, column]
        for column, name in enumerate(known.names)
        if name is not None and not known.virtual[column] and known.deviations[column] <= MAX_DEVIATION
    }
    lefts, lateral, ankles = [], [], []
    for sign, side in ((1.0, "left"), (-1.0, "right")):
        ankle, left, outside = _measure_leg(at, side, len(some))
        lefts.append(left)
        ankles.append(ankle)
        lateral.append(sign * outside)
    left = lefts[0] + lefts[1]
    left = left / np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-9)
    return LegSides(np.einsum("fa,fa->f", ankles[0] - ankles[1], left), np.stack(lateral, 1))


def check_legs(known: MarkerSet, frames: MarkerFrames) -> None:
    """Check that the legs are not labelled with each other's sides. Raises `InputError`.

    Legs may be crossed in all frames, but a lateral malleolus is never medial: both have to be on the wrong side where lateral
    landmarks are visible.
    """
    sides = measure_leg_sides(known, frames)
    legs = sides.legs[np.isfinite(sides.legs)]
    if not len(legs) or np.median(legs) > -MIN_LEG_OFFSET:
        return
    outside = [column[np.isfinite(column)] for column in sides.lateral.T]
    if all(len(one) for one in outside):
        wrong = all(np.median(one) < -MIN_LATERAL_OFFSET for one in outside)
    else:
        wrong = bool(np.mean(legs < 0) > MIN_SHARE)
    if wrong:
        labels = [label for label, name in zip(known.labels, known.names, strict=True) if _is_of_leg(name)]
        raise InputError(
            f"Left and right of the legs are exchanged: seen from the feet, the left leg is {-1e3 * float(np.median(legs)):.0f} mm to the "
            f"right of the right one ({', '.join(labels[:6])}, ...). Correct the labels, or the axes of the file if it is mirrored."
        )


def _measure_leg(
    at: Mapping[str, Float[np.ndarray, "F 3"]], side: str, count: int
) -> tuple[Float[np.ndarray, "F 3"], Float[np.ndarray, "F 3"], Float[np.ndarray, "F"]]:
    """Measure the ankle, the direction to the left, and how far lateral landmarks are to the left of medial ones."""

    def mean(names: tuple[str, ...]) -> Float[np.ndarray, "F 3"]:
        some = [at[f"{side} {name}"] for name in names if f"{side} {name}" in at]
        return _mean_of(np.stack(some)) if some else np.full((count, 3), np.nan)

    ankle, toes = mean(ANKLES), mean(TOES)
    heel = mean(HEELS) if any(f"{side} {name}" in at for name in HEELS) else ankle
    forward, up = toes - heel, mean(KNEES) - ankle
    left = np.cross(up, forward)
    left = left / np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-9)
    pairs = [
        np.einsum("fa,fa->f", at[f"{side} {lateral}"] - at[f"{side} {medial}"], left)
        for lateral, medial in ACROSS
        if f"{side} {lateral}" in at and f"{side} {medial}" in at
    ]
    return ankle, left, _mean_of(np.stack(pairs)) if pairs else np.full(count, np.nan)


def _mean_of(values: np.ndarray) -> np.ndarray:
    """Average over the first axis without the unknown ones; NaN where all are unknown."""
    known = np.isfinite(values)
    total = np.where(known, values, 0.0).sum(0)
    return np.where(known.any(0), total / np.maximum(known.sum(0), 1), np.nan)


def _is_of_leg(name: str | None) -> bool:
    plain = str(name).partition(" ")[2]
    return plain in (*TOES, *HEELS, *ANKLES, *KNEES)
