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

#: times of correlation that are compared, seconds; the last is that of a random walk
TIMES = (0.05, 0.2, 1.0, 5.0, 1e4)
#: independent variances of the neighbours that are compared, as shares of their own; the last leaves neighbours out
RIDGES = (0.03, 0.3, np.inf)
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
    #: errors in made gaps, predicted by the other rounds, for a bridge of unit variance
    errors: Float[np.ndarray, "E 3"]


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
    mine = [one._replace(gaps=[gap for gap in one.gaps if gap.marker == marker]) for one in made]
    mine = [one for one in mine if one.gaps]
    count = sum(len(one.gaps) for one in mine)
    size = 3 * (1 + len(neighbours))
    nothing = GapModel(
        neighbours[:0], np.full(size, np.nan), np.eye(size), 0.2 * rate, pooled, np.zeros((0, 3))
    )
    if len(mine) < 2:
        return nothing
    best, chosen = -np.inf, nothing
    for ridge in RIDGES:
        kept = neighbours if np.isfinite(ridge) else neighbours[:0]
        if len(kept) == 0 and np.isfinite(ridge):
            continue
        # each round of made gaps is predicted by the others
        folds = [_moments(marker, kept, [other for other in mine if other is not one], ridge) for one in mine]
        explained = [
            (gap, one.offsets, _explained(fold, one.offsets, one.seen, gap))
            for one, fold in zip(mine, folds, strict=True)
            for gap in one.gaps
        ]
        for seconds in TIMES:
            errors = np.concatenate([_standard_errors(*each, seconds * rate) for each in explained])
            scatter = errors[:, :3].T @ errors[:, :3] / len(errors)
            # log likelihood with the scatter's own mean variance
            fit = -1.5 * np.log(np.trace(scatter)) - 1.5 * np.mean(np.log(errors[:, 3]))
            if fit > best:
                residual = (count * scatter + PRIOR_GAPS * pooled) / (count + PRIOR_GAPS)
                model = _moments(marker, kept, mine, ridge)
                best = fit
                chosen = model._replace(time=seconds * rate, residual=residual, errors=errors[:, :3])
    return chosen


def _moments(marker: int, neighbours: Int[np.ndarray, "K"], made: list[MadeGaps], ridge: float) -> GapModel:
    """Compute the mean and covariance of the offsets of a marker and its neighbours in made gaps."""
    index = np.array([marker, *neighbours])
    rows = []
    for one in made:
        for gap in one.gaps:
            known = one.seen[gap.begin : gap.end, index]
            # the made gap is known to us
            known[:, 0] = True
            values = np.where(known[..., None], one.offsets[gap.begin : gap.end, index], np.nan)
            rows.append(values.reshape(len(values), -1))
    samples = np.concatenate(rows)
    known = ~np.isnan(samples)
    mean = np.where(known, samples, 0.0).sum(0) / np.maximum(known.sum(0), 1)
    centred = np.where(known, samples - mean, 0.0)
    covariance = centred.T @ centred / np.maximum(known.T.astype(float) @ known, 1.0)
    added = NOISE**2 + np.diagonal(covariance) * (ridge if np.isfinite(ridge) else 0.0)
    added[:3] = 0.0
    return GapModel(neighbours, mean, covariance + np.diag(added), 0.0, np.eye(3), np.zeros((0, 3)))


def estimate_gap(
    model: GapModel, gap: Gap, offsets: Float[np.ndarray, "F M 3"], seen: Bool[np.ndarray, "F M"]
) -> tuple[Float[np.ndarray, "T 3"], Float[np.ndarray, "T"]]:
    """Estimate the offsets of a marker in a gap; also return the variance factor of `residual` in each frame."""
    return _bridge_gap(gap, offsets, _explained(model, offsets, seen, gap), model.time)


def _bridge_gap(gap: Gap, offsets, explained, time: float) -> tuple[np.ndarray, np.ndarray]:
    left, right, variance = bridge(gap, time)
    ends = [
        offsets[end, gap.marker] - explained[at] if end >= 0 else np.zeros(3)
        for end, at in ((gap.before, 0), (gap.after, -1))
    ]
    return explained[1:-1] + left[:, None] * ends[0] + right[:, None] * ends[1], variance


def standardised_errors(model: GapModel) -> Float[np.ndarray, "E"]:
    """Compute the errors along the worst axis in made gaps, in standard deviations."""
    axis = worst_axis(model.residual)
    return model.errors @ axis / np.sqrt(axis @ model.residual @ axis)


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


def _standard_errors(gap: Gap, offsets, explained, time: float) -> Float[np.ndarray, "T 4"]:
    """Compute the errors in a made gap for a bridge of unit variance, and that variance."""
    found, variance = _bridge_gap(gap, offsets, explained, time)
    errors = offsets[gap.begin : gap.end, gap.marker] - found
    return np.concatenate([errors / np.sqrt(variance)[:, None], variance[:, None]], 1)
