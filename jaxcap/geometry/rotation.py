"""Rotations as unit quaternions: Hamilton product, order `wxyz`, shortest arc.

Every function works on one quaternion `(4,)` or on any stack of them `(..., 4)`. A small rotation is
applied on the right, in the body frame: `R <- R exp([w]x)` (Kineben, section 3.2.2).

At a removable singularity both branches of a `where` are kept finite ("double where"), so that values and
derivatives of every order are finite there.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Quaternion = Float[Array, "*shape 4"]
Vector = Float[Array, "*shape 3"]
Matrix = Float[Array, "*shape 3 3"]


def identity(dtype=None) -> Float[Array, "4"]:
    """Return the identity rotation, `(1, 0, 0, 0)`."""
    return jnp.array([1.0, 0.0, 0.0, 0.0], dtype)


@partial(jax.jit, inline=True)
def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Compose rotations: `b` followed by `a` (Hamilton product `a b`)."""
    aw, av, bw, bv = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    w = aw * bw - jnp.sum(av * bv, -1, keepdims=True)
    return jnp.concatenate([w, aw * bv + bw * av + jnp.cross(av, bv)], -1)


@partial(jax.jit, inline=True)
def conjugate(q: Quaternion) -> Quaternion:
    """Invert the rotation of a unit quaternion."""
    return q * jnp.array([1.0, -1.0, -1.0, -1.0], q.dtype)


@partial(jax.jit, inline=True)
def normalise(q: Quaternion) -> Quaternion:
    """Scale `q` to unit length, with `w >= 0`: the shorter of the two arcs."""
    q = q / jnp.sqrt(jnp.sum(q * q, -1, keepdims=True))
    return jnp.where(q[..., :1] < 0, -q, q)


@partial(jax.jit, inline=True)
def rotate(q: Quaternion, x: Vector) -> Vector:
    """Rotate the vector `x` by `q`."""
    w, v = q[..., :1], q[..., 1:]
    t = 2.0 * jnp.cross(v, x)
    return x + w * t + jnp.cross(v, t)


@partial(jax.jit, inline=True)
def exp(w: Vector) -> Quaternion:
    """Compute the rotation about `w` by `|w|` radians; smooth at `w = 0`.

    The exponential map of SO(3), Rodrigues' formula (Kineben, eq. 37) in quaternions.
    """
    squared = jnp.sum(w * w, -1, keepdims=True)
    small = squared < 1e-6
    angle = jnp.sqrt(jnp.where(small, 1.0, squared))
    # sin(a/2)/a and cos(a/2) by their series where the angle is small
    cosine = jnp.where(small, 1.0 - squared / 8.0 + squared**2 / 384.0, jnp.cos(angle / 2.0))
    half_sinc = jnp.where(small, 0.5 - squared / 48.0 + squared**2 / 3840.0, jnp.sin(angle / 2.0) / angle)
    return jnp.concatenate([cosine, half_sinc * w], -1)


@partial(jax.jit, inline=True)
def log(q: Quaternion) -> Vector:
    """Compute the rotation vector of `q`, at most pi radians long; the inverse of `exp`.

    Smooth at the identity and near pi: the angle comes from `atan2`, never from `acos`. At pi itself one of
    the two equivalent vectors is returned.
    """
    q = jnp.where(q[..., :1] < 0, -q, q)
    w, v = q[..., :1], q[..., 1:]
    squared = jnp.sum(v * v, -1, keepdims=True)
    small = squared < 1e-6
    norm = jnp.sqrt(jnp.where(small, 1.0, squared))
    safe_w = jnp.where(small, w, 1.0)
    ratio = squared / safe_w**2
    # 2 atan(|v|/w)/|v| by its series where |v| is small
    near = 2.0 / safe_w * (1.0 - ratio / 3.0 + ratio**2 / 5.0)
    far = 2.0 * jnp.arctan2(norm, jnp.where(small, 1.0, w)) / norm
    return jnp.where(small, near, far) * v


@partial(jax.jit, inline=True)
def about_axis(axis: Vector, angle: Float[Array, "*shape"]) -> Quaternion:
    """Create the rotation about a unit `axis` by `angle` radians."""
    half = jnp.asarray(angle)[..., None] / 2.0
    return jnp.concatenate([jnp.cos(half), jnp.sin(half) * axis], -1)


@partial(jax.jit, inline=True)
def angle_about(q: Quaternion, axis: Vector) -> Float[Array, "*shape"]:
    """Compute the angle of the twist of `q` about a unit `axis`, in `[-pi, pi]` radians.

    Zero where the twist is not defined (a swing by pi).
    """
    w, s = q[..., 0], jnp.sum(q[..., 1:] * axis, -1)
    sign = jnp.where(w < 0, -1.0, 1.0)
    undefined = (w * w + s * s) < 1e-20
    return 2.0 * jnp.arctan2(jnp.where(undefined, 0.0, sign * s), jnp.where(undefined, 1.0, sign * w))


@partial(jax.jit, inline=True)
def angles_about(q: Quaternion, first: Vector, second: Vector) -> Float[Array, "*shape 2"]:
    """Compute the two angles of `q = Rot(first, a) Rot(second, b)` about unit axes, in `[-pi, pi]` radians.

    They are defined for any second angle: the first angle comes from the image of the second axis, whose
    part perpendicular to the first axis rotates by it.
    """
    along = jnp.sum(first * second, -1, keepdims=True)
    across = second - along * first
    moved = rotate(q, second)
    sine = jnp.sum(jnp.cross(first, across) * moved, -1)
    cosine = jnp.sum(across * moved, -1)
    undefined = sine**2 + cosine**2 < 1e-20
    a = jnp.arctan2(jnp.where(undefined, 0.0, sine), jnp.where(undefined, 1.0, cosine))
    return jnp.stack([a, angle_about(multiply(about_axis(first, -a), q), second)], -1)


@partial(jax.jit, inline=True)
def swing_twist(q: Quaternion, axis: Vector) -> tuple[Quaternion, Quaternion]:
    """Decompose `q = swing * twist`: the twist rotates about `axis`, the swing about a perpendicular of it
    (Adaptation, section 3.1).

    The twist is the identity where it is not defined (a swing by pi).
    """
    twist = about_axis(axis, angle_about(q, axis))
    return multiply(q, conjugate(twist)), twist


@partial(jax.jit, inline=True)
def shortest_arc(a: Vector, b: Vector) -> Quaternion:
    """Compute the smallest rotation from unit vector `a` onto unit vector `b`.

    For opposite vectors it is a half turn about some perpendicular of `a`.
    """
    w = 1.0 + jnp.sum(a * b, -1, keepdims=True)
    helper = jnp.where(
        jnp.abs(a[..., :1]) < 0.6, jnp.array([1.0, 0, 0], a.dtype), jnp.array([0, 1.0, 0], a.dtype)
    )
    opposite = w < 1e-6
    v = jnp.where(opposite, jnp.cross(a, helper), jnp.cross(a, b))
    return normalise(jnp.concatenate([jnp.where(opposite, 0.0, w), v], -1))


@partial(jax.jit, inline=True)
def to_matrix(q: Quaternion) -> Matrix:
    """Convert a unit quaternion to its 3 x 3 rotation matrix."""
    w, x, y, z = (q[..., i] for i in range(4))
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return jnp.stack([jnp.stack(row, -1) for row in rows], -2)


@partial(jax.jit, inline=True)
def from_matrix(r: Matrix) -> Quaternion:
    """Convert a rotation matrix to its quaternion (Shepperd 1978).

    The largest of the four components is computed first, which avoids cancellation.
    """

    def m(i, j):
        return r[..., i, j]

    trace = m(0, 0) + m(1, 1) + m(2, 2)
    candidates = jnp.stack(
        [
            jnp.stack([1 + trace, m(2, 1) - m(1, 2), m(0, 2) - m(2, 0), m(1, 0) - m(0, 1)], -1),
            jnp.stack([m(2, 1) - m(1, 2), 1 + 2 * m(0, 0) - trace, m(0, 1) + m(1, 0), m(0, 2) + m(2, 0)], -1),
            jnp.stack([m(0, 2) - m(2, 0), m(0, 1) + m(1, 0), 1 + 2 * m(1, 1) - trace, m(1, 2) + m(2, 1)], -1),
            jnp.stack([m(1, 0) - m(0, 1), m(0, 2) + m(2, 0), m(1, 2) + m(2, 1), 1 + 2 * m(2, 2) - trace], -1),
        ],
        -2,
    )
    sizes = jnp.stack([1 + trace, *(1 + 2 * m(i, i) - trace for i in range(3))], -1)
    best = jnp.argmax(sizes, -1)[..., None, None]
    return normalise(jnp.take_along_axis(candidates, best, -2)[..., 0, :])


@partial(jax.jit, inline=True)
def skew(w: Vector) -> Matrix:
    """Create the matrix `[w]x` of the cross product: `skew(w) @ x = w x x` (Kineben, eq. 33)."""
    x, y, z = w[..., 0], w[..., 1], w[..., 2]
    o = jnp.zeros_like(x)
    return jnp.stack([jnp.stack(row, -1) for row in ([o, -z, y], [z, o, -x], [-y, x, o])], -2)


@partial(jax.jit, inline=True)
def right_jacobian(w: Vector) -> Matrix:
    """Compute `Jr(w)` with `exp(w + d) = exp(w) exp(Jr(w) d)` to first order in `d`."""
    squared = jnp.sum(w * w, -1)[..., None, None]
    small = squared < 1e-6
    angle = jnp.sqrt(jnp.where(small, 1.0, squared))
    a = jnp.where(small, 0.5 - squared / 24.0, (1.0 - jnp.cos(angle)) / angle**2)
    b = jnp.where(small, 1.0 / 6.0 - squared / 120.0, (angle - jnp.sin(angle)) / angle**3)
    cross = skew(w)
    return jnp.eye(3, dtype=w.dtype) - a * cross + b * (cross @ cross)


@partial(jax.jit, inline=True)
def slerp(a: Quaternion, b: Quaternion, t: Float[Array, "*shape"]) -> Quaternion:
    """Interpolate from `a` to `b` along the shortest arc; `t` is the fraction of the angle."""
    return multiply(a, exp(jnp.asarray(t)[..., None] * log(multiply(conjugate(a), b))))


@partial(jax.jit, inline=True)
def distance(a: Quaternion, b: Quaternion) -> Float[Array, "*shape"]:
    """Compute the angle between two rotations, in `[0, pi]` radians."""
    relative = multiply(conjugate(a), b)
    return 2.0 * jnp.arctan2(jnp.linalg.norm(relative[..., 1:], axis=-1), jnp.abs(relative[..., 0]))
