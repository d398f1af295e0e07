"""Rigid motions as unit dual quaternions, `[real wxyz, dual wxyz]`.

A dual quaternion `q0 + e qe` with `e^2 = 0` rotates by `q0` and then translates by `t`, with
`qe = (0, t) q0 / 2` (Adaptation, appendix A.1; Kavan, Collins, Zara and O'Sullivan 2008). `d` and `-d` are
the same motion. Every function works on one `(8,)` or on any stack `(..., 8)` of them.

Blends stay unnormalised: `apply` divides by the squared length of the real part, so that
derivatives need no square root.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from . import rotation

DualQuaternion = Float[Array, "*shape 8"]


def identity(dtype=None) -> Float[Array, "8"]:
    """Return the identity motion."""
    return jnp.zeros(8, dtype).at[0].set(1.0)


@partial(jax.jit, inline=True)
def from_rigid(q: rotation.Quaternion, t: rotation.Vector) -> DualQuaternion:
    """Convert a unit quaternion and a translation, metres, to the motion `x -> R x + t`."""
    return jnp.concatenate([q, rotation.multiply(_imaginary(t) / 2.0, q)], -1)


@partial(jax.jit, inline=True)
def about_centre(q: rotation.Quaternion, centre: rotation.Vector) -> DualQuaternion:
    """Create the rotation by the unit quaternion `q` about `centre`, metres."""
    return from_rigid(q, centre - rotation.rotate(q, centre))


@partial(jax.jit, inline=True)
def from_twist(twist: Float[Array, "*shape 6"]) -> DualQuaternion:
    """Compute the rate at the identity of a motion along the field `x -> a x x + b`, with `twist = (a, b)`.

    A motion `d` transported by the field has the rate `from_twist(twist) d`.
    """
    return jnp.concatenate([_imaginary(twist[..., :3]), _imaginary(twist[..., 3:])], -1) / 2.0


@partial(jax.jit, inline=True)
def multiply(a: DualQuaternion, b: DualQuaternion) -> DualQuaternion:
    """Compose motions: `b` followed by `a` (eq. A.2 with quaternions for numbers)."""
    real = rotation.multiply(a[..., :4], b[..., :4])
    dual = rotation.multiply(a[..., :4], b[..., 4:]) + rotation.multiply(a[..., 4:], b[..., :4])
    return jnp.concatenate([real, dual], -1)


@partial(jax.jit, inline=True)
def conjugate(d: DualQuaternion) -> DualQuaternion:
    """Invert the motion of a unit dual quaternion."""
    return jnp.concatenate([rotation.conjugate(d[..., :4]), rotation.conjugate(d[..., 4:])], -1)


@partial(jax.jit, inline=True)
def apply(d: DualQuaternion, x: rotation.Vector) -> rotation.Vector:
    """Move the point `x` by the motion that `d` is a multiple of, `d` of unit length or not.

    With `d = (a0, v0) + e (ae, ve)` and `n = |(a0, v0)|^2`, this is
    `x + 2 (v0 x (v0 x x + a0 x) + a0 ve - ae v0 + v0 x ve) / n` (Kavan 2008, algorithm 1). A component of
    `qe` along `q0`, as in a blend, has no effect.
    """
    return x + 2.0 * _displacement(d, x) / _squared(d)


@partial(jax.jit, inline=True)
def pull_back(
    d: Float[Array, "V 8"], x: Float[Array, "V 3"], directions: Float[Array, "V R 3"]
) -> Float[Array, "V R 8"]:
    """Differentiate `m . apply(d, x)` along directions `m (V, R, 3)` by the eight components of `d`, unit
    or not, in closed form."""

    # component by component, which is several times faster on a CPU than short vectors
    def dot(a, b):
        return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]

    def cross(a, b):
        return tuple(a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3))

    n = 2.0 / _squared(d)
    shift = tuple((n * _displacement(d, x)).T[:, :, None])
    p, m = tuple(x.T[:, :, None]), tuple(jnp.moveaxis(directions, 2, 0))
    a0, *v0, ae, b0, b1, b2 = d.T[:, :, None]
    ve = (b0, b1, b2)
    along, mv, mp, vp = dot(m, shift), dot(m, v0), dot(m, p), dot(v0, p)
    lever = tuple(c + e for c, e in zip(cross(v0, p), ve, strict=True))
    swept = cross(tuple(a0 * p[i] + ve[i] for i in range(3)), m)
    by_v0 = [swept[i] + (vp - ae) * m[i] + mv * p[i] - (2.0 * mp + along) * v0[i] for i in range(3)]
    turned = cross(m, v0)
    by_ve = [a0 * m[i] + turned[i] for i in range(3)]
    return n[:, :, None] * jnp.stack([dot(m, lever) - along * a0, *by_v0, -mv, *by_ve], -1)


@partial(jax.jit, inline=True)
def normalise(d: DualQuaternion) -> DualQuaternion:
    """Divide `d` by its dual norm (eq. 3.17): real part of unit length, dual part perpendicular to it."""
    real, dual = d[..., :4], d[..., 4:]
    squared = _squared(d)
    along = jnp.sum(real * dual, -1, keepdims=True) / squared
    return jnp.concatenate([real, dual - along * real], -1) / jnp.sqrt(squared)


@partial(jax.jit, inline=True)
def align(weights: Float[Array, "V N"], motions: Float[Array, "N 8"]) -> Float[Array, "V N"]:
    """Negate weights of motions in the opposite hemisphere to the motion with the row's largest weight.

    Blends then take the shorter path (Adaptation, "Note on Anti-Podality"). The blend
    `align(weights, motions) @ motions` is bounded away from zero: its real part along that motion is at
    least the largest weight.
    """
    real = motions[:, :4]
    opposite = real @ real.T < 0
    return jnp.where(opposite[jnp.argmax(weights, 1)], -weights, weights)


def _imaginary(v: rotation.Vector) -> rotation.Quaternion:
    return jnp.concatenate([jnp.zeros_like(v[..., :1]), v], -1)


def _displacement(d: DualQuaternion, x: rotation.Vector) -> rotation.Vector:
    """Compute the displacement of `x` by `apply`, times half the squared length of the real part."""
    a0, v0, ae, ve = d[..., :1], d[..., 1:4], d[..., 4:5], d[..., 5:]
    return jnp.cross(v0, jnp.cross(v0, x) + a0 * x + ve) + a0 * ve - ae * v0


def _squared(d: DualQuaternion) -> Float[Array, "*shape 1"]:
    """Compute the squared length of the real part; one where it is zero, as in a row without weights."""
    squared = jnp.sum(d[..., :4] ** 2, -1, keepdims=True)
    return jnp.where(squared < jnp.finfo(d.dtype).tiny, 1.0, squared)
