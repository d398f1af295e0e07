"""Joints' centres and orientations with the poses of all meshes, as one problem with an arrow."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...body.body import Body, pose_body
from ...body.geometric_jacobian import joint_rates, pose_rates, stack_rates, take_rates
from ...body.kinematics import forward_kinematics
from ...body.pose import Pose, retract
from ...body.skeleton import Skeleton
from ...body.skin.swing_twist import SwingTwistSkin
from ...body.symmetry import length_differences
from ...energy.energy import AbstractEnergy
from ...fit.frame_equations import frame_equations
from ...fit.linear.block_arrow import BlockArrow, Unknowns
from ...fit.linear.block_banded import BlockBanded
from ...fit.linearise import body_tangent
from ...fit.solvers.descent import ConstrainedInfo, Constraints
from ...fit.solvers.equalities import Equalities
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ...fit.solvers.minimise import minimise
from ...fit.solvers.problem import AbstractProblem
from ...geometry import rotation
from ...geometry.laplacian import Conformance, apply
from ...geometry.patches import Blocks, laplacian_rows, make_blocks
from ..objective import objective
from .joint_centre_prior import Anchors, Given, cut_anchors, given_anchors

#: vertices from which curvature is estimated, at least
SAMPLES = 4000
#: steps for the same anchors; the least damping of the next one; the share of Q that ends them
STEPS, LEAST, RTOL = 2, 1e-7, 1e-12


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


class Standing(eqx.Module):
    """Where joints are at rest, how they are turned there, and the poses."""

    centres: Float[Array, "J 3"]
    orientations: Float[Array, "J 4"]
    poses: Pose


class JointProblem(AbstractProblem[Standing]):
    """Half of Q by joints and poses, with energies of a user's own (Adaptation, 3.2.2).

    The unknowns are the numbers of all poses, and of every joint below a root its centre and,
    where the skin knows twist axes, two numbers of its orientation (a roll about the twist axis
    changes nothing). The bones of left and right `pairs` of joints stay equally long, which is
    the limit of the paper's heavy `lambda Q_sym` (eqs. 3.23 to 3.26). Anchors bend steps along what no motion tells of a
    centre, and are no part of what is minimised: they hold, and pull with a `strength`.
    """

    body: Body
    targets: Float[Array, "F V 3"]
    metric: Conformance
    curvature: Curvature
    anchors: Anchors | None = None
    strength: float | Float[Array, ""] = 0.0
    terms: AbstractEnergy | None = None
    pairs: tuple[tuple[int, int], ...] = eqx.field(static=True, default=())

    @property
    def slots(self) -> tuple[int, ...]:
        return shared_slots(self.body)

    def start(self, poses: Pose) -> Standing:
        """Start from the joints as they are."""
        skeleton = self.body.skeleton
        return Standing(skeleton.centres, skeleton.orientations, poses)

    def body_at(self, y: Standing, s: Float[Array, "S"] | None = None) -> Body:
        """Make the body of joints, moved along a tangent where one is given."""
        there = eqx.tree_at(
            lambda b: (b.skeleton.centres, b.skeleton.orientations), self.body, (y.centres, y.orientations)
        )
        if s is None:
            return there
        moved = jnp.zeros(6 * len(y.centres), s.dtype).at[np.array(self.slots, int)].set(s).reshape(-1, 6)
        joints = move_joints(there.skeleton, moved[:, :3], moved[:, 3:])
        return eqx.tree_at(lambda b: b.skeleton, there, joints)

    def value(self, y: Standing) -> Float[Array, ""]:
        return 0.5 * objective(self.body_at(y), y.poses, self.targets, self.metric, self.terms)

    def retract(self, y: Standing, d: Unknowns) -> Standing:
        joints = self.body_at(y, d[1]).skeleton
        poses = jax.vmap(retract, (None, 0, 0))(self.body.skeleton, y.poses, d[0])
        return Standing(joints.centres, joints.orientations, poses)

    def scales(self) -> Unknowns:
        dtype = self.targets.dtype
        shape = len(self.targets), self.body.skeleton.num_dofs
        return jnp.ones(shape, dtype), jnp.ones(len(self.slots), dtype)

    def constraint(self):
        return "bones of equal length" if self.pairs else None

    def information(self, y: Standing) -> ConstrainedInfo:
        body, slots = self.body_at(y), self.slots
        arrow, side = normal_equations(body, y.poses, self.targets, self.metric, self.curvature, slots)
        if self.anchors is not None:
            arrow, side = _anchored(arrow, side, body.skeleton, self.anchors, slots, self.strength)
        if self.terms is not None:
            arrow, side = _with_terms(arrow, side, self.terms, y, self)
        differences, by_centre = length_differences(body.skeleton, np.array(self.pairs, int).reshape(-1, 2))
        full = jnp.pad(by_centre, ((0, 0), (0, 0), (0, 3)))
        rows = full.reshape(len(differences), 6 * len(y.centres))[:, np.array(slots, int)]
        constraints = Constraints(equalities=Equalities(rows, -differences))
        gradient = jax.tree.map(jnp.negative, side)
        return ConstrainedInfo(self.value(y), gradient, arrow, constraints=constraints)  # pyright: ignore[reportCallIssue]


class JointStep(NamedTuple):
    """What one improvement of joints and poses leaves."""

    body: Body
    poses: Pose
    #: Q, and what a user's own energies add
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
    steps: int = STEPS,
    given: Given | None = None,
    terms: AbstractEnergy | None = None,
) -> JointStep:
    """Some steps of Levenberg-Marquardt on a `JointProblem` from Q = `value`, which they never raise.

    What no motion tells of a centre is left to where a skeleton has it, `given`, or else to the cut between parts. Anchors
    that would raise Q only keep centres from going further.
    """
    anchors = (
        cut_anchors(body, poses, metric, value / targets.size)
        if given is None
        else given_anchors(body, poses, given)
    )
    mirrored = tuple(map(tuple, np.asarray(pairs, int).tolist()))
    shares = jnp.asarray(damping, targets.dtype)
    for strength in (1.0, 0.0):
        strength = jnp.asarray(strength, targets.dtype)
        problem = JointProblem(body, targets, metric, curvature, anchors, strength, terms, mirrored)
        y, left, shares = _descend(problem, problem.start(poses), shares, steps)
        if float(left) < value:
            there = problem.body_at(y)
            return JointStep(there, y.poses, float(left), max(float(shares), LEAST))
    return JointStep(body, poses, value, max(float(shares), LEAST))


@eqx.filter_jit
def _descend(problem: JointProblem, start: Standing, damping: Float[Array, ""], steps: int):
    solver = LevenbergMarquardt(rtol=RTOL, relative=True)
    found = minimise(problem, start, solver, steps, damping)
    return found.y, 2.0 * problem.value(found.y), found.damping


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
    strength: float | Float[Array, ""],
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


def _with_terms(
    arrow: BlockArrow, side: Unknowns, terms: AbstractEnergy, y: Standing, problem: JointProblem
) -> tuple[BlockArrow, Unknowns]:
    """The equations with energies of every frame."""
    body, count = problem.body_at(y), len(problem.slots)
    dofs = body.skeleton.num_dofs

    def body_at(s):
        return problem.body_at(y, s)

    tangent = body_tangent(body_at, body, count) if count else None

    def of_frame(pose):
        return frame_equations(terms, body, pose, body_at if count else None, tangent)

    with jax.default_matmul_precision("highest"):
        _, slopes, grams = jax.lax.map(of_frame, y.poses)
    frames = BlockBanded(arrow.frames.blocks.at[:, 0].add(grams[:, :dofs, :dofs]))
    coupling = arrow.coupling + grams[:, :dofs, dofs:]
    shared = arrow.shared + jnp.sum(grams[:, dofs:, dofs:], 0)
    sides = side[0] - slopes[:, :dofs], side[1] - jnp.sum(slopes[:, dofs:], 0)
    return BlockArrow(frames, coupling, shared), sides


def move_joints(skeleton: Skeleton, shifts: Float[Array, "J 3"], turns: Float[Array, "J 3"]) -> Skeleton:
    """A skeleton with its centres shifted, metres, and its orientations turned on the right, radians."""
    orientations = rotation.normalise(rotation.multiply(skeleton.orientations, rotation.exp(turns)))
    return eqx.tree_at(
        lambda s: (s.centres, s.orientations), skeleton, (skeleton.centres + shifts, orientations)
    )
