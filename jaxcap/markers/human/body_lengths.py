"""Lengths of a person's segments, left and right, and those of other adults."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ...body.skeleton import Skeleton
from ..calibration.calibrate import Calibration
from ..calibration.observability import bone_length_deviations
from .population import (
    LENGTH_SPREADS,
    LIMBS,
    SHARES,
    STATURE,
    improbability,
    length_given_others,
    stature_of_limbs,
)

#: ends of the paired segments, by the joints of the left side
PAIRED = {**LIMBS, "foot": ("LeftFoot", "LeftToeBase")}
#: ends of the widths
WIDTHS = {"hips": ("LeftUpLeg", "RightUpLeg"), "shoulders": ("LeftArm", "RightArm")}

#: deviations from what the other lengths say from which on a length is improbable: 1 to 2 % of the limbs of adults (ANSUR II)
MAX_RATIO = 2.5
#: joints whose markers determine the length of a limb
ENDS = {
    "upper arm": "shoulders and elbows",
    "forearm": "elbows and wrists",
    "thigh": "pelvis and knees",
    "shank": "knees and ankles",
}


class SegmentLength(NamedTuple):
    """The length of a segment between two joint centres, metres."""

    name: str
    left: float
    #: NaN for a width
    right: float
    #: the larger standard deviation of both sides; NaN where the takes do not determine both
    deviation: float
    #: percentile among adults of the mean of both sides; NaN where unknown
    percentile: float


def segment_lengths(
    found: Calibration, skeleton: Skeleton, *, is_adult: bool = True
) -> tuple[SegmentLength, ...]:
    """Measure the segments of a person's skeleton with the precision of its calibration; no percentiles of a child."""
    centres = np.asarray(skeleton.centres, float)
    deviations = bone_length_deviations(found.subject, found.joints, found.covariance)

    def length(start: str, end: str) -> float:
        return float(np.linalg.norm(centres[skeleton.index(end)] - centres[skeleton.index(start)]))

    rows = []
    for name, (start, end) in PAIRED.items():
        sides = [length(start.replace("Left", side), end.replace("Left", side)) for side in ("Left", "Right")]
        spread = [deviations[skeleton.index(end.replace("Left", side))] for side in ("Left", "Right")]
        rows.append(
            SegmentLength(
                name,
                sides[0],
                sides[1],
                float(np.max(spread)),
                adult_percentile(name, np.mean(sides)) if is_adult else math.nan,
            )
        )
    for name, (start, end) in WIDTHS.items():
        rows.append(SegmentLength(name, length(start, end), math.nan, math.nan, math.nan))
    return tuple(rows)


def adult_percentile(name: str, length: float | np.floating) -> float:
    """Compute the percentile of a segment's length among adults, NaN where the table has no such segment."""
    if name not in SHARES:
        return math.nan
    mean = SHARES[name] * STATURE
    spread = mean * LENGTH_SPREADS[list(LIMBS).index(name)]
    return 50.0 * (1.0 + math.erf((float(length) - mean) / (spread * math.sqrt(2.0))))


def describe_lengths(rows: Sequence[SegmentLength]) -> list[str]:
    """Describe the limbs whose lengths are improbable for an adult with the other ones, the least probable first.

    Only lengths that the takes determine count. What is left is judged without an improbable limb.
    """
    known = {
        row.name: 0.5 * (row.left + row.right)
        for row in rows
        if row.name in LIMBS and math.isfinite(row.deviation)
    }
    said = []
    while len(known) > 1:
        ratios = {name: improbability(name, known) for name in known}
        worst = max(ratios, key=lambda name: abs(ratios[name]))
        ratio, length = ratios[worst], known.pop(worst)
        if abs(ratio) < MAX_RATIO:
            break
        usual, spread = length_given_others(worst, known)
        said.append(
            f"The {worst}s are improbably {'long' if ratio > 0 else 'short'}: {1e3 * length:.0f} mm, while adults whose other limbs are as long "
            f"as here (about {stature_of_limbs(known):.2f} m tall) have {1e3 * usual:.0f} ± {1e3 * spread * usual:.0f} mm, so they are off by "
            f"{abs(ratio):.1f} deviations. Check the labels and the places of the markers at {ENDS[worst]}, and whether the joints there rotate"
            f" in the takes{_other_limb(known)}."
        )
    return said


def _other_limb(known: Mapping[str, float]) -> str:
    """Name the other limb if there is only one, which may be the wrong one."""
    return f", or else the {next(iter(known))}s" if len(known) == 1 else ""
