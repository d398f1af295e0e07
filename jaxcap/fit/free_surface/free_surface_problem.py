"""The least-squares problem of a surface with free vertices, matched points and a prior of its displacements."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...energy.data.pairs import PointPairs, corner_directions, pair_directions, pair_positions
from ..linear_solvers.regularised_blocks import PrecisionRoot, RegularisedBlocks
from ..linear_solvers.sparse_blocks import SparseBlocks
from ..solvers.descent import ConstrainedInfo
from ..solvers.least_squares_problem import AbstractProblem
from .vertex_couplings import Couplings, add_pairs, no_equations


class FreeSurfaceProblem(AbstractProblem[Float[Array, "V 3"]]):
    """A problem that minimises `|r(x + d)|^2 + |R d|^2` over the displacements `d`, metres.

    `r` are the distances of pairs, divided by their standard deviations, and `R` the root of the prior's precision.
    The problem is linear: one step solves it.
    """

    #: positions `x` of the vertices that the prior refers to
    guide: Float[Array, "V 3"]
    pairs: PointPairs
    couplings: Couplings
    prior: PrecisionRoot
    #: relative residual at which conjugate gradients end
    tolerance: Float[Array, ""]

    def value(self, y: Float[Array, "V 3"]):
        return 0.5 * (jnp.sum(self._distances(y) ** 2) + jnp.sum(self.prior.residual(y) ** 2))

    def information(self, y: Float[Array, "V 3"]):
        pairs, count = self.pairs, len(self.guide)
        zero = no_equations(self.couplings, count, y.dtype)
        found = add_pairs(
            zero,
            corner_directions(pairs),
            self._distances(y),
            pairs.vertices,
            self.couplings.block_indices,
        )
        blocks = SparseBlocks(
            found.blocks[:count], self.couplings.edges, found.blocks[count:], self.tolerance
        )
        free: Bool[Array, "V 3"] = jnp.ones(y.shape, bool)
        hessian = RegularisedBlocks(blocks, self.prior, free)
        gradient = self.prior.precision(y) - found.side
        return ConstrainedInfo(self.value(y), gradient, hessian)  # pyright: ignore[reportCallIssue]

    def retract(self, y: Float[Array, "V 3"], d: Float[Array, "V 3"]):
        return y + d

    def scales(self):
        return jnp.ones_like(self.guide)

    def _distances(self, y: Float[Array, "V 3"]) -> Float[Array, "C 3"]:
        differences = pair_positions(self.pairs, self.guide + y) - self.pairs.points
        return jnp.einsum("cra,ca->cr", pair_directions(self.pairs), differences)
