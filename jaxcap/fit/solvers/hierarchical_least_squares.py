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

#: longest step of a level, in scaled units: radians, and `LEVER` metres
REACH = 1.0
#: largest number of active-set iterations in one step
PASSES = 10


class Rows(NamedTuple):
    """A linear system `residual + jacobian d = 0`, in scaled tangents."""

    residual: Float[Array, "R"]
    jacobian: Float[Array, "R D"]


class _Choice(NamedTuple):
    """The active set of the upper rows, and their linearisation `value + slope d` beyond the bound, of the
    sign `side`.
    """

    held: Bool[Array, "R"]
    value: Float[Array, "R"]
    slope: Float[Array, "R D"]
    side: Float[Array, "R"]


class Damping(NamedTuple):
    """The damping added to the curvatures of levels.

    A constant for all levels. For levels below the first also a share of their stiffest curvature, where
    their own curvature is too small a part of the whole.
    """

    constant: Float[Array, ""]
    share: Float[Array, ""]


def descend(levels: list[Rows], damping: Damping) -> Float[Array, "D"]:
    """Compute the step of all levels, highest first (Baerlocher and Boulic 2004),

        d <- d - (J N)^+ (r + J d),    N <- N - (J N)^+ (J N).

    Pseudo-inverses are computed from the eigenvectors of `N J^T J N`. The projector uses the whole range
    above rounding; the step is damped, so that no level moves further than `REACH`.
    """
    size, dtype = levels[0].jacobian.shape[1], levels[0].jacobian.dtype
    d, free = jnp.zeros(size, dtype), jnp.eye(size, dtype=dtype)
    for number, (residual, jacobian) in enumerate(levels):
        normal = jacobian.T @ jacobian
        stiffest = jnp.linalg.norm(normal)
        values, vectors = jnp.linalg.eigh(free @ normal @ free)
        held = values > size * jnp.finfo(dtype).eps * stiffest
        # eigenvectors of small values leave the free space by rounding
        vectors = jnp.where(held, free @ vectors, 0.0)
        gradient = vectors.T @ (jacobian.T @ (residual + jacobian @ d))
        values = jnp.where(held, values, 1.0)
        # with damping l^2 a step is at most c / 2 l long, where c is the length of the reducible residual
        limit = jnp.sum(gradient**2 / values) / (2 * REACH) ** 2
        added = damping.constant + (damping.share * stiffest if number else 0.0)
        d = d - vectors @ (gradient / (values + added + limit))
        free = free - vectors @ vectors.T
    return d


def constrained(
    levels: list[Rows], upper: Callable[[Float[Array, "D"]], Rows], damping: Damping
) -> tuple[Float[Array, "D"], list[Rows]]:
    """Compute the step of all levels that crosses no bound of an upper level, and the rows used as equations.

    **Arguments:** `upper(d)` linearises all levels but the last after a step `d`, concatenated. A row is an
    inequality if it is zero on one side of the pose or on both. It is active if the step would cross its
    bound, and is released if the step without it would lead back inside (a primal-dual active set,
    Hintermueller and others 2003, with multipliers of all lower levels in turn, Escande and others 2014).
    """
    here = _stacked(levels[:-1])
    size, tolerance = here.jacobian.shape[1], jnp.sqrt(jnp.finfo(here.residual.dtype).eps)
    # a step along which no row of one or a few unknowns is stationary
    probe = 100 * tolerance * (1.5 + jnp.cos(jnp.arange(size, dtype=here.residual.dtype)))
    ahead, behind = (Rows(*side) for side in zip(*jax.vmap(upper)(jnp.stack([probe, -probe])), strict=True))
    near = jnp.abs(here.residual) <= tolerance * _norms(here.jacobian)
    loose = near & ((ahead.residual == 0) | (behind.residual == 0))
    forward = ahead.residual != 0
    beyond = Rows(
        jnp.where(
            forward, ahead.residual - ahead.jacobian @ probe, behind.residual + behind.jacobian @ probe
        ),
        jnp.where(forward[:, None], ahead.jacobian, behind.jacobian),
    )
    passed = here.residual != 0
    known = Rows(
        jnp.where(passed, here.residual, beyond.residual),
        jnp.where(passed[:, None], here.jacobian, beyond.jacobian),
    )
    side = jnp.sign(jnp.where(forward, ahead.residual, behind.residual))

    def chosen(choice: _Choice) -> list[Rows]:
        residual = jnp.where(loose, jnp.where(choice.held, choice.value, 0.0), here.residual)
        jacobian = jnp.where(
            loose[:, None], jnp.where(choice.held[:, None], choice.slope, 0.0), here.jacobian
        )
        edges = np.cumsum([len(level.residual) for level in levels[:-2]])
        parts = (jnp.split(array, edges) for array in (residual, jacobian))
        return [*(Rows(r, j) for r, j in zip(*parts, strict=True)), levels[-1]]

    def unsettled(carry):
        _, _, changed, passes = carry
        return changed & (passes < PASSES)

    def choose(carry):
        choice, _, _, passes = carry
        rows = chosen(choice)
        d = descend(rows, damping)
        there = upper(d)
        over = loose & ~choice.held & (jnp.abs(there.residual) > tolerance * _norms(there.jacobian))
        # a bound that was not near, or the other one of two, is linearised beyond where it is crossed
        new = over & (~(choice.slope != 0).any(1) | (jnp.sign(there.residual) != choice.side))
        # in later passes nothing is released, so that no active set can cycle
        back = loose & choice.held & _leads_back(rows, d, choice.side) & (passes < PASSES // 2)
        choice = _Choice(
            (choice.held & ~back) | over,
            jnp.where(new, there.residual - there.jacobian @ d, choice.value),
            jnp.where(new[:, None], there.jacobian, choice.slope),
            jnp.where(new, jnp.sign(there.residual), choice.side),
        )
        return choice, (d, rows), (over | back).any(), passes + 1

    none = _Choice(jnp.zeros_like(loose), *known, side)
    start = none, (jnp.zeros_like(probe), chosen(none)), jnp.array(True), jnp.array(0)
    return jax.lax.while_loop(unsettled, choose, start)[1]


def _leads_back(levels: list[Rows], d: Float[Array, "D"], side: Float[Array, "R"]) -> Bool[Array, "R"]:
    """Find the active upper rows that keep the step from going inside.

    They are found from the effect of other rows of their own level, and otherwise by the first lower level
    that acts on them (its multipliers).
    """
    upper = _stacked(levels[:-1])
    tolerance = jnp.sqrt(jnp.finfo(d.dtype).eps)
    floor = tolerance * _norms(upper.jacobian)
    after = side * (upper.residual + upper.jacobian @ d)
    back = after < jnp.minimum(side * upper.residual, 0.0) - floor
    felt = back | (after > jnp.maximum(side * upper.residual, 0.0) + floor)
    for number in range(1, len(levels)):
        above, level = _stacked(levels[:number]), levels[number]
        normal = above.jacobian.T @ above.jacobian
        ridge = 10 * len(d) * jnp.finfo(d.dtype).eps * jnp.linalg.norm(normal) + jnp.finfo(d.dtype).tiny
        factor = jnp.linalg.cholesky(normal + ridge * jnp.eye(len(d), dtype=d.dtype))
        gradient = level.jacobian.T @ (level.residual + level.jacobian @ d)
        count = len(above.residual)
        forces = -side[:count] * (above.jacobian @ cho_solve((factor, True), gradient))
        there = jnp.abs(forces) * _norms(above.jacobian) > tolerance * jnp.linalg.norm(gradient)
        first = there & ~felt[:count]
        back = back.at[:count].set(jnp.where(first, forces < 0, back[:count]))
        felt = felt.at[:count].set(felt[:count] | there)
    return back


def _stacked(levels: list[Rows]) -> Rows:
    return Rows(*(jnp.concatenate(arrays) for arrays in zip(*levels, strict=True)))


def _norms(jacobian: Float[Array, "R D"]) -> Float[Array, "R"]:
    return jnp.sqrt(jnp.sum(jacobian**2, 1))
