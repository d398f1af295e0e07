"""Boxes of rotation vectors: a range for each component of a joint's rotation vector."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..arguments import checked
from ..body.pose import Pose, local_rotation_vectors
from ..body.retraction import retract
from ..body.skeleton import KINDS, Skeleton, dof_layout
from ..geometry import rotation
from .abstract_limits import AbstractLimits

#: alternating projections onto a universal joint's axes and its box
ALTERNATIONS = 20
#: axis components below this are taken as zero
MIN_AXIS_COMPONENT = 1e-6
#: largest norm of a rotation vector: slightly below pi, beyond which its sign flips
HALF_TURN = np.pi - 1e-5


class PoseBoxes(AbstractLimits):
    """Boxes `[lower, upper]` of some joints' rotation vectors (Adaptation, section 4.1.1): a hard limit for
    each degree of freedom, without coupling.

    A rotation vector is that of the joint's rotation from rest, in the joint's own frame: twist, flexion,
    sideways. It is at most pi long, so a box cannot reach past half a turn. Bounds may be infinite.
    """

    joints: tuple[str, ...] = eqx.field(static=True)
    lower: Float[Array, "J 3"]
    upper: Float[Array, "J 3"]

    def residual(self, skeleton: Skeleton, pose: Pose):
        """Compute the excess of each component beyond its range, radians, negative below it."""
        own = local_rotation_vectors(skeleton, pose)[self.indices(skeleton)]
        return (own - jnp.clip(own, self.lower, self.upper)).reshape(-1)

    def residual_joints(self, skeleton: Skeleton):
        return jnp.repeat(jnp.asarray(self.indices(skeleton), jnp.int32), 3)

    def project(self, skeleton: Skeleton, pose: Pose):
        """Clamp every component to its range, which is the projection in these coordinates.

        A revolute joint stays on its axis and a universal one on its two, where these intersect the box.
        Joints that cannot rotate stay unchanged.
        """
        joints = self.indices(skeleton)
        own = local_rotation_vectors(skeleton, pose)[joints]
        turned = _from_local_vectors(skeleton, joints, self._project_onto_axes(skeleton, own))
        # only violated joints change, so that allowed ones stay bitwise equal
        beyond = jnp.any(jnp.clip(own, self.lower, self.upper) != own, -1, keepdims=True)
        beyond = beyond & ~_has_kind(skeleton, joints, "fixed", "translate")[:, None]
        rotations = jnp.where(beyond, turned, pose.rotations[joints]).astype(pose.rotations.dtype)
        return Pose(pose.translations, pose.rotations.at[joints].set(rotations), pose.scale)

    def indices(self, skeleton: Skeleton) -> Int[np.ndarray, "J"]:
        """Look up the joint of each box. Raises `KeyError` where the skeleton lacks one."""
        return np.array([skeleton.index(name) for name in self.joints], int)

    def _project_onto_axes(
        self, skeleton: Skeleton, rotation_vectors: Float[Array, "J 3"]
    ) -> Float[Array, "J 3"]:
        """Project rotation vectors onto the boxes and onto the rotations that the joints' kinds allow."""
        joints, within = self.indices(skeleton), _clamp_vectors(rotation_vectors, self.lower, self.upper)
        revolute, universal = (_has_kind(skeleton, joints, kind) for kind in ("revolute", "universal"))
        if revolute.any():
            axes, low, high = _hinge_ranges(self, skeleton, joints)
            angles = jnp.clip(jnp.sum(rotation_vectors * axes, -1), low, high)
            along = _clamp_vectors(angles[:, None] * axes, self.lower, self.upper)
            within = jnp.where(revolute[:, None], along, within)
        if universal.any():
            first, second = skeleton.axes[joints, 0], skeleton.axes[joints, 1]

            def nearer(_, within):
                angles = rotation.angles_about(_from_local_vectors(skeleton, joints, within), first, second)
                pair = (rotation.about_axis(first, angles[:, 0]), rotation.about_axis(second, angles[:, 1]))
                vectors = _to_local_vectors(skeleton, joints, rotation.multiply(*pair))
                return _clamp_vectors(vectors, self.lower, self.upper)

            alternated = jax.lax.fori_loop(0, ALTERNATIONS, nearer, within)
            within = jnp.where(universal[:, None], alternated, within)
        return within


class BoxChart(NamedTuple):
    """Coordinates `x` of the tangents of a pose, `d = basis @ x`, in which boxes are bounds."""

    #: radians and metres; the identity except for ball joints with a box
    basis: Float[Array, "D D"]
    #: bounds of each component of `x`; infinite where it is free
    lower: Float[Array, "D"]
    upper: Float[Array, "D"]


def make_box_chart(boxes: PoseBoxes, skeleton: Skeleton, pose: Pose) -> BoxChart:
    """Create the chart of boxes about a pose that is within them (Adaptation, 4.1.4).

    A pose changes by `R <- R exp(d)`, and a box bounds `w = O^T log R`, with `O` the joint's own frame. As
    `exp(log R + e) = R exp(Jr(log R) e)` to first order, with `Jr` the right Jacobian, a change of `w` by
    `x` is `d = Jr(log R) O x`. A revolute joint has one coordinate, its angle, with the range in which its
    axis is in the box. A universal joint is not bounded here; `PoseBoxes.project` projects it.
    """
    layout, dtype = dof_layout(skeleton), pose.rotations.dtype
    # one more slot, for parameters that a joint does not have
    turn = jnp.eye(skeleton.num_dofs + 1, dtype=dtype)
    low, high = (jnp.full(skeleton.num_dofs + 1, end, dtype) for end in (-jnp.inf, jnp.inf))
    joints = boxes.indices(skeleton)
    own = local_rotation_vectors(skeleton, pose)[joints]

    rows = np.flatnonzero(_has_kind(skeleton, joints, "ball", "free"))
    slots = layout.rotations[joints[rows]]
    blocks = rotation.right_jacobian(rotation.log(pose.rotations[joints[rows]]))
    blocks = jnp.matmul(blocks, rotation.to_matrix(skeleton.orientations[joints[rows]]), precision="highest")
    blocks = jnp.where(_bounded(boxes)[rows, :, None], blocks, jnp.eye(3, dtype=dtype))
    turn = turn.at[slots[:, :, None], slots[:, None, :]].set(blocks.astype(dtype))
    low = low.at[slots].set((boxes.lower - own)[rows].astype(dtype))
    high = high.at[slots].set((boxes.upper - own)[rows].astype(dtype))

    rows = np.flatnonzero(_has_kind(skeleton, joints, "revolute"))
    slots = layout.rotations[joints[rows], 0]
    axes, least, most = _hinge_ranges(boxes, skeleton, joints)
    angles = jnp.sum(own * axes, -1)
    low = low.at[slots].set((least - angles)[rows].astype(dtype))
    high = high.at[slots].set((most - angles)[rows].astype(dtype))
    return BoxChart(turn[:-1, :-1], low[:-1], high[:-1])


def transform_normal_equations(
    chart: BoxChart, matrix: Float[Array, "D D"], rhs: Float[Array, "D"]
) -> tuple[Float[Array, "D D"], Float[Array, "D"]]:
    """Transform normal equations of tangents to the chart's coordinates."""
    product = partial(jnp.matmul, precision="highest")
    return product(chart.basis.T, product(matrix, chart.basis)), product(chart.basis.T, rhs)


def retract_within(
    boxes: PoseBoxes, skeleton: Skeleton, pose: Pose, chart: BoxChart, x: Float[Array, "D"]
) -> Pose:
    """Move a pose by coordinates of its chart, of any size, and keep it in the boxes to rounding.

    Ball joints with a box move straight in their rotation vectors, so that a component set to its bound
    reaches it. All other joints move as in `retract`.
    """
    joints = boxes.indices(skeleton)
    moved = retract(skeleton, pose, jnp.matmul(chart.basis, x, precision="highest"))
    rows = np.flatnonzero(_has_kind(skeleton, joints, "ball", "free"))
    ball, lower, upper = joints[rows], boxes.lower[rows], boxes.upper[rows]
    own = local_rotation_vectors(skeleton, pose)[ball] + x[dof_layout(skeleton).rotations[ball]]
    straight = _from_local_vectors(skeleton, ball, _clamp_vectors(own, lower, upper))
    rotations = jnp.where(_bounded(boxes)[rows], straight, moved.rotations[ball])
    rotations = moved.rotations.at[ball].set(rotations.astype(moved.rotations.dtype))
    return boxes.project(skeleton, Pose(moved.translations, rotations, moved.scale))


@checked
def make_pose_boxes(
    joints: Sequence[str], lower: Float[np.ndarray, "J 3"], upper: Float[np.ndarray, "J 3"]
) -> PoseBoxes:
    """Create checked boxes, radians. Raises `ValueError` where a lower bound is above its upper one."""
    for name, low, high in zip(joints, lower, upper, strict=True):
        if not (low <= high).all():
            raise ValueError(
                f"The box of joint '{name}' has lower bounds {low} above its upper bounds {high}; swap them."
            )
    return PoseBoxes(tuple(joints), jnp.asarray(lower, float), jnp.asarray(upper, float))


def rotating_joints(skeleton: Skeleton) -> tuple[int, ...]:
    """List the joints whose rotations are part of a pose: all that rotate except roots.

    Roots only orient the whole body.
    """
    return tuple(
        joint
        for joint, (parent, kind) in enumerate(zip(skeleton.parents, skeleton.kinds, strict=True))
        if parent >= 0 and KINDS[kind][1]
    )


def _clamp_vectors(
    vectors: Float[Array, "B 3"], lower: Float[Array, "B 3"], upper: Float[Array, "B 3"]
) -> Float[Array, "B 3"]:
    """Clamp every component to its range, and shorten the vector to at most half a turn.

    It is shortened along the line to the smallest rotation in the box, which stays in the box.
    """
    clipped = jnp.clip(vectors, lower, upper)
    least = jnp.clip(jnp.zeros_like(vectors), lower, upper)
    way = clipped - least
    # solve |least + share way| = pi; where the vector is shorter, share is at least 1
    a, b, c = (jnp.sum(p * q, -1, keepdims=True) for p, q in ((way, way), (way, least), (least, least)))
    room = jnp.maximum(HALF_TURN**2 - c, 0.0)
    share = room / (b + jnp.sqrt(jnp.maximum(b**2 + a * room, 1e-30)))
    return jnp.where(share < 1.0, least + share * way, clipped)


def _hinge_ranges(
    boxes: PoseBoxes, skeleton: Skeleton, joints: Int[np.ndarray, "B"]
) -> tuple[Float[Array, "B 3"], Float[Array, "B"], Float[Array, "B"]]:
    """Compute each joint's first axis in its own frame, and the range of angles about it in the box."""
    axes = rotation.rotate(rotation.conjugate(skeleton.orientations[joints]), skeleton.axes[joints, 0])
    turns = jnp.abs(axes) > MIN_AXIS_COMPONENT
    ends = jnp.stack([boxes.lower, boxes.upper]) / jnp.where(turns, axes, 1.0)
    low = jnp.max(jnp.where(turns, jnp.min(ends, 0), -jnp.inf), -1)
    high = jnp.min(jnp.where(turns, jnp.max(ends, 0), jnp.inf), -1)
    return axes, low, jnp.maximum(low, high)


def _bounded(boxes: PoseBoxes) -> Bool[Array, "B 1"]:
    """Test if a box bounds its joint at all."""
    return jnp.any(jnp.isfinite(boxes.lower) | jnp.isfinite(boxes.upper), -1, keepdims=True)


def _to_local_vectors(
    skeleton: Skeleton, joints: Int[np.ndarray, "B"], rotations: Float[Array, "B 4"]
) -> Float[Array, "B 3"]:
    """Convert rotations to rotation vectors in their joints' own frames."""
    return rotation.rotate(rotation.conjugate(skeleton.orientations[joints]), rotation.log(rotations))


def _from_local_vectors(
    skeleton: Skeleton, joints: Int[np.ndarray, "B"], vectors: Float[Array, "B 3"]
) -> Float[Array, "B 4"]:
    """Convert rotation vectors of `_to_local_vectors` back to quaternions."""
    return rotation.normalise(rotation.exp(rotation.rotate(skeleton.orientations[joints], vectors)))


def _has_kind(skeleton: Skeleton, joints: Int[np.ndarray, "B"], *kinds: str) -> np.ndarray:
    """Test if joints are of some kinds, (B,)."""
    return np.isin(np.array(skeleton.kinds)[joints], kinds)
