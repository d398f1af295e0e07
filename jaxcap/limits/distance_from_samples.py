"""Distance of poses from all rotations that limits were learned from."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..arguments import checked
from ..body.pose import Motion, Pose
from ..body.skeleton import Skeleton
from .frame_evaluation import map_frames
from .implicit_surface import LimitSurface, SurfaceLimits
from .primitives import radii


@checked
def sample_distance(limits: SurfaceLimits, skeleton: Skeleton, pose: Pose) -> Float[Array, "S"]:
    """Compute for each surface the rotation from a pose to the nearest one that was seen, radians.

    It is zero in the voxels of samples, and positive in the margin around them, where poses are allowed, and
    beyond. Of a child it is the distance from rotations that were seen with its parent nearby.
    """
    found = [_distance(surface, *surface.coordinates(skeleton, pose)) for surface in limits.surfaces]
    return jnp.stack(found)


@checked
@eqx.filter_jit
def sample_distance_frames(limits: SurfaceLimits, skeleton: Skeleton, motion: Motion) -> Float[Array, "F S"]:
    """Compute the distances of each frame from all that was seen, radians: see `sample_distance`."""
    return map_frames(lambda pose: sample_distance(limits, skeleton, pose), motion)


def _distance(surface: LimitSurface, place, parent) -> Float[Array, ""]:
    primitives = surface.primitives(parent)
    squared = jax.vmap(surface.chart.squared_distance, (0, None))(primitives.centres, place)
    # halves of rotation angles; those of quaternions come as sines
    far = squared > 1e-20
    halves = jnp.where(far, jnp.sqrt(jnp.where(far, squared, 1.0)), 0.0)
    if surface.chart.kind == "ball":
        halves = jnp.arcsin(jnp.minimum(halves, 1.0 - 1e-7))
    return 2 * jnp.maximum(
        jnp.min(halves - (radii(primitives) - surface.margin - surface.further_margin(parent))), 0.0
    )
