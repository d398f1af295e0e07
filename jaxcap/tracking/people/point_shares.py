"""Shares of several people in the points of one cloud: the E-step between people."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ...body.body import pose_body
from ...body.pose import Pose
from ...observe.clouds import Cloud
from ..expectation_maximisation.em_step import Estimate, box_volume, e_step, uniform_priors
from ..expectation_maximisation.surface_density import matched_log_density
from ..judgement.region_samples import RegionSamples
from ..track_frame import Tracker

#: standard deviation of a person's own outliers, such as hair and clothes, from the surface, metres
OUTLIER_DEVIATION = 0.1
#: standard deviation along the surface of a point from the nearest vertex, metres: the vertices of a reduced body are up to
#: 4 cm apart
ALONG_DEVIATION = 0.03
#: density of the points that belong to nobody, per cubic metre: equal to that of a person's outliers at 25 cm
NOBODY_DENSITY = 0.01
#: every how many samples of a surface the distances of points are measured to
STRIDE = 3
#: a share below this is none
MIN_SHARE = 1e-3


class PersonDensity(eqx.Module):
    """The density of one person at the N points of a cloud."""

    #: log of the mixture of surface and own outliers, per metre^3
    log_density: Float[Array, "N"]
    #: of the points from samples of the surface, metres
    distances: Float[Array, "N"]
    #: evenly spread samples of the surface, metres
    samples: Float[Array, "S 3"]


@eqx.filter_jit
def person_density(
    tracker: Tracker, surface: RegionSamples, pose: Pose, sigma: Float[Array, ""], cloud: Cloud
) -> PersonDensity:
    """Compute the density of a posed person at all points.

    It is `(1 - w) p(y) + w q(y)`: `p` is the density on the surface as a whole (`matched_log_density`), with the standard
    deviations `sigma` across the surface and `ALONG_DEVIATION` along it, or `sigma` if that is larger; and `q`, a normal
    distribution about the nearest sample of the surface with the standard deviation `OUTLIER_DEVIATION`, is the person's
    own class of outliers. `w` is the share of outliers of the tracker.
    """
    mixture, parts = tracker.mixture, tracker.parts
    estimate = Estimate(pose, sigma, uniform_priors(parts, sigma.dtype))
    posed, found = e_step(tracker.body, parts, mixture, cloud, box_volume(cloud), estimate)
    along = jnp.minimum(1.0, (sigma / ALONG_DEVIATION) ** 2)
    matched = matched_log_density(found, parts, posed, cloud, sigma, along)
    samples = pose_body(surface.body, pose).vertices
    # relative to the body's centre, as differences of squares lose digits far from the origin
    middle = jnp.mean(samples, 0)
    points, near = cloud.points - middle, samples[::STRIDE] - middle
    squared = jnp.sum(points**2, 1) + jnp.min(jnp.sum(near**2, 1) - 2 * points @ near.T, 1)
    squared = jnp.maximum(squared, 0.0)
    present = sum(count > 0 for count in parts.blocks_of_part)
    own = -jnp.log(present) - 1.5 * jnp.log(2 * jnp.pi * OUTLIER_DEVIATION**2)
    own = own - squared / (2 * OUTLIER_DEVIATION**2)
    log_density = jnp.logaddexp(jnp.log1p(-mixture.outlier) + matched, jnp.log(mixture.outlier) + own)
    return PersonDensity(log_density, jnp.sqrt(squared), samples)


@jax.jit
def responsibilities(log_densities: Float[Array, "K N"]) -> Float[Array, "K N"]:
    """Compute the share of each of K people in each point; the rest is nobody's.

    The shares are `p_k(y) / (sum_j p_j(y) + NOBODY_DENSITY)`. A person who is absent has a log-density of minus infinity.
    """
    nobody = jnp.full_like(log_densities[:1], jnp.log(NOBODY_DENSITY))
    return jax.nn.softmax(jnp.concatenate([log_densities, nobody]), axis=0)[:-1]


@jax.jit
def person_weights(
    weights: Float[Array, "N"],
    shares: Float[Array, "K N"],
    distances: Float[Array, "N"],
    person: int | Int[Array, ""],
    reach: float | Float[Array, ""],
) -> Float[Array, "N"]:
    """Compute the weights of the points for one person: those that the other people do not explain.

    Points that nobody explains keep their weight for everyone within `reach` metres of the predicted surface, so that a
    person's own unexplained points are judged.
    """
    others = jnp.sum(jnp.where(jnp.arange(len(shares))[:, None] == person, 0.0, shares), 0)
    kept = 1.0 - others
    return jnp.where((kept > MIN_SHARE) & (distances <= reach), weights * kept, 0.0)


@jax.jit
def is_nobodys(
    weights: Float[Array, "N"],
    shares: Float[Array, "K N"],
    distances: Float[Array, "K N"],
    away: float | Float[Array, ""],
) -> Bool[Array, "N"]:
    """Find the points that nobody explains and that are farther than `away` metres from every person."""
    return (weights > 0) & (jnp.sum(shares, 0) < 0.5) & (jnp.min(distances, 0) > away)


@jax.jit
def surface_distance(one: Float[Array, "S 3"], other: Float[Array, "S 3"]) -> Float[Array, ""]:
    """Compute the least distance between samples of two surfaces, metres."""
    middle = jnp.mean(one, 0)
    a, b = one[::STRIDE] - middle, other[::STRIDE] - middle
    squared = jnp.sum(a**2, 1)[:, None] - 2 * a @ b.T + jnp.sum(b**2, 1)
    return jnp.sqrt(jnp.maximum(jnp.min(squared), 0.0))
