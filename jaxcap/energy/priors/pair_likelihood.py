"""Priors of the joint distribution of the rotations of a joint and its parent, as learned from data."""

import jax
import jax.numpy as jnp

from ...body.body import Posed
from ...prior.pair_prior import PairPrior, log_components, log_density, pair_vectors, whitened_offsets
from ..energy import AbstractEnergy

#: keeps the slope of a root finite where a likelihood is one up to rounding
TINY = 1e-30


class LikelihoodPrior(AbstractEnergy):
    """`1 - mean_p P_p` over the likelihoods of all pairs (Adaptation, eq. 4.8), each as a share of its
    mixture's peak: zero at the likeliest pose, one far from all learned poses.

    It has influence only near the mixtures: where `P` is zero, so is its slope. For distant poses, and for
    initialisation, use `MahalanobisPrior`.
    """

    prior: PairPrior

    def residual(self, posed: Posed):
        """Compute six residuals per pair, whose squares sum to `(1 - P) / number of pairs`.

        With `d = x - x*` from the mode and `-B B^T` the curvature of `log P` there, `1 - P` is `|B^T d|^2 /
        2` and higher orders. So `sqrt(1 - P)` itself has a kink at the mode, like a length at zero, while the
        vector

            r = B^T d . sqrt((1 - P) / |B^T d|^2)

        has the same square everywhere and the slope `B^T / sqrt(2)` at the mode, so that the normal equations
        have the true curvature. For one Gaussian it is `L^T (x - mu)` under Welsch's loss.
        """
        prior = self.prior
        x = pair_vectors(prior, posed.body.skeleton, posed.pose)
        along = jnp.einsum("pji,pj->pi", prior.curvature_factors, x - prior.modes)
        square = jnp.sum(along**2, -1)
        # near the mode the quotient is a half to more digits than a difference of logarithms has
        near = square < jnp.sqrt(jnp.finfo(square.dtype).eps)
        beyond = jnp.maximum(prior.log_peaks - log_density(prior, x), TINY)
        ratio = jnp.where(near, 0.5, -jnp.expm1(-beyond) / jnp.where(near, 1.0, square))
        return (along * jnp.sqrt(ratio / len(prior.pairs))[:, None]).reshape(-1)


class MahalanobisPrior(AbstractEnergy):
    """`mean_p |L^T (x_p - mu)|^2`, the squared distance of each pair from its most likely component, in that
    component's standard deviations.

    The least squares of minus the logarithm of eq. 4.1, with the sum over components replaced by its largest
    term, which is chosen anew at each evaluation. Its gradient grows with the distance, so it attracts poses
    from anywhere. Where two components are equally likely it is discontinuous, by the difference of their
    weights and widths.
    """

    prior: PairPrior

    def residual(self, posed: Posed):
        prior = self.prior
        x = pair_vectors(prior, posed.body.skeleton, posed.pose)
        chosen = jnp.argmax(jax.lax.stop_gradient(log_components(prior, x)), -1)
        offsets = jnp.take_along_axis(whitened_offsets(prior, x), chosen[:, None, None], 1)
        return offsets.reshape(-1) / jnp.sqrt(len(prior.pairs))
