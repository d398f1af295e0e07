"""Expectation conditional maximisation of a pose against a cloud (Kineben, section 3.3.2)."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...arguments import check_fields, checked
from ...body.body import Body, Posed, pose_body
from ...body.pose import Pose
from ...energy.data.points import PointToPlane
from ...energy.data.sufficient_statistics import rigid_moments
from ...energy.energy import AbstractEnergy, Sum
from ...fit.correspondence.part_blocks import PartBlocks
from ...fit.frame_equations import posed_equations, sum_equations
from ...fit.pose_problem import PoseProblem
from ...fit.solvers.descent import NormalDescent
from ...fit.solvers.minimise import take_step
from ...observe.clouds import Cloud
from ...small_matrices import apply_small
from ...stacking import device_array
from ...value_checks import as_number, check_at_least, check_positive, check_values, check_within
from .clothes import Clothes
from .e_step import Posterior, no_posterior, posterior, update_priors, update_sigma
from .subsets import Subsets
from .surface_density import surface_log_density

#: weight of a point in clothes relative to one on the skin, besides their deviations: one piece of cloth moves as a whole, so
#: that its points are hardly independent of each other
CLOTHES_WEIGHT = 0.1


class MixtureSettings(eqx.Module):
    """Parameters of the mixture model."""

    #: least cosine between a point's normal and that of a matched vertex
    normal_threshold: Float[Array, ""]
    #: share of points that no part explains
    outlier: Float[Array, ""]
    #: lower bound of the standard deviation, metres
    smallest_sigma: Float[Array, ""]
    #: weight of the distance along the surface relative to the one across it; 1 is Kineben's point-to-point
    #: distance, 0 lets points slide freely
    tangential_weight: Float[Array, ""]
    #: constant on the diagonal of the normal equations, per metre and radian squared
    damping: Float[Array, ""]
    #: number of most likely parts that a point may match; on a skinned surface adjacent parts move almost
    #: alike, so that one is enough
    candidates: int = eqx.field(static=True, default=1)
    #: estimate the parts' prior shares too, or keep them uniform
    estimate_priors: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        check_fields(self)


@checked
def make_mixture_settings(
    normal_threshold: float = 0.5,
    outlier: float = 0.1,
    smallest_sigma: float = 0.002,
    tangential_weight: float = 0.05,
    damping: float = 1.0,
    candidates: int = 1,
    estimate_priors: bool = False,
) -> MixtureSettings:
    """Make a `MixtureSettings` from plain numbers.

    **Raises:** `InputError` for one that is out of its range.
    """
    where = "make_mixture_settings"
    check_within(where, -1, 1, normal_threshold=normal_threshold)
    check_values(where, lambda share: (share > 0) & (share < 1), "a share between 0 and 1", outlier=outlier)
    check_positive(where, "metres", smallest_sigma=smallest_sigma)
    check_within(where, 0, 1, tangential_weight=tangential_weight)
    check_at_least(where, 0, damping=damping)
    check_at_least(where, 1, candidates=candidates)
    return MixtureSettings(
        normal_threshold=as_number(normal_threshold),
        outlier=as_number(outlier),
        smallest_sigma=as_number(smallest_sigma),
        tangential_weight=as_number(tangential_weight),
        damping=as_number(damping),
        candidates=candidates,
        estimate_priors=estimate_priors,
    )


class Estimate(eqx.Module):
    """The estimates of expectation maximisation."""

    pose: Pose
    #: standard deviation of the points from the surface, metres
    sigma: Float[Array, ""]
    #: prior share of each part
    priors: Float[Array, "K"]
    #: clothes of each part; None where they are not modelled
    clothes: Clothes | None = None


class FrameStatistics(eqx.Module):
    """Statistics of an estimate's fit to a cloud."""

    #: mean log-likelihood of a point in the mixture of parts, per metre^3
    log_likelihood: Float[Array, ""]
    #: mean `surface_log_density` of a point, by which poses are compared
    surface_log_likelihood: Float[Array, ""]
    #: share of points that no part explains
    outlier_share: Float[Array, ""]
    #: mean distance of the explained points from their vertices, metres
    mean_distance: Float[Array, ""]
    sigma: Float[Array, ""]


def uniform_priors(parts: PartBlocks, dtype=None) -> Float[Array, "K"]:
    """Make uniform priors over the parts that have vertices (Kineben, eq. 19)."""
    present = np.array([float(count > 0) for count in parts.blocks_of_part])
    return device_array(present / present.sum(), dtype)


def data_energy(
    found: Posterior,
    posed: Posed,
    cloud: Cloud,
    sigma: Float[Array, ""],
    tangential_weight: Float[Array, ""],
    clothes: Clothes | None = None,
) -> AbstractEnergy:
    """Compute twice the expected negative log-likelihood (Kineben, eq. 29): `sum p d^2 / sigma^2`.

    The distance across the surface counts fully, the one along it by `tangential_weight`, because a point's nearest
    vertex is only near its own position on the surface. The second is summed into the moments of each part,
    whose points move with the part's bone. The first is not, because it depends on the blend of bones in the
    skin.
    """
    weights = cloud.weights[:, None] * found.weights / sigma**2
    points = jnp.broadcast_to(cloud.points[:, None], (*weights.shape, 3))
    if clothes is not None:
        weights, points = _add_clothes(found, posed, cloud, clothes.spread(sigma), weights, points)
    weights, points = weights.reshape(-1), points.reshape(-1, 3)
    vertices, bones = found.vertices.reshape(-1), found.parts.reshape(-1)
    r, t = posed.transforms.rotations[bones], posed.transforms.translations[bones]
    # the inverse of a similarity: its rotation block is a rotation times the scale
    rest = apply_small(jnp.swapaxes(r, 1, 2), posed.vertices[vertices] - t) / posed.pose.scale**2
    across = PointToPlane(vertices, points, posed.normals[vertices], (1.0 - tangential_weight) * weights)
    return Sum((across, rigid_moments(bones, rest, points, tangential_weight * weights, len(posed.joints))))


def _add_clothes(
    found: Posterior,
    posed: Posed,
    cloud: Cloud,
    clothes: Clothes,
    weights: Float[Array, "N C"],
    points: Float[Array, "N C 3"],
) -> tuple[Float[Array, "N C"], Float[Array, "N C 3"]]:
    """Add the pull of clothes to the weights and points of each first candidate.

    A point's squared distances from the skin and from the clothes add up to one about the mean of both targets: the point
    moves to the skin by the clothes' offset, as far as it is not one of the skin.
    """
    first = found.parts[:, 0]
    own = CLOTHES_WEIGHT * cloud.weights * found.clothes / clothes.deviation[first] ** 2
    total = own + weights[:, 0]
    share = jnp.where(total > 0, own / jnp.where(total > 0, total, 1.0), 0.0)
    inwards = (share * clothes.offset[first])[:, None] * posed.normals[found.vertices[:, 0]]
    return weights.at[:, 0].set(total), points.at[:, 0].add(-inwards)


def e_step(body: Body, parts: PartBlocks, mixture: MixtureSettings, cloud: Cloud, volume, estimate: Estimate):
    """Compute the E-step at an estimate: `(posed, posterior)`."""
    posed = pose_body(body, estimate.pose)
    return posed, posterior_at(parts, mixture, posed, cloud, volume, estimate)


def posterior_at(
    parts: PartBlocks, mixture: MixtureSettings, posed: Posed, cloud: Cloud, volume, estimate: Estimate
) -> Posterior:
    """Compute the posterior of a body that is posed already."""
    return posterior(
        parts,
        posed.vertices,
        posed.normals,
        cloud,
        estimate.sigma,
        normal_threshold=mixture.normal_threshold,
        outlier=mixture.outlier,
        box_volume=volume,
        priors=estimate.priors,
        candidates=mixture.candidates,
        clothes=estimate.clothes,
    )


class Step(eqx.Module):
    """A step of expectation maximisation: estimates before and after it, and the posterior at the first."""

    before: Estimate
    after: Estimate
    #: the body in both poses
    posed: Posed
    moved: Posed
    #: of all points, in the order of `Subsets.cloud`; unused ones have weight zero
    found: Posterior

    def largest_movement(self) -> Float[Array, ""]:
        """Compute the largest distance that the step moved a vertex, metres; constant for derivatives."""
        moved, posed = jax.lax.stop_gradient((self.moved.vertices, self.posed.vertices))
        return jnp.sqrt(jnp.max(jnp.sum((moved - posed) ** 2, 1)))


def first_step(
    body: Body, parts: PartBlocks, mixture: MixtureSettings, clouds: Cloud, start: Estimate
) -> Step:
    """Make the state before the first step of a loop, which has no posterior; `clouds` as in `Subsets`."""
    posed = pose_body(body, start.pose)
    found = no_posterior(clouds.weights.size, parts, mixture.candidates, clouds.points.dtype)
    return Step(start, start, posed, posed, found)


def em_step(
    parts: PartBlocks,
    mixture: MixtureSettings,
    prior: AbstractEnergy,
    subsets: Subsets,
    volume: Float[Array, ""],
    last: Step,
) -> Step:
    """Compute the E-step, one Gauss-Newton step on the pose, then the standard deviation and, optionally, the
    parts' shares (Kineben, section 3.3.2).

    The points are added subset by subset. Those of unused subsets are represented by the others.
    """
    estimate, posed = last.after, last.moved
    number, size = subsets.clouds.weights.shape
    dofs, dtype = posed.body.skeleton.num_dofs, posed.vertices.dtype
    blank = no_posterior(size, parts, mixture.candidates, dtype)

    def add(equations, subset):
        step, cloud = subset
        # a loop of a given length has derivatives in both modes
        return jax.lax.cond(step < subsets.count, add_used, lambda same, _: (same, blank), equations, cloud)

    def add_used(equations, cloud):
        own = posterior_at(parts, mixture, posed, cloud, volume, estimate)
        data = data_energy(own, posed, cloud, estimate.sigma, mixture.tangential_weight, estimate.clothes)
        return sum_equations([equations, posed_equations(data, posed)]), own

    none = jnp.zeros((), dtype), jnp.zeros(dofs, dtype), jnp.zeros((dofs, dofs), dtype)
    with jax.default_matmul_precision("highest"):
        equations, found = jax.lax.scan(add, none, (jnp.arange(number), subsets.clouds))
    found = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), found)
    cloud = subsets.cloud()
    used = jnp.sum(cloud.weights)
    share = jnp.sum(subsets.clouds.weights) / jnp.where(used > 0, used, 1.0)
    summed = jax.tree.map(lambda part: share * part, equations)
    pose = take_step(
        PoseProblem(prior, posed.body, summed=summed), estimate.pose, NormalDescent(), mixture.damping
    )
    moved = pose_body(posed.body, pose)
    squared = jnp.sum((moved.vertices[found.vertices] - cloud.points[:, None]) ** 2, -1)
    sigma = renew_sigma(mixture, found, squared, cloud, estimate.sigma)
    priors = estimate.priors
    if mixture.estimate_priors:
        priors = jnp.where(
            _has_inlier(found, cloud), update_priors(found, cloud.weights, parts.num_parts), priors
        )
    return Step(estimate, Estimate(pose, sigma, priors, estimate.clothes), posed, moved, found)


def step_statistics(
    parts: PartBlocks, mixture: MixtureSettings, subsets: Subsets, volume: Float[Array, ""], step: Step
) -> FrameStatistics:
    """Compute the statistics of the E-step of a step."""
    sigma, clothes = step.before.sigma, step.before.clothes
    return _statistics(parts, mixture, step.posed, step.found, subsets.cloud(), volume, sigma, clothes)


def renew_sigma(
    mixture: MixtureSettings,
    found: Posterior,
    squared_distances: Float[Array, "N C"],
    cloud: Cloud,
    sigma: Float[Array, ""],
) -> Float[Array, ""]:
    """Update the standard deviation within the bound of `mixture`; without a single inlier it keeps its value `sigma`."""
    renewed = jnp.maximum(update_sigma(found, squared_distances, cloud.weights), mixture.smallest_sigma)
    return jnp.where(_has_inlier(found, cloud), renewed, sigma)


def _has_inlier(found: Posterior, cloud: Cloud) -> Bool[Array, ""]:
    return jnp.sum(cloud.weights[:, None] * found.weights) > 0


def frame_statistics(
    body: Body,
    parts: PartBlocks,
    mixture: MixtureSettings,
    cloud: Cloud,
    volume: Float[Array, ""],
    estimate: Estimate,
) -> FrameStatistics:
    """Compute the statistics of an estimate's fit to its cloud."""
    posed, found = e_step(body, parts, mixture, cloud, volume, estimate)
    return _statistics(parts, mixture, posed, found, cloud, volume, estimate.sigma, estimate.clothes)


def _statistics(
    parts: PartBlocks,
    mixture: MixtureSettings,
    posed: Posed,
    found: Posterior,
    cloud: Cloud,
    volume: Float[Array, ""],
    sigma: Float[Array, ""],
    clothes: Clothes | None,
) -> FrameStatistics:
    on_surface = surface_log_density(
        found, parts, posed, cloud, sigma, mixture.outlier, volume, mixture.tangential_weight, clothes
    )
    total = jnp.maximum(jnp.sum(cloud.weights), jnp.finfo(cloud.weights.dtype).tiny)
    share = cloud.weights[:, None] * found.weights
    distances = jnp.sqrt(jnp.where(share > 0, found.squared_distances, 0.0))
    return FrameStatistics(
        log_likelihood=jnp.sum(cloud.weights * found.log_density) / total,
        surface_log_likelihood=jnp.sum(cloud.weights * on_surface) / total,
        outlier_share=jnp.sum(cloud.weights * found.outlier) / total,
        mean_distance=jnp.sum(share * distances) / jnp.maximum(jnp.sum(share), jnp.finfo(share.dtype).tiny),
        sigma=sigma,
    )


def box_volume(cloud: Cloud) -> Float[Array, ""]:
    """Compute the volume of the box around a cloud, metres^3: the support of the outlier class."""
    real = (cloud.weights > 0)[:, None]
    highest = jnp.max(jnp.where(real, cloud.points, -jnp.inf), 0)
    lowest = jnp.min(jnp.where(real, cloud.points, jnp.inf), 0)
    return jnp.maximum(jnp.prod(highest - lowest), 1e-6)
