"""Symmetric matrices of 3 x 3 blocks over vertices, and such matrices with a dense border.

Only vertices that share a pair or an edge are coupled, so that the blocks are stored as a list. Systems are
solved by conjugate gradients, with the diagonal blocks as preconditioner.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..solvers.equalities import Equalities
from .conjugate_gradients import conjugate_gradients
from .structured import AbstractFactor, AbstractStructuredMatrix

#: largest number of steps of conjugate gradients
MAX_STEPS = 2000


class SparseBlocks(AbstractStructuredMatrix):
    """A symmetric matrix over `e (V, 3)`: the diagonal blocks of vertices and the blocks of coupled pairs."""

    diagonal_blocks: Float[Array, "V 3 3"]
    #: each pair once; its block has the first vertex's rows and the second vertex's columns
    pairs: Int[Array, "E 2"]
    off_diagonal_blocks: Float[Array, "E 3 3"]
    #: relative residual at which conjugate gradients end
    tolerance: Float[Array, ""]

    def mv(self, vector: Float[Array, "V 3"]) -> Float[Array, "V 3"]:
        first, second = self.pairs.T
        with jax.default_matmul_precision("highest"):
            total = jnp.einsum("vab,vb->va", self.diagonal_blocks, vector)
            total = total.at[first].add(jnp.einsum("eab,eb->ea", self.off_diagonal_blocks, vector[second]))
            return total.at[second].add(jnp.einsum("eab,ea->eb", self.off_diagonal_blocks, vector[first]))

    def abs_mv(self, x: Float[Array, "V 3"]) -> Float[Array, "V 3"]:
        return SparseBlocks(
            jnp.abs(self.diagonal_blocks), self.pairs, jnp.abs(self.off_diagonal_blocks), self.tolerance
        ).mv(x)

    def restricted(self, free: Array) -> "SparseBlocks":
        one = jnp.eye(3, dtype=self.diagonal_blocks.dtype)
        own = (
            jnp.where(free[:, :, None] & free[:, None], self.diagonal_blocks, 0.0)
            + one * jnp.where(free, 0.0, 1.0)[:, None]
        )
        first, second = self.pairs.T
        across = jnp.where(free[first][:, :, None] & free[second][:, None], self.off_diagonal_blocks, 0.0)
        return SparseBlocks(own, self.pairs, across, self.tolerance)

    def in_structure(self):
        return jax.ShapeDtypeStruct(self.diagonal_blocks.shape[:2], self.diagonal_blocks.dtype)

    def diagonal(self) -> Float[Array, "V 3"]:
        return jnp.diagonal(self.diagonal_blocks, axis1=1, axis2=2)

    def add_diagonal(self, amounts: Float[Array, "V 3"]) -> "SparseBlocks":
        one = jnp.eye(3, dtype=self.diagonal_blocks.dtype)
        return eqx.tree_at(
            lambda s: s.diagonal_blocks, self, self.diagonal_blocks + amounts[:, :, None] * one
        )

    def factorise(self) -> "SparseFactor":
        return SparseFactor(self, jnp.linalg.inv(jax.lax.stop_gradient(self.diagonal_blocks)))


class SparseFactor(AbstractFactor):
    """The matrix with the inverses of its diagonal blocks."""

    matrix: SparseBlocks
    inverses: Float[Array, "V 3 3"]

    def precondition(self, rhs: Float[Array, "V 3"]) -> Float[Array, "V 3"]:
        return jnp.einsum("vab,vb->va", self.inverses, rhs)

    def solve(self, rhs: Float[Array, "V 3"], equalities: Equalities | None = None) -> Float[Array, "V 3"]:
        if equalities is not None:
            raise NotImplementedError("Equalities are not supported without shared unknowns.")
        tolerance = self.matrix.tolerance
        return conjugate_gradients(
            self.matrix.mv, rhs, self.precondition, tolerance=tolerance, max_steps=MAX_STEPS
        )


class BorderedMatrix(AbstractStructuredMatrix):
    """A symmetric matrix over `(x (F, D), s (S,), e (V, 3))`: an arrow over `(x, s)`, blocks over `e`, and
    their coupling.

    The arrow is eliminated. The Schur complement of the vertices is never formed: each of its products needs
    one solve with the arrow.
    """

    arrow: AbstractStructuredMatrix
    frames: Float[Array, "F D V 3"]
    shared: Float[Array, "S V 3"]
    vertices: SparseBlocks

    def mv(self, vector):
        x, s, e = vector
        inner = self.arrow.mv((x, s))
        outer = self._border_mv(e)
        return (
            inner[0] + outer[0],
            inner[1] + outer[1],
            self.vertices.mv(e) + self._border_transpose_mv((x, s)),
        )

    def abs_mv(self, x):
        absolute = jax.tree.map(jnp.abs, (self.frames, self.shared))
        rest = BorderedMatrix(self.arrow, absolute[0], absolute[1], self.vertices)
        inner, outer = self.arrow.abs_mv(x[:2]), rest._border_mv(x[2])
        return (
            inner[0] + outer[0],
            inner[1] + outer[1],
            self.vertices.abs_mv(x[2]) + rest._border_transpose_mv(x[:2]),
        )

    def restricted(self, free):
        x, s, e = free
        frames = jnp.where(x[:, :, None, None] & e, self.frames, 0.0)
        shared = jnp.where(s[:, None, None] & e, self.shared, 0.0)
        return BorderedMatrix(self.arrow.restricted((x, s)), frames, shared, self.vertices.restricted(e))

    def in_structure(self):
        return (*self.arrow.in_structure(), self.vertices.in_structure())

    def diagonal(self):
        return (*self.arrow.diagonal(), self.vertices.diagonal())

    def add_diagonal(self, amounts):
        x, s, e = amounts
        arrow, vertices = self.arrow.add_diagonal((x, s)), self.vertices.add_diagonal(e)
        return BorderedMatrix(arrow, self.frames, self.shared, vertices)

    def factorise(self) -> "BorderedFactor":
        return BorderedFactor(self, self.arrow.factorise(), self.vertices.factorise())

    def _border_mv(self, e):
        with jax.default_matmul_precision("highest"):
            return jnp.tensordot(self.frames, e, 2), jnp.tensordot(self.shared, e, 2)

    def _border_transpose_mv(self, known):
        x, s = known
        with jax.default_matmul_precision("highest"):
            return jnp.tensordot(x, self.frames, 2) + jnp.tensordot(s, self.shared, 1)


class BorderedFactor(AbstractFactor):
    """The factor of the arrow, and the preconditioner of the vertices."""

    matrix: BorderedMatrix
    arrow: AbstractFactor
    vertices: SparseFactor

    def solve(self, rhs, equalities: Equalities | None = None):
        x, s, e = rhs
        # any solution for (x, s) satisfies the equalities; those of the products are homogeneous
        still = None if equalities is None else Equalities(equalities.rows, jnp.zeros_like(equalities.values))

        def product(e):
            known = self.arrow.solve(self.matrix._border_mv(e), still)
            return self.matrix.vertices.mv(e) - self.matrix._border_transpose_mv(known)

        first = self.arrow.solve((x, s), equalities)
        left = e - self.matrix._border_transpose_mv(first)
        found = conjugate_gradients(
            product,
            left,
            self.vertices.precondition,
            tolerance=self.matrix.vertices.tolerance,
            max_steps=MAX_STEPS,
        )
        back = self.arrow.solve(self.matrix._border_mv(found), still)
        return first[0] - back[0], first[1] - back[1], found
