"""Block-arrow equations against dense solutions."""

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import pytest

from jaxcap.errors import InputError
from jaxcap.fit.linear_solvers.block_arrow import BlockArrow
from jaxcap.fit.linear_solvers.block_banded import BlockBanded
from jaxcap.fit.linear_solvers.structured import StructuredCholesky, damped
from jaxcap.fit.solvers.equalities import Equalities


def random_rows(rng, frames=4, dofs=5, shared=3, count=11):
    """Rows of a least-squares problem, frame by frame: by own unknowns, by shared ones, residual."""
    return [
        rng.normal(size=shape) for shape in ((frames, count, dofs), (frames, count, shared), (frames, count))
    ]


def arrow_of(own, common, residual):
    """The matrix, and the right side."""
    frames = BlockBanded(jnp.einsum("fri,frj->fij", own, own)[:, None])
    coupling, shared = jnp.einsum("fri,frs->fis", own, common), jnp.einsum("frs,frt->st", common, common)
    side = jnp.einsum("fri,fr->fi", own, residual), jnp.einsum("frs,fr->s", common, residual)
    return BlockArrow(frames, coupling, shared), side


def solved(own, common, residual, equalities=None, damping=None):
    arrow, side = arrow_of(own, common, residual)
    arrow = arrow if damping is None else damped(arrow, jnp.asarray(damping))
    return arrow.factorise().solve(side, equalities)


def dense_of(own, common):
    frames, count, dofs = own.shape
    wide = np.zeros((frames * count, frames * dofs + common.shape[2]))
    for frame in range(frames):
        rows = slice(frame * count, (frame + 1) * count)
        wide[rows, frame * dofs : (frame + 1) * dofs] = own[frame]
        wide[rows, frames * dofs :] = common[frame]
    return wide


def test_schur_is_dense_least_squares(rng):
    own, common, residual = random_rows(rng)
    by_frame, shared = solved(own, common, residual)
    expected = np.linalg.lstsq(dense_of(own, common), residual.ravel(), rcond=None)[0]
    np.testing.assert_allclose(np.append(by_frame.ravel(), shared), expected, rtol=1e-9, atol=1e-11)


def test_the_linear_solver_is_differentiable_and_takes_structures_only(rng):
    own, common, residual = random_rows(rng)
    _, side = arrow_of(own, common, residual)

    def shared(own):
        matrix = arrow_of(own, common, residual)[0]
        return jnp.sum(lx.linear_solve(matrix, side, StructuredCholesky()).value[1] ** 2)

    step = 1e-6 * rng.normal(size=own.shape)
    slope = float(jnp.vdot(jax.grad(shared)(jnp.asarray(own)), step))
    assert slope == pytest.approx(float(shared(own + step) - shared(own - step)) / 2, rel=1e-6)
    with pytest.raises(InputError, match="a MatrixLinearOperator; expected one with a structure"):
        lx.linear_solve(lx.MatrixLinearOperator(jnp.eye(2)), jnp.ones(2), StructuredCholesky())


def test_constraints_hold_and_the_rest_is_least(rng):
    own, common, residual = random_rows(rng)
    rows, violation = rng.normal(size=(2, 3)), rng.normal(size=2)
    by_frame, shared = solved(own, common, residual, Equalities(jnp.asarray(rows), jnp.asarray(violation)))
    np.testing.assert_allclose(rows @ shared, violation, atol=1e-10)
    # Karush-Kuhn-Tucker, dense
    wide = dense_of(own, common)
    count = wide.shape[1]
    kkt = np.zeros((count + 2, count + 2))
    kkt[:count, :count] = wide.T @ wide
    kkt[count:, count - 3 : count] = rows
    kkt[count - 3 : count, count:] = rows.T
    expected = np.linalg.solve(kkt, np.append(wide.T @ residual.ravel(), violation))[:count]
    np.testing.assert_allclose(np.append(by_frame.ravel(), shared), expected, rtol=1e-7, atol=1e-9)


def test_nothing_shared(rng):
    own, common, residual = random_rows(rng, shared=0)
    by_frame, shared = solved(own, common, residual)
    assert shared.shape == (0,)
    for frame in range(len(own)):
        expected = np.linalg.lstsq(own[frame], residual[frame], rcond=None)[0]
        np.testing.assert_allclose(by_frame[frame], expected, rtol=1e-9)


@pytest.mark.parametrize("damping", [0.0, 1e3])
def test_damping_makes_unknowns_without_data_stay(rng, damping):
    own, common, residual = random_rows(rng)
    own[:, :, 1], common[:, :, 2] = 0.0, 0.0
    by_frame, shared = solved(own, common, residual, damping=damping)
    assert np.isfinite(by_frame).all() and np.isfinite(shared).all()
    np.testing.assert_allclose(by_frame[:, 1], 0.0, atol=1e-12)
    np.testing.assert_allclose(shared[2], 0.0, atol=1e-12)
    if damping:
        # the step of much damping is the scaled gradient
        diagonal = np.einsum("fri,fri->fi", own, own)
        gradient = np.einsum("fri,fr->fi", own, residual)
        known = [0, 2, 3, 4]
        np.testing.assert_allclose(
            by_frame[:, known], gradient[:, known] / diagonal[:, known] / (1 + damping), rtol=2e-2, atol=1e-5
        )
