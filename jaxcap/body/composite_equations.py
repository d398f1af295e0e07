"""Normal equations of rows that move rigidly with bones, summed over the tree of joints."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..small_matrices import apply_small, multiply_small
from .geometric_jacobian import GeometricJacobian
from .skeleton import Skeleton


def composite_equations(
    skeleton: Skeleton,
    rates: GeometricJacobian,
    bones: Int[Array, "P"],
    wrenches: Float[Array, "P R 6"],
    residuals: Float[Array, "P R"],
    weights: Float[Array, "P"],
) -> tuple[Float[Array, "D"], Float[Array, "D D"]]:
    """Compute the gradient `J^T W r` and the matrix `J^T W J` of points that are fixed to bones.

    A joint moves all bones below it by one twist. So a pair of joints on one path shares the sum over the bones below the
    lower one, and other pairs share nothing. This is the composite-rigid-body algorithm (Featherstone 2008, section 6.2) with
    information in place of inertia. It does not form the rows of the whole tangent.

    **Arguments:** `wrenches` of the R rows of each point. A row is their product with the twist `(angular, linear)` of the
    point's bone (`wrenches_of`). `weights` of the points.
    """
    weighted = wrenches * weights[:, None, None]
    information = multiply_small(jnp.swapaxes(weighted, 1, 2), wrenches).reshape(len(bones), 36)
    forces = apply_small(jnp.swapaxes(weighted, 1, 2), residuals)
    joints = list(rates.joints)
    below = (
        jnp.asarray(skeleton.descendants, wrenches.dtype)
        .at[:, bones]
        .get(mode="promise_in_bounds", wrap_negative_indices=False)
    )
    sums = (below @ jnp.concatenate([information, forces], 1))[jnp.asarray(joints)]
    twists = jnp.concatenate([rates.angular, rates.linear], 1)
    pulled = apply_small(sums[:, :36].reshape(-1, 6, 6), twists)
    # entry (i, j) has the bones below the joint of j, right where that joint is below the joint of i
    pairs, lower = twists @ pulled.T, skeleton.descendants[joints][:, joints]
    matrix = jnp.where(lower, pairs, jnp.where(lower.T, pairs.T, 0.0))
    return jnp.sum(twists * sums[:, 36:], 1), matrix


def wrenches_of(points: Float[Array, "P 3"], directions: Float[Array, "P R 3"]) -> Float[Array, "P R 6"]:
    """Compute the wrenches `(p x n, n)` of directions at points; their product with a twist `(a, b)` is `n . (a x p + b)`."""
    return jnp.concatenate([jnp.cross(points[:, None], directions), directions], -1)
