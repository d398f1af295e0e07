"""The motion of one segment relative to another: the input of all joint estimators."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...geometry.sampling import even_indices
from .segment_frames import SegmentFrames
from .segment_sets import Segments

#: number of frames that a joint is estimated from, evenly over the known ones
MAX_FRAMES = 600


class RelativeMotion(NamedTuple):
    """Two segments over the F frames in which the parent is known, and also the child if `has_child_frame`."""

    #: the child's frame in the parent's, `p = rotations c + translations`; None where no frame of the child
    #: is known
    rotations: Float[np.ndarray, "F 3 3"] | None
    translations: Float[np.ndarray, "F 3"] | None
    #: the child's markers in the parent's frame
    child_markers: Float[np.ndarray, "F N 3"]
    child_visible: Bool[np.ndarray, "F N"]
    child_weights: Float[np.ndarray, "N"]
    #: the parent's markers in their own frame
    parent_markers: Float[np.ndarray, "B 3"]
    parent_weights: Float[np.ndarray, "B"]
    #: prior of the centre: its mean between the nearest markers, and its standard deviation, metres
    prior_centre: Float[np.ndarray, "3"]
    prior_deviation: float
    #: effect of noise: variances of the rotation of the parent's and of the child's frame about an axis,
    #: radians squared, and of the tracks, metres squared a coordinate
    rotation_noise: tuple[float, float] = (0.0, 0.0)
    marker_noise: float = 0.0

    @property
    def has_child_frame(self) -> bool:
        """True if both frames are known."""
        return self.rotations is not None

    def flipped(self) -> "RelativeMotion":
        """Exchange parent and child. Both frames have to be known."""
        assert self.rotations is not None and self.translations is not None
        back = self.rotations.swapaxes(-1, -2)
        shift = -np.einsum("fab,fb->fa", back, self.translations)
        tracks = np.einsum("fab,nb->fna", back, self.parent_markers) + shift[:, None]
        child_tracks = np.einsum("fab,fnb->fna", back, self.child_markers) + shift[:, None]
        shape = np.stack([np.median(child_tracks[s, n], axis=0) for n, s in enumerate(self.child_visible.T)])
        return RelativeMotion(
            back,
            shift,
            tracks,
            np.ones(tracks.shape[:2], bool),
            self.parent_weights,
            shape,
            self.child_weights,
            np.median(np.einsum("fab,b->fa", back, self.prior_centre) + shift, axis=0),
            self.prior_deviation,
            (self.rotation_noise[1], self.rotation_noise[0]),
            self.marker_noise,
        )


def relative_motion(
    positions: Float[np.ndarray, "F M 3"],
    seen: Bool[np.ndarray, "F M"],
    segments: Segments,
    frames: SegmentFrames,
    parent: int,
    child: int,
    noise: tuple[Float[np.ndarray, "K"], Float[np.ndarray, "K"]] | None = None,
    min_frames: int = 10,
) -> RelativeMotion | None:
    """Compute the motion of `child` relative to `parent`; None with fewer than `min_frames` common frames.

    `noise` is that of `frames` (`SegmentFrames.noise`); pass it to avoid its computation for every pair.
    """
    marker_noise, rotation_noise = frames.noise(positions, seen, segments) if noise is None else noise
    members, base = list(segments.members[child]), list(segments.members[parent])
    both = frames.known[:, parent] & frames.known[:, child]
    turns = both.sum() >= min_frames
    usable = both if turns else frames.known[:, parent] & seen[:, members].any(1)
    chosen = np.flatnonzero(usable)
    if len(chosen) < min_frames:
        return None
    chosen = chosen[even_indices(len(chosen), MAX_FRAMES, nearest=True)]
    r, o = frames.rotations[chosen, parent], frames.origins[chosen, parent]
    tracks = np.einsum("fba,fnb->fna", r, positions[chosen][:, members] - o[:, None])
    tracked = seen[chosen][:, members]
    alive = tracked.sum(0) >= min_frames
    if not alive.any():
        return None
    tracks, tracked = tracks[:, alive], tracked[:, alive]
    weights = segments.weights[members][alive]
    rotations = translations = None
    if turns:
        rotations = r.swapaxes(-1, -2) @ frames.rotations[chosen, child]
        translations = np.einsum("fba,fb->fa", r, frames.origins[chosen, child] - o)
    template = frames.local_positions[base]
    middle, spread = _estimate_prior(tracks, tracked, template)
    lever = float(np.mean(np.sum(tracks[tracked] ** 2, -1)))
    return RelativeMotion(
        rotations,
        translations,
        tracks,
        tracked,
        weights,
        template,
        segments.weights[base],
        middle,
        spread,
        (float(rotation_noise[parent]), float(rotation_noise[child])),
        float(marker_noise[parent] + rotation_noise[parent] * lever * 2 / 3),
    )


def _estimate_prior(
    child_markers: np.ndarray, child_visible: np.ndarray, parent_markers: np.ndarray
) -> tuple[np.ndarray, float]:
    """Average the midpoints of all pairs across, with most weight on the nearest pairs.

    Return also the weighted mean distance of the pairs.
    """
    usual = np.stack([np.median(child_markers[s, n], axis=0) for n, s in enumerate(child_visible.T)])
    gaps = np.stack(
        [
            np.median(np.linalg.norm(child_markers[s, n][:, None] - parent_markers, axis=-1), axis=0)
            for n, s in enumerate(child_visible.T)
        ]
    )
    shares = 1 / np.maximum(gaps, 1e-6) ** 4
    middles = 0.5 * (usual[:, None] + parent_markers[None])
    shares = shares / shares.sum()
    return np.einsum("nb,nba->a", shares, middles), float((shares * gaps).sum())
