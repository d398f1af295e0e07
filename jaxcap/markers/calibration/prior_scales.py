"""Deviations of priors that maximise the marginal likelihood (empirical Bayes).

A prior `z ~ N(0, sigma^2 I)` of `n` numbers with the posterior means `z` and variances `v` has

    sigma^2 = |z|^2 / gamma        gamma = n - sum v / sigma^2

at a maximum of the marginal likelihood (MacKay, Bayesian Interpolation, 1992). `gamma` is the number of those that the
data determine. The right side at the present `sigma` gives the next one. So numbers that no data determine have no
influence on the deviation, and a group that the data do not need vanishes (automatic relevance determination).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .calibration_parameters import PriorGroups

#: number of determined numbers that the initial deviations of a template count for
TEMPLATE_WEIGHT = 2.0
#: and that the deviation of all slides counts for in that of a bone's
SLIDE_WEIGHT = 6.0
#: lower and upper limit of the scale of a template's group
MIN_SCALE, MAX_SCALE = 0.05, 4.0


class ScaledGroups(eqx.Module):
    """Rows of a prior in units of initial deviations, their groups, and the scales of the groups' deviations."""

    rows: Float[Array, "N S"]
    groups: Int[Array, "N"]
    scales: Float[Array, "G"]

    def precision(self) -> Float[Array, "S S"]:
        """Compute the inverse covariance of `s`."""
        scaled = self.rows / self.scales[self.groups][:, None]
        return scaled.T @ scaled


def scaled_groups(groups: PriorGroups, dtype) -> ScaledGroups:
    """Start at scales of one."""
    count = int(groups.groups.max(initial=-1)) + 1
    return ScaledGroups(
        jnp.asarray(groups.rows, dtype), jnp.asarray(groups.groups), jnp.ones(max(count, 1), dtype)
    )


def next_variances(
    means: Float[Array, "N"],
    variances: Float[Array, "N"],
    groups: Int[Array, "N"],
    old: Float[Array, "G"],
    initial: Float[Array, ""] | float,
    weight: float,
) -> Float[Array, "G"]:
    """Compute the next prior variance of each group by MacKay's formula.

    **Arguments:** posterior `means` and `variances` of the numbers; `groups`, of each; `old`, the prior variances that
    they were computed with; `initial`, a variance that counts as `weight` determined numbers.
    """
    determined = jnp.maximum(1.0 - variances / old[groups], 0.0)
    squares = jax.ops.segment_sum(means**2, groups, len(old))
    count = jax.ops.segment_sum(determined, groups, len(old))
    return (squares + weight * initial) / (count + weight)


def update_scales(
    groups: ScaledGroups, shared: Float[Array, "S"], covariance: Float[Array, "S S"]
) -> ScaledGroups:
    """Update the scales of a template's groups from a posterior mean and covariance of `s`."""
    means = groups.rows @ shared
    variances = jnp.sum((groups.rows @ covariance) * groups.rows, 1)
    found = next_variances(means, variances, groups.groups, groups.scales**2, 1.0, TEMPLATE_WEIGHT)
    return ScaledGroups(groups.rows, groups.groups, jnp.clip(jnp.sqrt(found), MIN_SCALE, MAX_SCALE))


def slide_variances(
    slides: Float[Array, "K M 3"],
    variances: Float[Array, "K M 3"],
    bones: Int[Array, "M"],
    old: Float[Array, "K M"],
    num_bones: int,
    limits: tuple[float, float],
) -> Float[Array, "K M"]:
    """Update the prior variance of the slides of each bone with each feature, metres squared a square radian.

    The variance of all slides together counts as `SLIDE_WEIGHT` numbers of each bone. `limits` are those of deviations.
    """
    kinds, markers = slides.shape[:2]
    own = (jnp.arange(kinds)[:, None] * num_bones + bones[None]).reshape(-1)
    groups = jnp.repeat(own, 3)
    each, known = slides.reshape(-1), variances.reshape(-1)
    prior = jnp.zeros(kinds * num_bones, slides.dtype).at[own].set(old.reshape(-1))
    prior = jnp.where(prior > 0, prior, 1.0)
    determined = jnp.sum(jnp.maximum(1.0 - known / prior[groups], 0.0))
    common = jnp.sum(each**2) / jnp.maximum(determined, 1.0)
    found = next_variances(each, known, groups, prior, common, SLIDE_WEIGHT)
    return jnp.clip(found[own].reshape(kinds, markers), limits[0] ** 2, limits[1] ** 2)
