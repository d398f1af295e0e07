"""Joints' centres and orientations with the poses of all meshes: Gauss-Newton on an arrow."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..body.body import Body, pose_body
from ..body.kinematics import forward_kinematics
from ..body.pose import Pose, retract
from ..body.rates import joint_rates, pose_rates, stack_rates, take_rates
from ..body.skeleton import Skeleton
from ..body.skin.swing_twist import SwingTwistSkin
from ..body.symmetry import length_differences
from ..fit.solvers.block_arrow import BlockArrow, Unknowns
from ..fit.solvers.block_banded import BlockBanded
from ..fit.solvers.equalities import Equalities
from ..fit.solvers.structured import damped
from ..geometry import rotation
from ..geometry.laplacian import Conformance, apply
from ..geometry.patches import Blocks, laplacian_rows, make_blocks
from .anchors import Anchors, Given, cut_anchors, given_anchors
from .objective import objective

#: vertices from which curvature is estimated, at least
SAMPLES = 4000


class Curvature(eqx.Module):
    """The vertices over which `J^T A J` is summed, and what each of them counts."""

    vertices: Int[Array, "S"]
    laplacian: Blocks
    weight: Float[Array, ""]


def make_curvature(metric: Conformance, samples: int = SAMPLES) -> Curvature:
    """Every vertex; of more than twice `samples`, every n-th one, counted n times. Thousands of
    vertices say the same about some dozen numbers, and steps that rest on a good estimate of
    their curvature converge alike."""
    count = len(metric.neighbours)
    stride = max(1, count // samples)
    vertices = np.arange(stride // 2, count, stride)
    weight = jnp.asarray(count / len(vertices), metric.diagonal.dtype)
    return Curvature(jnp.asarray(vertices), make_blocks(metric, vertices), weight)


class JointStep(NamedTuple):
    """What one improvement of joints and poses leaves."""

    body: Body
    poses: Pose
    value: float
    damping: float


def improve_joints(
    body: Body,
    poses: Pose,
    targets: Float[Array, "F V 3"],
    metric: Conformance,
    curvature: Curvature,
    pairs: Int[np.ndarray, "P 2"],
    damping: float,
    value: float,
    tries: int = 5,
    given: Given | None = None,
) -> JointStep:
    """One step of Gauss-Newton (Adaptation, 3.2.2) that never raises Q.

    The unknowns are the numbers of all poses, and of every joint below a root its centre and,
    where the skin knows twist axes, two numbers of its orientation (a roll about the twist axis
    changes nothing). The bones of left and right `pairs` of joints stay equally long, which is
    the limit of the paper's heavy `lambda Q_sym` (eqs. 3.23 to 3.26). Where a step would raise
    Q it is damped more, up to `tries` times, and then left. What no motion tells of a centre is left
    to where a skeleton has it, `given`, or else to the cut between parts.
    """
    slots, bones = shared_slots(body), tuple(map(tuple, np.asarray(pairs, int).tolist()))
    equations = normal_equations(body, poses, targets, metric, curvature, slots)
    anchors = (
        cut_anchors(body, poses, metric, value / targets.size)
        if given is None
        else given_anchors(body, poses, given)
    )
    strengths = jnp.asarray([1.0, 0.0], targets.dtype)
    pulled, held = (_anchored(*equations, body.skeleton, anchors, slots, strength) for strength in strengths)
    for number in range(tries):
        # anchors that would raise Q only keep centres from going further
        shares = jnp.asarray(damping, targets.dtype)
        trial = _step(body, poses, held if number else pulled, shares, bones, slots)
        trial_value = float(objective(*trial, targets, metric))
        if trial_value < value:
            return JointStep(*trial, trial_value, max(damping / 5.0, 1e-7))
        damping = max(10.0 * damping, 1e-5) if number else damping
    return JointStep(body, poses, value, damping)


def shared_slots(body: Body) -> tuple[int, ...]:
    """Which numbers of `joint_rates` are unknown: centres, and orientations but for the roll."""
    numbers = [0, 1, 2, 4, 5] if isinstance(body.skin, SwingTwistSkin) else [0, 1, 2]
    below = [joint for joint, parent in enumerate(body.skeleton.parents) if parent >= 0]
    return tuple(6 * joint + number for joint in below for number in numbers)


@eqx.filter_jit
def normal_equations(
    body: Body,
    poses: Pose,
    targets: Float[Array, "F V 3"],
    metric: Conformance,
    curvature: Curvature,
    slots: tuple[int, ...],
) -> tuple[BlockArrow, Unknowns]:
    """The block-arrow normal equations of Q by poses and joints, frame by frame; the right-hand
    sides are exact, the matrices summed over the vertices of `curvature`."""
    skeleton, count = body.skeleton, len(body.vertices)
    dofs, chosen = skeleton.num_dofs, np.array(slots, int)
    every = jnp.broadcast_to(jnp.eye(3, dtype=body.vertices.dtype), (count, 3, 3))

    def of_frame(frame):
        pose, target = frame
        transforms = forward_kinematics(skeleton, pose)
        rates = stack_rates(
            pose_rates(skeleton, pose, transforms),
            take_rates(joint_rates(skeleton, pose, transforms), chosen),
        )
        rows = body.skin.jacobian(body.vertices, every, skeleton, pose, transforms, rates)
        side = jnp.tensordot(apply(metric, target - pose_body(body, pose).vertices), rows, 2)
        rough = laplacian_rows(curvature.laplacian, rows.reshape(count, -1)).reshape(-1, rows.shape[2])
        plain = rows[curvature.vertices].reshape(-1, rows.shape[2])
        gram = curvature.weight * (plain.T @ plain + metric.alpha * rough.T @ rough)
        return gram[:dofs, :dofs], gram[:dofs, dofs:], gram[dofs:, dofs:], side

    frames, coupling, shared, sides = jax.lax.map(of_frame, (poses, targets))
    arrow = BlockArrow(BlockBanded(frames[:, None]), coupling, jnp.sum(shared, 0))
    return arrow, (sides[:, :dofs], jnp.sum(sides[:, dofs:], 0))


@eqx.filter_jit
def _anchored(
    arrow: BlockArrow,
    side: Unknowns,
    skeleton: Skeleton,
    anchors: Anchors,
    slots: tuple[int, ...],
    strength: Float[Array, ""],
) -> tuple[BlockArrow, Unknowns]:
    """The equations with the hold of anchors on centres, in the measure of the data: what the
    curvature is for a turn of one radian; they also pull, with the given strength."""
    count, chosen = skeleton.num_joints, np.array(slots, int)
    known = jnp.zeros(6 * count, arrow.shared.dtype).at[chosen].set(jnp.diag(arrow.shared))
    total = jnp.sum(known.reshape(count, 6)[:, :3], 1)
    told = jnp.trace(anchors.told, axis1=1, axis2=2)
    measure = total / jnp.maximum(told, jnp.finfo(told.dtype).eps)
    weights, hold = (measure[:, None, None] * some for some in (anchors.weights, anchors.hold))
    pull = strength * jnp.einsum("jab,jb->ja", weights, anchors.middles - skeleton.centres)
    wide = jnp.zeros((count, 6, count, 6), weights.dtype)
    wide = wide.at[np.arange(count), :3, np.arange(count), :3].set(hold).reshape(6 * count, 6 * count)
    shared = arrow.shared + wide[chosen][:, chosen]
    pulled = side[1] + jnp.pad(pull, ((0, 0), (0, 3))).ravel()[chosen]
    return BlockArrow(arrow.frames, arrow.coupling, shared), (side[0], pulled)


@eqx.filter_jit
def _step(body, poses, equations, damping, bones, slots) -> tuple[Body, Pose]:
    skeleton = body.skeleton
    slots = np.array(slots, int)
    differences, by_centre = length_differences(skeleton, np.array(bones, int).reshape(-1, 2))
    full = jnp.pad(by_centre, ((0, 0), (0, 0), (0, 3)))
    rows = full.reshape(len(differences), 6 * skeleton.num_joints)[:, slots]
    arrow, side = equations
    by_frame, shared = damped(arrow, damping).factorise().solve(side, Equalities(rows, -differences))
    moved = jnp.zeros(6 * skeleton.num_joints, shared.dtype).at[slots].set(shared).reshape(-1, 6)
    joints = move_joints(skeleton, moved[:, :3], moved[:, 3:])
    new_poses = jax.vmap(retract, (None, 0, 0))(skeleton, poses, by_frame)
    return eqx.tree_at(lambda b: b.skeleton, body, joints), new_poses


def move_joints(skeleton: Skeleton, shifts: Float[Array, "J 3"], turns: Float[Array, "J 3"]) -> Skeleton:
    """A skeleton with its centres shifted, metres, and its orientations turned on the right, radians."""
    orientations = rotation.normalise(rotation.multiply(skeleton.orientations, rotation.exp(turns)))
    return eqx.tree_at(
        lambda s: (s.centres, s.orientations), skeleton, (skeleton.centres + shifts, orientations)
    )
