"""Running statistics of the evidence in a sequence, robust to single wrong frames."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...stacking import device_array
from .evidence import COVERAGE_TOLERANCE, NUM_DIRECTIONS, Evidence
from .region_samples import RegionSamples

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
NUM_FIRST_FRAMES = 30


class Baseline(eqx.Module):
    """Levels and deviations of the observed values (`stack_evidence`) in the good frames so far."""

    #: number of frames
    frames: Float[Array, ""]
    level: Float[Array, "3 Q"]
    deviation: Float[Array, "3 Q"]
    #: the level of the first `NUM_FIRST_FRAMES` good frames
    first_level: Float[Array, "3 Q"]
    #: share of the surface visible from each direction that has points
    coverage: Float[Array, "D"]
    #: one after a frame that was not good, otherwise zero
    flagged: Float[Array, ""]


def initial_baseline(surface: RegionSamples, num_cameras: int = 0) -> Baseline:
    """Make the statistics before the first frame; `num_cameras` is zero if the cameras are not known."""
    dtype = surface.areas.dtype
    shape = NUM_ROWS, len(surface.names) + 1
    level, none = device_array(np.zeros(shape), dtype), device_array(0.0, dtype)
    return Baseline(
        none,
        level,
        device_array(np.full(shape, INITIAL_DEVIATION), dtype),
        level,
        device_array(np.zeros(num_cameras or NUM_DIRECTIONS), dtype),
        none,
    )


def stack_evidence(evidence: Evidence) -> Float[Array, "*frames 3 Q"]:
    """Stack the judged values of each of the R regions and, last, of the whole body (Q = R + 1).

    The rows are the share of the cloud's points that are unexplained, the share of the body's area that
    should be visible and is empty, and the share of it that lies within another part.
    """
    values = jnp.stack([evidence.unexplained, evidence.empty, evidence.inside], -2)
    return jnp.concatenate([values, jnp.sum(values, -1, keepdims=True)], -1)


def sensor_directions(baseline: Baseline) -> Float[Array, "D"]:
    """Find the directions of a sequence's sensors, one or zero; all zero before the first frame."""
    best = jnp.max(baseline.coverage)
    return ((baseline.coverage >= best - COVERAGE_TOLERANCE) & (baseline.frames > 0)).astype(
        baseline.level.dtype
    )


@eqx.filter_jit
def update_baseline(baseline: Baseline, evidence: Evidence) -> Baseline:
    """Update the statistics with one more frame, which was judged to be right."""
    first = baseline.frames == 0
    rate = jnp.maximum(1.0 / (baseline.frames + 1.0), MIN_RATE)
    value = stack_evidence(evidence)
    bound = CLIP * baseline.deviation
    step = jnp.where(first, value - baseline.level, jnp.clip(value - baseline.level, -bound, bound))
    # the mean absolute deviation of a normal distribution is 0.8 of its standard deviation
    spread = jnp.where(first, baseline.deviation, 1.25 * jnp.abs(step))
    slow = jnp.maximum(1.0 / (baseline.frames + 3.0), MIN_RATE)
    level = baseline.level + rate * step
    return Baseline(
        baseline.frames + 1.0,
        level,
        jnp.maximum(baseline.deviation + slow * (spread - baseline.deviation), MIN_DEVIATION),
        jnp.where(baseline.frames < NUM_FIRST_FRAMES, level, baseline.first_level),
        baseline.coverage + rate * (evidence.coverage - baseline.coverage),
        jnp.zeros_like(baseline.flagged),
    )


def mark_flagged(baseline: Baseline) -> Baseline:
    """Mark the statistics after a frame that was not judged to be right.

    They are not updated from it, and the limit of a good frame is stricter for the next one.
    """
    return eqx.tree_at(lambda values: values.flagged, baseline, jnp.ones_like(baseline.flagged))


@eqx.filter_jit
def median_baseline(evidence: Evidence) -> Baseline:
    """Compute the statistics of frames in any order, stacked `(F, ...)`: medians, and median absolute
    deviations.

    More than half of the frames have to be right.
    """
    values = stack_evidence(evidence)
    level = jnp.median(values, 0)
    # 1.48 of it is the standard deviation of a normal distribution
    deviation = jnp.maximum(1.48 * jnp.median(jnp.abs(values - level), 0), MIN_DEVIATION)
    frames = jnp.full((), float(len(values)), level.dtype)
    return Baseline(
        frames, level, deviation, level, jnp.median(evidence.coverage, 0), jnp.zeros((), level.dtype)
    )
