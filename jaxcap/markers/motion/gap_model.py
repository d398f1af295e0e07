"""A Gaussian model of marker offsets in gaps, learned from gaps that are made in visible pieces.

The offset of a marker is its position in the rest frame of its bone, under a pose that is solved without it. Of it
the offsets of the other markers of the bone explain a part, by linear regression. The rest is an
Ornstein-Uhlenbeck process, as in Gaussian process regression with an exponential kernel (Rasmussen and Williams
2006, section 4.2). Between two known values it is a bridge with a closed form.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ...geometry.linear import inverse_symmetric

#: times of correlation that are compared, seconds
TIMES = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
#: deviation of observed positions, metres
NOISE = 1e-3
#: number of made gaps that the covariance of all markers counts as
PRIOR_GAPS = 3.0
#: standard deviations of the interval that holds in nine of ten cases
NINETY = 1.645


class Gap(NamedTuple):
    """Frames `begin` to `end`, exclusive, of a marker without its position; and the frames before and after, -1 if none."""

    marker: int
    begin: int
    end: int
    before: int
    after: int


class MadeGaps(NamedTuple):
    """Gaps made in visible pieces, and the offsets of all markers under the poses without them."""

    gaps: list[Gap]
    offsets: Float[np.ndarray, "F M 3"]
    #: the markers that are known there
    seen: Bool[np.ndarray, "F M"]


class GapModel(NamedTuple):
    """The statistics of a marker in gaps."""

    neighbours: Int[np.ndarray, "K"]
    #: mean offsets of the marker and its neighbours, and their covariance, by coordinates of all
    mean: Float[np.ndarray, "N"]
    covariance: Float[np.ndarray, "N N"]
    #: time of correlation of what the neighbours do not explain, frames
    time: float
    #: covariance of what neither neighbours nor ends explain, for a bridge of unit variance
    residual: Float[np.ndarray, "3 3"]


def bridge(
    gap: Gap, time: float
) -> tuple[Float[np.ndarray, "T"], Float[np.ndarray, "T"], Float[np.ndarray, "T"]]:
    """Compute the weights of the value before and after a gap, and the variance between, of a process of unit variance."""
    at = np.arange(gap.begin, gap.end)
    first, last = (
        np.exp(-np.abs(at - end) / time) if end >= 0 else np.zeros(len(at)) for end in (gap.before, gap.after)
    )
    whole = np.exp(-(gap.after - gap.before) / time) if gap.before >= 0 and gap.after >= 0 else 0.0
    left, right = ((a - whole * b) / (1 - whole**2) for a, b in ((first, last), (last, first)))
    return left, right, np.maximum(1 - left * first - right * last, 1e-6)


def learn_gap_model(
    marker: int,
    neighbours: Int[np.ndarray, "K"],
    made: list[MadeGaps],
    pooled: Float[np.ndarray, "3 3"],
    rate: float,
) -> GapModel:
    """Learn the statistics of a marker from its made gaps; with few of them, `pooled (3, 3)` is its covariance."""
    index = np.array([marker, *neighbours])
    rows, counts = [], 0
    for one in made:
        for gap in one.gaps:
            if gap.marker == marker:
                known = one.seen[gap.begin : gap.end, index]
                values = np.where(known[..., None], one.offsets[gap.begin : gap.end, index], np.nan)
                rows.append(values.reshape(len(values), -1))
                counts += 1
    if not rows:
        size = 3 * len(index)
        return GapModel(neighbours, np.full(size, np.nan), np.eye(size), 0.2 * rate, pooled)
    samples = np.concatenate(rows)
    known = ~np.isnan(samples)
    mean = np.where(known.any(0), np.nansum(samples, 0) / np.maximum(known.sum(0), 1), 0.0)
    centred = np.where(known, samples - mean, 0.0)
    pairs = np.maximum(known.T.astype(float) @ known, 1.0)
    covariance = centred.T @ centred / pairs
    # few gaps say little about the regression: as many unexplained ones are added to the neighbours
    ridge = NOISE**2 + np.diagonal(covariance) * PRIOR_GAPS / (counts + PRIOR_GAPS)
    ridge[:3] = 0.0
    first = GapModel(neighbours, mean, covariance + np.diag(ridge), 0.0, pooled)
    best, chosen = -np.inf, first
    for seconds in TIMES:
        model = first._replace(time=seconds * rate)
        errors = np.concatenate(
            [_standard_errors(model, one, gap) for one in made for gap in one.gaps if gap.marker == marker]
        )
        scatter = errors[:, :3].T @ errors[:, :3] / len(errors)
        residual = (counts * scatter + PRIOR_GAPS * pooled) / (counts + PRIOR_GAPS)
        # log likelihood with the scatter's own mean variance
        fit = -1.5 * np.log(np.trace(scatter)) - 1.5 * np.mean(np.log(errors[:, 3]))
        if fit > best:
            best, chosen = fit, model._replace(residual=residual)
    return chosen


def estimate_gap(
    model: GapModel, gap: Gap, offsets: Float[np.ndarray, "F M 3"], seen: Bool[np.ndarray, "F M"]
) -> tuple[Float[np.ndarray, "T 3"], Float[np.ndarray, "T"]]:
    """Estimate the offsets of a marker in a gap; also return the variance factor of `residual` in each frame."""
    left, right, variance = bridge(gap, max(model.time, 1e-3))
    explained = _explained(model, offsets, seen, gap)
    ends = [
        offsets[end, gap.marker] - explained[at] if end >= 0 else np.zeros(3)
        for end, at in ((gap.before, 0), (gap.after, -1))
    ]
    return explained[1:-1] + left[:, None] * ends[0] + right[:, None] * ends[1], variance


def standardised_errors(model: GapModel, made: list[MadeGaps], marker: int) -> Float[np.ndarray, "E"]:
    """Compute the errors along the worst axis in made gaps, in standard deviations."""
    axis = worst_axis(model.residual)
    spread = np.sqrt(axis @ model.residual @ axis)
    errors = [
        _standard_errors(model, one, gap)[:, :3] @ axis / spread
        for one in made
        for gap in one.gaps
        if gap.marker == marker
    ]
    return np.concatenate(errors) if errors else np.zeros(0)


def worst_axis(covariance: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3"]:
    """Return the direction with the largest variance."""
    return np.linalg.eigh(covariance)[1][:, -1]


def _explained(model: GapModel, offsets, seen, gap: Gap) -> Float[np.ndarray, "T 3"]:
    """Predict the offsets by the neighbours in the frame before the gap, in it, and in the frame after."""
    first, last = (end if end >= 0 else gap.begin for end in (gap.before, gap.after))
    frames = np.array([first, *range(gap.begin, gap.end), last])
    result = np.tile(model.mean[:3], (len(frames), 1))
    if not len(model.neighbours):
        return result
    known = seen[np.ix_(frames, model.neighbours)]
    values = offsets[frames][:, model.neighbours] - model.mean[3:].reshape(-1, 3)
    for pattern in np.unique(known, axis=0):
        rows = (known == pattern).all(1)
        part = 3 + np.flatnonzero(np.repeat(pattern, 3))
        if len(part):
            gain = inverse_symmetric(model.covariance[np.ix_(part, part)]) @ model.covariance[part, :3]
            result[rows] += values[rows].reshape(rows.sum(), -1)[:, part - 3] @ gain
    return result


def _standard_errors(model: GapModel, made: MadeGaps, gap: Gap) -> Float[np.ndarray, "T 4"]:
    """Compute the errors in a made gap for a bridge of unit variance, and that variance."""
    found, variance = estimate_gap(model, gap, made.offsets, made.seen)
    errors = made.offsets[gap.begin : gap.end, gap.marker] - found
    return np.concatenate([errors / np.sqrt(variance)[:, None], variance[:, None]], 1)
