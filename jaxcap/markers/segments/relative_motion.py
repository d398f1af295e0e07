"""The motion of one segment relative to another: the input of all joint estimators."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from .segment import Segments
from .segment_frames import SegmentFrames

#: number of frames that a joint is estimated from, evenly over the known ones
FRAMES = 600


class Relative(NamedTuple):
    """Two segments over the F frames in which the parent is known, and also the child if `turns`."""

    #: the child's frame in the parent's, `p = rotations c + translations`; None where no frame of the child
    #: is known
    rotations: Float[np.ndarray, "F 3 3"] | None
    translations: Float[np.ndarray, "F 3"] | None
    #: the child's markers in the parent's frame
    tracks: Float[np.ndarray, "F N 3"]
    tracked: Bool[np.ndarray, "F N"]
    weights: Float[np.ndarray, "N"]
    #: the parent's markers in their own frame
    base: Float[np.ndarray, "B 3"]
    base_weights: Float[np.ndarray, "B"]
    #: prior of the centre: its mean between the nearest markers, and its standard deviation, metres
    middle: Float[np.ndarray, "3"]
    spread: float
    #: effect of noise: variances of the rotation of the parent's and of the child's frame about an axis,
    #: radians squared, and of the tracks, metres squared a coordinate
    turn_noise: tuple[float, float] = (0.0, 0.0)
    track_noise: float = 0.0

    @property
    def turns(self) -> bool:
        """True if both frames are known."""
        return self.rotations is not None

    def flipped(self) -> "Relative":
        """Exchange parent and child. Both frames have to be known."""
        assert self.rotations is not None and self.translations is not None
        back = self.rotations.swapaxes(-1, -2)
        shift = -np.einsum("fab,fb->fa", back, self.translations)
        tracks = np.einsum("fab,nb->fna", back, self.base) + shift[:, None]
        own = np.einsum("fab,fnb->fna", back, self.tracks) + shift[:, None]
        shape = np.stack([np.median(own[s, n], axis=0) for n, s in enumerate(self.tracked.T)])
        return Relative(
            back,
            shift,
            tracks,
            np.ones(tracks.shape[:2], bool),
            self.base_weights,
            shape,
            self.weights,
            np.median(np.einsum("fab,b->fa", back, self.middle) + shift, axis=0),
            self.spread,
            (self.turn_noise[1], self.turn_noise[0]),
            self.track_noise,
        )


def relative(
    places: Float[np.ndarray, "F M 3"],
    seen: Bool[np.ndarray, "F M"],
    segments: Segments,
    frames: SegmentFrames,
    parent: int,
    child: int,
    noise: tuple[Float[np.ndarray, "K"], Float[np.ndarray, "K"]] | None = None,
    fewest: int = 10,
) -> Relative | None:
    """Compute the motion of `child` relative to `parent`; None with fewer than `fewest` common frames.

    `noise` is that of `frames` (`SegmentFrames.noise`); pass it to avoid its computation for every pair.
    """
    own, turn = frames.noise(places, seen, segments) if noise is None else noise
    members, base = list(segments.members[child]), list(segments.members[parent])
    both = frames.known[:, parent] & frames.known[:, child]
    turns = both.sum() >= fewest
    usable = both if turns else frames.known[:, parent] & seen[:, members].any(1)
    chosen = np.flatnonzero(usable)
    if len(chosen) < fewest:
        return None
    chosen = chosen[np.unique(np.linspace(0, len(chosen) - 1, min(FRAMES, len(chosen))).round().astype(int))]
    r, o = frames.rotations[chosen, parent], frames.origins[chosen, parent]
    tracks = np.einsum("fba,fnb->fna", r, places[chosen][:, members] - o[:, None])
    tracked = seen[chosen][:, members]
    alive = tracked.sum(0) >= fewest
    if not alive.any():
        return None
    tracks, tracked = tracks[:, alive], tracked[:, alive]
    weights = segments.weights[members][alive]
    rotations = translations = None
    if turns:
        rotations = r.swapaxes(-1, -2) @ frames.rotations[chosen, child]
        translations = np.einsum("fba,fb->fa", r, frames.origins[chosen, child] - o)
    template = frames.template[base]
    middle, spread = _between(tracks, tracked, template)
    lever = float(np.mean(np.sum(tracks[tracked] ** 2, -1)))
    return Relative(
        rotations,
        translations,
        tracks,
        tracked,
        weights,
        template,
        segments.weights[base],
        middle,
        spread,
        (float(turn[parent]), float(turn[child])),
        float(own[parent] + turn[parent] * lever * 2 / 3),
    )


def _between(tracks: np.ndarray, tracked: np.ndarray, base: np.ndarray) -> tuple[np.ndarray, float]:
    """Average the midpoints of all pairs across, with most weight on the nearest pairs.

    Return also the weighted mean distance of the pairs.
    """
    usual = np.stack([np.median(tracks[s, n], axis=0) for n, s in enumerate(tracked.T)])
    gaps = np.stack(
        [
            np.median(np.linalg.norm(tracks[s, n][:, None] - base, axis=-1), axis=0)
            for n, s in enumerate(tracked.T)
        ]
    )
    shares = 1 / np.maximum(gaps, 1e-6) ** 4
    middles = 0.5 * (usual[:, None] + base[None])
    shares = shares / shares.sum()
    return np.einsum("nb,nba->a", shares, middles), float((shares * gaps).sum())
