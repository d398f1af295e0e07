"""Displacements as unknowns of a linear least-squares problem, one block of equations for each vertex."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ...batched_map import map_batches
from ...body.body import Body, posed_vertices
from ...body.pose import Pose
from ...fit.linear_solvers.dense import DenseMatrix
from ..weights.rest_vertices import rest_slopes

#: vertices that are solved at once, which bounds memory
BATCH = 32


class CorrectiveEquations(eqx.Module):
    """The residuals of meshes as linear functions of displacements at rest.

    A posed vertex is affine in its rest position, `x_f = B_f p + t_f`. With a shift `s` of the rest position and directions
    `D`, its residual in the mesh f is `e_f - B_f (s + D u_f)`, with the values `u_f` of all units in the pose. A vertex
    depends on the units of its columns only. Its unknowns are the shift, and one direction for each column.
    """

    #: derivatives `B` of posed vertices by their rest positions
    slopes: Float[Array, "F V 3 3"]
    #: residuals `e` without displacements, metres
    errors: Float[Array, "F V 3"]
    values: Float[Array, "F K"]
    #: the columns of `values` for each vertex, and which of them are not padding
    columns: Int[Array, "V N"]
    used: Bool[Array, "V N"]

    def normal(
        self, vertex: Int[Array, ""], weights: Float[Array, "F"]
    ) -> tuple[Float[Array, "M M"], Float[Array, "M"]]:
        """Compute the normal equations of the unknowns of a vertex, with weights of the meshes."""
        own = self.values[:, self.columns[vertex]] * self.used[vertex]
        own = jnp.concatenate([jnp.ones_like(own[:, :1]), own], 1)
        slopes = self.slopes[:, vertex]
        squares = jnp.einsum("fca,fcb->fab", slopes, slopes).reshape(-1, 9)
        products = (own[:, :, None] * own[:, None]).reshape(len(own), -1)
        size = own.shape[1]
        blocks = ((weights[:, None] * products).T @ squares).reshape(size, size, 3, 3)
        matrix = blocks.transpose(0, 2, 1, 3).reshape(3 * size, 3 * size)
        pulled = jnp.einsum("fca,fc->fa", slopes, self.errors[:, vertex])
        return matrix, ((weights[:, None] * own).T @ pulled).reshape(-1)

    def spread(
        self, vertex: Int[Array, ""], x: Float[Array, "M"]
    ) -> tuple[Float[Array, "3"], Float[Array, "3 K"]]:
        """Split the unknowns of a vertex into its shift and its directions for all units."""
        blocks = x.reshape(-1, 3)
        own = jnp.where(self.used[vertex][:, None], blocks[1:], 0.0)
        directions = jnp.zeros((self.values.shape[1], 3), x.dtype).at[self.columns[vertex]].add(own)
        return blocks[0], directions.T


@eqx.filter_jit
def make_equations(
    body: Body,
    poses: Pose,
    targets: Float[Array, "F V 3"],
    values: Float[Array, "F K"],
    columns: Int[Array, "V N"],
    used: Bool[Array, "V N"],
) -> CorrectiveEquations:
    """Linearise the residuals of a body without displacements in its poses; exact, as skins are affine in rest positions."""
    errors = targets - posed_vertices(body, poses)
    return CorrectiveEquations(rest_slopes(body, poses), errors, values, columns, used)


@eqx.filter_jit
def solve_directions(
    equations: CorrectiveEquations, strength: Float[Array, ""]
) -> tuple[Float[Array, "V 3"], Float[Array, "V 3 K"]]:
    """Minimise `sum |e_f - B_f (s + D u_f)|^2 + strength |D|^2` for every vertex; return `s` and `D`, metres.

    Differentiable in both modes by all arrays of the equations.
    """
    ones = jnp.ones(len(equations.values), equations.values.dtype)

    def solve(vertex):
        matrix, side = equations.normal(vertex, ones)
        return equations.spread(vertex, _penalised(matrix, strength).solve(side))

    with jax.default_matmul_precision("highest"):
        return map_batches(solve, jnp.arange(len(equations.columns)), BATCH)


@eqx.filter_jit
def solve_left_out(
    equations: CorrectiveEquations, strengths: Float[Array, "S"], kept: Float[Array, "G F"]
) -> tuple[Float[Array, "V G S 3"], Float[Array, "V G S 3 K"], Float[Array, "V G 3"]]:
    """Solve with the meshes that each fold keeps, for all strengths; the last result are the shifts without directions."""

    def solve(vertex):
        def of_fold(weights):
            matrix, side = equations.normal(vertex, weights)
            found = jax.vmap(
                lambda strength: equations.spread(vertex, _penalised(matrix, strength).solve(side))
            )
            return *found(strengths), DenseMatrix(matrix[:3, :3]).solve(side[:3])

        return jax.vmap(of_fold)(kept)

    with jax.default_matmul_precision("highest"):
        return map_batches(solve, jnp.arange(len(equations.columns)), BATCH // 4)


def _penalised(matrix: Float[Array, "M M"], strength: Float[Array, ""]) -> DenseMatrix:
    """Add the prior of the directions, which follow the three unknowns of the shift."""
    return DenseMatrix(matrix).add_diagonal(jnp.where(jnp.arange(len(matrix)) < 3, 0.0, strength))
