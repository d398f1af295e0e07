"""Positions of constrained points, and rotations of bones."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...body.body import Body, pose_body
from ...body.pose import Pose
from ...geometry import rotation
from .constraints import Constraint, Constraints, Position, Quaternion, constrained_body, make_constraints


def point_positions(body: Body, pose: Pose, constraints: Sequence[Constraint]) -> list[Position]:
    """Compute the positions of constrained points in a pose, metres. Raises `ValueError` as
    `make_constraints` does."""
    arrays = make_constraints(body, constraints)
    vertices, joints = (np.asarray(found, float) for found in _positions_and_joints(body, pose, arrays))
    rows = iter(vertices)
    found = [
        joints[body.skeleton.index(c.point)] if isinstance(c.point, str) else next(rows) for c in constraints
    ]
    return [(float(x), float(y), float(z)) for x, y, z in found]


def bone_rotations(body: Body, pose: Pose) -> list[Quaternion]:
    """Compute the world rotation of every bone from rest, `wxyz`."""
    return [
        (float(w), float(x), float(y), float(z))
        for w, x, y, z in np.asarray(_bone_quaternions(body, pose), float)
    ]


@eqx.filter_jit
def _positions_and_joints(
    body: Body, pose: Pose, constraints: Constraints
) -> tuple[Float[Array, "C 3"], Float[Array, "J 3"]]:
    posed = pose_body(constrained_body(body, constraints), pose)
    return posed.vertices, posed.joints


@eqx.filter_jit
def _bone_quaternions(body: Body, pose: Pose) -> Float[Array, "J 4"]:
    whole = pose_body(body, pose).transforms.rotations / pose.scale
    return rotation.from_matrix(jnp.asarray(whole))
