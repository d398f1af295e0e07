"""Least squares of many frames in which only near ones meet: block-banded normal equations.

Rows that each touch `W + 1` successive frames leave normal equations whose blocks are zero further than `W` from the
diagonal; with `W = 2`, as of second differences,

    [ A_00  A_10^T A_20^T               ] [x_0]   [b_0]
    [ A_10  A_11   A_21^T A_31^T        ] [x_1]   [b_1]
    [ A_20  A_21   A_22   A_32^T A_42^T ] [x_2] = [b_2]
    [       A_31   A_32   A_33   A_43^T ] [x_3]   [b_3]
    [              A_42   A_43   A_44   ] [x_4]   [b_4]

Cholesky's factor has the same band, and is found frame by frame (Golub and Van Loan, *Matrix Computations*, 4.3):
time and memory grow with the number of frames, not with its cube and square.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Bool, Float, Shaped

from .boxed import AbstractSystem

_einsum = partial(jnp.einsum, precision="highest")


class Banded(AbstractSystem):
    """A symmetric block-banded matrix, such as `J^T J` of F frames.

    `blocks[f, w]`, with `B = W + 1` of them a frame, is by the numbers of frame `f` and of the frame `w` before it. What would lie before the
    first frame is not read.
    """

    blocks: Float[Array, "F B D D"]

    def product(self, x: Float[Array, "F D"]) -> Float[Array, "F D"]:
        blocks = self.blocks
        total = _einsum("fij,fj->fi", blocks[:, 0], x)
        for w in range(1, blocks.shape[1]):
            total = total.at[w:].add(_einsum("fij,fj->fi", blocks[w:, w], x[:-w]))
            total = total.at[:-w].add(_einsum("fij,fi->fj", blocks[w:, w], x[w:]))
        return total

    def magnitudes(self, x: Float[Array, "F D"]) -> Float[Array, "F D"]:
        return Banded(jnp.abs(self.blocks)).product(x)

    def solve(self, side: Float[Array, "F D"], free: Bool[Array, "F D"]) -> Float[Array, "F D"]:
        return solve_banded(among(self, free), jnp.where(free, side, 0.0))


def banded_equations(
    slopes: Float[Array, "K B R D"], apart: Float[Array, "K R"]
) -> tuple[Banded, Float[Array, "F D"]]:
    """`J^T J` and `J^T r` of `F = K + W` frames by rows that each touch successive ones: rows `k` by the numbers of the
    frames `k` to `k + W`, and how far they are from where a step is to bring them."""
    count, width, _, dofs = slopes.shape
    blocks = jnp.zeros((count + width - 1, width, dofs, dofs), slopes.dtype)
    sides = jnp.zeros((count + width - 1, dofs), slopes.dtype)
    for later in range(width):
        here = slice(later, later + count)
        sides = sides.at[here].add(_einsum("krd,kr->kd", slopes[:, later], apart))
        for before in range(later + 1):
            products = _einsum("kri,krj->kij", slopes[:, later], slopes[:, later - before])
            blocks = blocks.at[here, before].add(products)
    return Banded(blocks), sides


def among(banded: Banded, free: Bool[Array, "F D"]) -> Banded:
    """Rows and columns of the free numbers, and those of the identity for the others: they are masked, not removed,
    so that shapes stay."""
    both = free[:, None, :, None] & frames_before(free, banded.blocks.shape[1])[:, :, None, :]
    units = jnp.where(free, 0.0, 1.0)[:, :, None] * jnp.eye(free.shape[1], dtype=banded.blocks.dtype)
    return Banded(jnp.where(both, banded.blocks, 0.0).at[:, 0].add(units))


def solve_banded(banded: Banded, sides: Float[Array, "F D"]) -> Float[Array, "F D"]:
    """The `x` with `A x = sides` by a block Cholesky factor; not a number where `A` is not positive definite.

    Differentiable in both modes: a derivative is one more substitution with the same factor.
    """
    factor, scale = _factor(jax.lax.stop_gradient(banded.blocks))

    def solve(_, sides):
        return scale * _backward(factor, _forward(factor, scale * sides))

    return jax.lax.custom_linear_solve(banded.product, sides, solve, symmetric=True)


def _factor(
    blocks: Float[Array, "F B D D"],
) -> tuple[Float[Array, "F B D D"], Float[Array, "F D"]]:
    """The Cholesky factor's band, the blocks on its diagonal inverted, of equations brought to a unit diagonal, and by what. Metres and radians, and
    numbers that hardly count, are on one scale then, and are given back what rounding may take.

    One frame after the other: batches of small factors stall on a CPU. Inverses make all else products, of which
    there are many and which all devices are fast at.
    """
    frames, width, dofs, _ = blocks.shape
    diagonal = jnp.diagonal(blocks[:, 0], axis1=1, axis2=2)
    scale = 1.0 / jnp.sqrt(jnp.maximum(diagonal, jnp.finfo(blocks.dtype).tiny))
    even = blocks * scale[:, None, :, None] * frames_before(scale, width)[:, :, None, :]
    there = jnp.arange(frames)[:, None] >= jnp.arange(width)
    even = jnp.where(there[:, :, None, None], even, 0.0)
    ridge = dofs * jnp.finfo(blocks.dtype).eps
    one = jnp.eye(dofs, dtype=blocks.dtype)
    even = even.at[:, 0].add(ridge * one)

    def row(above, blocks):
        """A row of the factor by those of the `W` frames before it, the nearest first."""
        found = [jnp.zeros_like(blocks[0])] * width
        for w in range(width - 1, 0, -1):
            left = blocks[w] - sum(found[v] @ above[w - 1, v - w].T for v in range(w + 1, width))
            found[w] = left @ above[w - 1, 0].T
        corner = jnp.linalg.cholesky(blocks[0] - sum(part @ part.T for part in found[1:]))
        found[0] = solve_triangular(corner, one, lower=True)
        whole = jnp.stack(found)
        return jnp.concatenate([whole[None], above])[: width - 1], whole

    # no frame is before the first; a factor of one there leaves its zeros as they are
    none = jnp.zeros((width - 1, width, dofs, dofs), blocks.dtype).at[:, 0].set(one)
    with jax.default_matmul_precision("highest"):
        return jax.lax.scan(row, none, even)[1], scale


def _forward(factor: Float[Array, "F B D D"], sides: Float[Array, "F D"]) -> Float[Array, "F D"]:
    """`L^-1 b`."""

    def one(before, row):
        blocks, side = row
        known = _einsum("wij,wj->i", blocks[1:], before)
        found = _einsum("ij,j->i", blocks[0], side - known)
        return jnp.concatenate([found[None], before])[: len(before)], found

    none = jnp.zeros((factor.shape[1] - 1, factor.shape[2]), sides.dtype)
    return jax.lax.scan(one, none, (factor, sides))[1]


def _backward(factor: Float[Array, "F B D D"], sides: Float[Array, "F D"]) -> Float[Array, "F D"]:
    """`L^-T b`, from the last frame on. What a frame that is found takes from the sides of those before it is
    carried along, the nearest first."""

    def one(known, row):
        blocks, side = row
        found = _einsum("ij,i->j", blocks[0], side - known[0])
        passed = jnp.concatenate([known, jnp.zeros_like(found)[None]])[1:]
        taken = _einsum("wij,i->wj", blocks[1:], found)
        return passed.at[: len(taken)].add(taken), found

    none = jnp.zeros((factor.shape[1], factor.shape[2]), sides.dtype)
    return jax.lax.scan(one, none, (factor, sides), reverse=True)[1]


def frames_before(each: Shaped[Array, "F *D"], width: int) -> Shaped[Array, "F B *D"]:
    """What the frame itself has, the one before it, and so on; those before the first have
    the last ones'."""
    return jnp.stack([jnp.roll(each, w, 0) for w in range(width)], 1)
