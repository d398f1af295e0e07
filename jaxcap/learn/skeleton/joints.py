"""Joint centres and orientations, optimised with the poses of all meshes as one block-arrow problem."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...body.body import Body, pose_body
from ...body.geometric_jacobian import concatenate_jacobians, joint_jacobian, pose_jacobian, select_parameters
from ...body.kinematics import forward_kinematics
from ...body.pose import Pose
from ...body.retraction import retract
from ...body.skeleton import Skeleton
from ...body.skin.swing_twist import SwingTwistSkin
from ...body.symmetry import length_differences
from ...energy.energy import AbstractEnergy
from ...fit.frame_equations import frame_equations
from ...fit.linear_solvers.block_arrow import BlockArrow, Unknowns
from ...fit.linear_solvers.block_banded import BlockBanded
from ...fit.linearise import body_tangent
from ...fit.sequences.poses_and_shared import AbstractPosesAndShared
from ...fit.solvers.descent import ConstrainedInfo, StepConstraints
from ...fit.solvers.equalities import Equalities
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ...fit.solvers.minimise import minimise
from ...geometry import rotation
from ...geometry.laplacian import (
    Conformance,
    PatchLaplacian,
    apply_conformance,
    laplacian_rows,
    make_patch_laplacian,
)
from ..objective import objective
from .centre_constraints import KeptBones, MiddlePlanes, kept_bones, middle_planes
from .given_centres import GivenCentres
from .joint_centre_prior import (
    JointCentrePrior,
    boundary_centre_prior,
    fixed_centre_prior,
    given_centre_prior,
)

#: the least number of vertices from which the curvature is estimated
SAMPLES = 4000
#: steps with the same anchors; the least damping of the next update; the relative tolerance on Q
STEPS, MIN_DAMPING, RTOL = 2, 1e-7, 1e-12


class Curvature(eqx.Module):
    """The vertices over which `J^T A J` is summed, and their weight."""

    vertices: Int[Array, "S"]
    laplacian: PatchLaplacian
    weight: Float[Array, ""]


def make_curvature(metric: Conformance, samples: int = SAMPLES) -> Curvature:
    """Sample vertices for the curvature: all, or every n-th with weight n for more than twice `samples`
    vertices.

    Thousands of vertices are redundant for some dozen unknowns, and steps with a good estimate of the
    curvature converge equally well.
    """
    count = len(metric.neighbours)
    stride = max(1, count // samples)
    vertices = np.arange(stride // 2, count, stride)
    weight = jnp.asarray(count / len(vertices), metric.diagonal.dtype)
    return Curvature(jnp.asarray(vertices), make_patch_laplacian(metric, vertices), weight)


class JointState(eqx.Module):
    """Joint centres and orientations at rest, and the poses."""

    centres: Float[Array, "J 3"]
    orientations: Float[Array, "J 4"]
    poses: Pose


class JointProblem(AbstractPosesAndShared[JointState]):
    """Half of Q as a function of joints and poses, with user-defined energies (Adaptation, 3.2.2).

    The unknowns are the parameters of all poses and, for each joint below a root, its centre and, if the skin
    has twist axes, two parameters of its orientation (a roll about the twist axis has no effect). The bones
    of `left_right_pairs` of joints stay equally long, the limit of the paper's heavily weighted `lambda
    Q_sym` (eqs. 3.23 to 3.26). Anchors damp steps along directions of a centre that no motion determines, and
    pull with a `prior_strength`.
    """

    body: Body
    targets: Float[Array, "F V 3"]
    metric: Conformance
    curvature: Curvature
    centre_prior: JointCentrePrior | None = None
    prior_strength: float | Float[Array, ""] = 0.0
    terms: AbstractEnergy | None = None
    left_right_pairs: tuple[tuple[int, int], ...] = eqx.field(static=True, default=())
    middle_planes: MiddlePlanes | None = None
    #: vectors between joints that are too close to each other to be moved by the motion
    kept_bones: KeptBones | None = None
    #: whether the orientations of joints are unknowns
    free_orientations: bool = eqx.field(static=True, default=True)
    #: factors of the distances of each mesh
    frame_weights: Float[Array, "F"] | None = None

    @property
    def slots(self) -> tuple[int, ...]:
        return shared_slots(self.body, self.free_orientations)

    def start(self, poses: Pose) -> JointState:
        """Return the current joints and the given poses as a starting point."""
        skeleton = self.body.skeleton
        return JointState(skeleton.centres, skeleton.orientations, poses)

    def body_at(self, y: JointState, s: Float[Array, "S"] | None = None) -> Body:
        """Build the body at given joints, optionally moved along a tangent."""
        body = eqx.tree_at(
            lambda b: (b.skeleton.centres, b.skeleton.orientations), self.body, (y.centres, y.orientations)
        )
        if s is None:
            return body
        moved = jnp.zeros(6 * len(y.centres), s.dtype).at[np.array(self.slots, int)].set(s).reshape(-1, 6)
        joints = move_joints(body.skeleton, moved[:, :3], moved[:, 3:])
        return eqx.tree_at(lambda b: b.skeleton, body, joints)

    def value(self, y: JointState) -> Float[Array, ""]:
        value, prior = 0.5 * self.value_of_data(y), self.centre_prior
        if prior is None:
            return value
        rotations = prior.rotation_energy(self.body.skeleton, y.poses)
        return value + self.prior_strength * (prior.energy(y.centres) + rotations)

    def value_of_data(self, y: JointState) -> Float[Array, ""]:
        """Evaluate Q with the user's energies."""
        return objective(self.body_at(y), y.poses, self.targets, self.metric, self.terms, self.frame_weights)

    def retract(self, y: JointState, d: Unknowns) -> JointState:
        joints = self.body_at(y, d[1]).skeleton
        poses = jax.vmap(retract, (None, 0, 0))(self.body.skeleton, y.poses, d[0])
        return JointState(joints.centres, joints.orientations, poses)

    def scales(self) -> Unknowns:
        dtype = self.targets.dtype
        shape = len(self.targets), self.body.skeleton.num_dofs
        return jnp.ones(shape, dtype), jnp.ones(len(self.slots), dtype)

    def skeleton_of_poses(self):
        return self.body.skeleton

    def shared_names(self):
        numbers = (*(f"centre.{axis}" for axis in "xyz"), *(f"orientation.{axis}" for axis in "xyz"))
        return tuple(f"{self.body.skeleton.names[slot // 6]}.{numbers[slot % 6]}" for slot in self.slots)

    def residual_variance(self, y: JointState, energy: Float[Array, ""]):
        unknowns = len(self.targets) * self.body.skeleton.num_dofs + len(self.slots)
        return energy / max(self.targets.size - unknowns, 1)

    def describe_constraints(self):
        lengths = ["bones of equal length"] if self.left_right_pairs else []
        middle = [] if self.middle_planes is None else ["joints on the middle"]
        kept = [] if self.kept_bones is None else ["bones that keep their vectors"]
        return " and ".join(lengths + middle + kept) or None

    def information(self, y: JointState) -> ConstrainedInfo:
        body, slots = self.body_at(y), self.slots
        arrow, side = normal_equations(
            body, y.poses, self.targets, self.metric, self.curvature, slots, self.frame_weights
        )
        if self.centre_prior is not None:
            arrow, side = _add_prior(
                arrow, side, body, y.poses, self.centre_prior, slots, self.prior_strength
            )
        if self.terms is not None:
            arrow, side = _add_energies(arrow, side, self.terms, y, self)
        differences, by_centre = length_differences(
            body.skeleton, np.array(self.left_right_pairs, int).reshape(-1, 2)
        )
        for constraint in (self.middle_planes, self.kept_bones):
            if constraint is not None:
                distances, slopes = constraint.differences(y.centres)
                differences = jnp.concatenate([differences, distances])
                by_centre = jnp.concatenate([by_centre, slopes])
        full = jnp.pad(by_centre, ((0, 0), (0, 0), (0, 3)))
        rows = full.reshape(len(differences), 6 * len(y.centres))[:, np.array(slots, int)]
        equalities = Equalities(rows, -differences) if len(rows) else None
        constraints = StepConstraints(equalities=equalities)
        gradient = jax.tree.map(jnp.negative, side)
        return ConstrainedInfo(self.value(y), gradient, arrow, constraints=constraints)  # pyright: ignore[reportCallIssue]


class JointStep(NamedTuple):
    """The result of one update of joints and poses."""

    body: Body
    poses: Pose
    #: Q plus the user's energies
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
    given_centres: GivenCentres | None = None,
    terms: AbstractEnergy | None = None,
    free_orientations: bool = True,
    frame_weights: Float[Array, "F"] | None = None,
    planes: MiddlePlanes | None = None,
    close: tuple[tuple[int, int], ...] = (),
) -> JointStep:
    """Run some Levenberg-Marquardt steps on a `JointProblem` from Q = `value`; Q never rises.

    Components of a centre that no motion determines follow the `given_centres` skeleton or else the cut between
    parts. If anchors that pull would raise Q, given centres stay where they are, and those of a cut only damp the motion of
    centres. Without `free_orientations`, joints keep
    their orientations, which several bodies may share. `frame_weights` as of `objective`. Without given centres, joints stay in
    `planes`. `close` pairs of joints keep the vectors between their given centres.
    """
    size = targets.size if frame_weights is None else targets[0].size * float(jnp.sum(frame_weights))
    if given_centres is None:
        anchors = boundary_centre_prior(body, poses, metric, value / size, frame_weights)
        tries, kept = ((anchors, 1.0), (anchors, 0.0)), None
    else:
        anchors = given_centre_prior(body, poses, given_centres, value / size, frame_weights)
        tries = (anchors, 1.0), (fixed_centre_prior(body, len(targets), frame_weights), 1.0)
        planes, kept = middle_planes(given_centres), kept_bones(given_centres, close, np.asarray(pairs))
    left_right_pairs = tuple(map(tuple, np.asarray(pairs, int).tolist()))
    first = shares = jnp.asarray(damping, targets.dtype)
    for anchors, strength in tries:
        problem = JointProblem(
            body,
            targets,
            metric,
            curvature,
            anchors,
            jnp.asarray(strength, targets.dtype),
            terms,
            left_right_pairs,
            planes,
            kept,
            free_orientations,
            frame_weights,
        )
        y, left, shares = _descend(problem, problem.start(poses), first, steps)
        if float(left) < value:
            improved = problem.body_at(y)
            return JointStep(improved, y.poses, float(left), max(float(shares), MIN_DAMPING))
    return JointStep(body, poses, value, max(float(shares), MIN_DAMPING))


@eqx.filter_jit
def _descend(problem: JointProblem, start: JointState, damping: Float[Array, ""], steps: int):
    solver = LevenbergMarquardt(rtol=RTOL, relative=True)
    found = minimise(problem, start, solver, steps, damping)
    return found.y, problem.value_of_data(found.y), found.damping


def shared_slots(body: Body, free_orientations: bool = True) -> tuple[int, ...]:
    """Return the indices of unknowns in `joint_jacobian`: centres, and orientations without the roll if they are free and the
    skin has twist axes."""
    twisting = free_orientations and isinstance(body.skin, SwingTwistSkin)
    numbers = [0, 1, 2, 4, 5] if twisting else [0, 1, 2]
    # the centre of a fixed joint has no effect on the surface
    below = [
        joint
        for joint, (parent, kind) in enumerate(zip(body.skeleton.parents, body.skeleton.kinds, strict=True))
        if parent >= 0 and kind != "fixed"
    ]
    return tuple(6 * joint + number for joint in below for number in numbers)


@eqx.filter_jit
def normal_equations(
    body: Body,
    poses: Pose,
    targets: Float[Array, "F V 3"],
    metric: Conformance,
    curvature: Curvature,
    slots: tuple[int, ...],
    frame_weights: Float[Array, "F"] | None = None,
) -> tuple[BlockArrow, Unknowns]:
    """Assemble the block-arrow normal equations of Q over poses and joints, frame by frame.

    The right-hand sides are exact; the matrices are summed over the vertices of `curvature`. `frame_weights` as of `objective`; a
    frame without weight keeps its own block, and its pose stays.
    """
    skeleton, count = body.skeleton, len(body.vertices)
    dofs, chosen = skeleton.num_dofs, np.array(slots, int)
    every = jnp.broadcast_to(jnp.eye(3, dtype=body.vertices.dtype), (count, 3, 3))

    def of_frame(frame):
        pose, target, weight = frame
        transforms = forward_kinematics(skeleton, pose)
        rates = concatenate_jacobians(
            pose_jacobian(skeleton, pose, transforms),
            select_parameters(joint_jacobian(skeleton, pose, transforms), chosen),
        )
        rows = body.skin.jacobian(body.vertices, every, skeleton, pose, transforms, rates)
        side = jnp.tensordot(apply_conformance(metric, target - pose_body(body, pose).vertices), rows, 2)
        rough = laplacian_rows(curvature.laplacian, rows.reshape(count, -1)).reshape(-1, rows.shape[2])
        plain = rows[curvature.vertices].reshape(-1, rows.shape[2])
        gram = curvature.weight * (plain.T @ plain + metric.alpha * rough.T @ rough)
        own = jnp.where(weight > 0, weight, 1.0) * gram[:dofs, :dofs]
        return own, weight * gram[:dofs, dofs:], weight * gram[dofs:, dofs:], weight * side

    weights = jnp.ones(len(targets), targets.dtype) if frame_weights is None else frame_weights
    frames, coupling, shared, sides = jax.lax.map(of_frame, (poses, targets, weights))
    arrow = BlockArrow(BlockBanded(frames[:, None]), coupling, jnp.sum(shared, 0))
    return arrow, (sides[:, :dofs], jnp.sum(sides[:, dofs:], 0))


@eqx.filter_jit
def _add_prior(
    arrow: BlockArrow,
    side: Unknowns,
    body: Body,
    poses: Pose,
    prior: JointCentrePrior,
    slots: tuple[int, ...],
    strength: float | Float[Array, ""],
) -> tuple[BlockArrow, Unknowns]:
    """Add the prior on centres and rotations to the normal equations; its damping does not depend on its strength."""
    skeleton = body.skeleton
    count, chosen = skeleton.num_joints, np.array(slots, int)
    pull, stiff = prior.pull(skeleton.centres)
    pull = strength * pull
    wide = jnp.zeros((count, 6, count, 6), pull.dtype)
    wide = wide.at[np.arange(count), :3, np.arange(count), :3].set(prior.damping + strength * stiff)
    shared = arrow.shared + wide.reshape(6 * count, 6 * count)[chosen][:, chosen]
    stiffness, back = prior.rotations_to_rest(skeleton, poses)
    frames = BlockBanded(arrow.frames.blocks.at[:, 0].add(strength * jax.vmap(jnp.diag)(stiffness)))
    pulled = side[1] + jnp.pad(pull, ((0, 0), (0, 3))).ravel()[chosen]
    return BlockArrow(frames, arrow.coupling, shared), (side[0] + strength * stiffness * back, pulled)


def _add_energies(
    arrow: BlockArrow, side: Unknowns, terms: AbstractEnergy, y: JointState, problem: JointProblem
) -> tuple[BlockArrow, Unknowns]:
    """Add the energies of every frame to the normal equations."""
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


def move_joints(
    skeleton: Skeleton, shifts: Float[Array, "J 3"], rotation_vectors: Float[Array, "J 3"]
) -> Skeleton:
    """Shift the centres of a skeleton, metres, and right-multiply its orientations by rotations, radians."""
    orientations = rotation.normalise(
        rotation.multiply(skeleton.orientations, rotation.exp(rotation_vectors))
    )
    return eqx.tree_at(
        lambda s: (s.centres, s.orientations), skeleton, (skeleton.centres + shifts, orientations)
    )
