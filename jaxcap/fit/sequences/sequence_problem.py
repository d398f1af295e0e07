"""Many frames and their shared unknowns as one least-squares problem, linearised frame by frame."""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...arguments import check_fields
from ...body.body import Body, pose_body
from ...body.pose import Pose, rest_pose
from ...body.retraction import project, retract
from ...body.symmetry import length_differences
from ...energy.energy import AbstractEnergy
from ...energy.stacked import AbstractNeighbourEnergy, AbstractSharedEnergy, join_frame, split_frames
from ...limits.rotation_vector_boxes import BoxChart, PoseBoxes, make_box_chart, retract_within
from ..frame_equations import frame_equations
from ..linear_solvers.block_arrow import BlockArrow
from ..linear_solvers.block_banded import BlockBanded
from ..linearise import BodyTangent, body_tangent
from ..pose_problem import pose_scales
from ..solvers.descent import ConstrainedInfo, StepConstraints
from ..solvers.equalities import Equalities
from .neighbours import window_equations, window_residuals
from .poses_and_shared import AbstractPosesAndShared
from .unknowns import AbstractUnknown, make_body, split_tangent

#: iterations that make mirrored bones equally long
EQUALISING_ITERATIONS = 8


class SequenceEstimate(eqx.Module):
    """Poses stacked over frames, and a value for each shared unknown by its name."""

    poses: Pose
    values: dict[str, Any]


#: tangents of all frames `(F, D)`, and of the shared unknowns `(S,)`
SequenceTangent = tuple[Float[Array, "F D"], Float[Array, "S"]]


class SequenceProblem(AbstractPosesAndShared[SequenceEstimate]):
    """The problem of finding the poses of F frames, and their shared unknowns, that minimise a sum of
    energies.

    - `frames` is summed over all frames. Terms within `Stacked` have separate data for each frame, terms
      within `FrameWeighted` a weight; any other term is the same in every frame.
    - `between` are energies of successive frames, `times (F,)` apart.
    - `shared` are energies of the body itself, evaluated at its rest pose, and of the shared values.
    - `unknowns` by name: parameters that change `body` in all frames at once. Without any, only poses are
      unknown.
    - `boxes` are hard: poses stay within. Their tangents are then coordinates of the boxes' charts.
    - `fixed` frames keep their poses.
    - `left_right_pairs`: pairs of joints with bones of equal length, kept exactly to first order.

    Normal equations are block-arrow, and block-banded among coupled frames: time and memory are linear in the
    number of frames. No array of the size frames by rows by unknowns is stored.
    """

    body: Body
    frames: AbstractEnergy
    times: Float[Array, "F"]
    unknowns: dict[str, AbstractUnknown] = eqx.field(default_factory=dict)
    between: tuple[AbstractNeighbourEnergy, ...] = ()
    shared: tuple[AbstractEnergy | AbstractSharedEnergy, ...] = ()
    boxes: PoseBoxes | None = None
    fixed: Bool[Array, "F"] | None = None
    left_right_pairs: tuple[tuple[int, int], ...] = eqx.field(static=True, default=())

    def __check_init__(self):
        check_fields(self)

    @property
    def num_frames(self) -> int:
        return self.times.shape[0]

    @property
    def num_shared(self) -> int:
        """S, the number of shared scalar unknowns."""
        return sum(unknown.size(self.body) for unknown in self.unknowns.values())

    def body_at(self, values: dict[str, Any], d: Float[Array, "S"] | None = None) -> Body:
        """Make the body of shared values, moved along a tangent if given."""
        if d is not None:
            values = self._retract_values(values, d)
        return make_body(self.body, self.unknowns, values)

    def start(self, poses: Pose) -> SequenceEstimate:
        """Make the start from poses, projected onto joints' types and boxes, and the unchanged body."""

        def allowed(pose: Pose) -> Pose:
            pose = project(self.body.skeleton, pose)
            return pose if self.boxes is None else self.boxes.project(self.body.skeleton, pose)

        values = {name: unknown.start(self.body) for name, unknown in self.unknowns.items()}
        return SequenceEstimate(jax.vmap(allowed)(poses), values)

    def retract(self, y: SequenceEstimate, d: SequenceTangent) -> SequenceEstimate:
        # types and axes of joints are those of the body, for all shared values
        skeleton = self.body.skeleton
        if self.boxes is None:
            poses = jax.vmap(retract, (None, 0, 0))(skeleton, y.poses, d[0])
        else:
            move = jax.vmap(retract_within, (None, None, 0, 0, 0))
            poses = move(self.boxes, skeleton, y.poses, self.charts(y.poses), d[0])
        fixed = self.fixed
        if fixed is not None:
            # exactly, to the last bit
            poses = jax.tree.map(
                lambda new, old: jnp.where(fixed.reshape(-1, *[1] * (new.ndim - 1)), old, new), poses, y.poses
            )
        return SequenceEstimate(poses, self._retract_values(y.values, d[1]))

    def scales(self) -> SequenceTangent:
        own = pose_scales(self.body.skeleton)
        shared = [self.unknowns[name].scales(self.body) for name in sorted(self.unknowns)]
        shared = jnp.concatenate([jnp.zeros(0, own.dtype), *shared])
        return jnp.broadcast_to(own, (self.num_frames, len(own))), shared

    def value(self, y: SequenceEstimate) -> Float[Array, ""]:
        """Compute `|r|^2 / 2`, frame by frame."""
        body = self.body_at(y.values)
        own, same = split_frames(self.frames)

        def of_frame(total, frame):
            pose, arrays = frame
            r = join_frame(arrays, same).residual(pose_body(body, pose))
            return total + 0.5 * (r @ r), None

        # recomputed in reverse mode: the intermediate arrays of all frames need too much memory
        zero = jnp.zeros((), body.vertices.dtype)
        total, _ = jax.lax.scan(jax.checkpoint(of_frame), zero, (y.poses, own))
        for term in self.between:
            total = total + 0.5 * jnp.sum(window_residuals(term, body, y.poses, self.times) ** 2)
        for r in self._shared_residuals(y.values):
            total = total + 0.5 * (r @ r)
        return total

    def residual(self, y: SequenceEstimate) -> Float[Array, "R"]:
        """Compute all residuals: of the frames, between them, and of the shared values."""
        body = self.body_at(y.values)
        own, same = split_frames(self.frames)
        rows = [
            jax.vmap(lambda pose, arrays: join_frame(arrays, same).residual(pose_body(body, pose)))(
                y.poses, own
            )
        ]
        for term in self.between:
            rows.append(window_residuals(term, body, y.poses, self.times))
        return jnp.concatenate([r.reshape(-1) for r in rows] + self._shared_residuals(y.values))

    def linearise(self, y: SequenceEstimate):
        """Compute the residual and a dense Jacobian by `[x, s]`, for small problems and checks."""
        frames, dofs = self.num_frames, self.body.skeleton.num_dofs

        def moved(d):
            return self.residual(
                self.retract(y, (d[: frames * dofs].reshape(frames, dofs), d[frames * dofs :]))
            )

        zero = jnp.zeros(frames * dofs + self.num_shared, self.body.vertices.dtype)
        return moved(zero), jax.jacfwd(moved)(zero)

    def information(self, y: SequenceEstimate) -> ConstrainedInfo:
        value, gradient, hessian = self.normal_equations(y)
        x, s = self.scales()
        hessian = hessian.rescaled(x, s)
        scaled = x * gradient[0], s * gradient[1]
        return ConstrainedInfo(value, scaled, hessian, constraints=self._constraints(y))  # pyright: ignore[reportCallIssue]

    def normal_equations(self, y: SequenceEstimate) -> tuple[Float[Array, ""], SequenceTangent, BlockArrow]:
        """Sum `|r|^2 / 2`, `J^T r` and `J^T J` one frame at a time."""
        own, same = split_frames(self.frames)
        dofs, count, dtype = self.body.skeleton.num_dofs, self.num_shared, self.body.vertices.dtype
        body, tangent = self.body_at(y.values), self.body_tangent(y.values)
        body_at = partial(self.body_at, y.values) if count else None

        def of_frame(total, frame):
            pose, arrays = frame
            value, side, matrix = frame_equations(join_frame(arrays, same), body, pose, body_at, tangent)
            shared = value, side[dofs:], matrix[dofs:, dofs:]
            return jax.tree.map(jnp.add, total, shared), (
                matrix[:dofs, :dofs],
                matrix[:dofs, dofs:],
                side[:dofs],
            )

        none = jnp.zeros((), dtype), jnp.zeros(count, dtype), jnp.zeros((count, count), dtype)
        with jax.default_matmul_precision("highest"):
            total, (own_blocks, coupling, sides) = jax.lax.scan(of_frame, none, (y.poses, own))
            width = max([1, *(term.frames for term in self.between)])
            blocks = jnp.zeros((self.num_frames, width, dofs, dofs), dtype).at[:, 0].set(own_blocks)
            for term in self.between:
                banded = window_equations(term, partial(self.body_at, y.values), count, y.poses, self.times)
                number = term.frames
                windows = self.num_frames - number + 1
                for later in range(number):
                    here = slice(later, later + windows)
                    sides = sides.at[here].add(banded.gradients[:, later])
                    coupling = coupling.at[here].add(banded.coupling[:, later])
                    for before in range(later + 1):
                        blocks = blocks.at[here, before].add(banded.blocks[:, later, later - before])
                total = jax.tree.map(jnp.add, total, banded.total)
            rows, residual = self._shared_jacobian(y.values)
            own = 0.5 * (residual @ residual), rows.T @ residual, rows.T @ rows
            value, side, shared = jax.tree.map(jnp.add, total, own)
        arrow = BlockArrow(BlockBanded(blocks), coupling, shared)
        if self.boxes is not None:
            turn = self.charts(y.poses).basis
            arrow, sides = (
                arrow.change_variables(turn),
                jnp.einsum("fai,fa->fi", turn, sides, precision="highest"),
            )
        return value, (sides, side), arrow

    def skeleton_of_poses(self):
        return self.body.skeleton

    def shared_names(self):
        return tuple(
            f"{name}[{component}]"
            for name in sorted(self.unknowns)
            for component in self.unknowns[name].component_names(self.body)
        )

    def residual_variance(self, y: SequenceEstimate, energy: Float[Array, ""]):
        rows = jax.eval_shape(self.residual, y).shape[0]
        return energy / max(rows - self.num_frames * self.body.skeleton.num_dofs - self.num_shared, 1)

    def pose_bases(self, y: SequenceEstimate):
        return None if self.boxes is None else self.charts(y.poses).basis

    def _retract_values(self, values: dict[str, Any], d: Float[Array, "S"]) -> dict[str, Any]:
        parts = split_tangent(self.body, self.unknowns, d)
        return {name: unknown.retract(values[name], parts[name]) for name, unknown in self.unknowns.items()}

    def body_tangent(self, values: dict[str, Any]) -> BodyTangent | None:
        """Differentiate the body by the shared unknowns."""
        if not self.num_shared:
            return None
        return body_tangent(partial(self.body_at, values), self.body_at(values), self.num_shared)

    def charts(self, poses: Pose) -> BoxChart:
        """Make the charts of the boxes about poses; `boxes` are given."""
        assert self.boxes is not None
        return jax.vmap(make_box_chart, (None, None, 0))(self.boxes, self.body.skeleton, poses)

    def project_feasible(self, y: SequenceEstimate) -> SequenceEstimate:
        """Clip shared values to the bounds of their unknowns, and make mirrored bones equally long by the
        least change.
        """

        def inside(name: str, value: Any) -> Any:
            ends = self.unknowns[name].bounds(value)
            return (
                value
                if ends is None
                else self.unknowns[name].retract(value, jnp.clip(jnp.zeros_like(ends[0]), *ends))
            )

        values = {name: inside(name, value) for name, value in y.values.items()}
        if self.left_right_pairs:
            s = self.scales()[1]

            def equalise(_, values):
                return self._retract_values(
                    values, s * Equalities(*self._equalities(values)).minimum_norm_solution()
                )

            values = jax.lax.fori_loop(0, EQUALISING_ITERATIONS, equalise, values)
        return SequenceEstimate(y.poses, values)

    def describe_constraints(self):
        bounded = [
            name
            for name in sorted(self.unknowns)
            if self.unknowns[name].bounds(self.unknowns[name].start(self.body))
        ]
        names = [f"bounds of the unknown '{name}'" for name in bounded]
        names += ["pose boxes"] * (self.boxes is not None) + ["bones of equal length"] * bool(
            self.left_right_pairs
        )
        return " and ".join(names) or None

    def _constraints(self, y: SequenceEstimate) -> StepConstraints | None:
        low, high = self._bounds(y)
        equalities = Equalities(*self._equalities(y.values)) if self.left_right_pairs else None
        return None if low is None and equalities is None else StepConstraints(low, high, equalities)

    def _equalities(self, values: dict[str, Any]) -> tuple[Float[Array, "C S"], Float[Array, "C"]]:
        """Linearise the length differences of mirrored bones; the values are their negative residuals."""
        body, tangent = self.body_at(values), self.body_tangent(values)
        assert tangent is not None
        differences, by_centre = length_differences(body.skeleton, self.left_right_pairs)
        rows = jnp.einsum("bja,jas->bs", by_centre, tangent.centres)
        return rows * self.scales()[1], -differences

    def _bounds(self, y: SequenceEstimate) -> tuple[SequenceTangent, SequenceTangent] | tuple[None, None]:
        x, s = self.scales()
        names = sorted(self.unknowns)
        bounds = [self.unknowns[name].bounds(y.values[name]) for name in names]
        if self.boxes is None and self.fixed is None and not any(bounds):
            return None, None
        low, high = jnp.full_like(x, -jnp.inf), jnp.full_like(x, jnp.inf)
        if self.boxes is not None:
            charts = self.charts(y.poses)
            low, high = charts.lower / x, charts.upper / x
        if self.fixed is not None:
            low, high = (jnp.where(self.fixed[:, None], 0.0, end) for end in (low, high))
        free = [
            ends or (jnp.full(size, -jnp.inf), jnp.full(size, jnp.inf))
            for ends, size in zip(
                bounds, (self.unknowns[name].size(self.body) for name in names), strict=True
            )
        ]
        none = jnp.zeros(0, s.dtype)
        least, most = (jnp.concatenate([none, *(ends[i] for ends in free)]) / s for i in range(2))
        return (low, least), (high, most)

    def _shared_residuals(self, values: dict[str, Any]) -> list[Float[Array, "R"]]:
        body = self.body_at(values)
        posed = pose_body(body, rest_pose(body.skeleton))
        return [
            term.residual(values, posed) if isinstance(term, AbstractSharedEnergy) else term.residual(posed)
            for term in self.shared
        ]

    def _shared_jacobian(self, values) -> tuple[Float[Array, "R S"], Float[Array, "R"]]:
        def moved(d):
            r = jnp.concatenate(
                [jnp.zeros(0, d.dtype), *self._shared_residuals(self._retract_values(values, d))]
            )
            return r, r

        return jax.jacfwd(moved, has_aux=True)(jnp.zeros(self.num_shared, self.body.vertices.dtype))
