"""Solutions of frames that may be wrong, and the better one of two."""

import numpy as np
from jaxtyping import Bool, Float, Int

#: distance between observed and predicted position beyond which a marker is far off, metres
FAR = 0.05
#: a frame with a median residual above this many deviations is solved again from an initial guess
MAX_RESIDUAL_SCALE = 3.0
#: number of successive frames in which a single marker is far off, longer than most swaps of labels
MIN_FAR_FRAMES = 10


def far_markers(
    used: Bool[np.ndarray, "F M"], distances: Float[np.ndarray, "F M"]
) -> Bool[np.ndarray, "F M"]:
    """Find the used markers that are far from where the pose has them, or at no finite distance."""
    return used & ~(distances <= FAR)


def is_better(num_far: Int[np.ndarray, "2 F"], scales: Float[np.ndarray, "2 F"]) -> Bool[np.ndarray, "F"]:
    """Test whether the second solution of a frame has fewer far markers than the first, or as many and a smaller median.

    **Arguments:** the number of far markers, and the median residual in standard deviations, of both solutions.
    """
    (far, other_far), (scale, other_scale) = num_far, scales
    # the few markers that are not far fit any pose
    fits = (other_scale < MAX_RESIDUAL_SCALE) | ~(other_scale > scale)
    fewer = (other_far < far) & fits
    return (fewer | ((other_far == far) & ~(scale <= other_scale))) & np.isfinite(other_scale)
