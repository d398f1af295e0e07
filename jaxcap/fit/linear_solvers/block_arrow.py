"""Normal equations of many frames that share some unknowns.

Every frame has its own unknowns `x_f`; all frames share `s`. Without coupling between frames the equations
are

    [ A_1           B_1 ] [x_1]   [g_1]
    [      A_2      B_2 ] [x_2] = [g_2]
    [ B_1^T  B_2^T  C   ] [ s ]   [ h ]

and the frames are eliminated by the Schur complement `C - sum_f B_f^T A_f^-1 B_f`. If neighbouring frames are
coupled, `A` is block-banded, and the same elimination holds with its factor.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..solvers.equalities import Equalities, enforce_equalities
from .block_banded import BandedFactor, BlockBanded, stack_previous
from .cholesky import CholeskyFactor, factorise
from .structured import AbstractFactor, AbstractStructuredMatrix

#: the unknowns of each frame, and those shared by all frames
Unknowns = tuple[Float[Array, "F D"], Float[Array, "S"]]


class BlockArrow(AbstractStructuredMatrix):
    """A symmetric block-arrow matrix over `(x (F, D), s (S,))`; S may be zero."""

    frames: BlockBanded
    coupling: Float[Array, "F D S"]
    shared: Float[Array, "S S"]

    def mv(self, vector: Unknowns) -> Unknowns:
        x, s = vector
        with jax.default_matmul_precision("highest"):
            across = jnp.einsum("fds,fd->s", self.coupling, x)
            return self.frames.mv(x) + self.coupling @ s, self.shared @ s + across

    def abs_mv(self, x: Unknowns) -> Unknowns:
        return BlockArrow(
            BlockBanded(jnp.abs(self.frames.blocks)), jnp.abs(self.coupling), jnp.abs(self.shared)
        ).mv(x)

    def restricted(self, free: tuple[Bool[Array, "F D"], Bool[Array, "S"]]) -> "BlockArrow":
        x, s = free
        coupling = jnp.where(x[:, :, None] & s, self.coupling, 0.0)
        shared = jnp.where(s[:, None] & s, self.shared, 0.0) + jnp.diag(jnp.where(s, 0.0, 1.0))
        return BlockArrow(self.frames.restricted(x), coupling, shared)

    def in_structure(self):
        return self.frames.in_structure(), jax.ShapeDtypeStruct(self.shared.shape[:1], self.shared.dtype)

    def diagonal(self) -> Unknowns:
        return self.frames.diagonal(), jnp.diagonal(self.shared)

    def add_diagonal(self, amounts: Unknowns) -> "BlockArrow":
        x, s = amounts
        return BlockArrow(self.frames.add_diagonal(x), self.coupling, self.shared + jnp.diag(s))

    def change_variables(self, matrix: Float[Array, "F D D"]) -> "BlockArrow":
        """Change the variables of the frames to `y` with `x = matrix @ y`."""
        before = stack_previous(matrix, self.frames.blocks.shape[1])
        product = partial(jnp.einsum, precision="highest")
        blocks = product("fai,fwab,fwbj->fwij", matrix, self.frames.blocks, before)
        return BlockArrow(BlockBanded(blocks), product("fai,fas->fis", matrix, self.coupling), self.shared)

    def rescaled(self, x: Float[Array, "F D"], s: Float[Array, "S"]) -> "BlockArrow":
        """Rescale the variables of the frames by `x` and the shared ones by `s`."""
        before = stack_previous(x, self.frames.blocks.shape[1])
        blocks = self.frames.blocks * x[:, None, :, None] * before[:, :, None, :]
        coupling = self.coupling * x[:, :, None] * s
        return BlockArrow(BlockBanded(blocks), coupling, self.shared * s[:, None] * s)

    def factorise(self) -> "ArrowFactor":
        frames = self.frames.factorise()
        columns = frames.forward(self.coupling)
        with jax.default_matmul_precision("highest"):
            eliminated = jnp.tensordot(columns, columns, ((0, 1), (0, 1)))
            return ArrowFactor(frames, columns, factorise(self.shared - eliminated))


class ArrowFactor(AbstractFactor):
    """The frames' factor `L`, `L^-1 B`, and the factor of the Schur complement."""

    frames: BandedFactor
    columns: Float[Array, "F D S"]
    shared: CholeskyFactor

    def solve(self, rhs: Unknowns, equalities: Equalities | None = None) -> Unknowns:
        """Solve for all unknowns; with equalities, minimise `y^T A y / 2 - rhs^T y` subject to them."""
        with jax.default_matmul_precision("highest"):
            known = self.frames.forward(rhs[0][:, :, None])[:, :, 0]
            s = self.shared.solve(rhs[1] - jnp.einsum("fds,fd->s", self.columns, known))
            s = enforce_equalities(self.shared.solve, s, equalities)
            return self.frames.backward((known - self.columns @ s)[:, :, None])[:, :, 0], s
