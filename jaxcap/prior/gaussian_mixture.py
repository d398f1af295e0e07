"""Gaussian mixtures by expectation maximisation, from a start by k-means++.

Plain NumPy, float64: a few thousand poses of six numbers are no work for a compiler.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..geometry.linear import factor_symmetric

#: least standard deviation of a component in any direction, radians: captured joints are not known better
FLOOR = np.radians(2.0)
#: rounds of EM at most, and the mean gain of log-likelihood that ends them
ROUNDS, GAIN = 200, 1e-5
#: tries of k-means, of which the tightest is where EM starts
TRIES = 5


class Mixture(NamedTuple):
    """Weights, which sum to one, means and inverse covariances of K Gaussians in D numbers."""

    weights: Float[np.ndarray, "K"]
    means: Float[np.ndarray, "K D"]
    precisions: Float[np.ndarray, "K D D"]


class MixtureFit(NamedTuple):
    """A mixture, and the mean log-likelihood of the samples at its start and after each round."""

    mixture: Mixture
    history: Float[np.ndarray, "R"]


def fit_mixture(
    samples: Float[np.ndarray, "N D"],
    count: int,
    *,
    floor: float = FLOOR,
    seed: int = 0,
    rounds: int = ROUNDS,
    gain: float = GAIN,
) -> MixtureFit:
    """A mixture of `count` Gaussians by EM (Adaptation, section 4.1.1); the likelihood never falls.

    **Arguments:** `floor`, radians, the least deviation of a component in any direction; `rounds` at
    most, fewer where one gains less than `gain` by sample.

    **Raises:** `ValueError` where there are fewer samples than components, or one is not finite.
    """
    if not 1 <= count <= len(samples):
        raise ValueError(f"{len(samples)} samples cannot be split among {count} components; give more.")
    if not np.isfinite(samples).all():
        raise ValueError("A sample of a mixture is not finite; leave its frame out.")
    rng = np.random.default_rng(seed)
    tries = [spread_labels(samples, count, rng) for _ in range(TRIES if count > 1 else 1)]
    labels, _ = min(tries, key=lambda found: found[1])
    means = samples[:count]
    mixture = _maximise(samples, np.eye(count)[labels], means, floor)
    history = []
    for _ in range(rounds + 1):
        joint = log_joint(mixture, samples)
        total = log_sum(joint)
        history.append(total.mean())
        if len(history) > rounds or (len(history) > 1 and history[-1] - history[-2] < gain):
            break
        mixture = _maximise(samples, np.exp(joint - total[:, None]), mixture.means, floor)
    # a component that lost all its samples says nothing
    kept = mixture.weights > 0
    return MixtureFit(Mixture(*(part[kept] for part in mixture)), np.array(history))


def log_joint(mixture: Mixture, samples: Float[np.ndarray, "N D"]) -> Float[np.ndarray, "N K"]:
    """Logarithm of weight times density of each component at each sample."""
    factors = factor_symmetric(mixture.precisions)
    offsets = (samples[None] - mixture.means[:, None]) @ factors
    scales = np.log(np.diagonal(factors, axis1=1, axis2=2)).sum(1) - 0.5 * samples.shape[1] * np.log(
        2 * np.pi
    )
    with np.errstate(divide="ignore"):
        weights = np.log(mixture.weights)
    return (weights + scales)[None] - 0.5 * np.einsum("kni,kni->nk", offsets, offsets)


def log_density(mixture: Mixture, samples: Float[np.ndarray, "N D"]) -> Float[np.ndarray, "N"]:
    """Logarithm of the mixture's density at each sample (Adaptation, eq. 4.1)."""
    return log_sum(log_joint(mixture, samples))


def log_sum(joint: Float[np.ndarray, "N K"]) -> Float[np.ndarray, "N"]:
    """`log(sum(exp(joint)))` of every row."""
    top = joint.max(1, keepdims=True)
    return top[:, 0] + np.log(np.exp(joint - top).sum(1))


def spread_labels(
    samples: Float[np.ndarray, "N D"], count: int, rng: np.random.Generator, rounds: int = 10
) -> tuple[Int[np.ndarray, "N"], float]:
    """Clusters by k-means++ (Arthur and Vassilvitskii 2007), and the sum of squared distances to their
    centres: each centre is drawn with a chance that grows with the squared distance to those before it;
    a few rounds of k-means then settle them."""
    centres = samples[[rng.integers(len(samples))]]
    apart = ((samples - centres[0]) ** 2).sum(1)
    while len(centres) < count:
        # where all samples are the same, any is as good
        chances = apart / apart.sum() if apart.sum() > 0 else None
        centres = np.vstack([centres, samples[rng.choice(len(samples), p=chances)]])
        apart = np.minimum(apart, ((samples - centres[-1]) ** 2).sum(1))
    labels = _closest(samples, centres)
    for _ in range(rounds):
        sizes = np.bincount(labels, minlength=count)
        sums = np.stack([np.bincount(labels, column, count) for column in samples.T], 1)
        centres = np.where(sizes[:, None] > 0, sums / np.maximum(sizes, 1)[:, None], centres)
        moved = _closest(samples, centres)
        if (moved == labels).all():
            break
        labels = moved
    return labels, float(((samples - centres[labels]) ** 2).sum())


def _closest(samples, centres) -> np.ndarray:
    return np.argmin((centres**2).sum(1) - 2 * samples @ centres.T, 1)


def _maximise(samples, shares, means, floor) -> Mixture:
    """The M step. Among covariances with no deviation below the floor, the likeliest has the samples'
    own eigenvectors and their variances raised to it, so the step maximises exactly what the E step
    set up, and the likelihood cannot fall."""
    sizes = shares.sum(0)
    # a component without samples stays where it is
    divisor = np.where(sizes > 0, sizes, 1.0)[:, None]
    means = np.where(sizes[:, None] > 0, shares.T @ samples / divisor, means)
    offsets = samples[None] - means[:, None]
    covariances = np.swapaxes(offsets * shares.T[..., None], 1, 2) @ offsets / divisor[..., None]
    variances, axes = np.linalg.eigh(covariances)
    axes = axes / np.sqrt(np.maximum(variances, floor**2))[:, None]
    return Mixture(sizes / len(samples), means, axes @ np.swapaxes(axes, 1, 2))
