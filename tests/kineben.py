"""The paper's own derivatives of posed points (Kineben, eqs. 8 to 16), as 4 x 4 operators."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def translate_operator(axis: Float[Array, "3"]) -> Float[Array, "4 4"]:
    """Compute the derivative of points under a translation along the world `axis` (Kineben, eq. 8).

    It maps homogeneous `x` to its rate. The paper uses the unit axes, which is the case of a root.
    """
    return jnp.zeros((4, 4), axis.dtype).at[:3, 3].set(axis)


def revolute_operator(axis: Float[Array, "3"], centre: Float[Array, "3"]) -> Float[Array, "4 4"]:
    """Compute the derivative of points under a rotation about the world `axis` through the world `centre`
    of a joint.

    It is the paper's `T_1..i-1 xi T_1..i-1^-1` (Kineben, eq. 10) multiplied out,
    `[[axis]x, -axis x centre]`.
    """
    turn = jnp.stack([jnp.cross(axis, unit) for unit in jnp.eye(3, dtype=axis.dtype)], 1)
    return jnp.zeros((4, 4), axis.dtype).at[:3, :3].set(turn).at[:3, 3].set(-jnp.cross(axis, centre))


def ball_operator(
    rotation: Float[Array, "3 3"], centre: Float[Array, "3"], component: int
) -> Float[Array, "4 4"]:
    """Compute the derivative of points under component `component` of a ball joint's update (Kineben, eqs. 12,
    13 and 41).

    It is a rotation about that column of the joint's total `rotation` `R_1..i` through its world `centre`,
    `R_1..i q + t_1..i` in the paper.
    """
    return revolute_operator(rotation[:, component], centre)


def cone_gradient(axis: Float[Array, "3"], rotation: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """Compute the gradient of `x . R x` of a cone limit by the update `R exp([d]x)` at `d = 0`.

    It is `x x R^T x` (Kineben, eq. 16). Its sign is correct, as finite differences show:
    `x . R (d x x) = R^T x . (d x x) = d . (x x R^T x)`.
    """
    return jnp.cross(axis, rotation.T @ axis)
