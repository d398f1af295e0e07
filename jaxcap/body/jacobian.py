"""How posed points move with the numbers of a pose, in closed form.

Every number `k` of a tangent turns or shifts all that descends from its joint, so that it
moves the points of the world along a linear field, `x -> a_k x x + b_k`: a twist
(Kineben, eqs. 8 to 13 and 41, is this field as a 4 x 4 operator). A skinned vertex rides
with the bones below the joint by their weights,

    dx_v / dk = sum_{i descends from joint(k)} w_vi (a_k x T_i v + b_k),

which needs one sum down the tree for each joint, not one pass of forward differentiation
for each number. It is the derivative at `d = 0` of the vertices of
`pose_body(body, retract(skeleton, pose, d))`.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .body import Body, Posed
from .kinematics import world_axes
from .skeleton import Skeleton, dof_layout
from .skin import LinearSkin, RigidSkin


def dof_twists(skeleton: Skeleton, posed: Posed) -> tuple[Float[Array, "D 3"], Float[Array, "D 3"]]:
    """The twist of every number of a tangent, as `(angular, linear)`.

    One more unit of number `k` moves a point `x` that hangs on its joint by
    `angular[k] x x + linear[k]`: for a turn about the world axis `a` through the joint's
    centre `c` that is `(a, -a x c)` (Kineben, eqs. 10 and 13), for a shift along `a` it is
    `(0, a)` (eq. 8, with the axis carried by the joint's ancestors and by the scale).
    """
    shifts, turns = world_axes(skeleton, posed.pose, posed.transforms)
    joints, numbers, turning = _slots(skeleton)
    axes = jnp.where(turning[:, None], turns[joints, numbers], shifts[joints, numbers])
    angular = jnp.where(turning[:, None], axes, 0.0)
    return angular, jnp.where(turning[:, None], jnp.cross(posed.joints[joints], axes), axes)


def subtree_moments(
    body: Body, posed: Posed, vertices: Int[Array, "C"]
) -> tuple[Float[Array, "C J 3"], Float[Array, "C J"]]:
    """`P_vj = sum_i w_vi T_i v`, metres, and `W_vj = sum_i w_vi` over the bones `i` that
    descend from joint `j`: what of a vertex moves with `j`.

    **Arguments:** `vertices (C,)` are indices of body vertices.

    **Raises:** `TypeError` where the skin is neither rigid nor linear.
    """
    weights, spread = _weighted_points(body, posed, vertices)
    down = jnp.asarray(body.skeleton.descent.T, weights.dtype)
    return jnp.moveaxis(spread @ down, 0, -1), weights @ down


def point_jacobian(body: Body, posed: Posed, vertices: Int[Array, "C"]) -> Float[Array, "C 3 D"]:
    """The derivative of posed vertices with respect to the tangent, metres a unit.

    **Arguments:** `vertices (C,)` are indices of body vertices.

    **Raises:** `TypeError` where the skin is neither rigid nor linear.
    """
    weights, spread = _weighted_points(body, posed, vertices)
    angular, linear = dof_twists(body.skeleton, posed)
    down = _below(body.skeleton, weights.dtype)
    x, y, z = spread @ down
    share = weights @ down
    return jnp.stack(
        [
            angular[:, 1] * z - angular[:, 2] * y + linear[:, 0] * share,
            angular[:, 2] * x - angular[:, 0] * z + linear[:, 1] * share,
            angular[:, 0] * y - angular[:, 1] * x + linear[:, 2] * share,
        ],
        axis=1,
    )


def projected_jacobian(
    body: Body, posed: Posed, vertices: Int[Array, "C"], directions: Float[Array, "C 3"]
) -> Float[Array, "C D"]:
    """Rows `n_v . dx_v/dd` along `directions n (C, 3)`, for distances to planes.

    The `(C, 3, D)` Jacobian is never formed: with `n . (a x p) = a . (p x n)` each bone
    feels the moment `p x n` and the force `n`, and these meet the twists in one product.

    **Raises:** `TypeError` where the skin is neither rigid nor linear.
    """
    weights, (x, y, z) = _weighted_points(body, posed, vertices)
    angular, linear = dof_twists(body.skeleton, posed)
    nx, ny, nz = directions[:, :1], directions[:, 1:2], directions[:, 2:]
    wrench = jnp.concatenate([y * nz - z * ny, z * nx - x * nz, x * ny - y * nx], 1)
    down = _below(body.skeleton, weights.dtype)
    moments = wrench @ (down[None] * angular.T[:, None, :]).reshape(-1, down.shape[1])
    return moments + (weights @ down) * (directions @ linear.T)


def translate_operator(axis: Float[Array, "3"]) -> Float[Array, "4 4"]:
    """The derivative of points under a shift along the world `axis` (Kineben, eq. 8): maps
    homogeneous `x` to its rate. The paper has the unit axes, which is a root's case."""
    return jnp.zeros((4, 4), axis.dtype).at[:3, 3].set(axis)


def revolute_operator(axis: Float[Array, "3"], centre: Float[Array, "3"]) -> Float[Array, "4 4"]:
    """The derivative of points under a turn about the world `axis` through the world
    `centre` of a joint: the paper's `T_1..i-1 xi T_1..i-1^-1` (Kineben, eq. 10) multiplied
    out, `[[axis]x, -axis x centre]`."""
    turn = jnp.stack([jnp.cross(axis, unit) for unit in jnp.eye(3, dtype=axis.dtype)], 1)
    return jnp.zeros((4, 4), axis.dtype).at[:3, :3].set(turn).at[:3, 3].set(-jnp.cross(axis, centre))


def ball_operator(
    rotation: Float[Array, "3 3"], centre: Float[Array, "3"], number: int
) -> Float[Array, "4 4"]:
    """The derivative of points under number `number` of a ball joint's update (Kineben,
    eqs. 12, 13 and 41): a turn about that column of the joint's whole `rotation` `R_1..i`
    through its world `centre`, `R_1..i q + t_1..i` in the paper."""
    return revolute_operator(rotation[:, number], centre)


def cone_gradient(axis: Float[Array, "3"], rotation: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """The gradient of `x . R x` of a cone limit to the update `R exp([d]x)` at `d = 0`:
    `x x R^T x` (Kineben, eq. 16; its sign is right, as finite differences show:
    `x . R (d x x) = R^T x . (d x x) = d . (x x R^T x)`)."""
    return jnp.cross(axis, rotation.T @ axis)


def _slots(skeleton: Skeleton) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The joint of each number of a tangent, which of its axes it is, whether it turns."""
    layout = dof_layout(skeleton)
    numbers = np.zeros(skeleton.num_dofs, int)
    turning = np.zeros(skeleton.num_dofs, bool)
    for slots, turns in ((layout.translations, False), (layout.rotations, True)):
        joint, number = np.nonzero(slots < skeleton.num_dofs)
        numbers[slots[joint, number]] = number
        turning[slots[joint, number]] = turns
    return layout.joints, numbers, turning


def _below(skeleton: Skeleton, dtype) -> Float[Array, "J D"]:
    """One where a bone moves with a number's joint."""
    return jnp.asarray(skeleton.descent[dof_layout(skeleton).joints].T, dtype)


def _weighted_points(
    body: Body, posed: Posed, vertices: Int[Array, "C"]
) -> tuple[Float[Array, "C J"], Float[Array, "3 C J"]]:
    """Weights `w_vi` and the points `w_vi T_i v`, coordinate by coordinate."""
    if not isinstance(body.skin, RigidSkin | LinearSkin):
        raise TypeError(
            f"Analytic derivatives hold for rigid and linear skins, not for {type(body.skin).__name__}; "
            "use automatic differentiation with this skin."
        )
    rest = body.vertices[vertices]
    weights = body.skin.influence(body.skeleton.num_joints)[vertices].astype(rest.dtype)
    r, t = posed.transforms.rotations, posed.transforms.translations
    bones = jnp.concatenate([r, t[:, :, None]], 2)
    homogeneous = jnp.concatenate([rest, jnp.ones_like(rest[:, :1])], 1)
    return weights, jnp.stack([weights * (homogeneous @ bones[:, i].T) for i in range(3)])
