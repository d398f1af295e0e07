"""Poses, joint centres and marker positions in one problem: bundle adjustment with block-arrow equations."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...arguments import checked
from ...batched_map import map_batches
from ...body.body import pose_body
from ...body.pose import Pose
from ...body.retraction import retract
from ...energy.check_energies import UserTerms, sum_user_terms
from ...energy.energy import AbstractEnergy
from ...fit.frame_equations import frame_equations
from ...fit.linear_solvers.block_arrow import BlockArrow, Unknowns
from ...fit.linear_solvers.block_banded import BlockBanded
from ...fit.linearise import BodyTangent, body_tangent
from ...fit.sequences.poses_and_shared import AbstractPosesAndShared
from ...fit.solvers.descent import ConstrainedInfo, StepConstraints
from ...fit.solvers.equalities import Equalities
from ...fit.solvers.least_squares_problem import AbstractNestedProblem
from ..posture import posture_prior
from ..robust import OUTLIER_BOUND, UNBOUNDED, robust_kernel
from ..subject import Subject, marker_body, shift_markers
from .calibration_parameters import (
    AbstractTemplatePrior,
    TemplatePrior,
    equal_length_constraints,
    parameter_names,
    shift_subject,
)
from .prior_scales import ScaledGroups, scaled_groups
from .residuals import linearise_residuals, marker_residuals, residual_equations
from .rotation_prior import (
    RotationPrior,
    free_rotation_prior,
    rotation_prior_equations,
    rotation_prior_square,
)

#: information on every number of a pose, 1/radian² and 1/metre²: undetermined ones keep their values
RIDGE = 1.0
#: largest deviation of a marker, as a multiple of that of all markers
MAX_DEVIATION_RATIO = 10.0
#: number of frames that are linearised at once
BATCH_SIZE = 5


class CalibrationEstimate(eqx.Module):
    """All unknowns of a calibration.

    They are the poses of F frames; `s` of `jaxcap.markers.calibration.calibration_parameters`, from the
    template, metres; and the sliding of skin with each feature of a frame, metres a radian.
    """

    poses: Pose
    shared: Float[Array, "S"]
    slides: Float[Array, "K M 3"]


class CalibrationProblem(
    AbstractNestedProblem[CalibrationEstimate], AbstractPosesAndShared[CalibrationEstimate]
):
    """Find the subject and the poses that minimise robust squared marker residuals, in standard deviations.

    All frames share `s` of `jaxcap.markers.calibration.calibration_parameters`, then the slides. A marker's
    rest position is in its own residuals only, so that its columns are 3 x 3 blocks.

    - `deviations (M,)` of markers, metres; residuals beyond `outlier_bound` squared deviations have lower weights.
    - `rotation_prior` is the prior of rotations about axes that joints hardly rotate about.
    - `prior (S, S)` is the inverse covariance of `s` about the template, with the scales that `prior_groups` has found;
      `slide_deviations (K, M)` are those of the slides, metres a radian.
    - `frames_per_observation`: that many frames have the information on shared unknowns that one has with independent
      errors. Both priors of shared unknowns count that many times, which is the same as a likelihood with that share.
    - `frame_weights (F,)`: the observations of a frame count that many times, as those of a static pose do that is seen once
      but stands for many frames.
    - `max_deviation_ratio`: no marker has a larger deviation than this multiple of that of all.
    - `skin_features (F, M, K)`, radians, that the skin slides with.
    - `terms` are energies of a user's own, in every frame; they see the subject's skeleton, with the markers
      as vertices.
    - `joints` are those with unknown centres; `left_right_pairs` those with bones of equal length.
    """

    template: Subject
    positions: Float[Array, "F M 3"]
    seen: Bool[Array, "F M"]
    deviations: Float[Array, "M"]
    rotation_prior: RotationPrior
    prior: Float[Array, "S S"]
    prior_groups: ScaledGroups | None
    skin_features: Float[Array, "F M K"]
    slide_deviations: Float[Array, "K M"]
    frames_per_observation: Float[Array, ""]
    max_deviation_ratio: Float[Array, ""]
    outlier_bound: Float[Array, ""]
    frame_weights: Float[Array, "F"]
    terms: AbstractEnergy | None
    joints: tuple[int, ...] = eqx.field(static=True)
    left_right_pairs: tuple[tuple[int, int], ...] = eqx.field(static=True, default=())

    def subject(self, y: CalibrationEstimate) -> Subject:
        """Build the subject of an estimate."""
        return shift_subject(self.template, self.joints, y.shared)

    def value(self, y):
        return self._prior_value(y) + jnp.sum(
            map_batches(self._frame_cost(y), self._frame_inputs(y), BATCH_SIZE)
        )

    def retract(self, y, d: Unknowns):
        by_frame, shared = d
        count = len(self.prior)
        poses = jax.vmap(retract, (None, 0, 0))(self.template.skeleton, y.poses, by_frame)
        slides = y.slides + shared[count:].reshape(y.slides.shape)
        return CalibrationEstimate(poses, y.shared + shared[:count], slides)

    def scales(self) -> Unknowns:
        dtype, size = (
            self.positions.dtype,
            len(self.prior) + 3 * self.skin_features.shape[1] * self.skin_features.shape[2],
        )
        return jnp.ones((len(self.positions), self.template.skeleton.num_dofs), dtype), jnp.ones(size, dtype)

    def describe_constraints(self):
        return "bones of equal length" if self.left_right_pairs else None

    def information(self, y):
        return self._constrained(y, RIDGE)

    def _constrained(self, y: CalibrationEstimate, ridge: float) -> ConstrainedInfo:
        value, gradient, hessian = self.normal_equations(y, ridge)
        equalities = None
        if self.left_right_pairs:
            rows, violation = equal_length_constraints(self.subject(y), self.joints, self.left_right_pairs)
            equalities = Equalities(jnp.pad(rows, ((0, 0), (0, y.slides.size))), violation)
        constraints = StepConstraints(equalities=equalities)
        return ConstrainedInfo(value, gradient, hessian, constraints=constraints)  # pyright: ignore[reportCallIssue]

    def skeleton_of_poses(self):
        return self.template.skeleton

    def shared_names(self):
        return parameter_names(self.template, self.joints, self.skin_features.shape[2])

    def residual_variance(self, y: CalibrationEstimate, energy: Float[Array, ""]):
        return jnp.ones((), self.positions.dtype)

    def variance_inflation(self):
        return self.frames_per_observation

    def information_of_data(self, y):
        return self._constrained(y, 0.0)

    def improve_nested(self, y):
        """Take a step of each frame's pose by itself, where it lowers the energy.

        Valleys are curved, and steps along them become longer this way (Jeong and others, Pushing the
        Envelope of Modern Methods for Bundle Adjustment, 2012).
        """
        of_frame = self._frame_cost(y)
        matrices, sides = self.pose_equations(y)
        steps = BlockBanded(matrices[:, None]).factorise().solve(-sides)

        def improve(frame, step):
            pose = frame[0]
            moved = retract(self.template.skeleton, pose, step)
            better = of_frame((moved, *frame[1:])) < of_frame(frame)
            return jax.tree.map(lambda new, old: jnp.where(better, new, old), moved, pose)

        frames = self._frame_inputs(y)
        poses = map_batches(lambda x: improve(*x), (frames, steps), BATCH_SIZE)
        return CalibrationEstimate(poses, y.shared, y.slides)

    def shared_covariance(self, y: CalibrationEstimate) -> Float[Array, "S S"]:
        """Compute the posterior covariance of all shared unknowns, from the normal equations at `y`.

        Bones of equal length (`left_right_pairs`) are not taken into account.
        """
        factor = self.normal_equations(y)[2].factorise().shared
        size = len(self.prior) + y.slides.size
        found = self.frames_per_observation * factor.solve(jnp.eye(size, dtype=self.prior.dtype))
        return (found + found.T) / 2

    def pose_equations(self, y: CalibrationEstimate) -> tuple[Float[Array, "F D D"], Float[Array, "F D"]]:
        """Compute `J^T J` and `J^T r` of each frame with respect to its own pose, all else fixed."""
        subject = self.subject(y)

        def of_frame(frame):
            pose, place, visible, phi, weight = frame
            _, side, matrix = residual_equations(
                apply_sliding(subject, y.slides, phi),
                pose,
                place,
                lambda residual: self.root_weights_and_cost(residual, visible, weight)[0] ** 2,
            )
            prior_matrix, prior_side = rotation_prior_equations(subject.skeleton, self.rotation_prior, pose)
            matrix, side = (
                matrix + prior_matrix + RIDGE * jnp.eye(len(side), dtype=side.dtype),
                side + prior_side,
            )
            if self.terms is not None:
                _, own_side, own_matrix = frame_equations(self.terms, marker_body(subject), pose)
                matrix, side = matrix + own_matrix, side + own_side
            return matrix, side

        return map_batches(of_frame, self._frame_inputs(y), BATCH_SIZE)

    def normal_equations(
        self, y: CalibrationEstimate, ridge: float = RIDGE
    ) -> tuple[Float[Array, ""], Unknowns, BlockArrow]:
        """Sum `|r|^2 / 2`, `J^T r` and `J^T J` over batches of frames, with the information `ridge` on every number of a pose."""
        subject, markers, kinds = self.subject(y), self.template.num_markers, 1 + self.skin_features.shape[2]
        skeleton = subject.skeleton
        dofs, centres = skeleton.num_dofs, 3 * len(self.joints)
        tangent = self._term_tangent(y)

        def of_frame(frame):
            pose, place, visible, phi, weight = frame
            rows = linearise_residuals(apply_sliding(subject, y.slides, phi), pose, place, self.joints)
            root, cost = self.root_weights_and_cost(rows.residual, visible, weight)
            r, ends = rows.residual * root[:, None], rows.by_offset * root[:, None, None]
            wide = jnp.concatenate([rows.by_pose, rows.by_centres], 2) * root[:, None, None]
            shares = jnp.concatenate([jnp.ones((markers, 1), phi.dtype), phi], 1)
            flat = wide.reshape(3 * markers, -1)
            gram = flat.T @ flat
            # every row times the 3 x 3 block of its marker
            across = jnp.einsum("mrn,mra->nma", wide, ends)
            across = jnp.einsum("nma,mt->ntma", across, shares).reshape(gram.shape[0], -1)
            squares = jnp.einsum("mra,mrb,mt,mu->tumab", ends, ends, shares, shares)
            by_own = jnp.einsum("mra,mr,mt->tma", ends, r, shares).reshape(-1)
            pull = flat.T @ r.reshape(-1)
            matrix, side = rotation_prior_equations(skeleton, self.rotation_prior, pose)
            frame_matrix = gram[:dofs, :dofs] + matrix + ridge * jnp.eye(dofs, dtype=r.dtype)
            frame_side, coupling = pull[:dofs] + side, jnp.concatenate([gram[:dofs, dofs:], across[:dofs]], 1)
            value = cost + 0.5 * rotation_prior_square(self.rotation_prior, pose)
            summed = value, gram[dofs:, dofs:], across[dofs:], squares, jnp.append(pull[dofs:], by_own)
            return (frame_matrix, coupling, frame_side), summed

        def add(total, frames):
            per_frame, summed = jax.vmap(of_frame)(frames)
            return jax.tree.map(lambda a, b: a + jnp.sum(b, 0), total, summed), per_frame

        dtype, size = self.positions.dtype, centres + 3 * markers * kinds
        none = (
            jnp.zeros((), dtype),
            jnp.zeros((centres, centres), dtype),
            jnp.zeros((centres, 3 * markers * kinds), dtype),
            jnp.zeros((kinds, kinds, markers, 3, 3), dtype),
            jnp.zeros(size, dtype),
        )
        with jax.default_matmul_precision("highest"):
            total, per_frame = _scan_batches(add, none, self._frame_inputs(y))
            value, corner, across, squares, side = total
            blocks, coupling, sides = per_frame
            marker = jnp.arange(markers)
            ends = jnp.zeros((kinds, markers, 3, kinds, markers, 3), dtype)
            # the one index of both picked axes comes first
            ends = ends.at[:, marker, :, :, marker, :].set(jnp.transpose(squares, (2, 0, 3, 1, 4)))
            shared = jnp.block([[corner, across], [across.T, ends.reshape(size - centres, size - centres)]])
            arrow, gradient = BlockArrow(BlockBanded(blocks[:, None]), coupling, shared), (sides, side)
            if self.terms is not None:
                more, others, theirs = self._term_equations(y, tangent)
                value, gradient = value + more, jax.tree.map(jnp.add, gradient, others)
                arrow = jax.tree.map(jnp.add, arrow, theirs)
            return self._with_priors(y, value, gradient, arrow)

    def _with_priors(self, y, value, gradient: Unknowns, arrow: BlockArrow):
        prior, stiff = self.frames_per_observation * self.prior, self._slide_precision()
        count = len(prior)
        pull = jnp.concatenate([prior @ y.shared, stiff * y.slides.reshape(-1)])
        firm = jnp.diag(jnp.concatenate([jnp.zeros(count, stiff.dtype), stiff])).at[:count, :count].set(prior)
        shared = eqx.tree_at(lambda a: a.shared, arrow, arrow.shared + firm)
        return value + self._prior_value(y), (gradient[0], gradient[1] + pull), shared

    def _prior_value(self, y: CalibrationEstimate) -> Float[Array, ""]:
        away = y.shared
        bones = self.frames_per_observation * (away @ self.prior @ away)
        return 0.5 * (bones + self._slide_precision() @ y.slides.reshape(-1) ** 2)

    def _slide_precision(self) -> Float[Array, "Z"]:
        """Compute the precision of each number of the slides."""
        return self.frames_per_observation * jnp.repeat(self.slide_deviations.reshape(-1), 3) ** -2.0

    def _frame_inputs(self, y: CalibrationEstimate):
        return y.poses, self.positions, self.seen, self.skin_features, self.frame_weights

    def root_weights_and_cost(
        self,
        residual: Float[Array, "M 3"],
        seen: Bool[Array, "M"],
        frame_weight: Float[Array, ""] | float = 1.0,
    ):
        """Compute the square root of each marker's weight in a frame, and half of the robust cost of all."""
        information = jnp.where(seen, self.template.weights / self.deviations**2, 0.0)
        costs, slopes = robust_kernel(jnp.sum(residual**2, 1) * information, self.outlier_bound)
        positive = information > 0
        counted = frame_weight * slopes * information
        root = jnp.where(positive, jnp.sqrt(jnp.where(positive, counted, 1.0)), 0.0)
        return root, 0.5 * frame_weight * jnp.sum(jnp.where(seen, costs, 0.0))

    def _frame_cost(self, y: CalibrationEstimate):
        subject = self.subject(y)
        body = marker_body(subject)

        def cost(frame):
            pose, place, visible, phi, weight = frame
            value = self.root_weights_and_cost(
                marker_residuals(apply_sliding(subject, y.slides, phi), pose, place), visible, weight
            )[1]
            value = value + 0.5 * rotation_prior_square(self.rotation_prior, pose)
            if self.terms is None:
                return value
            r = self.terms.residual(pose_body(body, pose))
            return value + 0.5 * (r @ r)

        return cost

    def _term_tangent(self, y: CalibrationEstimate) -> BodyTangent | None:
        if self.terms is None:
            return None
        return body_tangent(
            self._body_function(y), marker_body(self.subject(y)), len(self.prior) + y.slides.size
        )

    def _body_function(self, y: CalibrationEstimate):
        return lambda s: marker_body(
            shift_subject(self.template, self.joints, y.shared + s[: len(self.prior)])
        )

    def _term_equations(self, y: CalibrationEstimate, tangent: BodyTangent | None):
        terms: Any = self.terms
        dofs, body = self.template.skeleton.num_dofs, marker_body(self.subject(y))

        def of_frame(total, pose):
            value, side, matrix = frame_equations(terms, body, pose, self._body_function(y), tangent)
            total = jax.tree.map(jnp.add, total, (value, side[dofs:], matrix[dofs:, dofs:]))
            return total, (matrix[:dofs, :dofs], matrix[:dofs, dofs:], side[:dofs])

        shared = self.scales()[1]
        none = (
            jnp.zeros((), shared.dtype),
            jnp.zeros_like(shared),
            jnp.zeros((len(shared), len(shared)), shared.dtype),
        )
        (value, side, matrix), (blocks, coupling, sides) = jax.lax.scan(of_frame, none, y.poses)
        return value, (sides, side), BlockArrow(BlockBanded(blocks[:, None]), coupling, matrix)


@checked
def make_calibration_problem(
    template: Subject,
    positions: Float[Array, "F M 3"],
    seen: Bool[Array, "F M"],
    joints: tuple[int, ...],
    left_right_pairs: tuple[tuple[int, int], ...] = (),
    template_prior: AbstractTemplatePrior = TemplatePrior(),
    *,
    robust: bool = True,
    terms: UserTerms = (),
) -> CalibrationProblem:
    """Build a problem about a template, with its deviations, free rotations and skin that does not slide."""
    dtype = positions.dtype
    found = template_prior.groups(template, joints)
    groups = None if found is None else scaled_groups(found, dtype)
    prior = template_prior.precision(template, joints) if groups is None else groups.precision()
    return CalibrationProblem(
        template,
        positions,
        seen,
        template.deviations,
        free_rotation_prior(template.skeleton),
        jnp.asarray(prior, dtype),
        groups,
        jnp.zeros((*seen.shape, 0), dtype),
        jnp.zeros((0, template.num_markers), dtype),
        jnp.ones((), dtype),
        jnp.asarray(MAX_DEVIATION_RATIO, dtype),
        jnp.asarray(OUTLIER_BOUND if robust else UNBOUNDED, dtype),
        jnp.ones(len(positions), dtype),
        posture_prior(template, sum_user_terms("make_calibration_problem", terms, marker_body(template))),
        joints,
        left_right_pairs,
    )


def apply_sliding(subject: Subject, slides: Float[Array, "K M 3"], phi: Float[Array, "M K"]) -> Subject:
    """Shift the markers of a subject by the skin sliding of one frame."""
    return shift_markers(subject, jnp.einsum("mk,kma->ma", phi, slides))


def _scan_batches(add, initial, frames):
    """Scan over batches of frames with the largest size that divides their number."""
    count = jax.tree.leaves(frames)[0].shape[0]
    size = max(number for number in range(1, BATCH_SIZE + 1) if count % number == 0)
    batches = jax.tree.map(lambda leaf: leaf.reshape(count // size, size, *leaf.shape[1:]), frames)
    total, per_frame = jax.lax.scan(add, initial, batches)
    return total, jax.tree.map(lambda leaf: leaf.reshape(count, *leaf.shape[2:]), per_frame)
