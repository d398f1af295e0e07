"""Planar transforms: rotations about the vertical and translations along the floor.

They do not change a motion itself.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..body.pose import Pose, shift_roots
from ..body.skeleton import Skeleton
from ..geometry import rotation

#: radians below which a rotation's arc is taken as a straight line
SMALL_ANGLE = 1e-7


class PlanarTransform(NamedTuple):
    """A planar transform `x' = R x + shift`, with `R` the rotation about the vertical y by `heading`."""

    #: radians
    heading: float
    #: metres along x and z
    shift: Float[np.ndarray, "2"]


def fit_planar_transform(
    source: Float[np.ndarray, "N 3"], target: Float[np.ndarray, "N 3"]
) -> PlanarTransform:
    """Find the planar transform that best aligns points `source` with those `target`, in closed form (Kovar et
    al. 2002, section 3.2, equation 4)."""
    a, b = (np.asarray(points, float)[:, [0, 2]] for points in (target, source))
    middle_a, middle_b = a.mean(0), b.mean(0)
    a, b = a - middle_a, b - middle_b
    heading = float(np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b)))
    return PlanarTransform(heading, middle_a - _rotation_2d(heading) @ middle_b)


def planar_power(planar: PlanarTransform, exponent: float) -> PlanarTransform:
    """Compute a `exponent` of a planar transform, along the arc from the identity; -1 inverts it."""
    arc = _mean_rotation(planar.heading)
    # a scaled rotation, so its inverse is the transpose over the squared scale
    u = arc.T @ planar.shift / np.sum(arc[0] ** 2)
    heading = exponent * planar.heading
    return PlanarTransform(heading, _mean_rotation(heading) @ (exponent * u))


def apply_planar_transform(
    skeleton: Skeleton, transform: list[PlanarTransform] | PlanarTransform, poses: Pose
) -> Pose:
    """Apply a planar transform to the roots of stacked poses; one for all frames, or one for each."""
    each = transform if isinstance(transform, list) else [transform] * len(poses.scale)
    dtype = poses.rotations.dtype
    headings = jnp.asarray([one.heading for one in each], dtype)
    shifts = jnp.asarray([[one.shift[0], 0.0, one.shift[1]] for one in each], dtype).reshape(-1, 3)
    return _transform_roots(skeleton, headings, shifts, poses)


@jax.jit
def _transform_roots(
    skeleton: Skeleton, headings: Float[Array, "F"], shifts: Float[Array, "F 3"], poses: Pose
) -> Pose:
    turns = rotation.exp(headings[:, None] * jnp.asarray([0.0, 1.0, 0.0], headings.dtype))
    translations, rotations = poses.translations, poses.rotations
    for root in np.flatnonzero(np.array(skeleton.parents) < 0):
        centre = skeleton.centres[root]
        place = rotation.rotate(turns, centre + translations[:, root])
        translations = translations.at[:, root].set(place - centre)
        rotations = rotations.at[:, root].set(
            rotation.normalise(rotation.multiply(turns, rotations[:, root]))
        )
    return shift_roots(skeleton, Pose(translations, rotations, poses.scale), shifts)


def _rotation_2d(heading: float) -> Float[np.ndarray, "2 2"]:
    """Build the rotation matrix of (x, z) about y."""
    c, s = np.cos(heading), np.sin(heading)
    return np.array([[c, s], [-s, c]])


def _mean_rotation(heading: float) -> Float[np.ndarray, "2 2"]:
    """Average the rotations from 0 to `heading`: the V of the exponential map of SE(2)."""
    if abs(heading) < SMALL_ANGLE:
        return np.eye(2)
    c, s = (1.0 - np.cos(heading)) / heading, np.sin(heading) / heading
    return np.array([[s, c], [-c, s]])
