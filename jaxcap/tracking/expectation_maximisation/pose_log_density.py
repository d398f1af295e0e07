"""Density of a pose given a cloud, by which poses of one frame are compared."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...body.pose import Pose
from ...observe.clouds import Cloud
from ..track_frame import Tracker, first_estimate, penalty
from .em_step import box_volume, frame_statistics

#: standard deviation at which poses are compared, metres
COMPARISON_SIGMA = 0.02


@eqx.filter_jit
def pose_log_density(tracker: Tracker, pose: Pose, cloud: Cloud) -> Float[Array, ""]:
    """Compute the log-density of a pose for each point of a cloud, up to a constant: the mean log-likelihood of the
    points minus the `penalty` of the priors.

    The standard deviation is the same for all poses.
    """
    sigma = jnp.asarray(COMPARISON_SIGMA, pose.rotations.dtype)
    estimate = first_estimate(tracker, pose, sigma)
    volume = box_volume(cloud)
    found = frame_statistics(tracker.body, tracker.parts, tracker.mixture, cloud, volume, estimate)
    density = found.surface_log_likelihood - penalty(tracker, cloud, pose)
    # a NaN pose explains nothing
    return jnp.where(jnp.isfinite(density), density, -jnp.inf)
