"""The frames of a live run at a constant rate: dropped ones are interpolated."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ...body.pose import take_poses
from ...edit.interpolation import interpolate_poses
from ...errors import InputError
from ..track.frame_records import Results

#: verdict of a frame that was not tracked
DROPPED = "dropped"
#: largest number of frames without a tracked one before them: longer pauses mean a wrong rate, or another clock
MAX_PAUSE_FRAMES = 100_000


def frame_slots(seconds: Float[np.ndarray, "N"], rate: float) -> Int[np.ndarray, "N"]:
    """Number the frames of a motion that tracked frames at these times are, ascending; equal for frames at the same time.

    **Raises:** `InputError` if the times do not fit the rate.
    """
    slots = np.round((seconds - seconds[0]) * rate).astype(int)
    # clocks may step back a little
    slots = np.maximum.accumulate(slots)
    if (np.diff(slots) > MAX_PAUSE_FRAMES).any():
        raise InputError(
            f"The times of the frames span {seconds.max() - seconds[0]:.3g} s, with a pause of more than {MAX_PAUSE_FRAMES} "
            f"frames at {rate:g} frames per second; check the clock of the source, or give its --rate."
        )
    return slots


def fill_slots(
    results: Results, names: Sequence[str], slots: Int[np.ndarray, "N"]
) -> tuple[Results, list[str]]:
    """Give every slot a frame: the last one that was tracked there, or one between its neighbours, with the verdict `dropped`."""
    last = np.append(np.diff(slots) > 0, True)
    rows, slots = np.flatnonzero(last), slots[last]
    places = np.arange(slots[-1] + 1)
    after = np.searchsorted(slots, places)
    before = np.where(slots[after] == places, after, after - 1)
    span = np.maximum(slots[after] - slots[before], 1)
    fraction = (places - slots[before]) / span
    poses = interpolate_poses(
        take_poses(results.poses, rows[before]), take_poses(results.poses, rows[after]), jnp.asarray(fraction)
    )
    there = slots[after] == places
    nearest = rows[before]
    verdicts = [
        results.verdicts[row] if known else (DROPPED, ()) for row, known in zip(nearest, there, strict=True)
    ]
    unseen = [results.unseen[row] if known else () for row, known in zip(nearest, there, strict=True)]
    others = [known and results.others[row] for row, known in zip(nearest, there, strict=True)]
    filled = Results(
        np.where(there, results.seconds[nearest], 0.0),
        poses,
        jax.tree.map(lambda values: np.asarray(values)[nearest], results.statistics),
        verdicts,
        unseen,
        others,
    )
    return filled, [str(names[int(row)]) if known else "" for row, known in zip(nearest, there, strict=True)]
