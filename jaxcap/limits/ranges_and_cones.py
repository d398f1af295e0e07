"""Joint limits of single angles, as ranges, and of directions, as cones.

Energies that penalise violated limits are elsewhere; `.cst` and `.asf` files are read into these arrays.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..arguments import checked
from ..body.pose import Pose, revolute_angles, universal_angles
from ..body.skeleton import KINDS, Skeleton
from ..geometry import rotation
from .abstract_limits import AbstractLimits

#: alternating projections onto the two cones
ALTERNATIONS = 20


class Cone(NamedTuple):
    """The limit of one ball joint: its rotated `heading` axis stays within `heading_angle` of its direction
    at rest, and its `bank` axis within `bank_angle` (Kineben, eqs. 15 and 42).

    Axes `(3,)` in the rest frame of the world, angles in radians, in `[0, pi]`.
    """

    heading: tuple[float, float, float]
    heading_angle: float
    bank: tuple[float, float, float]
    bank_angle: float


class JointRanges(AbstractLimits):
    """Ranges and cones of a skeleton's joints; arrays of any length, zero included.

    A range limits one angle of a revolute or universal joint (Kineben, eq. 14). A pair of cones limits one
    ball joint (eqs. 15 and 42). Angles in radians.
    """

    #: joint of each range
    joints: Int[Array, "R"]
    #: index of the limited angle of its joint: 0, or 1 for a universal joint's second
    angle_indices: Int[Array, "R"]
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

    def residual(self, skeleton: Skeleton, pose: Pose):
        """Compute the excess of angles beyond their ranges, then of rotated axes beyond their cones.

        Angles (Kineben, eq. 14) are in radians, negative below the range. Cones (eqs. 15 and 42) are in
        cosines: `x_B . R x_B - t` where it is negative, with `t` the cosine of the cone's angle, for the
        heading and the bank axis.
        """
        angles = self._angles(skeleton, pose)
        beyond = jnp.minimum(angles - self.lower, 0.0) + jnp.maximum(angles - self.upper, 0.0)
        turned = pose.rotations[self.ball_joints]
        heading = cone_residual(turned, self.heading, self.heading_angle)
        return jnp.concatenate([beyond, heading, cone_residual(turned, self.bank, self.bank_angle)])

    def residual_joints(self, skeleton: Skeleton):
        return jnp.concatenate([self.joints, self.ball_joints, self.ball_joints])

    def project(self, skeleton: Skeleton, pose: Pose):
        """Clamp each angle to its range, and project onto the two cones alternately until both hold."""
        angles = self._angles(skeleton, pose)
        clamped = jnp.clip(angles, self.lower, self.upper)
        # only violated joints change, so that allowed ones stay bitwise equal
        table = jnp.stack([revolute_angles(skeleton, pose), jnp.zeros(skeleton.num_joints)], -1)
        table = jnp.where(_is_universal(skeleton)[:, None], universal_angles(skeleton, pose), table)
        table = table.at[self.joints, self.angle_indices].set(clamped.astype(table.dtype))
        moved = jnp.zeros(skeleton.num_joints, bool).at[self.joints].max(clamped != angles)
        first, second = (rotation.about_axis(skeleton.axes[:, i], table[:, i]) for i in range(2))
        boxed = jnp.where(_is_universal(skeleton)[:, None], rotation.multiply(first, second), first)
        rotations = jnp.where(moved[:, None], boxed, pose.rotations)
        turned = rotations[self.ball_joints]
        turned = turned.astype(jnp.result_type(turned, self.heading, self.heading_angle))

        def into_both(_, turned):
            return _project_onto_cone(
                _project_onto_cone(turned, self.heading, self.heading_angle), self.bank, self.bank_angle
            )

        # unrolled, it would dominate the compile time of a program with limits
        turned = jax.lax.fori_loop(0, ALTERNATIONS if len(turned) else 0, into_both, turned)
        rotations = rotations.at[self.ball_joints].set(turned)
        return Pose(pose.translations, rotations, pose.scale)

    def _angles(self, skeleton: Skeleton, pose: Pose) -> Float[Array, "R"]:
        """Compute the angle of each range, modulo a turn the one nearest to the middle of the range."""
        first, pairs = revolute_angles(skeleton, pose), universal_angles(skeleton, pose)
        universal = _is_universal(skeleton)[self.joints]
        angles = jnp.where(universal, pairs[self.joints, self.angle_indices], first[self.joints])
        middle = (self.lower + self.upper) / 2
        return middle + (angles - middle + jnp.pi) % (2 * jnp.pi) - jnp.pi


def cone_residual(
    rotations: Float[Array, "B 4"], axis: Float[Array, "B 3"], angle: Float[Array, "B"]
) -> Float[Array, "B"]:
    """Compute `min(x_B . R x_B - cos(angle), 0)` (Kineben, eq. 15)."""
    return jnp.minimum(jnp.sum(axis * rotation.rotate(rotations, axis), -1) - jnp.cos(angle), 0.0)


def _project_onto_cone(
    rotations: Float[Array, "B 4"], axis: Float[Array, "B 3"], angle: Float[Array, "B"]
) -> Float[Array, "B 4"]:
    """Apply the smallest rotation that brings the axis into its cone."""
    there = rotation.rotate(rotations, axis)
    across = jnp.cross(there, axis)
    sine = jnp.sqrt(jnp.maximum(jnp.sum(across**2, -1), 1e-30))
    beyond = jnp.arctan2(sine, jnp.sum(there * axis, -1)) - angle
    # slightly inside of the edge, so that rounding does not leave it outside
    back = rotation.about_axis(across / sine[:, None], beyond + 1e-6)
    return jnp.where((beyond > 0)[:, None], rotation.multiply(back, rotations), rotations)


def _is_universal(skeleton: Skeleton) -> Bool[Array, "J"]:
    return jnp.array([kind == "universal" for kind in skeleton.kinds])


@checked
def make_joint_ranges(
    skeleton: Skeleton,
    ranges: Mapping[str, Sequence] | None = None,
    cones: Mapping[str, Cone] | None = None,
) -> JointRanges:
    """Create `JointRanges` from limits by joint name.

    **Arguments:** `ranges` gives `(lower, upper)` radians for a revolute joint and
    `((lower, upper), (lower, upper))` for a universal one; `cones` a `Cone` for a ball or free joint. Axes
    need not be of unit length.

    **Raises:** `InputError` when a joint is unknown or of another kind, a lower bound is above its upper
    one, an angle is not in `[0, pi]`, or an axis has no length.
    """
    rows, balls = [], []
    place = {name: joint for joint, name in enumerate(skeleton.names)}
    for name, limits in (ranges or {}).items():
        joint = _find_joint(skeleton, place, name, ("revolute", "universal"), "range")
        pairs = np.asarray(limits, float).reshape(-1, 2)
        count = KINDS[skeleton.kinds[joint]][1]
        if len(pairs) != count:
            raise ValueError(
                f"Joint '{name}' is {skeleton.kinds[joint]} and has {len(pairs)} ranges of angles; expected {count}."
            )
        for number, (lower, upper) in enumerate(pairs):
            if not lower <= upper:
                raise ValueError(
                    f"The range of joint '{name}' has the lower bound {lower:g} above its upper bound {upper:g}; "
                    "swap them."
                )
            # a range with an infinite bound has no middle
            rows.append((joint, number, max(lower, -2 * np.pi), min(upper, 2 * np.pi)))
    for name, cone in (cones or {}).items():
        joint = _find_joint(skeleton, place, name, ("ball", "free"), "cone")
        axes = np.asarray([cone.heading, cone.bank], float)
        lengths = np.linalg.norm(axes, axis=1)
        angles = np.asarray([cone.heading_angle, cone.bank_angle], float)
        if not (lengths > 0).all():
            raise ValueError(f"A cone of joint '{name}' has the axis (0, 0, 0); expected a non-zero vector.")
        if not ((angles >= 0) & (angles <= np.pi + 1e-9)).all():
            raise ValueError(
                f"The cone angles of joint '{name}' are {angles.tolist()}; expected 0 to pi radians."
            )
        balls.append((joint, axes / lengths[:, None], angles))
    table = np.asarray(rows, float).reshape(-1, 4)
    axes = np.asarray([ball[1] for ball in balls], float).reshape(-1, 2, 3)
    angles = np.asarray([ball[2] for ball in balls], float).reshape(-1, 2)
    return JointRanges(
        joints=jnp.asarray(table[:, 0].astype(np.int32)),
        angle_indices=jnp.asarray(table[:, 1].astype(np.int32)),
        lower=jnp.asarray(table[:, 2]),
        upper=jnp.asarray(table[:, 3]),
        ball_joints=jnp.asarray([ball[0] for ball in balls], dtype=jnp.int32),
        heading=jnp.asarray(axes[:, 0]),
        heading_angle=jnp.asarray(angles[:, 0]),
        bank=jnp.asarray(axes[:, 1]),
        bank_angle=jnp.asarray(angles[:, 1]),
    )


def _find_joint(
    skeleton: Skeleton, joint_indices: Mapping[str, int], name: str, kinds: tuple[str, ...], limit_name: str
) -> int:
    if name not in joint_indices:
        raise ValueError(
            f"There is a {limit_name} for joint '{name}', which is not in the skeleton; expected one of "
            f"{', '.join(skeleton.names)}."
        )
    joint = joint_indices[name]
    if skeleton.kinds[joint] not in kinds:
        raise ValueError(
            f"There is a {limit_name} for joint '{name}', which is {skeleton.kinds[joint]}; expected a "
            f"{' or '.join(kinds)} joint."
        )
    return joint
