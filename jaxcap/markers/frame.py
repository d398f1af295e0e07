"""The pose of one frame: robust Levenberg-Marquardt with derivatives in closed form."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg
from jaxtyping import Array, Bool, Float, Int

from ..body.pose import Pose, retract
from .residuals import linearise, marker_residuals
from .robust import kernel, spread
from .subject import Subject


class Search(eqx.Module):
    """When the search for a pose ends."""

    iterations: int = eqx.field(static=True, default=12)
    #: radians and metres: no number of the last step was larger
    tolerance: float = eqx.field(static=True, default=1e-3)


class SolvedFrame(NamedTuple):
    """One frame's pose, and what it leaves of the M markers that were seen."""

    pose: Pose
    #: metres; zero where not seen
    residuals: Float[Array, "M"]
    #: 0 to 1, what each marker counts in the end; zero where not seen
    weights: Float[Array, "M"]
    #: standard deviations that residuals are long at their median, at least one
    spread: Float[Array, ""]
    iterations: Int[Array, ""]


class _State(NamedTuple):
    pose: Pose
    damping: Float[Array, ""]
    step: Float[Array, ""]
    count: Int[Array, ""]


def solve_frame(
    subject: Subject,
    start: Pose,
    places: Float[Array, "M 3"],
    seen: Bool[Array, "M"],
    search: Search = Search(),
) -> SolvedFrame:
    """The pose with the least robust distances to the markers that are seen, in standard deviations.

    Deviations are widened by the median of the residuals, so that a start from far off, or a subject
    that fits badly, takes no marker for a swapped one. Numbers of the pose that no seen marker tells
    stay as they are at the start. Never fails: without markers the start comes back.
    """
    information = jnp.where(seen, subject.weights / subject.deviations**2, 0.0)
    counted = information > 0

    def squares(pose):
        residual = marker_residuals(subject, pose, places)
        return jnp.sum(residual**2, 1) * information

    def improve(state: _State) -> _State:
        rows = linearise(subject, state.pose, places)
        squared = jnp.sum(rows.residual**2, 1) * information
        wide = spread(squared, counted)
        costs, slopes = kernel(squared / wide)
        # in units of the widened variance, so that the cost falls where the step is good
        weights = slopes * information / wide
        flat = rows.by_pose.reshape(-1, rows.by_pose.shape[2])
        weighted = flat * jnp.repeat(weights, 3)[:, None]
        matrix, side = weighted.T @ flat, -(weighted.T @ rows.residual.reshape(-1))
        step = _damped_step(matrix, side, state.damping)
        trial = retract(subject.skeleton, state.pose, step)
        better = jnp.sum(kernel(squares(trial) / wide)[0]) <= jnp.sum(costs)
        pose = jax.tree.map(lambda new, old: jnp.where(better, new, old), trial, state.pose)
        damping = jnp.where(better, state.damping * 0.1, jnp.maximum(state.damping, 1e-4) * 10.0)
        size = jnp.max(jnp.abs(step))
        return _State(pose, jnp.maximum(damping, 1e-7), jnp.where(better, size, state.step), state.count + 1)

    def goes_on(state: _State):
        # a step that is refused again and again has come to the end of what the precision shows
        return (state.count < search.iterations) & (state.step > search.tolerance) & (state.damping < 1e3)

    dtype = places.dtype
    first = _State(start, jnp.asarray(1e-6, dtype), jnp.asarray(jnp.inf, dtype), jnp.asarray(0))
    state = jax.lax.while_loop(goes_on, improve, first)
    residual = marker_residuals(subject, state.pose, places)
    squared = jnp.sum(residual**2, 1) * information
    wide = spread(squared, counted)
    return SolvedFrame(
        state.pose,
        jnp.where(seen, jnp.sqrt(jnp.sum(residual**2, 1)), 0.0),
        jnp.where(counted, kernel(squared / wide)[1], 0.0),
        jnp.sqrt(wide),
        state.count,
    )


def _damped_step(matrix: Float[Array, "D D"], side: Float[Array, "D"], damping) -> Float[Array, "D"]:
    """The step on equilibrated equations: a number that no marker tells has no slope and stays."""
    diagonal = jnp.diag(matrix)
    # information of a marker with a deviation of a metre at a metre from its joint: as good as none
    told = diagonal > 1.0
    scale = jnp.where(told, 1.0 / jnp.sqrt(jnp.where(told, diagonal, 1.0)), 0.0)
    even = matrix * scale[:, None] * scale[None, :]
    ridge = damping + len(matrix) * jnp.finfo(matrix.dtype).eps
    even = even + jnp.diag(jnp.where(told, ridge, 1.0))
    factor = jax.scipy.linalg.cho_factor(even, lower=True)
    return scale * jax.scipy.linalg.cho_solve(factor, scale * side)
