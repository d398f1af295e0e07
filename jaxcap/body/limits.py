"""How far joints may turn, as data: ranges of single angles and cones about axes.

The energies that hold a pose to them are elsewhere; `.cst` and `.asf` files are read
into these arrays, and `.npz` bodies carry them.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .skeleton import KINDS, Skeleton


class Cone(NamedTuple):
    """The limit of one ball joint: its turned `heading` axis stays within `heading_angle`
    of where it was at rest, and its `bank` axis within `bank_angle` (Kineben, eqs. 15 and
    42). Axes `(3,)` in the rest frame of the world, angles in radians, in `[0, pi]`."""

    heading: tuple[float, float, float]
    heading_angle: float
    bank: tuple[float, float, float]
    bank_angle: float


class JointRanges(eqx.Module):
    """Limits of a skeleton's joints; arrays of any length, zero included.

    A range holds one rotation number of a revolute or universal joint (Kineben, eq. 14);
    a cone pair holds one ball joint (eqs. 15 and 42). Angles in radians.
    """

    #: joint of each range
    joints: Int[Array, "R"]
    #: which of its joint's angles a range is for: 0, or 1 for a universal joint's second
    numbers: Int[Array, "R"]
    lower: Float[Array, "R"]
    upper: Float[Array, "R"]
    #: joint of each cone pair
    ball_joints: Int[Array, "B"]
    #: unit axes, rest frame of the world
    heading: Float[Array, "B 3"]
    #: largest angle between the heading axis and itself at rest
    heading_angle: Float[Array, "B"]
    #: unit axes, rest frame of the world
    bank: Float[Array, "B 3"]
    bank_angle: Float[Array, "B"]


def make_joint_ranges(
    skeleton: Skeleton,
    ranges: Mapping[str, Sequence] | None = None,
    cones: Mapping[str, Cone] | None = None,
) -> JointRanges:
    """`JointRanges` from limits by joint name.

    **Arguments:** `ranges` gives `(lower, upper)` radians for a revolute joint and
    `((lower, upper), (lower, upper))` for a universal one; `cones` a `Cone` for a ball or
    free joint. Axes need not be of unit length.

    **Raises:** `ValueError` when a joint is unknown or of another kind, a lower bound is
    above its upper one, an angle is not in `[0, pi]`, or an axis has no length.
    """
    rows, balls = [], []
    for name, limits in (ranges or {}).items():
        joint = _joint(skeleton, name, ("revolute", "universal"), "range")
        pairs = np.asarray(limits, float).reshape(-1, 2)
        count = KINDS[skeleton.kinds[joint]][1]
        if len(pairs) != count:
            raise ValueError(
                f"Joint '{name}' is {skeleton.kinds[joint]} and needs {count} pairs of angles, not {len(pairs)}."
            )
        for number, (lower, upper) in enumerate(pairs):
            if not lower <= upper:
                raise ValueError(
                    f"The range of joint '{name}' goes from {lower:g} down to {upper:g}; swap them."
                )
            rows.append((joint, number, lower, upper))
    for name, cone in (cones or {}).items():
        joint = _joint(skeleton, name, ("ball", "free"), "cone")
        axes = np.asarray([cone.heading, cone.bank], float)
        lengths = np.linalg.norm(axes, axis=1)
        angles = np.asarray([cone.heading_angle, cone.bank_angle], float)
        if not (lengths > 0).all():
            raise ValueError(f"A cone of joint '{name}' has the axis (0, 0, 0); give it a direction.")
        if not ((angles >= 0) & (angles <= np.pi + 1e-9)).all():
            raise ValueError(
                f"The cone angles of joint '{name}' are {angles.tolist()}; give 0 to pi radians."
            )
        balls.append((joint, axes / lengths[:, None], angles))
    table = np.asarray(rows, float).reshape(-1, 4)
    axes = np.asarray([ball[1] for ball in balls], float).reshape(-1, 2, 3)
    angles = np.asarray([ball[2] for ball in balls], float).reshape(-1, 2)
    return JointRanges(
        joints=jnp.asarray(table[:, 0].astype(np.int32)),
        numbers=jnp.asarray(table[:, 1].astype(np.int32)),
        lower=jnp.asarray(table[:, 2]),
        upper=jnp.asarray(table[:, 3]),
        ball_joints=jnp.asarray([ball[0] for ball in balls], dtype=jnp.int32),
        heading=jnp.asarray(axes[:, 0]),
        heading_angle=jnp.asarray(angles[:, 0]),
        bank=jnp.asarray(axes[:, 1]),
        bank_angle=jnp.asarray(angles[:, 1]),
    )


def _joint(skeleton: Skeleton, name: str, kinds: tuple[str, ...], what: str) -> int:
    if name not in skeleton.names:
        raise ValueError(
            f"There is a {what} for joint '{name}', but the skeleton has {', '.join(skeleton.names)}."
        )
    joint = skeleton.names.index(name)
    if skeleton.kinds[joint] not in kinds:
        raise ValueError(
            f"There is a {what} for joint '{name}', which is {skeleton.kinds[joint]}; it fits {' and '.join(kinds)} joints."
        )
    return joint
