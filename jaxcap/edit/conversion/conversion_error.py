"""Errors of a converted motion by frames and by parts of the body."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

#: errors above which a frame failed: that many times the median of all frames, and metres
FAILED_RATIO, FAILED_ERROR = 4.0, 0.01
#: mean error, metres, up to which a frame has not failed, even if its last steps still improved it
EXACT = 1e-4


class ConversionError(NamedTuple):
    """Distances of the target's vertices from their points on the source's surface, metres."""

    #: (F,) mean over the vertices with a counterpart, and the distance that 95 % of them do not exceed
    mean: Float[np.ndarray, "F"]
    quantile: Float[np.ndarray, "F"]
    #: (F, J) mean over the vertices of each joint of the target; NaN for a joint without any
    parts: Float[np.ndarray, "F J"]
    #: (F,) frames whose fit did not converge, or whose error is far above that of the others
    failed: Bool[np.ndarray, "F"]

    @property
    def worst_frame(self) -> int:
        """The frame with the largest mean."""
        return int(np.argmax(np.nan_to_num(self.mean, nan=np.inf)))

    @property
    def worst_part(self) -> int:
        """The joint whose vertices have the largest mean in that frame."""
        return int(np.argmax(np.nan_to_num(self.parts[self.worst_frame], nan=-1.0)))


def conversion_error(
    distances: Float[np.ndarray, "F W"],
    matched: Bool[np.ndarray, "W"],
    bones: Int[np.ndarray, "W"],
    num_joints: int,
    converged: Bool[np.ndarray, "F"],
) -> ConversionError:
    """Collect the distances of vertices by frames and joints; `bones` are the joints that move the vertices most."""
    own, bones = distances[:, matched], bones[matched]
    counts = np.bincount(bones, minlength=num_joints)
    sums = np.stack([np.bincount(bones, row, num_joints) for row in own])
    parts = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
    mean = own.mean(1)
    known = mean[np.isfinite(mean)]
    limit = max(FAILED_ERROR, FAILED_RATIO * float(np.median(known)) if len(known) else 0.0)
    # written so that NaN counts as failed
    failed = ~(mean <= limit) | (~converged & ~(mean <= EXACT))
    return ConversionError(mean, np.quantile(own, 0.95, axis=1), parts, failed)
