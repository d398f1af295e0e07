"""Symmetric matrices of 3 x 3 blocks over vertices, plus a sparse precision matrix that all three coordinates share.

A smoothness term couples many vertices, and no two coordinates. It is kept as an operator on fields, not as blocks;
its diagonal enters the preconditioner.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Bool, Float, Int

from ..solvers.equalities import Equalities
from .conjugate_gradients import conjugate_gradients
from .sparse_blocks import MAX_STEPS, SparseBlocks, SparseFactor
from .structured import AbstractFactor, AbstractStructuredMatrix


class PrecisionRoot(eqx.Module):
    """A square matrix `R` over vertices with the sparsity of a mesh's edges, the root of a precision `R^T R`."""

    #: the columns of each row, padded with the row's own
    columns: Int[Array, "V N"]
    #: entries of `R` and of `R^T` there; zero where padded
    values: Float[Array, "V N"]
    transposed: Float[Array, "V N"]
    #: the diagonal of `R^T R`
    diagonal: Float[Array, "V"]

    def residual(self, field: Float[Array, "V C"]) -> Float[Array, "V C"]:
        """Compute `R d`."""
        return self._product(self.values, field)

    def precision(self, field: Float[Array, "V C"]) -> Float[Array, "V C"]:
        """Compute `R^T R d`."""
        return self._product(self.transposed, self.residual(field))

    def scaled(self, factor: float) -> "PrecisionRoot":
        """Multiply `R` by a factor."""
        values, turned, diagonal = self.values, self.transposed, self.diagonal
        return PrecisionRoot(self.columns, factor * values, factor * turned, factor**2 * diagonal)

    def absolute(self) -> "PrecisionRoot":
        """Replace all entries by their absolute values."""
        return PrecisionRoot(self.columns, jnp.abs(self.values), jnp.abs(self.transposed), self.diagonal)

    def _product(self, values: Float[Array, "V N"], field: Float[Array, "V C"]) -> Float[Array, "V C"]:
        total = jnp.zeros_like(field)
        for k in range(self.columns.shape[1]):
            total = total + values[:, k, None] * field[self.columns[:, k]]
        return total


def make_precision_root(matrix: scipy.sparse.csr_array) -> PrecisionRoot:
    """Make the root of a sparse matrix with a symmetric pattern, stored with its transpose by rows of equal length."""
    matrix, turned = (part.tocsr() for part in (matrix, matrix.T))
    for part in (matrix, turned):
        part.sort_indices()
    counts = np.diff(matrix.indptr)
    count = len(counts)
    columns = np.tile(np.arange(count)[:, None], (1, int(counts.max(initial=1))))
    rows = np.repeat(np.arange(count), counts)
    slots = np.arange(len(rows)) - matrix.indptr[rows]
    columns[rows, slots] = matrix.indices
    values = np.zeros((2, *columns.shape))
    values[:, rows, slots] = matrix.data, turned.data
    diagonal = np.asarray(matrix.multiply(matrix).sum(0)).ravel()
    return PrecisionRoot(
        jnp.asarray(columns, jnp.int32), *(jnp.asarray(part, float) for part in (*values, diagonal))
    )


class RegularisedBlocks(AbstractStructuredMatrix):
    """A symmetric matrix over `e (V, 3)`: blocks, plus a precision matrix that acts on each coordinate."""

    blocks: SparseBlocks
    root: PrecisionRoot
    #: unknowns on which the precision acts
    free: Bool[Array, "V 3"]

    def mv(self, vector: Float[Array, "V 3"]) -> Float[Array, "V 3"]:
        return self.blocks.mv(vector) + self._smooth(self.root, vector)

    def abs_mv(self, x: Float[Array, "V 3"]) -> Float[Array, "V 3"]:
        return self.blocks.abs_mv(x) + self._smooth(self.root.absolute(), x)

    def restricted(self, free: Array) -> "RegularisedBlocks":
        return RegularisedBlocks(self.blocks.restricted(free), self.root, self.free & free)

    def in_structure(self):
        return self.blocks.in_structure()

    def diagonal(self) -> Float[Array, "V 3"]:
        return self.blocks.diagonal() + jnp.where(self.free, self.root.diagonal[:, None], 0.0)

    def add_diagonal(self, amounts: Float[Array, "V 3"]) -> "RegularisedBlocks":
        return RegularisedBlocks(self.blocks.add_diagonal(amounts), self.root, self.free)

    def factorise(self) -> "RegularisedFactor":
        own = jnp.where(self.free, self.root.diagonal[:, None], 0.0)
        return RegularisedFactor(self, self.blocks.add_diagonal(own).factorise())

    def _smooth(self, root: PrecisionRoot, vector: Float[Array, "V 3"]) -> Float[Array, "V 3"]:
        return jnp.where(self.free, root.precision(jnp.where(self.free, vector, 0.0)), 0.0)


class RegularisedFactor(AbstractFactor):
    """The matrix, and the preconditioner of its diagonal blocks."""

    matrix: RegularisedBlocks
    inner: SparseFactor

    def solve(self, rhs: Float[Array, "V 3"], equalities: Equalities | None = None) -> Float[Array, "V 3"]:
        if equalities is not None:
            raise NotImplementedError("Equalities are not supported without shared unknowns.")
        return conjugate_gradients(
            self.matrix.mv,
            rhs,
            self.inner.precondition,
            tolerance=self.matrix.blocks.tolerance,
            max_steps=MAX_STEPS,
        )
