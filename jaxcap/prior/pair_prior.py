"""Prior of the joint distribution of the rotations of a joint and its parent: a Gaussian mixture for each pair.

Whole poses have too many dimensions to be learned, but a pair of neighbouring joints has only six
(Adaptation, section 4.1.1).
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.optimize import minimize

from ..arguments import check_fields, checked
from ..body.pose import Pose, local_rotation_vectors
from ..body.skeleton import Skeleton
from ..geometry import rotation
from ..limits.rotation_vector_boxes import rotating_joints

#: frames at rest that differ by more than this, radians, belong to different rest poses
MAX_FRAME_ANGLE = np.radians(35.0)


class PairPrior(eqx.Module):
    """Gaussian mixtures over the rotations `x = (r_parent, r_child)` of P pairs of joints (Adaptation, eq.
    4.1).

    `r` is the rotation vector of a joint's rotation from rest, in the joint's own frame: twist, flexion,
    sideways, radians. Mixtures of fewer than K components are padded with components of weight zero.
    """

    #: names of each pair, the joint nearer to the root first
    pairs: tuple[tuple[str, str], ...] = eqx.field(static=True)
    #: orientations at rest of the joints in the training skeleton, unit quaternions
    frames: Float[Array, "P 2 4"]
    #: mixing weights, which sum to one
    weights: Float[Array, "P K"]
    means: Float[Array, "P K 6"]
    #: lower triangular `L`, with `L L^T` the inverse of the covariance
    factors: Float[Array, "P K 6 6"]
    #: mode of each mixture, and the log-density there
    modes: Float[Array, "P 6"]
    log_peaks: Float[Array, "P"]
    #: `B` with `-B B^T` the Hessian of the log-density at the mode
    curvature_factors: Float[Array, "P 6 6"]

    def __check_init__(self):
        check_fields(self)

    @property
    def precisions(self) -> Float[Array, "P K 6 6"]:
        """The inverse covariances."""
        return self.factors @ jnp.swapaxes(self.factors, -1, -2)

    @property
    def log_norms(self) -> Float[Array, "P K"]:
        """Logarithm of each component's own density at its mean."""
        return jnp.sum(jnp.log(jnp.diagonal(self.factors, axis1=-2, axis2=-1)), -1) - 3 * jnp.log(2 * jnp.pi)


def pair_indices(prior: PairPrior, skeleton: Skeleton) -> Int[np.ndarray, "P 2"]:
    """Look up the joint indices of the pairs in a skeleton. Raises `KeyError` where it lacks a joint."""
    return np.array([[skeleton.index(name) for name in pair] for pair in prior.pairs], int).reshape(-1, 2)


def pair_vectors(prior: PairPrior, skeleton: Skeleton, pose: Pose) -> Float[Array, "P 6"]:
    """Compute the rotation vectors of every pair in a pose: the parent's, then the child's."""
    return local_rotation_vectors(skeleton, pose)[pair_indices(prior, skeleton)].reshape(-1, 6)


def whitened_offsets(prior: PairPrior, x: Float[Array, "P 6"]) -> Float[Array, "P K 6"]:
    """Compute the whitened offset `L^T (x - mu)` to every component."""
    return jnp.einsum("pkji,pkj->pki", prior.factors, x[:, None] - prior.means)


def log_components(prior: PairPrior, x: Float[Array, "P 6"]) -> Float[Array, "P K"]:
    """Compute the logarithm of weight times density of each component; minus infinity for padding."""
    present = prior.weights > 0
    weights = jnp.where(present, jnp.log(jnp.where(present, prior.weights, 1.0)), -jnp.inf)
    return weights + prior.log_norms - 0.5 * jnp.sum(whitened_offsets(prior, x) ** 2, -1)


def log_density(prior: PairPrior, x: Float[Array, "P 6"]) -> Float[Array, "P"]:
    """Compute the log-density of the mixtures (eq. 4.1); the density is per radian to the sixth power."""
    return jax.nn.logsumexp(log_components(prior, x), axis=-1)


@checked
def likelihood(prior: PairPrior, skeleton: Skeleton, pose: Pose) -> Float[Array, "P"]:
    """Compute the density of each pair relative to its mixture's peak: one at the mode, towards zero far
    from the training data."""
    x = pair_vectors(prior, skeleton, pose)
    return jnp.exp(jnp.minimum(log_density(prior, x) - prior.log_peaks, 0.0))


def successive_pairs(skeleton: Skeleton) -> tuple[tuple[str, str], ...]:
    """List every rotating joint with its nearest rotating ancestor.

    Joints that do not rotate are skipped. Roots are in no pair, as they only orient the whole body.
    """
    turning = set(rotating_joints(skeleton))
    pairs = []
    for joint in sorted(turning):
        above = skeleton.parents[joint]
        while above >= 0 and above not in turning:
            above = skeleton.parents[above]
        if above >= 0:
            pairs.append((skeleton.names[above], skeleton.names[joint]))
    return tuple(pairs)


def describe_mismatch(prior: PairPrior, skeleton: Skeleton) -> str | None:
    """Describe why a prior does not fit a skeleton, as half a sentence; return None where it fits.

    The frames are compared too, as rotations from another rest pose have another meaning.
    """
    there = set(successive_pairs(skeleton))
    for pair, frames in zip(prior.pairs, np.asarray(prior.frames), strict=True):
        for name, frame in zip(pair, frames, strict=True):
            if name not in skeleton.names:
                return f"there is no joint '{name}' among {', '.join(skeleton.names)}"
            own = skeleton.orientations[skeleton.index(name)]
            turned = float(rotation.distance(jnp.asarray(frame, own.dtype), own))
            if turned > MAX_FRAME_ANGLE:
                return f"the rest frame of '{name}' differs by {np.degrees(turned):.0f}°"
        if pair not in there:
            return f"'{pair[1]}' is not the next rotating joint below '{pair[0]}'"
    return None


@checked
def make_pair_prior(
    pairs: Sequence[tuple[str, str]],
    frames: Float[np.ndarray, "P 2 4"],
    weights: Float[np.ndarray, "P K"],
    means: Float[np.ndarray, "P K 6"],
    factors: Float[np.ndarray, "P K 6 6"],
) -> PairPrior:
    """Create a prior from its mixtures, and find the mode of each.

    **Raises:** `ValueError` where there is no pair, arrays do not fit together, weights of a pair are
    negative or do not sum to one, or a factor is not lower triangular with a positive diagonal.
    """
    if not len(pairs):
        raise ValueError("There are no pairs of successive rotating joints; a prior needs at least one.")
    weights, means, factors = (np.asarray(values, float) for values in (weights, means, factors))
    shape = (len(pairs), weights.shape[-1])
    if (weights.shape, means.shape, factors.shape) != (shape, (*shape, 6), (*shape, 6, 6)):
        raise ValueError(
            f"The mixtures of {len(pairs)} pairs have weights of shape {weights.shape}, means of shape "
            f"{means.shape} and factors of shape {factors.shape}; expected {shape}, {(*shape, 6)} and "
            f"{(*shape, 6, 6)}."
        )
    for pair, share, mean, factor in zip(pairs, weights, means, factors, strict=True):
        name = " and ".join(pair)
        if not ((share >= 0).all() and abs(share.sum() - 1) < 1e-4):
            raise ValueError(
                f"The mixing weights of {name} are {share.tolist()}; expected numbers of at least 0 that sum to 1."
            )
        if not (
            np.isfinite(mean).all()
            and np.isfinite(factor).all()
            and (np.diagonal(factor, axis1=1, axis2=2) > 0).all()
        ):
            raise ValueError(
                f"The precision of a Gaussian of {name} is not positive definite; learn the prior again."
            )
    if np.triu(factors, 1).any():
        raise ValueError("The factors of the precisions are not lower triangular; learn the prior again.")
    peaks = [
        mixture_mode(*(part[share > 0] for part in (share, mean, factor)))
        for share, mean, factor in zip(weights, means, factors, strict=True)
    ]
    modes, heights, bends = (np.array(parts) for parts in zip(*peaks, strict=True))
    arrays = (frames, weights, means, factors, modes, heights, bends)
    return PairPrior(tuple(pairs), *(jnp.asarray(values, float) for values in arrays))


def mixture_mode(
    weights: Float[np.ndarray, "K"], means: Float[np.ndarray, "K D"], factors: Float[np.ndarray, "K D D"]
) -> tuple[Float[np.ndarray, "D"], float, Float[np.ndarray, "D D"]]:
    """Find the mode of a mixture, its log-density there, and `B` with `-B B^T` its Hessian there.

    Newton's method in a trust region starts from every mean.
    """
    precisions = factors @ np.swapaxes(factors, 1, 2)
    log_scales = (
        np.log(weights) + np.log(np.diagonal(factors, axis1=1, axis2=2)).sum(1) - means.shape[1] / 2 * np.log(2 * np.pi)
    )  # fmt: skip

    def depth(x):
        """Evaluate the negative log-density and its gradient."""
        joint = log_scales - 0.5 * (np.einsum("kji,kj->ki", factors, x - means) ** 2).sum(-1)
        total = np.logaddexp.reduce(joint)
        slopes = np.einsum("kij,kj->ki", precisions, x - means)
        return -total, np.exp(joint - total) @ slopes

    def bend(x):
        """Evaluate the Hessian of the negative log-density."""
        joint = log_scales - 0.5 * (np.einsum("kji,kj->ki", factors, x - means) ** 2).sum(-1)
        shares = np.exp(joint - np.logaddexp.reduce(joint))
        slopes = np.einsum("kij,kj->ki", precisions, x - means)
        slope = shares @ slopes
        spread = np.einsum("k,ki,kj->ij", shares, slopes, slopes) - np.outer(slope, slope)
        return np.einsum("k,kij->ij", shares, precisions) - spread

    found = [
        minimize(depth, mean, jac=True, hess=bend, method="trust-exact", options={"gtol": 1e-10})
        for mean in means
    ]
    lowest = min(found, key=lambda one: one.fun)
    values, vectors = np.linalg.eigh(bend(lowest.x))
    # the Hessian is singular where two peaks merge
    return lowest.x, -float(lowest.fun), vectors * np.sqrt(np.maximum(values, 1e-9 * values.max()))
