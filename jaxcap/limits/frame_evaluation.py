"""Tests of joint limits over the frames of a motion."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
from jaxtyping import Array, Bool, Float

from ..arguments import checked
from ..batched_map import map_batches
from ..body.pose import Motion, Pose
from ..body.skeleton import Skeleton
from .abstract_limits import AbstractLimits, allowed
from .implicit_surface import SurfaceLimits, comfort

#: number of frames in a batch: more do not fit into the cache
BATCH = 256


@checked
@eqx.filter_jit
def allowed_frames(limits: AbstractLimits, skeleton: Skeleton, motion: Motion) -> Bool[Array, "F J"]:
    """Test if each joint is within its limits in each frame; joints without limits are."""
    return map_frames(lambda pose: allowed(limits, skeleton, pose), motion)


@checked
@eqx.filter_jit
def residual_frames(limits: AbstractLimits, skeleton: Skeleton, motion: Motion) -> Float[Array, "F C"]:
    """Compute the violation of each limit in each frame, about radians, of the joints `limits.residual_joints`."""
    return map_frames(lambda pose: limits.residual(skeleton, pose), motion)


@checked
@eqx.filter_jit
def comfort_frames(limits: SurfaceLimits, skeleton: Skeleton, motion: Motion) -> Float[Array, "F S"]:
    """Compute the comfort of each frame by each learned surface: see `comfort`."""
    return map_frames(lambda pose: comfort(limits, skeleton, pose), motion)


@checked
@eqx.filter_jit
def nearest_frames(limits: AbstractLimits, skeleton: Skeleton, motion: Motion) -> Motion:
    """Project every frame independently to the nearest allowed pose."""
    return Motion(map_frames(lambda pose: limits.project(skeleton, pose), motion), motion.rate)


def map_frames(function: Callable[[Pose], Any], motion: Motion) -> Any:
    """Map a function of one pose over the frames of a motion."""
    return map_batches(function, motion.poses, BATCH)
