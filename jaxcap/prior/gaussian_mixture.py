"""Gaussian mixtures by expectation maximisation (EM), initialised by k-means++.

Plain NumPy in float64: compilation does not pay off for a few thousand poses of six numbers.
"""

import warnings
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.cluster.vq import kmeans2
from scipy.special import logsumexp

from ..geometry.linear import factor_symmetric

#: least standard deviation of a component in any direction, radians; captured joints are not more accurate
MIN_DEVIATION = np.radians(2.0)
#: the most rounds of EM, and the gain in mean log-likelihood below which they end
MAX_ITERATIONS, MIN_GAIN = 200, 1e-5
#: runs of k-means; the one with the least sum of squares initialises EM
NUM_KMEANS_RUNS = 5


class GaussianMixture(NamedTuple):
    """Weights (with sum one), means and inverse covariances of K Gaussians in D dimensions."""

    weights: Float[np.ndarray, "K"]
    means: Float[np.ndarray, "K D"]
    precisions: Float[np.ndarray, "K D D"]


class MixtureFit(NamedTuple):
    """A mixture, and the mean log-likelihood of the samples at the start and after each round."""

    mixture: GaussianMixture
    history: Float[np.ndarray, "R"]


def fit_mixture(
    samples: Float[np.ndarray, "N D"],
    num_components: int,
    *,
    min_deviation: float = MIN_DEVIATION,
    seed: int = 0,
    max_iterations: int = MAX_ITERATIONS,
    min_gain: float = MIN_GAIN,
) -> MixtureFit:
    """Fit a mixture of `num_components` Gaussians by EM (Adaptation, section 4.1.1); the likelihood never falls.

    **Arguments:** `min_deviation` is the least standard deviation of a component in any direction, radians; `max_iterations`
    is the most rounds, which end early if one gains less than `min_gain` per sample.

    **Raises:** `ValueError` if there are fewer samples than components, or if a sample is not finite.
    """
    if not 1 <= num_components <= len(samples):
        raise ValueError(
            f"A mixture of {num_components} components cannot be fitted to {len(samples)} samples; give more samples."
        )
    if not np.isfinite(samples).all():
        raise ValueError("A sample is not finite; leave its frame out.")
    rng = np.random.default_rng(seed)
    tries = [
        kmeans_labels(samples, num_components, rng)
        for _ in range(NUM_KMEANS_RUNS if num_components > 1 else 1)
    ]
    labels, _ = min(tries, key=lambda found: found[1])
    means = samples[:num_components]
    mixture = _m_step(samples, np.eye(num_components)[labels], means, min_deviation)
    history = []
    for _ in range(max_iterations + 1):
        joint = log_joint(mixture, samples)
        total = np.asarray(logsumexp(joint, axis=1))
        history.append(total.mean())
        if len(history) > max_iterations or (len(history) > 1 and history[-1] - history[-2] < min_gain):
            break
        mixture = _m_step(samples, np.exp(joint - total[:, None]), mixture.means, min_deviation)
    # drop components without samples
    kept = mixture.weights > 0
    return MixtureFit(GaussianMixture(*(part[kept] for part in mixture)), np.array(history))


def log_joint(mixture: GaussianMixture, samples: Float[np.ndarray, "N D"]) -> Float[np.ndarray, "N K"]:
    """Compute the logarithm of weight times density of each component at each sample."""
    factors = factor_symmetric(mixture.precisions)
    offsets = (samples[None] - mixture.means[:, None]) @ factors
    scales = np.log(np.diagonal(factors, axis1=1, axis2=2)).sum(1) - 0.5 * samples.shape[1] * np.log(
        2 * np.pi
    )
    with np.errstate(divide="ignore"):
        weights = np.log(mixture.weights)
    return (weights + scales)[None] - 0.5 * np.einsum("kni,kni->nk", offsets, offsets)


def mixture_log_density(
    mixture: GaussianMixture, samples: Float[np.ndarray, "N D"]
) -> Float[np.ndarray, "N"]:
    """Compute the logarithm of the mixture density at each sample (Adaptation, eq. 4.1)."""
    return np.asarray(logsumexp(log_joint(mixture, samples), axis=1))


def kmeans_labels(
    samples: Float[np.ndarray, "N D"], count: int, rng: np.random.Generator, max_iterations: int = 10
) -> tuple[Int[np.ndarray, "N"], float]:
    """Cluster samples by k-means++ (Arthur and Vassilvitskii 2007) and a few rounds of k-means.

    Returns the labels, and the sum of squared distances to the centres.
    """
    distinct, labels = np.unique(samples, axis=0, return_inverse=True)
    if len(distinct) <= count:
        return labels.reshape(-1), 0.0
    with warnings.catch_warnings():
        # a cluster may lose its samples; the mixture drops it
        warnings.filterwarnings("ignore", "One of the clusters is empty")
        centres, labels = kmeans2(samples, count, iter=max_iterations, minit="++", rng=rng)
    return labels, float(((samples - centres[labels]) ** 2).sum())


def _m_step(samples, responsibilities, means, min_deviation) -> GaussianMixture:
    """Perform the M step, with standard deviations bounded from below.

    Among covariances with no deviation below the floor, the most likely has the eigenvectors of the samples,
    and their variances raised to the floor. The step is therefore an exact maximiser, and the likelihood
    cannot fall.
    """
    sizes = responsibilities.sum(0)
    # keep the mean of a component without samples
    divisor = np.where(sizes > 0, sizes, 1.0)[:, None]
    means = np.where(sizes[:, None] > 0, responsibilities.T @ samples / divisor, means)
    offsets = samples[None] - means[:, None]
    covariances = np.swapaxes(offsets * responsibilities.T[..., None], 1, 2) @ offsets / divisor[..., None]
    variances, axes = np.linalg.eigh(covariances)
    axes = axes / np.sqrt(np.maximum(variances, min_deviation**2))[:, None]
    return GaussianMixture(sizes / len(samples), means, axes @ np.swapaxes(axes, 1, 2))
