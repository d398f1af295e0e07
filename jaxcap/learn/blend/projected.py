"""Normal equations of bones from which the unknowns of every vertex are eliminated."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...fit.linear.block_arrow import ArrowFactor, BlockArrow, Unknowns
from ...fit.linear.cholesky import factorise
from ...fit.linear.conjugate_gradients import conjugate_gradients
from ...fit.linear.structured import AbstractFactor, AbstractStructured
from ...fit.solvers.equalities import Equalities
from ..skeleton.limbs import Limbs, Tree, bone_rates


class Moves(eqx.Module):
    """How blended vertices move with the bones: linear, and nothing of the size vertices by unknowns is kept."""

    tree: Tree
    limbs: Limbs
    #: weights times rest places, and weights: what a bone's `(R, t)` counts in a vertex
    spread: Float[Array, "V B"]
    #: what counts as one unit of a tangent
    scales: Unknowns

    def push(self, d: Unknowns) -> Float[Array, "V N"]:
        """Compute the moves of the vertices in all frames along a tangent."""
        rates = bone_rates(self.tree, self.limbs, jax.tree.map(jnp.multiply, self.scales, d))
        return jnp.matmul(self.spread, flat_bones(rates), precision="highest")

    def pull(self, errors: Float[Array, "V N"]) -> Unknowns:
        """Compute the products of errors with the moves by every number of a tangent."""
        (found,) = jax.linear_transpose(self.push, jax.tree.map(jnp.zeros_like, self.scales))(errors)
        return found


def flat_bones(bones: Float[Array, "F J 3 4"]) -> Float[Array, "B N"]:
    """Lay out bones so that the weighted places of vertices times them are the posed vertices."""
    return bones.transpose(1, 3, 0, 2).reshape(4 * bones.shape[1], -1)


class Own(eqx.Module):
    """The directions `C` in which each vertex moves by unknowns of its own, in all frames, and `(C C^T)^-1`."""

    rows: Float[Array, "V K N"]
    inverse: Float[Array, "V K K"]

    def without(self, errors: Float[Array, "V N"]) -> Float[Array, "V N"]:
        """Leave out of errors what these directions can make good."""
        with jax.default_matmul_precision("highest"):
            inner = jnp.einsum("vij,vj->vi", self.inverse, jnp.einsum("vjn,vn->vj", self.rows, errors))
            return errors - jnp.einsum("vin,vi->vn", self.rows, inner)


class Projected(AbstractStructured):
    """The matrix `J^T (1 - C^T (C C^T)^-1 C) J` over tangents of bones.

    `J^T J` is an arrow, the rest joins all frames. It is known by its products; the arrow is the preconditioner of conjugate
    gradients, which stay on the equations that a step keeps (Gould, Hribar and Nocedal 2001).
    """

    #: of `J^T J`, and all that was added to the diagonal
    arrow: BlockArrow
    added: Unknowns
    moves: Moves
    own: Own
    #: the share of the right side at which conjugate gradients end, and their steps at most
    tolerance: Float[Array, ""]
    steps: Int[Array, ""]

    def mv(self, vector: Unknowns) -> Unknowns:
        product = self.moves.pull(self.own.without(self.moves.push(vector)))
        return jax.tree.map(lambda image, share, x: image + share * x, product, self.added, vector)

    def magnitudes(self, x: Unknowns) -> Unknowns:
        return self.arrow.magnitudes(x)

    def among(self, free: Unknowns) -> "Projected":
        raise NotImplementedError("Projected equations have no bounds.")

    def in_structure(self):
        return self.arrow.in_structure()

    def diagonal(self) -> Unknowns:
        """The diagonal of the arrow, which bounds that of the matrix."""
        return self.arrow.diagonal()

    def add_diagonal(self, amounts: Unknowns) -> "Projected":
        added = jax.tree.map(jnp.add, self.added, amounts)
        return eqx.tree_at(lambda p: (p.arrow, p.added), self, (self.arrow.add_diagonal(amounts), added))

    def factorise(self) -> "ProjectedFactor":
        return ProjectedFactor(self, self.arrow.factorise())


class ProjectedFactor(AbstractFactor):
    """The matrix with the factor of its arrow."""

    matrix: Projected
    arrow: ArrowFactor

    def solve(self, side: Unknowns, equalities: Equalities | None = None) -> Unknowns:
        still = None if equalities is None else Equalities(equalities.rows, jnp.zeros_like(equalities.values))
        kept = _along(equalities)

        def product(x):
            image = self.matrix.mv(x)
            return image[0], kept(image[1])

        first = self.arrow.solve(side, equalities)
        left = jax.tree.map(jnp.subtract, side, self.matrix.mv(first))
        found = conjugate_gradients(
            product,
            (left[0], kept(left[1])),
            lambda side: self.arrow.solve(side, still),
            tolerance=self.matrix.tolerance,
            max_steps=self.matrix.steps,
        )
        return jax.tree.map(jnp.add, first, found)


def _along(equalities: Equalities | None) -> Callable[[Array], Array]:
    """Leave out of a right side what only presses on equations: else it would be a residual for ever."""
    if equalities is None or len(equalities.rows) == 0:
        return lambda s: s
    rows = equalities.rows
    factor = factorise(jnp.matmul(rows, rows.T, precision="highest"))
    return lambda s: s - rows.T @ factor.solve(rows @ s)
