"""Normal equations of bones with the unknowns of each vertex eliminated."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...fit.linear_solvers.block_arrow import ArrowFactor, BlockArrow, Unknowns
from ...fit.linear_solvers.cholesky import factorise
from ...fit.linear_solvers.conjugate_gradients import conjugate_gradients
from ...fit.linear_solvers.structured import AbstractFactor, AbstractStructuredMatrix
from ...fit.solvers.equalities import Equalities
from ..skeleton.limbs import BoneState, TreeTopology, bone_derivatives


class BoneJacobian(eqx.Module):
    """The linear map from bone tangents to vertex displacements, without a stored Jacobian."""

    tree: TreeTopology
    bone_state: BoneState
    #: weights times rest positions, and weights: the coefficients of a bone's `(R, t)` in a vertex
    weighted_rest: Float[Array, "V B"]
    #: the unit of each component of a tangent
    scales: Unknowns

    def jvp(self, d: Unknowns) -> Float[Array, "V N"]:
        """Compute the displacements of the vertices in all frames along a tangent."""
        rates = bone_derivatives(self.tree, self.bone_state, jax.tree.map(jnp.multiply, self.scales, d))
        return jnp.matmul(self.weighted_rest, flat_bones(rates), precision="highest")

    def vjp(self, errors: Float[Array, "V N"]) -> Unknowns:
        """Apply the transpose of `jvp` to errors."""
        (found,) = jax.linear_transpose(self.jvp, jax.tree.map(jnp.zeros_like, self.scales))(errors)
        return found


def flat_bones(bones: Float[Array, "F J 3 4"]) -> Float[Array, "B N"]:
    """Reshape bones so that the matrix of weighted rest positions times them gives the posed vertices."""
    return bones.transpose(1, 3, 0, 2).reshape(4 * bones.shape[1], -1)


class VertexDirections(eqx.Module):
    """The directions `C` of each vertex by its own unknowns, in all frames, and `(C C^T)^-1`."""

    rows: Float[Array, "V K N"]
    inverse: Float[Array, "V K K"]

    def project_out(self, errors: Float[Array, "V N"]) -> Float[Array, "V N"]:
        """Project errors onto the orthogonal complement of these directions."""
        with jax.default_matmul_precision("highest"):
            inner = jnp.einsum("vij,vj->vi", self.inverse, jnp.einsum("vjn,vn->vj", self.rows, errors))
            return errors - jnp.einsum("vin,vi->vn", self.rows, inner)


class ProjectedHessian(AbstractStructuredMatrix):
    """The matrix `J^T (1 - C^T (C C^T)^-1 C) J` over tangents of bones.

    `J^T J` is an arrow matrix; the rest couples all frames. The matrix is available by its products only. The
    arrow is the preconditioner of projected conjugate gradients, which satisfy the equality constraints of a
    step (Gould, Hribar and Nocedal 2001).
    """

    #: `J^T J` plus `added`, and the amounts added to the diagonal
    arrow: BlockArrow
    added_diagonal: Unknowns
    jacobian: BoneJacobian
    directions: VertexDirections
    #: tolerance of conjugate gradients relative to the right-hand side, and their most steps
    tolerance: Float[Array, ""]
    steps: Int[Array, ""]

    def mv(self, vector: Unknowns) -> Unknowns:
        product = self.jacobian.vjp(self.directions.project_out(self.jacobian.jvp(vector)))
        return jax.tree.map(lambda image, share, x: image + share * x, product, self.added_diagonal, vector)

    def abs_mv(self, x: Unknowns) -> Unknowns:
        return self.arrow.abs_mv(x)

    def restricted(self, free: Unknowns) -> "ProjectedHessian":
        raise NotImplementedError("Reduced normal equations do not support bounds.")

    def in_structure(self):
        return self.arrow.in_structure()

    def diagonal(self) -> Unknowns:
        """Return the diagonal of the arrow, an upper bound of the diagonal of the matrix."""
        return self.arrow.diagonal()

    def add_diagonal(self, amounts: Unknowns) -> "ProjectedHessian":
        added = jax.tree.map(jnp.add, self.added_diagonal, amounts)
        return eqx.tree_at(
            lambda p: (p.arrow, p.added_diagonal), self, (self.arrow.add_diagonal(amounts), added)
        )

    def factorise(self) -> "ProjectedHessianFactor":
        return ProjectedHessianFactor(self, self.arrow.factorise())


class ProjectedHessianFactor(AbstractFactor):
    """The matrix with the factor of its arrow."""

    matrix: ProjectedHessian
    arrow: ArrowFactor

    def solve(self, rhs: Unknowns, equalities: Equalities | None = None) -> Unknowns:
        still = None if equalities is None else Equalities(equalities.rows, jnp.zeros_like(equalities.values))
        kept = _null_space_projection(equalities)

        def product(x):
            image = self.matrix.mv(x)
            return image[0], kept(image[1])

        first = self.arrow.solve(rhs, equalities)
        left = jax.tree.map(jnp.subtract, rhs, self.matrix.mv(first))
        found = conjugate_gradients(
            product,
            (left[0], kept(left[1])),
            lambda side: self.arrow.solve(side, still),
            tolerance=self.matrix.tolerance,
            max_steps=self.matrix.steps,
        )
        return jax.tree.map(jnp.add, first, found)


def _null_space_projection(equalities: Equalities | None) -> Callable[[Array], Array]:
    """Build the projection of a right-hand side onto the null space of equality constraints.

    The other component is balanced by constraint forces, and would remain as a residual.
    """
    if equalities is None or len(equalities.rows) == 0:
        return lambda s: s
    rows = equalities.rows
    factor = factorise(jnp.matmul(rows, rows.T, precision="highest"))
    return lambda s: s - rows.T @ factor.solve(rows @ s)
