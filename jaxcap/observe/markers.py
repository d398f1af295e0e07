"""Positions of optical markers over time."""

from collections import Counter

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float

from ..arguments import as_jax_array, as_real_array, check_fields, check_length, checked
from ..errors import InputError
from ..value_checks import check_metres, check_rate


class MarkerFrames(eqx.Module):
    """Positions of optical markers over time, metres; the position of an occluded marker is zero.

    NumPy arrays are accepted and become JAX arrays. A slice or an array of indices selects frames.
    `make_markers` checks its input and accepts NaN for occluded markers.
    """

    positions: Float[Array, "F M 3"] = eqx.field(converter=as_jax_array)
    visible: Bool[Array, "F M"] = eqx.field(converter=as_jax_array)
    labels: tuple[str, ...] = eqx.field(static=True)
    #: frames per second
    rate: float = eqx.field(static=True, default=100.0)

    def __check_init__(self):
        lengths = check_fields(self)
        check_length(self, "labels", len(self.labels), lengths, "M")
        check_rate("MarkerFrames", self.rate)

    def __len__(self) -> int:
        return self.positions.shape[0]

    def __getitem__(self, frames: slice | np.ndarray) -> "MarkerFrames":
        step = abs(frames.step or 1) if isinstance(frames, slice) else 1
        return MarkerFrames(self.positions[frames], self.visible[frames], self.labels, self.rate / step)


@checked
def make_markers(positions, labels, rate: float, *, name: str = "the markers") -> MarkerFrames:
    """Create checked `MarkerFrames`; a marker with NaN in any coordinate is occluded in that frame.

    **Arguments:** `positions (F, M, 3)` metres; `labels`, a name for each marker; `rate`, frames per second;
    `name` for messages.

    **Raises:** `InputError` with one sentence for another shape, no frames, no markers, labels too many,
    too few, empty or duplicate, a position that is infinite, positions that cannot be in metres, and a rate
    that is not above zero.
    """
    labels = tuple(str(label) for label in labels)
    single = getattr(positions, "dtype", None) == np.float32
    positions = np.asarray(positions) if single else as_real_array("make_markers", "positions", positions)
    if positions.ndim != 3 or positions.shape[2] != 3:
        raise InputError(f"{name} have an array of shape {positions.shape}; expected (F, M, 3).")
    if positions.shape[1] == 0:
        raise InputError(f"{name}: there are no markers; give at least one.")
    if len(positions) == 0:
        raise InputError(f"{name}: there are no frames; give at least one.")
    if len(labels) != positions.shape[1]:
        raise InputError(
            f"{name}: {positions.shape[1]} markers have {len(labels)} labels; expected one for each marker."
        )
    twice = [label for label, count in Counter(labels).items() if count > 1]
    if twice or "" in labels:
        what = f"two markers have the label '{twice[0]}'" if twice else "a marker has an empty label"
        raise InputError(f"{name}: {what}; give each marker a unique label.")
    if not (np.isfinite(rate) and rate > 0):
        raise InputError(f"{name}: `rate` is {rate} frames per second; expected a finite number above 0.")
    infinite = np.argwhere(np.isinf(positions))
    if len(infinite):
        raise InputError(
            f"{name}: marker '{labels[infinite[0, 1]]}' has an infinite coordinate; use NaN for an "
            "occluded marker."
        )
    seen = np.asarray(~np.isnan(positions).any(2))
    # relative to the median of each frame, as people walk far
    shown = np.where(seen[..., None], positions, np.nan)[seen.any(1)]
    shown = shown - np.nanmedian(shown, 1, keepdims=True)
    check_metres("make_markers", "positions", shown[~np.isnan(shown).any(2)])
    return MarkerFrames(np.where(seen[..., None], positions, 0), seen, labels, float(rate))
