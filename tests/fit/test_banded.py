"""Block-banded equations against dense ones."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcap.fit.linear_solvers.block_banded import BlockBanded
from jaxcap.fit.solvers.bounded_least_squares import solve_bounded

SHAPES = [(1, 0, 3), (6, 1, 4), (11, 2, 5), (7, 3, 1), (2, 2, 3)]

diagonal_inverse = jax.jit(lambda banded: banded.factorise().inverse_diagonal_blocks())
solve, boxed = jax.jit(lambda banded, sides: banded.solve(sides)), jax.jit(solve_bounded)


def random_rows(rng, frames, width, dofs):
    """Rows that each touch `width + 1` frames, enough of them to tell all numbers, and what they are from their aim."""
    count = frames + width
    slopes = rng.normal(size=(count, width + 1, 2 * dofs, dofs))
    return slopes, rng.normal(size=(count, 2 * dofs))


def banded_equations(slopes, residuals):
    """Sum `J^T J` and `J^T r` of rows that each touch successive frames: rows `k` by the numbers of the frames from `k` on."""
    count, width, _, dofs = slopes.shape
    blocks = jnp.zeros((count + width - 1, width, dofs, dofs), slopes.dtype)
    sides = jnp.zeros((count + width - 1, dofs), slopes.dtype)
    for later in range(width):
        here = slice(later, later + count)
        sides = sides.at[here].add(jnp.einsum("krd,kr->kd", slopes[:, later], residuals))
        for before in range(later + 1):
            products = jnp.einsum("kri,krj->kij", slopes[:, later], slopes[:, later - before])
            blocks = blocks.at[here, before].add(products)
    return BlockBanded(blocks), sides


def random_banded(rng, frames, width, dofs):
    """Equations that rows of more frames leave, cut to those in the middle: what lies before the first is not zero."""
    banded, sides = banded_equations(*map(jnp.asarray, random_rows(rng, frames, width, dofs)))
    return BlockBanded(banded.blocks[width : width + frames]), sides[width : width + frames]


def dense_of(banded) -> np.ndarray:
    blocks = np.asarray(banded.blocks)
    frames, width, dofs, _ = blocks.shape
    matrix = np.zeros((frames, dofs, frames, dofs))
    for frame in range(frames):
        for w in range(min(width, frame + 1)):
            matrix[frame, :, frame - w] = blocks[frame, w]
            matrix[frame - w, :, frame] = blocks[frame, w].T
    return matrix.reshape(frames * dofs, frames * dofs)


@pytest.mark.parametrize(("frames", "width", "dofs"), SHAPES)
def test_solution_is_that_of_the_dense_matrix(rng, frames, width, dofs):
    banded, sides = random_banded(rng, frames, width, dofs)
    matrix = dense_of(banded)
    expected = np.linalg.solve(matrix, np.ravel(sides)).reshape(frames, dofs)
    np.testing.assert_allclose(solve(banded, sides), expected, rtol=1e-9, atol=1e-11)
    x = rng.normal(size=(frames, dofs))
    for product, dense in ((banded.mv, matrix), (banded.abs_mv, np.abs(matrix))):
        np.testing.assert_allclose(
            np.ravel(product(jnp.asarray(x))), dense @ x.ravel(), rtol=1e-12, atol=1e-12
        )


@pytest.mark.parametrize(("frames", "width", "dofs"), SHAPES)
def test_blocks_of_the_inverse_are_those_of_the_dense_inverse(rng, frames, width, dofs):
    banded, _ = random_banded(rng, frames, width, dofs)
    inverse = np.linalg.inv(dense_of(banded)).reshape(frames, dofs, frames, dofs)
    expected = inverse[np.arange(frames), :, np.arange(frames)]
    np.testing.assert_allclose(diagonal_inverse(banded), expected, rtol=1e-9, atol=1e-11)


def test_equations_are_those_of_the_rows(rng):
    slopes, apart = random_rows(rng, 5, 2, 3)
    count, width, rows, dofs = slopes.shape
    wide = np.zeros((count, rows, count + 2, dofs))
    for k in range(count):
        wide[k, :, k : k + width] = slopes[k].transpose(1, 0, 2)
    wide = wide.reshape(count * rows, -1)
    banded, sides = banded_equations(jnp.asarray(slopes), jnp.asarray(apart))
    np.testing.assert_allclose(dense_of(banded), wide.T @ wide, atol=1e-12)
    np.testing.assert_allclose(np.ravel(sides), wide.T @ apart.ravel(), atol=1e-12)


def test_derivatives_of_a_solution_against_differences(rng):
    slopes, apart = map(jnp.asarray, random_rows(rng, 4, 2, 2))
    weights, ways = rng.normal(size=(8, 2)), [jnp.asarray(rng.normal(size=a.shape)) for a in (slopes, apart)]
    traces = []

    @jax.jit
    def value(slopes, apart):
        traces.append(slopes)
        return jnp.sum(weights * jnp.sin(solve(*banded_equations(slopes, apart))))

    h = 1e-6
    ends = [float(value(slopes + s * h * ways[0], apart + s * h * ways[1])) for s in (1, -1)]
    assert len(traces) == 1
    expected = (ends[0] - ends[1]) / (2 * h)
    gradients = jax.grad(value, (0, 1))(slopes, apart)
    reverse = sum(float(jnp.vdot(g, way)) for g, way in zip(gradients, ways, strict=True))
    forward = float(jax.jvp(value, (slopes, apart), tuple(ways))[1])
    assert abs(expected) > 1e-3
    assert reverse == pytest.approx(expected, rel=1e-6)
    assert forward == pytest.approx(reverse, rel=1e-12)


def test_single_precision_bears_stiffness_and_numbers_that_are_all_but_one(rng):
    """Units of some numbers are 10^5 times as large as those of others, and two numbers do nearly the same."""
    slopes, _ = random_rows(rng, 11, 2, 4)
    slopes[..., 3] = slopes[..., 2] + 1e-5 * slopes[..., 3]
    units = 10.0 ** rng.uniform(-3, 3, size=4)
    banded, _ = banded_equations(jnp.asarray(slopes * units), jnp.zeros(slopes.shape[0::2]))
    stiff = BlockBanded(banded.blocks.astype(jnp.float32))
    matrix = dense_of(stiff)
    x = rng.normal(size=matrix.shape[:1]) / np.tile(units, len(matrix) // 4)
    sides = (matrix @ x).reshape(-1, 4)
    found = solve(stiff, jnp.asarray(sides, jnp.float32))
    assert found.dtype == jnp.float32
    # what the two do together is told, and all else
    left = (matrix @ np.ravel(found)).reshape(-1, 4) - sides
    np.testing.assert_allclose(left / units, 0.0, atol=1e-3 * np.abs(sides / units).max())
    told = [
        np.stack([y[:, 0], y[:, 1], y[:, 2] + y[:, 3]])
        for y in (np.asarray(found) * units, x.reshape(-1, 4) * units)
    ]
    np.testing.assert_allclose(told[0], told[1], atol=1e-3)


def test_bounds_are_kept_as_with_the_dense_matrix(rng):
    banded, sides = random_banded(rng, 6, 2, 3)
    free = np.abs(np.asarray(solve(banded, sides)))
    low, high = (
        -rng.uniform(0, 1, size=free.shape) * free.max(),
        rng.uniform(0, 1, size=free.shape) * free.max(),
    )
    low[0], high[0] = -np.inf, np.inf
    found = np.asarray(boxed(banded, sides, jnp.asarray(low), jnp.asarray(high)))
    dense = boxed(dense_of(banded), *(jnp.asarray(np.ravel(part)) for part in (sides, low, high)))
    np.testing.assert_allclose(np.ravel(found), dense, atol=1e-10)
    # Karush-Kuhn-Tucker: some at their bounds, drawn outwards; no slope by the others
    slope = np.asarray(banded.mv(jnp.asarray(found)) - sides)
    at = np.where(found == low, -1, np.where(found == high, 1, 0))
    assert (at < 0).any() and (at > 0).any() and (at == 0).any()
    assert (at * slope <= 0).all()
    np.testing.assert_allclose(slope[at == 0], 0.0, atol=1e-9)
    assert ((found >= low) & (found <= high)).all()
