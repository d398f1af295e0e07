"""The retraction of poses: the step along a tangent vector, its inverse, and the projection onto the joints' kinds."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..arguments import checked
from ..geometry import rotation
from .pose import Pose, revolute_angles, universal_angles
from .skeleton import Skeleton, dof_layout


@checked
@partial(jax.jit, inline=True)
def retract(skeleton: Skeleton, pose: Pose, d: Float[Array, "D"]) -> Pose:
    """Move a pose along a tangent vector `d`, metres and radians, in the layout of `dof_layout`.

    A rotation is updated on the right, in the body frame (Kineben, 3.2.2). A revolute joint stays on its
    axis and a universal joint on its two.
    """
    layout = dof_layout(skeleton)
    padded = jnp.append(d, jnp.zeros((), d.dtype))
    translations = pose.translations + padded[layout.translations]
    step = _rotation_vectors(skeleton, padded[layout.rotations])
    rotations = rotation.normalise(rotation.multiply(pose.rotations, rotation.exp(step)))
    pairs = _joints_of_kind(skeleton, "universal")
    if pairs.size:
        angles = universal_angles(skeleton, pose)[pairs] + padded[layout.rotations[pairs, :2]]
        turned = [rotation.about_axis(skeleton.axes[pairs, i], angles[:, i]) for i in range(2)]
        rotations = rotations.at[pairs].set(rotation.normalise(rotation.multiply(*turned)))
    return Pose(translations, rotations, pose.scale)


@checked
@partial(jax.jit, inline=True)
def difference(skeleton: Skeleton, a: Pose, b: Pose) -> Float[Array, "D"]:
    """Compute the tangent `d` with `retract(a, d) = b`, where the joints' kinds allow `b`."""
    layout = dof_layout(skeleton)
    relative = rotation.log(rotation.multiply(rotation.conjugate(a.rotations), b.rotations))
    revolute = _joints_of_kind(skeleton, "revolute")
    if revolute.size:
        along = jnp.sum(relative[revolute] * skeleton.axes[revolute, 0], -1)
        relative = relative.at[revolute, 0].set(along)
    pairs = _joints_of_kind(skeleton, "universal")
    if pairs.size:
        change = universal_angles(skeleton, b)[pairs] - universal_angles(skeleton, a)[pairs]
        wrapped = (change + jnp.pi) % (2 * jnp.pi) - jnp.pi
        relative = relative.at[pairs, :2].set(wrapped)
    d = jnp.zeros(skeleton.num_dofs + 1, relative.dtype)
    d = d.at[layout.translations].set(b.translations - a.translations)
    return d.at[layout.rotations].set(relative)[:-1]


@checked
@partial(jax.jit, inline=True)
def project(skeleton: Skeleton, pose: Pose) -> Pose:
    """Project a pose onto the poses that the joints' kinds allow.

    For example, a fixed joint does not rotate, and a revolute joint rotates only about its axis.
    """
    kinds = np.array(skeleton.kinds)[:, None]
    twist = rotation.about_axis(skeleton.axes[:, 0], revolute_angles(skeleton, pose))
    angles = universal_angles(skeleton, pose)
    pair = rotation.multiply(*(rotation.about_axis(skeleton.axes[:, i], angles[:, i]) for i in range(2)))
    still = rotation.identity(pose.rotations.dtype)
    rotations = jnp.where(np.isin(kinds, ["fixed", "translate"]), still, pose.rotations)
    rotations = jnp.where(kinds == "revolute", twist, rotations)
    rotations = jnp.where(kinds == "universal", pair, rotations)
    slides = np.isin(kinds, ["translate", "free"])
    return Pose(jnp.where(slides, pose.translations, 0.0), rotation.normalise(rotations), pose.scale)


def _rotation_vectors(skeleton: Skeleton, parameters: Float[Array, "J 3"]) -> Float[Array, "J 3"]:
    """Compute each joint's right update as a rotation vector, from its one or three parameters."""
    kinds = np.array(skeleton.kinds)[:, None]
    along = parameters[:, :1] * skeleton.axes[:, 0]
    return jnp.where(kinds == "revolute", along, jnp.where(kinds == "universal", 0.0, parameters))


def _joints_of_kind(skeleton: Skeleton, kind: str) -> np.ndarray:
    return np.flatnonzero(np.array(skeleton.kinds) == kind)
