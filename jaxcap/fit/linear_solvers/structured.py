"""Structured matrices of normal equations, and the linear solver that factorises them.

The matrices are lineax operators, so that optimistix's descents and searches accept them as the Hessian of
`optx.FunctionInfo.EvalGradHessian`, and that every solver of lineax for square systems solves them.
"""

import abc
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, PyTree

from ...errors import InputError
from ..solvers.equalities import Equalities

Structured = TypeVar("Structured", bound="AbstractStructuredMatrix")


class AbstractFactor(eqx.Module):
    """A factorised matrix."""

    @abc.abstractmethod
    def solve(self, rhs: Any, equalities: Equalities | None = None) -> Any:
        """Solve `A x = rhs`; with equalities, minimise `x^T A x / 2 - rhs^T x` subject to them.

        The result is NaN where `A` is not positive definite.
        """


class AbstractStructuredMatrix(lx.AbstractLinearOperator):
    """A symmetric positive semidefinite matrix over unknowns that are a pytree of arrays."""

    @abc.abstractmethod
    def diagonal(self) -> PyTree[Array]:
        """Get the diagonal, in the shape of the unknowns."""

    @abc.abstractmethod
    def add_diagonal(self: Structured, amounts: PyTree[Array]) -> Structured:
        """Add amounts, in the shape of the unknowns, to the diagonal."""

    @abc.abstractmethod
    def abs_mv(self, x: PyTree[Array]) -> PyTree[Array]:
        """Compute `|A| x`, the scale of the rounding errors of a product."""

    @abc.abstractmethod
    def restricted(self: Structured, free: PyTree[Array]) -> Structured:
        """Keep the rows and columns of free unknowns, and replace the others by those of the identity.

        They are masked, not removed, so that shapes stay constant.
        """

    @abc.abstractmethod
    def factorise(self) -> AbstractFactor:
        """Factorise the matrix in time linear in the number of frames."""

    def solve(self, rhs: PyTree[Array]) -> PyTree[Array]:
        """Solve `A x = rhs`, differentiably in both modes: a derivative is one more substitution with the
        same factor.
        """
        factor = jax.lax.stop_gradient(self).factorise()
        return jax.lax.custom_linear_solve(self.mv, rhs, lambda _, b: factor.solve(b), symmetric=True)

    def as_matrix(self) -> Float[Array, "N N"]:
        """Write out the whole matrix, for tests and small problems."""
        zero = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), self.in_structure())
        flat, unravel = ravel_pytree(zero)
        columns = jax.vmap(lambda x: ravel_pytree(self.mv(unravel(x)))[0])(
            jnp.eye(len(flat), dtype=flat.dtype)
        )
        return columns.T

    def transpose(self):
        return self

    def out_structure(self):
        return self.in_structure()


class StructuredCholesky(lx.AbstractLinearSolver[AbstractFactor]):
    """Cholesky factors in the structure of the matrix: frame by frame, with the shared unknowns in a Schur complement.

    Sparse matrices over rest vertices have no exact factor; theirs preconditions conjugate gradients.
    """

    def init(self, operator: lx.AbstractLinearOperator, options: dict[str, Any]) -> AbstractFactor:
        del options
        if not isinstance(operator, AbstractStructuredMatrix):
            raise InputError(
                f"StructuredCholesky: the matrix is a {type(operator).__name__}; expected one with a structure, such as "
                "`problem.information(y).hessian`."
            )
        return operator.factorise()

    def compute(self, state: AbstractFactor, vector: PyTree[Array], options: dict[str, Any]):
        del options
        return state.solve(vector), lx.RESULTS.successful, {}

    def transpose(self, state: AbstractFactor, options: dict[str, Any]):
        return state, options

    def conj(self, state: AbstractFactor, options: dict[str, Any]):
        return state, options

    def assume_full_rank(self) -> bool:
        return True


def damped(matrix: Structured, relative: Float[Array, ""]) -> Structured:
    """Damp a matrix after Marquardt: add a share of each diagonal entry to it.

    A floor relative to the largest entry of the same block keeps unknowns without data still.
    """

    def raised(diagonal):
        if diagonal.shape[-1] == 0:
            return diagonal
        floor = jnp.finfo(diagonal.dtype)
        return relative * diagonal + jnp.maximum(jnp.max(diagonal, -1, keepdims=True) * floor.eps, floor.tiny)

    return matrix.add_diagonal(jax.tree.map(raised, matrix.diagonal()))


for _question in (lx.is_symmetric, lx.is_positive_semidefinite):
    _question.register(AbstractStructuredMatrix)(lambda operator: True)
for _question in (
    lx.is_diagonal, lx.is_tridiagonal, lx.has_unit_diagonal, lx.is_lower_triangular, lx.is_upper_triangular,
    lx.is_negative_semidefinite,
):  # fmt: skip
    _question.register(AbstractStructuredMatrix)(lambda operator: False)
for _same in (lx.linearise, lx.materialise, lx.conj):
    _same.register(AbstractStructuredMatrix)(lambda operator: operator)


@lx.diagonal.register(AbstractStructuredMatrix)
def _(operator):
    return ravel_pytree(operator.diagonal())[0]
