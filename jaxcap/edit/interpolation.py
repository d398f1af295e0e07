"""Interpolate poses: rotations along the shortest arc, translations and scale linearly."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..arguments import checked
from ..body.pose import Motion, Pose, take_poses
from ..geometry import rotation


@jax.jit
def interpolate_poses(start: Pose, end: Pose, fraction: Float[Array, "F"] | Float[Array, "F J"]) -> Pose:
    """Interpolate from `start` to `end` by a `fraction` for each frame, or for each joint (Shoemake 1985).

    The scale uses the share of the first joint. The result is exactly `start` at 0, and `end` at 1 up to
    rounding. Stacks of F poses each.
    """
    fraction = jnp.asarray(fraction, start.rotations.dtype)
    shares = jnp.broadcast_to(fraction.reshape(len(fraction), -1), start.rotations.shape[:2])
    each = shares[..., None]
    rotations = rotation.normalise(rotation.slerp(start.rotations, end.rotations, shares))
    rotations = jnp.where(each == 0, start.rotations, rotations)
    rotations = jnp.where(each == 1, end.rotations, rotations)
    translations = start.translations + each * (end.translations - start.translations)
    scale = start.scale + shares[:, 0] * (end.scale - start.scale)
    return Pose(translations, rotations, scale)


def smooth_step(fraction: Float[np.ndarray, "F"]) -> Float[np.ndarray, "F"]:
    """Compute a smooth step from 0 to 1 with zero slope at either end, `3 t^2 - 2 t^3` (Kovar et al. 2002,
    section 5)."""
    fraction = np.clip(fraction, 0.0, 1.0)
    return fraction * fraction * (3.0 - 2.0 * fraction)


@checked
def resample(motion: Motion, rate: float | int) -> Motion:
    """Resample a motion to another rate, frames per second.

    Each new frame is interpolated between its two neighbours. The result begins with the same frame and ends
    at most one new frame before the end.

    **Raises:** `ValueError` for a rate that is not above 0, or a motion without frames.
    """
    if not 0 < rate < np.inf:
        raise ValueError(f"The rate is {rate:g}; expected above 0 frames per second.")
    if len(motion) == 0:
        raise ValueError("The motion has no frames; give one with at least one frame.")
    count = int(np.floor((len(motion) - 1) * rate / motion.rate + 1e-9)) + 1
    times = np.minimum(np.arange(count) * (motion.rate / rate), len(motion) - 1)
    # remove rounding errors of times that are whole frames
    times = np.where(np.abs(times - np.round(times)) < 1e-9 * len(motion), np.round(times), times)
    before = np.floor(times).astype(int)
    after = np.minimum(before + 1, len(motion) - 1)
    poses = interpolate_poses(
        take_poses(motion.poses, before), take_poses(motion.poses, after), jnp.asarray(times - before)
    )
    return Motion(poses, float(rate))
