"""The times at which the animation of a glTF file is sampled: from its first key to its last, on the grid of its keys."""

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

#: frames a second where keys lie on no grid; and the most that a grid of keys is taken to have
PLAIN, FASTEST = 30.0, 480.0
#: share of a step that keys may lie off the grid, seconds below which they are one, and parts that a step is tried in
OFF, SAME, PARTS = 0.05, 1e-4, 6


def first_and_last(keys: Sequence[Float[np.ndarray, "_"]]) -> tuple[float, float]:
    """The least and the largest time of keys."""
    return min(float(times[0]) for times in keys), max(float(times[-1]) for times in keys)


def frames_of(keys: Sequence[Float[np.ndarray, "_"]], rate: float | None, path: Path) -> int:
    """Count the frames from the first key to the last at a rate, or on the coarsest grid that has all keys.

    Warns where keys lie on no grid, and `PLAIN` frames a second are taken.
    """
    first, last = first_and_last(keys)
    if rate is not None:
        return int(min((last - first) * rate + 0.5, 2**40)) + 1
    steps = grid_steps(np.unique(np.concatenate(keys)))
    if steps is None:
        warnings.warn(
            f"{path}: the keys of its animation lie on no grid of times; it is sampled at {PLAIN:g} frames a second, which "
            "may miss single keys. Give a rate for another one.",
            stacklevel=2,
        )
        steps = round((last - first) * PLAIN)
    return steps + 1


def grid_steps(times: Float[np.ndarray, "K"]) -> int | None:
    """The least number of even steps from the first time to the last such that each lies on one; None where there is none."""
    gaps = np.diff(times)
    gaps = gaps[gaps > SAME]
    if not len(gaps):
        return 0
    span = float(times[-1] - times[0])
    # neighbouring gaps of one step each, together, know it better than any of them
    least = float(gaps[gaps < 1.5 * gaps.min()].mean())
    for steps in (len(gaps), *(round(span * part / least) for part in range(1, PARTS + 1))):
        places = (times - times[0]) * (steps / span)
        if steps <= FASTEST * span + 1 and np.abs(places - np.round(places)).max() < OFF:
            return steps
    return None
