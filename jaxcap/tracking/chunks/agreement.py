"""Agreement of two runs in a frame: the poses, and all that decides how tracking continues."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...body.kinematics import forward_kinematics, joint_positions
from ...body.pose import Pose
from ...body.skeleton import Skeleton
from ..judge_frame import MIN_PAUSE, SearchHistory, TrackedFrame
from ..judgement.verdict import Judgement
from .division import AGREEING_FRAMES
from .segments import AbstractSegment

#: largest distance between the joints of two runs that agree, metres
TOLERANCE = 1e-4
#: largest difference between the shares of limits in their verdicts: runs that differ by more could search in other frames
MAX_SHARE_DIFFERENCE = 0.1


class Comparison(NamedTuple):
    """Two runs in one frame."""

    #: largest distance between the same joints, metres
    distance: float
    #: largest difference between the shares of limits in the verdicts
    share_difference: float
    #: the poses are the same within the tolerance, and tracking continues in the same way
    agree: bool


def compare_frames(
    skeleton: Skeleton, one: TrackedFrame, other: TrackedFrame, tolerance: float = TOLERANCE
) -> Comparison:
    """Compare the frame of the same number in two runs.

    They agree if the joints are closer than `tolerance`, metres, both are good with nearly the same distance from the limits of a
    verdict, and none waits for the end of a pause between searches. Frames that are lost or doubtful agree with none: their
    poses may be guesses, and the poses that come after them depend on what was before them.
    """
    distance = float(_largest_distance(skeleton, one.pose, other.pose))
    good = all(frame.verdict == "good" and is_rested(frame.searches) for frame in (one, other))
    shares = float(np.abs(np.asarray(one.judgement.shares) - np.asarray(other.judgement.shares)).max())
    agree = good and distance <= tolerance and shares <= MAX_SHARE_DIFFERENCE
    return Comparison(distance, shares, bool(agree))


def is_unsure(judgement: Judgement, difference: float) -> Bool[np.ndarray, "*frames"]:
    """Test if the verdict of a frame, or of each of stacked frames, could be another one if the shares of limits were larger or smaller by
    a `difference`.
    """
    worst = np.max(np.asarray(judgement.shares), axis=(-2, -1))
    limits = np.asarray(judgement.doubt), np.asarray(judgement.tolerance)
    return np.asarray(np.any([np.abs(worst - limit) <= difference for limit in limits], axis=0))


def is_rested(searches: SearchHistory) -> bool:
    """Test if the next search is neither delayed nor followed by a longer pause because of earlier ones."""
    return searches.wait <= 0 and 2 * searches.length <= MIN_PAUSE


@eqx.filter_jit
def _largest_distance(skeleton: Skeleton, one: Pose, other: Pose) -> Float[Array, ""]:
    first, second = (joint_positions(skeleton, forward_kinematics(skeleton, pose)) for pose in (one, other))
    return jnp.max(jnp.linalg.norm(first - second, axis=1))


class AgreementTest:
    """Finds the frame from which on a run may be replaced by an earlier one, frame by frame."""

    def __init__(self, skeleton: Skeleton, expected: AbstractSegment, first: int, tolerance: float):
        self._skeleton, self._tolerance = skeleton, tolerance
        #: number of the next frame, and of the frames before it that agree
        self._next, self._count = first, 0
        self._first = expected.first
        self._expected = expected.frames(max(first, expected.first), expected.end)

    def __call__(self, frame: TrackedFrame) -> bool:
        """Compare the next frame; return whether this is the last one of enough frames that agree."""
        other = next(self._expected, None) if self._next >= self._first else None
        self._next += 1
        if other is None:
            return False
        agree = compare_frames(self._skeleton, frame, other, self._tolerance).agree
        self._count = self._count + 1 if agree else 0
        return self._count >= AGREEING_FRAMES
