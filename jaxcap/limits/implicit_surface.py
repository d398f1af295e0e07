"""Joint limits as implicit surfaces of spherical primitives, with coupling of a child to its parent."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..arguments import check_fields, checked
from ..body.pose import Pose
from ..body.skeleton import Skeleton
from .abstract_limits import AbstractLimits
from .chart import Chart
from .primitives import Primitives, signed_distance
from .project_onto_surface import project_inside
from .rest_poses.anatomical_joint import AnatomicalJoint


class LimitSurface(eqx.Module):
    """The limits of one joint: a union of blended spheres in the chart of its rotation (Limits, eq. 2), one
    for every keyframe of its parent (section 4.2).

    Primitive `n` of keyframe `v` is matched with primitive `n` of every other keyframe. The surface at any
    rotation of the parent therefore has weighted means of centres and radii, and is continuous between
    keyframes. An uncoupled joint has one keyframe and no parent.
    """

    joint: str = eqx.field(static=True)
    #: the joint that this joint is coupled to
    parent: str | None = eqx.field(static=True)
    chart: Chart
    parent_chart: Chart | None
    #: positions of the keyframes in the parent's chart, and the standard deviation of their Gaussian weights
    keys: Float[Array, "V 3"]
    reach: Float[Array, ""]
    centres: Float[Array, "V N 3"]
    #: thickness of the primitives; one that a keyframe lacks coincides with another one there
    thickness: Float[Array, "V N"]
    #: half the width of the smallest voxel: the unit of `stiffness` and `level`
    unit: Float[Array, ""]
    #: `level` is `iso` and `stiffness` is `k` of eq. 2
    level: Float[Array, ""]
    stiffness: Float[Array, ""]
    #: number of samples of each primitive at each keyframe
    counts: Float[Array, "V N"]
    #: densities at the training samples, sorted, for the comfort of a pose
    densities: Float[Array, "Q"]
    #: part of `thickness` beyond the voxels of samples, half a rotation in radians
    margin: Float[Array, ""] = eqx.field(default_factory=lambda: jnp.zeros(()))
    #: growth of the margin with the distance of the parent from the balls around all keyframes, and the radius of these balls
    growth: Float[Array, ""] = eqx.field(default_factory=lambda: jnp.zeros(()))
    key_radius: Float[Array, ""] = eqx.field(default_factory=lambda: jnp.zeros(()))
    #: the joint and its parent in the skeleton that they were learned with; None where they are not recognised
    anatomy: AnatomicalJoint | None = None
    parent_anatomy: AnatomicalJoint | None = None
    #: the skeletons from whose rest poses the rotations of the joint and of its parent are; None where there is none
    rest: Skeleton | None = None
    parent_rest: Skeleton | None = None

    def __check_init__(self):
        check_fields(self)

    def keyframe_weights(self, parent_coordinates: Float[Array, "3"]) -> Float[Array, "V"]:
        """Compute the blend weight of each keyframe at coordinates of the parent; they sum to one."""
        squared_distances = jnp.sum((self.keys - parent_coordinates) ** 2, -1)
        return jax.nn.softmax(-0.5 * squared_distances / self.reach**2)

    def primitives(self, parent_coordinates: Float[Array, "3"] | None) -> Primitives:
        """Interpolate the primitives at coordinates of the parent; they are thicker where the parent was not seen."""
        if parent_coordinates is None:
            centres, thickness = self.centres[0], self.thickness[0]
        else:
            shares = self.keyframe_weights(parent_coordinates)
            centres = jnp.tensordot(shares, self.centres, 1)
            thickness = shares @ self.thickness + self.further_margin(parent_coordinates)
        return Primitives(centres, thickness, self.unit, self.level, self.stiffness)

    def further_margin(self, parent_coordinates: Float[Array, "3"] | None) -> Float[Array, ""]:
        """Compute the margin that is added where the parent is away from all rotations that were seen."""
        if parent_coordinates is None:
            return jnp.zeros((), self.margin.dtype)
        nearest = jnp.min(jnp.sum((self.keys - parent_coordinates) ** 2, -1))
        far = nearest > self.key_radius**2
        distance = jnp.sqrt(jnp.where(far, nearest, 1.0))
        return self.growth * jnp.where(far, distance - self.key_radius, 0.0)

    def coordinates(
        self, skeleton: Skeleton, pose: Pose
    ) -> tuple[Float[Array, "3"], Float[Array, "3"] | None]:
        """Compute the coordinates of a pose in the charts of the joint and of its parent."""
        place = self.chart.coordinates(pose.rotations[skeleton.index(self.joint)])
        if self.parent_chart is None or self.parent is None:
            return place, None
        return place, self.parent_chart.coordinates(pose.rotations[skeleton.index(self.parent)])


class SurfaceLimits(AbstractLimits):
    """Learned limits of several joints, parents before their children."""

    surfaces: tuple[LimitSurface, ...]

    def residual(self, skeleton: Skeleton, pose: Pose):
        """Compute `max(0, level - F)` over the stiffness, in radians, continued by the distance to the
        nearest primitive beyond the cut-off of all primitives (Limits, section 5.2); see `signed_distance`.
        """
        beyond = []
        for surface in self.surfaces:
            place, parent = surface.coordinates(skeleton, pose)
            beyond.append(2 * jnp.maximum(signed_distance(surface.primitives(parent), place), 0.0))
        return jnp.stack(beyond)

    def residual_joints(self, skeleton: Skeleton):
        return jnp.array([skeleton.index(surface.joint) for surface in self.surfaces], jnp.int32)

    def project(self, skeleton: Skeleton, pose: Pose):
        """Project parents first, then each child onto the limits at its parent's new rotation (Limits,
        section 4.2)."""
        rotations = pose.rotations
        for surface in self.surfaces:
            here = Pose(pose.translations, rotations, pose.scale)
            place, parent = surface.coordinates(skeleton, here)
            primitives = surface.primitives(parent)
            inside = signed_distance(primitives, place) <= 0
            found = surface.chart.rotation(project_inside(primitives, surface.chart, place))
            joint = skeleton.index(surface.joint)
            rotations = rotations.at[joint].set(jnp.where(inside, rotations[joint], found))
        return Pose(pose.translations, rotations, pose.scale)


@checked
def comfort(limits: SurfaceLimits, skeleton: Skeleton, pose: Pose) -> Float[Array, "S"]:
    """Compute for each surface the share of training samples whose density is no higher than that of this
    pose.

    It is one where the joint is most of the time, and zero where it has never been. The density is that of
    joint and parent together, with each sample spread over its voxel.
    """
    return jnp.stack([_comfort(surface, *surface.coordinates(skeleton, pose)) for surface in limits.surfaces])


def density(
    surface: LimitSurface, coordinates: Float[Array, "3"], parent_coordinates: Float[Array, "3"] | None
) -> Float[Array, ""]:
    """Estimate the density of samples at a point, up to a factor."""
    # the standard deviation is the width of a sample's voxel, two units
    near = jnp.exp(-0.125 * jnp.sum((surface.centres - coordinates) ** 2, -1) / surface.unit**2)
    by_key = jnp.sum(surface.counts * near, -1)
    if parent_coordinates is None:
        return by_key[0]
    keys = jnp.exp(-0.5 * jnp.sum((surface.keys - parent_coordinates) ** 2, -1) / surface.reach**2)
    return keys @ by_key


def _comfort(surface: LimitSurface, coordinates, parent_coordinates) -> Float[Array, ""]:
    here = density(surface, coordinates, parent_coordinates)
    rank = jnp.searchsorted(surface.densities, here, side="right")
    return rank / len(surface.densities)
