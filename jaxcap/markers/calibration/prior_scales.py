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
#: and that the deviation of all slides counts for in that of a bone, and this one in that of a bone and feature
BONE_WEIGHT, SLIDE_WEIGHT = 3.0, 3.0
#: lower and upper limit of the scale of a template's group. The given deviations are the largest: data that contradict
#: them contradict the model, as where skin slides
MIN_SCALE, MAX_SCALE = 0.05, 1.0


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
    old: Float[Array, "N"],
    num_groups: int,
    initial: Float[Array, "G"] | Float[Array, ""] | float,
    weight: float,
) -> Float[Array, "G"]:
    """Compute the next prior variance of each group by MacKay's formula.

    **Arguments:** posterior `means` and `variances` of the numbers; `groups`, of each; `old`, the prior variances that
    they were computed with; `initial`, a variance that counts as `weight` determined numbers.
    """
    determined = jnp.maximum(1.0 - variances / old, 0.0)
    squares = jax.ops.segment_sum(means**2, groups, num_groups)
    count = jax.ops.segment_sum(determined, groups, num_groups)
    return (squares + weight * initial) / (count + weight)


def update_scales(
    groups: ScaledGroups, shared: Float[Array, "S"], covariance: Float[Array, "S S"]
) -> ScaledGroups:
    """Update the scales of a template's groups from a posterior mean and covariance of `s`."""
    means = groups.rows @ shared
    variances = jnp.sum((groups.rows @ covariance) * groups.rows, 1)
    old = groups.scales[groups.groups] ** 2
    found = next_variances(means, variances, groups.groups, old, len(groups.scales), 1.0, TEMPLATE_WEIGHT)
    return ScaledGroups(groups.rows, groups.groups, jnp.clip(jnp.sqrt(found), MIN_SCALE, MAX_SCALE))


def slide_variances(
    slides: Float[Array, "K M 3"],
    covariance: Float[Array, "K N N"],
    modes: Float[Array, "R N"],
    bones: Int[Array, "R"],
    old: Float[Array, "K R"],
    num_bones: int,
) -> Float[Array, "K B"]:
    """Update the prior variance of the slides of each bone with each feature, metres squared a square radian.

    `covariance`, that of the slides with each feature. `modes` change the distances between markers of a bone, `bones` are
    those of the modes. A rigid motion of all markers of a bone is left out: if it were included, ever larger slides would
    replace poses. The variance of all slides together counts as `BONE_WEIGHT` numbers of each bone, and that of a bone as
    `SLIDE_WEIGHT` numbers of each of its features.
    """
    kinds = len(slides)
    means = (slides.reshape(kinds, -1) @ modes.T).reshape(-1)
    variances = jnp.einsum("rn,knm,rm->kr", modes, covariance, modes).reshape(-1)
    old, own = old.reshape(-1), jnp.tile(bones, kinds)
    determined = jnp.maximum(1.0 - variances / old, 0.0)
    common = jnp.sum(means**2) / jnp.maximum(jnp.sum(determined), 1.0)
    of_bone = next_variances(means, variances, own, old, num_bones, common, BONE_WEIGHT)
    groups = jnp.repeat(jnp.arange(kinds), len(bones)) * num_bones + own
    found = next_variances(
        means, variances, groups, old, kinds * num_bones, jnp.tile(of_bone, kinds), SLIDE_WEIGHT
    )
    return found.reshape(kinds, num_bones)
