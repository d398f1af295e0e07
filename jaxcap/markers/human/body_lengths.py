"""Lengths of a person's segments, left and right, and those of other adults."""

import math
from typing import NamedTuple

import numpy as np

from ...body.skeleton import Skeleton
from ..calibration.calibrate import Calibration
from ..calibration.observability import bone_length_deviations

#: ends of the paired segments, by the joints of the left side
PAIRED = {
    "upper arm": ("LeftArm", "LeftForeArm"),
    "forearm": ("LeftForeArm", "LeftHand"),
    "thigh": ("LeftUpLeg", "LeftLeg"),
    "shank": ("LeftLeg", "LeftFoot"),
    "foot": ("LeftFoot", "LeftToeBase"),
}
#: ends of the widths
WIDTHS = {"hips": ("LeftUpLeg", "RightUpLeg"), "shoulders": ("LeftArm", "RightArm")}
#: mean lengths between joint centres, as shares of stature: de Leva (1996), tables 1 to 4, means of women and men
#: (thigh: men, as the women's hip centre is far below all later estimates)
SHARES = {"upper arm": 0.160, "forearm": 0.153, "thigh": 0.2425, "shank": 0.2525}
#: mean stature of adults, metres, and relative standard deviations of stature and of a segment at equal stature (women and men
#: of ANSUR II, Gordon and others 2014)
STATURE, STATURE_SPREAD, SEGMENT_SPREAD = 1.69, 0.053, 0.035


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
    spread = mean * math.hypot(STATURE_SPREAD, SEGMENT_SPREAD)
    return 50.0 * (1.0 + math.erf((float(length) - mean) / (spread * math.sqrt(2.0))))
