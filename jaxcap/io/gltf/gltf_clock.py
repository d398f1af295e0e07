"""The sampling times of a glTF animation: from the first key to the last, on the grid of the keys."""

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

#: frames per second if keys lie on no grid; and the largest rate of a grid
DEFAULT_RATE, MAX_RATE = 30.0, 480.0
#: largest offset of a key in steps; seconds below which keys coincide; subdivisions that are tried
KEY_TOLERANCE, MIN_KEY_GAP, MAX_SUBDIVISIONS = 0.05, 1e-4, 6


def time_range(keys: Sequence[Float[np.ndarray, "_"]]) -> tuple[float, float]:
    """Return the first and the last time of all keys."""
    return min(float(times[0]) for times in keys), max(float(times[-1]) for times in keys)


def count_frames(keys: Sequence[Float[np.ndarray, "_"]], rate: float | None, path: Path) -> int:
    """Count the frames from the first key to the last.

    Frames are at `rate`, or on the coarsest grid that contains all keys. Warns if keys lie on no grid; the
    rate is then `DEFAULT_RATE` frames per second.
    """
    first, last = time_range(keys)
    if rate is not None:
        return int(min((last - first) * rate + 0.5, 2**40)) + 1
    steps = count_grid_steps(np.unique(np.concatenate(keys)))
    if steps is None:
        warnings.warn(
            f"{path}: the key times of the animation are not regular; it is sampled at {DEFAULT_RATE:g} frames per second, which "
            "may miss some keys. Give a `rate` to change this.",
            stacklevel=2,
        )
        steps = round((last - first) * DEFAULT_RATE)
    return steps + 1


def count_grid_steps(times: Float[np.ndarray, "K"]) -> int | None:
    """Find the least number of equal steps from the first time to the last that contains all times.

    None if no grid fits.
    """
    gaps = np.diff(times)
    gaps = gaps[gaps > MIN_KEY_GAP]
    if not len(gaps):
        return 0
    span = float(times[-1] - times[0])
    # the mean of several one-step gaps is more precise than each of them
    least = float(gaps[gaps < 1.5 * gaps.min()].mean())
    for steps in (len(gaps), *(round(span * part / least) for part in range(1, MAX_SUBDIVISIONS + 1))):
        places = (times - times[0]) * (steps / span)
        if steps <= MAX_RATE * span + 1 and np.abs(places - np.round(places)).max() < KEY_TOLERANCE:
            return steps
    return None
