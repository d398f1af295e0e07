"""Projection of motions to their limits, smooth over time."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..arguments import checked
from ..body.pose import Motion, Pose
from ..body.skeleton import Skeleton
from ..geometry import rotation
from .abstract_limits import AbstractLimits, allowed
from .frame_evaluation import map_frames, nearest_frames

#: number of rounds, each a smoothing of the corrections and a new projection
ROUNDS = 4


@checked
@eqx.filter_jit
def project_motion(
    limits: AbstractLimits, skeleton: Skeleton, motion: Motion, smoothness: float = 0.02, rounds: int = ROUNDS
) -> Motion:
    """Project a motion to its limits, frame by frame (Limits, section 4.2), with smooth corrections.

    The nearest allowed pose may be on one side of the limits in one frame and on the other in the next. So
    the corrections `c_f` are smoothed, as the minimum of `sum |c_f - c'_f|^2 + s |c_f+1 - c_f|^2`, and
    frames are projected again from there. Frames that are allowed do not change, and have corrections of
    zero.

    **Arguments:** `smoothness` in seconds, the time scale of the smoothing; 0 projects every frame
    independently.
    """
    poses = motion.poses
    within = map_frames(lambda pose: allowed(limits, skeleton, pose), motion)
    nearest = nearest_frames(limits, skeleton, motion).poses
    if smoothness <= 0 or rounds <= 0 or len(motion) < 2:
        return Motion(nearest, motion.rate)
    weight = (smoothness * motion.rate) ** 2

    def again(_, found: Pose):
        turns = rotation.log(rotation.multiply(rotation.conjugate(poses.rotations), found.rotations))
        turns = jax.vmap(_smooth_corrections, (1, 1, None), 1)(turns, within, weight)
        moved = rotation.multiply(poses.rotations, rotation.exp(turns))
        kept = jnp.where(within[..., None], poses.rotations, rotation.normalise(moved))
        smoothed = Pose(poses.translations, kept, poses.scale)
        return nearest_frames(limits, skeleton, Motion(smoothed, motion.rate)).poses

    return Motion(jax.lax.fori_loop(0, rounds, again, nearest), motion.rate)


def _smooth_corrections(
    corrections: Float[Array, "F 3"], fixed: Bool[Array, "F"], weight: Float[Array, ""] | float
) -> Float[Array, "F 3"]:
    """Smooth the corrections of one joint by a tridiagonal system, with zero at allowed frames."""
    count = len(corrections)
    sides = jnp.full(count, 2.0, corrections.dtype).at[0].set(1.0).at[-1].set(1.0)
    diagonal = jnp.where(fixed, 1.0, 1.0 + weight * sides)
    couple = jnp.where(fixed, 0.0, -weight) * jnp.ones(count, corrections.dtype)
    lower = couple.at[0].set(0.0)
    upper = couple.at[-1].set(0.0)
    right = jnp.where(fixed[:, None], 0.0, corrections)
    return jax.lax.linalg.tridiagonal_solve(lower, diagonal, upper, right)
