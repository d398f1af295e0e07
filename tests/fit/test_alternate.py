"""Outer rounds on problems that are made anew."""

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

from jaxcap.fit.alternate import alternate, anneal_problem, minimise_reweighted
from jaxcap.fit.linear_solvers.dense import DenseMatrix
from jaxcap.fit.solvers.descent import ConstrainedInfo
from jaxcap.fit.solvers.least_squares_problem import AbstractProblem
from jaxcap.fit.solvers.levenberg_marquardt import LevenbergMarquardt


class Towards(AbstractProblem):
    """Find the place nearest to a target, and pay a toll wherever that is."""

    target: Float[Array, "2"]
    toll: Float[Array, ""]

    def value(self, y):
        return 0.5 * jnp.sum((y - self.target) ** 2) + self.toll

    def information(self, y):
        return ConstrainedInfo(self.value(y), y - self.target, DenseMatrix(jnp.eye(2)))  # pyright: ignore[reportCallIssue]

    def retract(self, y, d):
        return y + d

    def scales(self):
        return jnp.ones(2)


SOLVER = LevenbergMarquardt(rtol=0.0, atol=1e-12, damping=1e-3)


def test_stages_end_at_the_last_whatever_it_is_worth():
    met = []

    def remake(y, stage):
        met.append(np.asarray(y))
        return Towards(jnp.array([stage, 2.0 * stage]), jnp.asarray(stage**2))

    found = anneal_problem(remake, jnp.zeros(2), SOLVER, (1.0, 3.0), steps=20)
    np.testing.assert_allclose(found, [3.0, 6.0], atol=1e-9)
    # each stage begins where the last one ended
    np.testing.assert_allclose(met, [[0.0, 0.0], [1.0, 2.0]], atol=1e-9)


def test_rounds_keep_the_best_and_stop_where_nothing_is_gained():
    # the target runs away and the toll rises with how far the place has gone beyond one
    def remake(y):
        return Towards(y + jnp.array([1.0, 0.0]), 10.0 * jnp.maximum(y[0] - 1.0, 0.0))

    found = alternate(remake, jnp.array([-2.0, 0.0]), SOLVER, rounds=12, steps=20, patience=2)
    assert found.value == min(found.history) == pytest.approx(0.5)
    assert len(found.history) < 12


def test_weak_types_are_not_compiled_again():
    traced = []

    class Counted(Towards):
        def value(self, y):
            traced.append(y.weak_type or self.toll.weak_type)
            return super().value(y)

    def update(number, problem, y):
        return Counted(problem.target, jnp.asarray(2.0)), jnp.full(2, 0.5), number == 3

    first = Counted(jnp.ones(2), jnp.asarray(1.0))
    minimise_reweighted(
        first, jnp.full(2, 0.0), update, lambda number: 1e-3, SOLVER, rounds=2, steps=3, max_steps=20
    )
    once = len(traced)
    minimise_reweighted(
        first, jnp.zeros(2), update, lambda number: 1e-3, SOLVER, rounds=4, steps=3, max_steps=40
    )
    assert once == len(traced)
    assert not any(traced)
