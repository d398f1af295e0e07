"""Adaptation of rest vertices to the pairs of many frames, with a shape prior (Adaptation, 4.1.3).

Poses and joints can be adapted in the same step (4.1.4: "a huge sparse equation system"). The unknowns are
every frame's pose, the coefficients of modes, which move joints, and the shifts of all rest vertices. Frames
are coupled only through shared unknowns. Vertices are coupled if they share a pair or are at most two edges
apart.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Float, Int

from ...arguments import checked
from ...body.body import Body, pose_body
from ...body.pose import Pose
from ...energy.data.pairs import PairDistances, PointPairs, corner_directions
from ...fit.free_surface.vertex_couplings import Couplings, add_pairs, find_couplings, no_equations
from ...fit.linear_solvers.sparse_blocks import BorderedMatrix, SparseBlocks
from ...fit.linearise import frame_jacobian, vertex_maps
from ...fit.sequences.sequence_problem import SequenceEstimate, SequenceProblem
from ...fit.solvers.descent import ConstrainedInfo, NormalDescent
from ...fit.solvers.least_squares_problem import AbstractProblem
from ...fit.solvers.minimise import take_step
from .shape_prior import ShapePrior

#: damping of a step on all unknowns, as a share of each curvature
DAMPING = 1e-3


class ShapeTerm(eqx.Module):
    """A `ShapePrior` as arrays, with its couplings and weights."""

    #: the Laplacian's rows, columns and values
    rows: Int[Array, "N"]
    columns: Int[Array, "N"]
    values: Float[Array, "N"]
    #: `L^T L`: its diagonal, and its entries above the diagonal by pairs of vertices
    diagonal: Float[Array, "V"]
    coupled_vertices: Int[Array, "E 2"]
    off_diagonal: Float[Array, "E"]
    poses: Pose
    vectors: Float[Array, "M V 3"]
    #: weight of squared changes of Laplacian vectors, mean over meshes, against the sum of squared distances
    weight: Float[Array, ""]
    #: weight of every vertex's squared shift, for parts that no scan shows
    shift_weight: Float[Array, ""]

    def laplacian(self, x: Float[Array, "V *k"]) -> Float[Array, "V *k"]:
        return _sparse_product(self.values, self.rows, self.columns, x)

    def transposed(self, x: Float[Array, "V *k"]) -> Float[Array, "V *k"]:
        return _sparse_product(self.values, self.columns, self.rows, x)


@checked
def adapt_shape(
    body: Body,
    poses: Pose,
    pairs: PointPairs,
    prior: ShapePrior,
    weight: float,
    shift_weight: float = 1e-4,
    tolerance: float = 1e-6,
) -> Body:
    """Adapt rest vertices to pairs and a shape prior by one sparse linear system.

    Minimise the pairs' squared distances, summed over frames, plus `weight` times the squared change of the
    Laplacian vectors, mean over the prior's poses.

    **Arguments:** `shift_weight`, a weak weight of every vertex's squared shift; `tolerance`, the residual at which
    conjugate gradients end, as a share of the right side.

    **Raises:** `ValueError` if two vertices of a pair share no edge.
    """
    shape = shape_term(body, prior, weight, shift_weight)
    limit = jnp.asarray(tolerance, body.vertices.dtype)
    step = _vertex_step(body, poses, pairs, _couplings(body, pairs), shape, limit)
    return eqx.tree_at(lambda b: b.vertices, body, body.vertices + step)


@checked
def adapt_together(
    problem: SequenceProblem,
    poses: Pose,
    pairs: PointPairs,
    prior: ShapePrior,
    weight: float | Float[Array, ""],
    shift_weight: float | Float[Array, ""] = 1e-4,
    tolerance: float = 1e-5,
) -> tuple[Body, Pose]:
    """Take one Gauss-Newton step on all poses, the coefficients of modes and all rest vertices.

    It replaces a step of `problem` followed by `adapt_shape`. Here the shape of the posed training meshes
    also depends on the joints (4.1.3).

    **Arguments:** `problem`, usually `shared_problem` with `joint_modes(body, move_surface=False)`, as
    vertices are free; `poses` and `pairs` stacked over frames; the others as in `adapt_shape`.

    It is differentiable with respect to all floating-point arrays, in forward and reverse mode: the iteration
    by the implicit function theorem, to its tolerance. The vertices of pairs must be concrete, so do not call
    it under `jit`; it is jitted inside.

    **Raises:** `ValueError` if two vertices of a pair share no edge.
    """
    body = problem.body
    dtype = body.vertices.dtype
    problem, poses, pairs = jax.tree.map(
        lambda leaf: leaf.astype(dtype) if eqx.is_inexact_array(leaf) else leaf, (problem, poses, pairs)
    )
    shape = shape_term(body, prior, weight, shift_weight)
    whole = SurfaceProblem(problem, pairs, _couplings(body, pairs), shape, jnp.asarray(tolerance, dtype))
    return _surface_step(whole, poses)


def shape_term(
    body: Body, prior: ShapePrior, weight: float | Float[Array, ""], shift_weight: float | Float[Array, ""]
) -> ShapeTerm:
    """Convert a shape prior to arrays."""
    dtype = body.vertices.dtype
    laplacian = scipy.sparse.coo_matrix(prior.laplacian)
    squared = scipy.sparse.csr_matrix(prior.laplacian.T @ prior.laplacian)
    above = scipy.sparse.triu(squared, 1, format="coo")
    return ShapeTerm(
        jnp.asarray(laplacian.row, jnp.int32),
        jnp.asarray(laplacian.col, jnp.int32),
        jnp.asarray(laplacian.data, dtype),
        jnp.asarray(squared.diagonal(), dtype),
        jnp.asarray(np.stack([above.row, above.col], 1), jnp.int32),
        jnp.asarray(above.data, dtype),
        jax.tree.map(lambda leaf: leaf.astype(dtype), prior.poses),
        jnp.asarray(prior.vectors, dtype),
        jnp.asarray(weight, dtype),
        jnp.asarray(shift_weight, dtype),
    )


class SurfaceEstimate(eqx.Module):
    """Poses and coefficients of modes, and a further shift of each rest vertex, metres."""

    sequence: SequenceEstimate
    shifts: Float[Array, "V 3"]


class SurfaceProblem(AbstractProblem[SurfaceEstimate]):
    """A sequence's problem extended by all rest vertices and a shape term.

    Of the terms of frames, only the distances of `pairs` depend on the vertices.
    """

    sequence: SequenceProblem
    pairs: PointPairs
    coupling: Couplings
    shape: ShapeTerm
    tolerance: Float[Array, ""]

    def body_at(self, y: SurfaceEstimate, d: Float[Array, "S"] | None = None) -> Body:
        """Build the body of an estimate, with its modes moved along a tangent if one is given."""
        body = self.sequence.body_at(y.sequence.values, d)
        return eqx.tree_at(lambda b: b.vertices, body, body.vertices + y.shifts)

    def retract(self, y: SurfaceEstimate, d: Any) -> SurfaceEstimate:
        return SurfaceEstimate(self.sequence.retract(y.sequence, d[:2]), y.shifts + d[2])

    def scales(self):
        return (*self.sequence.scales(), jnp.ones_like(self.sequence.body.vertices))

    def value(self, y: SurfaceEstimate) -> Float[Array, ""]:
        body = self.body_at(y)
        missing = jax.lax.map(
            lambda mesh: self.shape.laplacian(pose_body(body, mesh[0]).vertices) - mesh[1],
            (self.shape.poses, self.shape.vectors),
        )
        own = self.shape.weight * jnp.mean(jnp.sum(missing**2, (1, 2))) + self.shape.shift_weight * jnp.sum(
            y.shifts**2
        )
        return self._shifted_sequence(y).value(y.sequence) + 0.5 * own

    def information(self, y: SurfaceEstimate) -> ConstrainedInfo:
        body, there, shape = self.body_at(y), self._shifted_sequence(y), self.shape
        inner, (x, s) = there.information(y.sequence), there.scales()
        blocks, side = vertex_normal_equations(
            body, y.sequence.poses, self.pairs, self.coupling, shape, self.tolerance
        )
        tangent = there.body_tangent(y.sequence.values)
        dofs = body.skeleton.num_dofs

        def of_frame(total, frame):
            pose, pairs = frame
            _, rows = frame_jacobian(PairDistances(pairs), body, pose, None, tangent)
            pulled = jnp.einsum(
                "ckrb,crn->ckbn", _pair_jacobian(body, pose, pairs), rows.reshape(-1, 3, rows.shape[1])
            )
            coupled = jnp.zeros((*body.vertices.shape, rows.shape[1]), rows.dtype)
            coupled = coupled.at[pairs.vertices].add(pulled)
            return total + coupled[:, :, dofs:], jnp.moveaxis(coupled[:, :, :dofs], 2, 0)

        def of_mesh(total, mesh):
            pose, vectors = mesh
            maps, positions = vertex_maps(body, pose)
            slopes = jax.jacfwd(lambda d: pose_body(self.body_at(y, d), pose).vertices)(jnp.zeros_like(s))
            slopes, missing = shape.laplacian(slopes), shape.laplacian(positions) - vectors
            flat = slopes.reshape(-1, len(s))
            matrix, pull, border = total
            border = border + jnp.einsum("vba,vbk->vak", maps, shape.transposed(slopes))
            return (matrix + flat.T @ flat, pull + flat.T @ missing.reshape(-1), border), None

        border = jnp.zeros((*body.vertices.shape, len(s)), s.dtype)
        # recomputed in reverse mode, to save the memory of all pairs' rows
        border, by_frame = jax.lax.scan(jax.checkpoint(of_frame), border, (y.sequence.poses, self.pairs))
        none = jnp.zeros((len(s), len(s)), s.dtype), jnp.zeros_like(s), jnp.zeros_like(border)
        sums, _ = jax.lax.scan(of_mesh, none, (shape.poses, shape.vectors))
        matrix, pull, rough = jax.tree.map(lambda leaf: shape.weight / len(shape.vectors) * leaf, sums)
        arrow: Any = inner.hessian
        arrow = eqx.tree_at(lambda a: a.shared, arrow, arrow.shared + matrix * s[:, None] * s)
        hessian = BorderedMatrix(
            arrow, by_frame * x[:, :, None, None], jnp.moveaxis((border + rough) * s, 2, 0), blocks
        )
        gradient = inner.grad[0], inner.grad[1] + s * pull, shape.shift_weight * y.shifts - side
        return ConstrainedInfo(self.value(y), gradient, hessian, constraints=inner.constraints)  # pyright: ignore[reportCallIssue]

    def _shifted_sequence(self, y: SurfaceEstimate) -> SequenceProblem:
        """Return the sequence's problem with the shifted vertices."""
        shifted = self.sequence.body.vertices + y.shifts
        return eqx.tree_at(lambda p: p.body.vertices, self.sequence, shifted)


@eqx.filter_jit
def _surface_step(problem: SurfaceProblem, poses: Pose) -> tuple[Body, Pose]:
    start = SurfaceEstimate(problem.sequence.start(poses), jnp.zeros_like(problem.sequence.body.vertices))
    found = take_step(problem, start, NormalDescent(relative=True), DAMPING)
    return problem.body_at(found), found.sequence.poses


@eqx.filter_jit
def _vertex_step(
    body: Body,
    poses: Pose,
    pairs: PointPairs,
    coupling: Couplings,
    shape: ShapeTerm,
    tolerance: Float[Array, ""],
) -> Float[Array, "V 3"]:
    matrix, side = vertex_normal_equations(body, poses, pairs, coupling, shape, tolerance)
    return matrix.factorise().solve(side)


def vertex_normal_equations(
    body: Body,
    poses: Pose,
    pairs: PointPairs,
    coupling: Couplings,
    shape: ShapeTerm,
    tolerance: Float[Array, ""],
) -> tuple[SparseBlocks, Float[Array, "V 3"]]:
    """Assemble the normal equations of rest vertices from frames, training meshes and the weight of shifts.

    Return the sparse matrix and the right side.
    """
    count = len(body.vertices)

    def of_frame(total, frame):
        pose, pairs, slots = frame
        rows = _pair_jacobian(body, pose, pairs)
        differences = PairDistances(pairs).residual(pose_body(body, pose)).reshape(-1, 3)
        return add_pairs(total, rows, differences, pairs.vertices, slots), None

    def of_mesh(total, mesh):
        pose, vectors = mesh
        own, across, side = total
        maps, positions = vertex_maps(body, pose)
        missing = vectors - shape.laplacian(positions)
        first, second = shape.coupled_vertices.T
        own = own + jnp.einsum("v,vba,vbc->vac", shape.diagonal, maps, maps)
        across = across + jnp.einsum("e,eba,ebc->eac", shape.off_diagonal, maps[first], maps[second])
        return (own, across, side + jnp.einsum("vba,vb->va", maps, shape.transposed(missing))), None

    zero = no_equations(coupling, count, body.vertices.dtype)
    found, _ = jax.lax.scan(of_frame, zero, (poses, pairs, coupling.block_indices))
    blocks, side = found.blocks, found.side
    none = (
        zero.blocks[:count],
        jnp.zeros((len(shape.coupled_vertices), 3, 3), side.dtype),
        zero.side,
    )
    sums, _ = jax.lax.scan(of_mesh, none, (shape.poses, shape.vectors))
    own, across, pull = jax.tree.map(lambda leaf: shape.weight / len(shape.vectors) * leaf, sums)
    own = blocks[:count] + own + shape.shift_weight * jnp.eye(3, dtype=side.dtype)
    matrix = SparseBlocks(
        own,
        jnp.concatenate([coupling.edges, shape.coupled_vertices]),
        jnp.concatenate([blocks[count:], across]),
        tolerance,
    )
    return matrix, side + pull


def _couplings(body: Body, pairs: PointPairs) -> Couplings:
    return find_couplings(np.asarray(body.faces), len(body.vertices), pairs)


def _pair_jacobian(body: Body, pose: Pose, pairs: PointPairs) -> Float[Array, "C K R 3"]:
    """Compute the Jacobian of the pairs' residuals with respect to the rest positions of their vertices."""
    maps, _ = vertex_maps(body, pose)
    return jnp.einsum("ckra,ckab->ckrb", corner_directions(pairs), maps[pairs.vertices])


def _sparse_product(values, rows, columns, x):
    return jax.ops.segment_sum(values.reshape(-1, *[1] * (x.ndim - 1)) * x[columns], rows, len(x))
