"""The markers of frames in the order of a subject's."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...observe.markers import MarkerFrames
from ..subject import Subject


class MatchedMarkers(NamedTuple):
    """Frames with the M markers of a subject. The position of a marker that is not visible is zero."""

    positions: Float[Array, "F M 3"]
    seen: Bool[Array, "F M"]


def match_markers(subject: Subject, frames: MarkerFrames) -> MatchedMarkers:
    """Match the markers of frames to those of a subject, by label.

    Other markers are ignored, and markers that the frames do not have are never visible. A marker with a
    position that is not finite is not visible.

    **Raises:** `ValueError` where no label is shared, or where there are no frames.
    """
    place = {label: index for index, label in enumerate(frames.labels)}
    chosen = np.array([place.get(label, -1) for label in subject.labels])
    if (chosen < 0).all():
        raise ValueError(
            f"None of the frames' markers ({', '.join(frames.labels[:6])}, ...) is a marker of the subject "
            f"({', '.join(subject.labels[:6])}, ...); fit a subject to these markers, or rename them."
        )
    if len(frames) == 0:
        raise ValueError("There are no frames to solve; give at least one.")
    positions = np.asarray(frames.positions)[:, chosen]
    seen = np.asarray(frames.visible)[:, chosen] & (chosen >= 0) & np.isfinite(positions).all(2)
    dtype = subject.offsets.dtype
    return MatchedMarkers(jnp.asarray(np.where(seen[..., None], positions, 0.0), dtype), jnp.asarray(seen))
