"""Many frames and what they share as one least-squares problem, linearised frame by frame."""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..body.body import Body, Posed, pose_body
from ..body.pose import Pose, project, rest_pose, retract
from ..body.pose_boxes import BoxChart, PoseBoxes, box_chart, move_within
from ..body.symmetry import length_differences
from ..energy.stacked import AbstractNeighbourEnergy, AbstractSharedEnergy, join_frame, split_frames
from ..energy.term import AbstractEnergy
from .frame_equations import frame_equations
from .linearise import BodyTangent, body_tangent
from .problem import pose_scales
from .solvers.block_arrow import BlockArrow
from .solvers.block_banded import BlockBanded
from .solvers.descent import ConstrainedInfo, Constraints
from .solvers.equalities import Equalities
from .solvers.problem import AbstractProblem
from .unknowns import AbstractUnknown, make_body, split_tangent


class SequenceEstimate(eqx.Module):
    """Poses stacked over frames, and a value for each shared unknown by its name."""

    poses: Pose
    values: dict[str, Any]


#: tangents of all frames `(F, D)`, and of what they share `(S,)`
SequenceTangent = tuple[Float[Array, "F D"], Float[Array, "S"]]


class SequenceProblem(AbstractProblem[SequenceEstimate]):
    """Find the poses of F frames, and what they share, that make a sum of energies least.

    - `frames` is summed over all frames. Terms within `Stacked` have data of their own for each frame, terms within
      `WeighedFrames` a weight; any other term is the same in every frame.
    - `between` are energies of successive frames, `times (F,)` apart.
    - `shared` are energies of the body itself, evaluated at its rest pose, and of the shared values.
    - `unknowns` by name: what changes `body` in all frames at once. Without any, only poses are unknown.
    - `boxes` are hard: poses stay within. Their tangents are then numbers of the boxes' charts.
    - `held` frames keep their poses.
    - `mirrored`: pairs of joints whose bones are equally long, kept exactly to first order.

    Normal equations are block-arrow, and block-banded among the frames where these meet: time and memory grow with the
    number of frames. Nothing of the size frames by rows by unknowns is kept.
    """

    body: Body
    frames: AbstractEnergy
    times: Float[Array, "F"]
    unknowns: dict[str, AbstractUnknown] = eqx.field(default_factory=dict)
    between: tuple[AbstractNeighbourEnergy, ...] = ()
    shared: tuple[AbstractEnergy | AbstractSharedEnergy, ...] = ()
    boxes: PoseBoxes | None = None
    held: Bool[Array, "F"] | None = None
    mirrored: tuple[tuple[int, int], ...] = eqx.field(static=True, default=())

    @property
    def num_frames(self) -> int:
        return self.times.shape[0]

    @property
    def num_shared(self) -> int:
        """S, how many numbers the frames share."""
        return sum(unknown.size(self.body) for unknown in self.unknowns.values())

    def body_at(self, values: dict[str, Any], d: Float[Array, "S"] | None = None) -> Body:
        """Make the body of shared values, moved along a tangent where one is given."""
        if d is not None:
            values = self._moved(values, d)
        return make_body(self.body, self.unknowns, values)

    def start(self, poses: Pose) -> SequenceEstimate:
        """Start from poses, projected onto what the joints' kinds and the boxes allow, and the body as it is."""

        def allowed(pose: Pose) -> Pose:
            pose = project(self.body.skeleton, pose)
            return pose if self.boxes is None else self.boxes.nearest(self.body.skeleton, pose)

        values = {name: unknown.start(self.body) for name, unknown in self.unknowns.items()}
        return SequenceEstimate(jax.vmap(allowed)(poses), values)

    def retract(self, y: SequenceEstimate, d: SequenceTangent) -> SequenceEstimate:
        # kinds and axes of joints are those of the body, whatever is shared
        skeleton = self.body.skeleton
        if self.boxes is None:
            poses = jax.vmap(retract, (None, 0, 0))(skeleton, y.poses, d[0])
        else:
            move = jax.vmap(move_within, (None, None, 0, 0, 0))
            poses = move(self.boxes, skeleton, y.poses, self._charts(self.boxes, y.poses), d[0])
        held = self.held
        if held is not None:
            # to the last bit
            poses = jax.tree.map(
                lambda new, old: jnp.where(held.reshape(-1, *[1] * (new.ndim - 1)), old, new), poses, y.poses
            )
        return SequenceEstimate(poses, self._moved(y.values, d[1]))

    def scales(self) -> SequenceTangent:
        own = pose_scales(self.body.skeleton)
        shared = [self.unknowns[name].scales(self.body) for name in sorted(self.unknowns)]
        shared = jnp.concatenate([jnp.zeros(0, own.dtype), *shared])
        return jnp.broadcast_to(own, (self.num_frames, len(own))), shared

    def value(self, y: SequenceEstimate) -> Float[Array, ""]:
        """Compute `|r|^2 / 2`, frame after frame."""
        body = self.body_at(y.values)
        own, same = split_frames(self.frames)

        def of_frame(total, frame):
            pose, arrays = frame
            r = join_frame(arrays, same).residual(pose_body(body, pose))
            return total + 0.5 * (r @ r), None

        # made again in reverse mode: what all frames leave is too much to keep
        zero = jnp.zeros((), body.vertices.dtype)
        total, _ = jax.lax.scan(jax.checkpoint(of_frame), zero, (y.poses, own))
        for term in self.between:
            r = jax.lax.map(
                lambda window, term=term: _neighbour_residual(term, body, *window),
                self._windows(term, y.poses),
            )
            total = total + 0.5 * jnp.sum(r**2)
        for r in self._shared_residuals(y.values):
            total = total + 0.5 * (r @ r)
        return total

    def residual(self, y: SequenceEstimate) -> Float[Array, "R"]:
        """Write out all residuals: of the frames, between them, and of what is shared."""
        body = self.body_at(y.values)
        own, same = split_frames(self.frames)
        rows = [
            jax.vmap(lambda pose, arrays: join_frame(arrays, same).residual(pose_body(body, pose)))(
                y.poses, own
            )
        ]
        for term in self.between:
            windows = self._windows(term, y.poses)
            rows.append(
                jax.vmap(lambda *window, term=term: _neighbour_residual(term, body, *window))(*windows)
            )
        return jnp.concatenate([r.reshape(-1) for r in rows] + self._shared_residuals(y.values))

    def linearise(self, y: SequenceEstimate):
        """Write out the residual and a dense Jacobian by `[x, s]`: for small problems and checks."""
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
                banded = self._between_equations(term, y)
                number = term.frames
                windows = self.num_frames - number + 1
                for later in range(number):
                    here = slice(later, later + windows)
                    sides = sides.at[here].add(banded.sides[:, later])
                    coupling = coupling.at[here].add(banded.coupling[:, later])
                    for before in range(later + 1):
                        blocks = blocks.at[here, before].add(banded.blocks[:, later, later - before])
                total = jax.tree.map(jnp.add, total, banded.total)
            rows, residual = self._shared_rows(y.values)
            own = 0.5 * (residual @ residual), rows.T @ residual, rows.T @ rows
            value, side, shared = jax.tree.map(jnp.add, total, own)
        arrow = BlockArrow(BlockBanded(blocks), coupling, shared)
        if self.boxes is not None:
            turn = self._charts(self.boxes, y.poses).turn
            arrow, sides = arrow.turned(turn), jnp.einsum("fai,fa->fi", turn, sides, precision="highest")
        return value, (sides, side), arrow

    def _moved(self, values: dict[str, Any], d: Float[Array, "S"]) -> dict[str, Any]:
        parts = split_tangent(self.body, self.unknowns, d)
        return {name: unknown.retract(values[name], parts[name]) for name, unknown in self.unknowns.items()}

    def body_tangent(self, values: dict[str, Any]) -> BodyTangent | None:
        """Differentiate the body by what is shared."""
        if not self.num_shared:
            return None
        turns = any("orientations" in unknown.moves for unknown in self.unknowns.values())
        return body_tangent(partial(self.body_at, values), self.body_at(values), self.num_shared, turns)

    def _charts(self, boxes: PoseBoxes, poses: Pose) -> BoxChart:
        return jax.vmap(box_chart, (None, None, 0))(boxes, self.body.skeleton, poses)

    def _constraints(self, y: SequenceEstimate) -> Constraints | None:
        x, s = self.scales()
        bounds = {name: self.unknowns[name].bounds(y.values[name]) for name in sorted(self.unknowns)}
        if self.boxes is not None or self.held is not None or any(bounds.values()):
            low, high = jnp.full_like(x, -jnp.inf), jnp.full_like(x, jnp.inf)
            if self.boxes is not None:
                charts = self._charts(self.boxes, y.poses)
                low, high = charts.low / x, charts.high / x
            if self.held is not None:
                low, high = (jnp.where(self.held[:, None], 0.0, end) for end in (low, high))
            free = [
                bounds[name] or (jnp.full(size, -jnp.inf), jnp.full(size, jnp.inf))
                for name, size in ((name, self.unknowns[name].size(self.body)) for name in bounds)
            ]
            none = jnp.zeros(0, s.dtype)
            least, most = (jnp.concatenate([none, *(ends[i] for ends in free)]) / s for i in range(2))
            return Constraints((low, least), (high, most))
        if self.mirrored:
            body, tangent = self.body_at(y.values), self.body_tangent(y.values)
            assert tangent is not None
            differences, by_centre = length_differences(body.skeleton, self.mirrored)
            rows = jnp.einsum("bja,jas->bs", by_centre, tangent.centres) * s
            return Constraints(equalities=Equalities(rows, -differences))
        return None

    def _windows(self, term: AbstractNeighbourEnergy, poses: Pose):
        number, windows = term.frames, self.num_frames - term.frames + 1
        stacked = jax.tree.map(
            lambda leaf: jnp.stack([leaf[i : i + windows] for i in range(number)], 1), poses
        )
        gaps = jnp.diff(self.times)
        return stacked, jnp.stack([gaps[i : i + windows] for i in range(number - 1)], 1)

    def _between_equations(self, term: AbstractNeighbourEnergy, y: SequenceEstimate) -> "_WindowEquations":
        number, dofs, count = term.frames, self.body.skeleton.num_dofs, self.num_shared

        def of_window(total, window):
            poses, gaps = window

            def moved(d):
                body = self.body_at(y.values, d[number * dofs :])
                steps = d[: number * dofs].reshape(number, dofs)
                there = jax.vmap(retract, (None, 0, 0))(body.skeleton, poses, steps)
                r = _neighbour_residual(term, body, there, gaps)
                return r, r

            zero = jnp.zeros(number * dofs + count, self.body.vertices.dtype)
            rows, r = jax.jacfwd(moved, has_aux=True)(zero)
            mine, common = rows[:, : number * dofs].reshape(len(r), number, dofs), rows[:, number * dofs :]
            value, side, matrix = total
            total = value + 0.5 * (r @ r), side + common.T @ r, matrix + common.T @ common
            blocks = jnp.einsum("rai,rbj->abij", mine, mine)
            return total, (blocks, jnp.einsum("rai,rs->ais", mine, common), jnp.einsum("rai,r->ai", mine, r))

        dtype = self.body.vertices.dtype
        none = jnp.zeros((), dtype), jnp.zeros(count, dtype), jnp.zeros((count, count), dtype)
        total, (blocks, coupling, sides) = jax.lax.scan(of_window, none, self._windows(term, y.poses))
        return _WindowEquations(total, blocks, coupling, sides)

    def _shared_residuals(self, values: dict[str, Any]) -> list[Float[Array, "R"]]:
        body = self.body_at(values)
        posed = pose_body(body, rest_pose(body.skeleton))
        return [
            term.residual(values, posed) if isinstance(term, AbstractSharedEnergy) else term.residual(posed)
            for term in self.shared
        ]

    def _shared_rows(self, values) -> tuple[Float[Array, "R S"], Float[Array, "R"]]:
        def moved(d):
            r = jnp.concatenate([jnp.zeros(0, d.dtype), *self._shared_residuals(self._moved(values, d))])
            return r, r

        return jax.jacfwd(moved, has_aux=True)(jnp.zeros(self.num_shared, self.body.vertices.dtype))


class _WindowEquations(eqx.Module):
    """Normal equations of the windows of one energy, of `n` frames each."""

    #: value, right side and matrix of what is shared
    total: tuple[Float[Array, ""], Float[Array, "S"], Float[Array, "S S"]]
    blocks: Float[Array, "K n n D D"]
    coupling: Float[Array, "K n D S"]
    sides: Float[Array, "K n D"]


def _neighbour_residual(term: AbstractNeighbourEnergy, body: Body, poses: Pose, gaps: Float[Array, "W"]):
    each = [jax.tree.map(lambda leaf, i=i: leaf[i], poses) for i in range(term.frames)]
    posed: tuple[Posed, ...] = tuple(pose_body(body, pose) for pose in each)
    return term.residual(posed, gaps)
