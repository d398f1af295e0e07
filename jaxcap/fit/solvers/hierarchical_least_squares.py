"""One step of hierarchical least squares: each level in the null space of those above, with inequalities
among the rows of the upper levels.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_solve
from jaxtyping import Array, Bool, Float

#: longest step of a level, in scaled units: radians, and `LEVER_ARM` metres
MAX_STEP = 1.0
#: largest number of active-set iterations in one step
MAX_ITERATIONS = 10


class LinearSystem(NamedTuple):
    """A linear system `residual + jacobian d = 0`, in scaled tangents."""

    residual: Float[Array, "R"]
    jacobian: Float[Array, "R D"]


class _ActiveSet(NamedTuple):
    """The active set of the upper rows, and their linearisation `value + slope d` beyond the bound, of the
    sign `sign`.
    """

    active: Bool[Array, "R"]
    value: Float[Array, "R"]
    slope: Float[Array, "R D"]
    sign: Float[Array, "R"]


class Damping(NamedTuple):
    """The damping added to the curvatures of levels.

    A constant for all levels. For levels below the first also a share of their stiffest curvature, where
    their own curvature is too small a part of the whole.
    """

    constant: Float[Array, ""]
    relative: Float[Array, ""]


def hierarchical_step(levels: list[LinearSystem], damping: Damping) -> Float[Array, "D"]:
    """Compute the step of all levels, highest first (Baerlocher and Boulic 2004),

        d <- d - (J N)^+ (r + J d),    N <- N - (J N)^+ (J N).

    Pseudo-inverses are computed from the eigenvectors of `N J^T J N`. The projector uses the whole range
    above rounding; the step is damped, so that no level moves further than `MAX_STEP`.
    """
    size, dtype = levels[0].jacobian.shape[1], levels[0].jacobian.dtype
    d, free = jnp.zeros(size, dtype), jnp.eye(size, dtype=dtype)
    for number, (residual, jacobian) in enumerate(levels):
        normal = jacobian.T @ jacobian
        stiffest = jnp.linalg.norm(normal)
        values, vectors = jnp.linalg.eigh(free @ normal @ free)
        significant = values > size * jnp.finfo(dtype).eps * stiffest
        # eigenvectors of small values leave the free space by rounding
        vectors = jnp.where(significant, free @ vectors, 0.0)
        gradient = vectors.T @ (jacobian.T @ (residual + jacobian @ d))
        values = jnp.where(significant, values, 1.0)
        # with damping l^2 a step is at most c / 2 l long, where c is the length of the reducible residual
        limit = jnp.sum(gradient**2 / values) / (2 * MAX_STEP) ** 2
        added = damping.constant + (damping.relative * stiffest if number else 0.0)
        d = d - vectors @ (gradient / (values + added + limit))
        free = free - vectors @ vectors.T
    return d


def constrained_step(
    levels: list[LinearSystem], linearise_upper: Callable[[Float[Array, "D"]], LinearSystem], damping: Damping
) -> tuple[Float[Array, "D"], list[LinearSystem]]:
    """Compute the step of all levels that crosses no bound of an upper level, and the rows used as equations.

    **Arguments:** `linearise_upper(d)` linearises all levels but the last after a step `d`, concatenated. A
    row is an inequality if it is zero on one side of the pose or on both. It is active if the step would
    cross its bound, and is released if the step without it would lead back inside (a primal-dual active set,
    Hintermueller and others 2003, with multipliers of all lower levels in turn, Escande and others 2014).
    """
    here = _concatenate(levels[:-1])
    size, tolerance = here.jacobian.shape[1], jnp.sqrt(jnp.finfo(here.residual.dtype).eps)
    # a step along which no row of one or a few unknowns is stationary
    probe = 100 * tolerance * (1.5 + jnp.cos(jnp.arange(size, dtype=here.residual.dtype)))
    ahead, behind = (
        LinearSystem(*side)
        for side in zip(*jax.vmap(linearise_upper)(jnp.stack([probe, -probe])), strict=True)
    )
    near = jnp.abs(here.residual) <= tolerance * _row_norms(here.jacobian)
    loose = near & ((ahead.residual == 0) | (behind.residual == 0))
    forward = ahead.residual != 0
    beyond = LinearSystem(
        jnp.where(
            forward, ahead.residual - ahead.jacobian @ probe, behind.residual + behind.jacobian @ probe
        ),
        jnp.where(forward[:, None], ahead.jacobian, behind.jacobian),
    )
    passed = here.residual != 0
    known = LinearSystem(
        jnp.where(passed, here.residual, beyond.residual),
        jnp.where(passed[:, None], here.jacobian, beyond.jacobian),
    )
    side = jnp.sign(jnp.where(forward, ahead.residual, behind.residual))

    def chosen(choice: _ActiveSet) -> list[LinearSystem]:
        residual = jnp.where(loose, jnp.where(choice.active, choice.value, 0.0), here.residual)
        jacobian = jnp.where(
            loose[:, None], jnp.where(choice.active[:, None], choice.slope, 0.0), here.jacobian
        )
        edges = np.cumsum([len(level.residual) for level in levels[:-2]])
        parts = (jnp.split(array, edges) for array in (residual, jacobian))
        return [*(LinearSystem(r, j) for r, j in zip(*parts, strict=True)), levels[-1]]

    def unsettled(carry):
        _, _, changed, passes = carry
        return changed & (passes < MAX_ITERATIONS)

    def choose(carry):
        choice, _, _, passes = carry
        rows = chosen(choice)
        d = hierarchical_step(rows, damping)
        there = linearise_upper(d)
        over = loose & ~choice.active & (jnp.abs(there.residual) > tolerance * _row_norms(there.jacobian))
        # a bound that was not near, or the other one of two, is linearised beyond where it is crossed
        new = over & (~(choice.slope != 0).any(1) | (jnp.sign(there.residual) != choice.sign))
        # in later passes nothing is released, so that no active set can cycle
        back = loose & choice.active & _find_releasable(rows, d, choice.sign) & (passes < MAX_ITERATIONS // 2)
        choice = _ActiveSet(
            (choice.active & ~back) | over,
            jnp.where(new, there.residual - there.jacobian @ d, choice.value),
            jnp.where(new[:, None], there.jacobian, choice.slope),
            jnp.where(new, jnp.sign(there.residual), choice.sign),
        )
        return choice, (d, rows), (over | back).any(), passes + 1

    none = _ActiveSet(jnp.zeros_like(loose), *known, side)
    start = none, (jnp.zeros_like(probe), chosen(none)), jnp.array(True), jnp.array(0)
    return jax.lax.while_loop(unsettled, choose, start)[1]


def _find_releasable(
    levels: list[LinearSystem], d: Float[Array, "D"], sign: Float[Array, "R"]
) -> Bool[Array, "R"]:
    """Find the active upper rows that keep the step from going inside.

    They are found from the effect of other rows of their own level, and otherwise by the first lower level
    that acts on them (its multipliers).
    """
    upper = _concatenate(levels[:-1])
    tolerance = jnp.sqrt(jnp.finfo(d.dtype).eps)
    floor = tolerance * _row_norms(upper.jacobian)
    after = sign * (upper.residual + upper.jacobian @ d)
    back = after < jnp.minimum(sign * upper.residual, 0.0) - floor
    felt = back | (after > jnp.maximum(sign * upper.residual, 0.0) + floor)
    for number in range(1, len(levels)):
        above, level = _concatenate(levels[:number]), levels[number]
        normal = above.jacobian.T @ above.jacobian
        ridge = 10 * len(d) * jnp.finfo(d.dtype).eps * jnp.linalg.norm(normal) + jnp.finfo(d.dtype).tiny
        factor = jnp.linalg.cholesky(normal + ridge * jnp.eye(len(d), dtype=d.dtype))
        gradient = level.jacobian.T @ (level.residual + level.jacobian @ d)
        count = len(above.residual)
        forces = -sign[:count] * (above.jacobian @ cho_solve((factor, True), gradient))
        there = jnp.abs(forces) * _row_norms(above.jacobian) > tolerance * jnp.linalg.norm(gradient)
        first = there & ~felt[:count]
        back = back.at[:count].set(jnp.where(first, forces < 0, back[:count]))
        felt = felt.at[:count].set(felt[:count] | there)
    return back


def _concatenate(levels: list[LinearSystem]) -> LinearSystem:
    return LinearSystem(*(jnp.concatenate(arrays) for arrays in zip(*levels, strict=True)))


def _row_norms(jacobian: Float[Array, "R D"]) -> Float[Array, "R"]:
    return jnp.sqrt(jnp.sum(jacobian**2, 1))
