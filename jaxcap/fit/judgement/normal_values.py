"""Running statistics of the evidence in a sequence, robust to single wrong frames."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .evidence import COVERAGE_TOLERANCE, NUM_DIRECTIONS, Evidence
from .surface import SampledSurface

#: least rate of the running statistics
MIN_RATE = 0.03
#: deviations beyond which a frame moves the statistics no further
CLIP = 3.0
#: initial deviation, shares of the cloud and of the body's area; and the least one
INITIAL_DEVIATION, MIN_DEVIATION = 0.002, 0.0005
#: number of values for each region, and the row of the area within another part
NUM_ROWS, INSIDE = 3, 2
#: number of good frames after which the level is compared with its value at that time, to detect slowly
#: growing faults
NUM_BASE_FRAMES = 30


class NormalValues(eqx.Module):
    """Levels and deviations of the observed values (`stack_evidence`) in the good frames so far."""

    #: number of frames
    frames: Float[Array, ""]
    level: Float[Array, "3 Q"]
    deviation: Float[Array, "3 Q"]
    #: the level of the first `NUM_BASE_FRAMES` good frames
    base: Float[Array, "3 Q"]
    #: share of the surface visible from each direction that has points
    coverage: Float[Array, "D"]
    #: one after a frame that was not good, otherwise zero
    flagged: Float[Array, ""]


def initial_values(surface: SampledSurface, num_cameras: int = 0) -> NormalValues:
    """Make the statistics before the first frame; `num_cameras` is zero if the cameras are not known."""
    level = jnp.zeros((NUM_ROWS, len(surface.names) + 1), surface.areas.dtype)
    none = jnp.zeros((), level.dtype)
    return NormalValues(
        none,
        level,
        jnp.full_like(level, INITIAL_DEVIATION),
        level,
        jnp.zeros(num_cameras or NUM_DIRECTIONS, level.dtype),
        none,
    )


def stack_evidence(evidence: Evidence) -> Float[Array, "*frames 3 Q"]:
    """Stack the judged values of each of the R regions and, last, of the whole body (Q = R + 1).

    The rows are the share of the cloud's points that are unexplained, the share of the body's area that
    should be visible and is empty, and the share of it that lies within another part.
    """
    values = jnp.stack([evidence.unexplained, evidence.empty, evidence.inside], -2)
    return jnp.concatenate([values, jnp.sum(values, -1, keepdims=True)], -1)


def sensor_directions(usual: NormalValues) -> Float[Array, "D"]:
    """Find the directions of a sequence's sensors, one or zero; all zero before the first frame."""
    best = jnp.max(usual.coverage)
    return ((usual.coverage >= best - COVERAGE_TOLERANCE) & (usual.frames > 0)).astype(usual.level.dtype)


@eqx.filter_jit
def update_values(usual: NormalValues, evidence: Evidence) -> NormalValues:
    """Update the statistics with one more frame, which was judged to be right."""
    first = usual.frames == 0
    rate = jnp.maximum(1.0 / (usual.frames + 1.0), MIN_RATE)
    value = stack_evidence(evidence)
    bound = CLIP * usual.deviation
    step = jnp.where(first, value - usual.level, jnp.clip(value - usual.level, -bound, bound))
    # the mean absolute deviation of a normal distribution is 0.8 of its standard deviation
    spread = jnp.where(first, usual.deviation, 1.25 * jnp.abs(step))
    slow = jnp.maximum(1.0 / (usual.frames + 3.0), MIN_RATE)
    level = usual.level + rate * step
    return NormalValues(
        usual.frames + 1.0,
        level,
        jnp.maximum(usual.deviation + slow * (spread - usual.deviation), MIN_DEVIATION),
        jnp.where(usual.frames < NUM_BASE_FRAMES, level, usual.base),
        usual.coverage + rate * (evidence.coverage - usual.coverage),
        jnp.zeros_like(usual.flagged),
    )


def mark_flagged(usual: NormalValues) -> NormalValues:
    """Mark the statistics after a frame that was not judged to be right.

    They are not updated from it, and the limit of a good frame is stricter for the next one.
    """
    return eqx.tree_at(lambda u: u.flagged, usual, jnp.ones_like(usual.flagged))


@eqx.filter_jit
def median_values(evidence: Evidence) -> NormalValues:
    """Compute the statistics of frames in any order, stacked `(F, ...)`: medians, and median absolute
    deviations.

    More than half of the frames have to be right.
    """
    values = stack_evidence(evidence)
    level = jnp.median(values, 0)
    # 1.48 of it is the standard deviation of a normal distribution
    deviation = jnp.maximum(1.48 * jnp.median(jnp.abs(values - level), 0), MIN_DEVIATION)
    frames = jnp.full((), float(len(values)), level.dtype)
    return NormalValues(
        frames, level, deviation, level, jnp.median(evidence.coverage, 0), jnp.zeros((), level.dtype)
    )
