"""Symmetric matrices without structure."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..solvers.equalities import Equalities, enforce_equalities
from .cholesky import CholeskyFactor, factorise
from .structured import AbstractFactor, AbstractStructuredMatrix


class DenseMatrix(AbstractStructuredMatrix):
    """A dense symmetric positive semidefinite matrix over `x (D,)`."""

    matrix: Float[Array, "D D"]

    def mv(self, vector: Float[Array, "D"]) -> Float[Array, "D"]:
        return jnp.matmul(self.matrix, vector, precision="highest")

    def abs_mv(self, x: Float[Array, "D"]) -> Float[Array, "D"]:
        return jnp.abs(self.matrix) @ x

    def restricted(self, free: Bool[Array, "D"]) -> "DenseMatrix":
        return DenseMatrix(
            jnp.where(free[:, None] & free, self.matrix, 0.0) + jnp.diag(jnp.where(free, 0.0, 1.0))
        )

    def in_structure(self):
        return jax.ShapeDtypeStruct(self.matrix.shape[:1], self.matrix.dtype)

    def diagonal(self) -> Float[Array, "D"]:
        return jnp.diagonal(self.matrix)

    def add_diagonal(self, amounts: Float[Array, "D"]) -> "DenseMatrix":
        return DenseMatrix(self.matrix + jnp.diag(amounts))

    def factorise(self) -> "DenseFactor":
        # a small ridge, as equations without structure are damped already, and a ridge moves weakly
        # determined unknowns
        return DenseFactor(factorise(self.matrix, 10 * float(jnp.finfo(self.matrix.dtype).eps)))

    def as_matrix(self) -> Float[Array, "D D"]:
        return self.matrix


class DenseFactor(AbstractFactor):
    """The Cholesky factor of the whole matrix."""

    factor: CholeskyFactor

    def solve(self, rhs: Float[Array, "D"], equalities: Equalities | None = None) -> Float[Array, "D"]:
        return enforce_equalities(self.factor.solve, self.factor.solve(rhs), equalities)
