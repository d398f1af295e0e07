"""Normal equations in which each frame is coupled only to nearby frames.

Rows that each depend on `W + 1` successive frames give equations whose blocks are zero further than `W` from
the diagonal. With `W = 2`, as for second differences,

    [ A_00  A_10^T A_20^T               ] [x_0]   [b_0]
    [ A_10  A_11   A_21^T A_31^T        ] [x_1]   [b_1]
    [ A_20  A_21   A_22   A_32^T A_42^T ] [x_2] = [b_2]
    [       A_31   A_32   A_33   A_43^T ] [x_3]   [b_3]
    [              A_42   A_43   A_44   ] [x_4]   [b_4]

The Cholesky factor has the same band and is computed frame by frame (Golub and Van Loan, *Matrix
Computations*, 4.3). Time and memory are linear in the number of frames, not cubic and quadratic. With `W = 0`
the frames are independent.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Bool, Float, Shaped

from ..solvers.equalities import Equalities
from .cholesky import diagonal_scale, rounding_bound
from .structured import AbstractFactor, AbstractStructuredMatrix

_einsum = partial(jnp.einsum, precision="highest")


class BlockBanded(AbstractStructuredMatrix):
    """A symmetric block-banded matrix over `x (F, D)`.

    `blocks[f, w]`, with `B = W + 1` blocks per frame, couples frame `f` (rows) to frame `f - w` (columns).
    Blocks before the first frame are ignored.
    """

    blocks: Float[Array, "F B D D"]

    def mv(self, vector: Float[Array, "F D"]) -> Float[Array, "F D"]:
        total = _einsum("fij,fj->fi", self.blocks[:, 0], vector)
        for w in range(1, self.blocks.shape[1]):
            total = total.at[w:].add(_einsum("fij,fj->fi", self.blocks[w:, w], vector[:-w]))
            total = total.at[:-w].add(_einsum("fij,fi->fj", self.blocks[w:, w], vector[w:]))
        return total

    def abs_mv(self, x: Float[Array, "F D"]) -> Float[Array, "F D"]:
        return BlockBanded(jnp.abs(self.blocks)).mv(x)

    def restricted(self, free: Bool[Array, "F D"]) -> "BlockBanded":
        both = free[:, None, :, None] & stack_previous(free, self.blocks.shape[1])[:, :, None, :]
        return BlockBanded(jnp.where(both, self.blocks, 0.0)).add_diagonal(jnp.where(free, 0.0, 1.0))

    def in_structure(self):
        frames, _, dofs, _ = self.blocks.shape
        return jax.ShapeDtypeStruct((frames, dofs), self.blocks.dtype)

    def diagonal(self) -> Float[Array, "F D"]:
        return jnp.diagonal(self.blocks[:, 0], axis1=1, axis2=2)

    def add_diagonal(self, amounts: Float[Array, "F D"]) -> "BlockBanded":
        one = jnp.eye(self.blocks.shape[2], dtype=self.blocks.dtype)
        return BlockBanded(self.blocks.at[:, 0].add(amounts[:, :, None] * one))

    def factorise(self) -> "BandedFactor":
        """Factorise frame by frame, because batches of small factors are slow on a CPU.

        The diagonal blocks of the factor are inverted, so that every other operation is a matrix product,
        which all devices compute fast.
        """
        frames, width, dofs, _ = self.blocks.shape
        scale = diagonal_scale(self.diagonal())
        even = self.blocks * scale[:, None, :, None] * stack_previous(scale, width)[:, :, None, :]
        exists = jnp.arange(frames)[:, None] >= jnp.arange(width)
        even = jnp.where(exists[:, :, None, None], even, 0.0)
        one = jnp.eye(dofs, dtype=even.dtype)
        even = even.at[:, 0].add(rounding_bound(dofs, even.dtype) * one)

        def row(above, blocks):
            """Compute a row of the factor from the rows of the `W` previous frames, the nearest first."""
            found = [jnp.zeros_like(blocks[0])] * width
            for w in range(width - 1, 0, -1):
                left = blocks[w] - sum(found[v] @ above[w - 1, v - w].T for v in range(w + 1, width))
                found[w] = left @ above[w - 1, 0].T
            corner = jnp.linalg.cholesky(blocks[0] - sum(part @ part.T for part in found[1:]))
            found[0] = solve_triangular(corner, one, lower=True)
            whole = jnp.stack(found)
            return jnp.concatenate([whole[None], above])[: width - 1], whole

        # there is no frame before the first; an identity factor there leaves the zeros unchanged
        none = jnp.zeros((width - 1, width, dofs, dofs), even.dtype).at[:, 0].set(one)
        with jax.default_matmul_precision("highest"):
            return BandedFactor(jax.lax.scan(row, none, even)[1], scale)


class BandedFactor(AbstractFactor):
    """The banded Cholesky factor `L` of equations scaled to a unit diagonal by `scale`, with inverted
    diagonal blocks.
    """

    blocks: Float[Array, "F B D D"]
    scale: Float[Array, "F D"]

    def solve(self, rhs: Float[Array, "F D"], equalities: Equalities | None = None) -> Float[Array, "F D"]:
        if equalities is not None:
            raise NotImplementedError("Equalities are not supported without shared unknowns.")
        return self.backward(self.forward(rhs[:, :, None]))[:, :, 0]

    def forward(self, rhs: Float[Array, "F D K"]) -> Float[Array, "F D K"]:
        """Compute `L^-1 S b`, from the first frame to the last."""
        rhs = self.scale[:, :, None] * rhs
        if self.blocks.shape[1] == 1:
            return _einsum("fij,fjk->fik", self.blocks[:, 0], rhs)

        def one(before, row):
            blocks, side = row
            known = _einsum("wij,wjk->ik", blocks[1:], before)
            found = _einsum("ij,jk->ik", blocks[0], side - known)
            return jnp.concatenate([found[None], before])[: len(before)], found

        none = jnp.zeros((self.blocks.shape[1] - 1, *rhs.shape[1:]), rhs.dtype)
        return jax.lax.scan(one, none, (self.blocks, rhs))[1]

    def backward(self, rhs: Float[Array, "F D K"]) -> Float[Array, "F D K"]:
        """Compute `S L^-T b`, from the last frame to the first.

        The updates of a solved frame to the right sides of earlier frames are carried along, the nearest
        first.
        """
        if self.blocks.shape[1] == 1:
            return self.scale[:, :, None] * _einsum("fij,fik->fjk", self.blocks[:, 0], rhs)

        def one(known, row):
            blocks, side = row
            found = _einsum("ij,ik->jk", blocks[0], side - known[0])
            passed = jnp.concatenate([known, jnp.zeros_like(found)[None]])[1:]
            taken = _einsum("wij,ik->wjk", blocks[1:], found)
            return passed.at[: len(taken)].add(taken), found

        none = jnp.zeros((self.blocks.shape[1], *rhs.shape[1:]), rhs.dtype)
        return self.scale[:, :, None] * jax.lax.scan(one, none, (self.blocks, rhs), reverse=True)[1]

    def inverse_diagonal_blocks(self) -> Float[Array, "F D D"]:
        """Compute the diagonal blocks of the inverse, in time linear in the number of frames.

        The recursion runs from the last frame to the first, each from the later frames in its band
        (Takahashi, Fagan and Chin 1973).
        """
        frames, width, dofs, _ = self.blocks.shape
        reach = width - 1
        # the blocks below each diagonal block of the factor: of the frame w later, L_{f+w, f}
        below = [jnp.roll(self.blocks[:, w], -w, 0).at[frames - w :].set(0.0) for w in range(1, width)]
        below = jnp.stack(below, 1) if reach else jnp.zeros((frames, 0, dofs, dofs), self.blocks.dtype)

        def one(later, row):
            """Compute one diagonal block of the inverse from `later (W, W, D, D)`, those among the next `W`
            frames.
            """
            corner, under = row
            slopes = _einsum("wij,jk->wik", under, corner)
            across = -_einsum("vwij,wjk->vik", later, slopes)
            own = _einsum("ji,jk->ik", corner, corner) - _einsum("wij,wik->jk", slopes, across)
            whole = jnp.zeros((width, width, dofs, dofs), own.dtype).at[1:, 1:].set(later)
            whole = whole.at[0, 0].set(own).at[1:, 0].set(across).at[0, 1:].set(jnp.swapaxes(across, 1, 2))
            return whole[:reach, :reach], own

        none = jnp.zeros((reach, reach, dofs, dofs), self.blocks.dtype)
        _, own = jax.lax.scan(one, none, (self.blocks[:, 0], below), reverse=True)
        return own * self.scale[:, :, None] * self.scale[:, None, :]


def stack_previous(each: Shaped[Array, "F *D"], width: int) -> Shaped[Array, "F B *D"]:
    """Stack the values of each frame with those of the frames before it, cyclically at the start."""
    return jnp.stack([jnp.roll(each, w, 0) for w in range(width)], 1)
