"""Projection onto implicit limit surfaces."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .chart import Chart
from .primitives import Primitives, field, radii

#: rounds of a straight step to the surface and a tangential step along it; bisections of a straight step
ROUNDS, NUM_BISECTIONS = 3, 5
#: margin of the field above the level, so that rounding does not put a point outside again
LEVEL_MARGIN = 0.02


def project_inside(primitives: Primitives, chart: Chart, point: Float[Array, "3"]) -> Float[Array, "3"]:
    """Find the allowed point nearest to a forbidden one, by rotation distance.

    Every primitive contains a ball that is inside the surface by itself. The nearest point of these balls
    is allowed and no further than the nearest sample, so the search starts there. It goes straight towards
    the point until it reaches the surface, which blends the balls. Then it follows the surface until the
    direction to the point is normal to it.
    """

    def inside(x):
        return field(primitives, x) >= primitives.level + LEVEL_MARGIN / 2

    def squared_distance(x):
        return chart.squared_distance(x, point)

    def improve(_, place):
        edge = _last_inside(inside, place, chart.unwrap(point, place))
        normal = _unit(jax.grad(lambda x: field(primitives, x))(edge))
        down = -jax.grad(squared_distance)(edge) / 2
        aside = edge + down - jnp.sum(down * normal) * normal
        aside = jnp.where(inside(aside), aside, _nearest_ball_point(primitives, chart, aside))
        best = jnp.where(squared_distance(edge) < squared_distance(place), edge, place)
        return jnp.where(inside(aside) & (squared_distance(aside) < squared_distance(best)), aside, best)

    # in one dimension there is no tangential direction
    rounds = 1 if chart.dimension == 1 else ROUNDS
    return jax.lax.fori_loop(0, rounds, improve, _nearest_ball_point(primitives, chart, point))


def _nearest_ball_point(primitives: Primitives, chart: Chart, point: Float[Array, "3"]) -> Float[Array, "3"]:
    """Find the nearest point of the balls, by rotation distance."""
    squared_distances = jax.vmap(chart.squared_distance, (0, None))(primitives.centres, point)
    reach = radii(primitives) - LEVEL_MARGIN * primitives.unit / primitives.stiffness
    nearest = jnp.argmin(jnp.sqrt(jnp.maximum(squared_distances, 0.0)) - reach)
    centre, radius = primitives.centres[nearest], reach[nearest]
    towards = -jax.grad(chart.squared_distance)(centre, point)
    away = jnp.linalg.norm(chart.unwrap(point, centre) - centre)
    return centre + jnp.minimum(radius, away) * _unit(towards)


def _last_inside(inside, start: Float[Array, "3"], end: Float[Array, "3"]) -> Float[Array, "3"]:
    """Find the last allowed point from an allowed start towards a forbidden end, by bisection."""

    def halve(_, shares):
        low, high = shares
        middle = (low + high) / 2
        there: Bool[Array, ""] = inside(start + middle * (end - start))
        return jnp.where(there, middle, low), jnp.where(there, high, middle)

    zero = jnp.zeros((), start.dtype)
    low, _ = jax.lax.fori_loop(0, NUM_BISECTIONS, halve, (zero, zero + 1.0))
    return start + low * (end - start)


def _unit(x: Float[Array, "3"]) -> Float[Array, "3"]:
    squared = jnp.sum(x**2)
    some = squared > 1e-24
    return jnp.where(some, x / jnp.sqrt(jnp.where(some, squared, 1.0)), 0.0)
