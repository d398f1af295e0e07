"""Markers on anatomical landmarks of the embedded human, by the names that laboratories use."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from ...body.people.human import human
from ...geometry.attachment import Attachment
from ..marker_sets.landmarks import landmark_attachment
from ..marker_sets.recognise import recognise_markers
from .surface_markers import MARKER_HEIGHT, SurfaceMarkers

#: largest standard deviation of a marker from its landmark, metres; those on plates have more
MAX_DEVIATION = 0.02


def anatomical_markers(
    labels: Sequence[str], resolution: str = "full", height: float = MARKER_HEIGHT
) -> SurfaceMarkers:
    """Place the labelled markers on landmarks of the human of a named resolution, for any shape.

    Labels are those of any set that `recognise_markers` knows (`LASI`, `R.Knee.Lat`, `C7`). Markers on plates
    and wands, and those somewhere on a segment, are left out. `height` is the distance of the marker's centre
    from the skin, metres.

    **Raises:** `ValueError` where no label is known.
    """
    found = recognise_markers(labels)
    names, hold = landmark_attachment(resolution)
    known = [index for index in range(len(labels)) if found.deviations[index] <= MAX_DEVIATION]
    if not known:
        raise ValueError(
            f"None of the labels {', '.join(list(labels)[:8])} is a known landmark such as LASIS, RKNE or "
            "C7; give the vertices of the human that the markers are attached to."
        )
    rows = np.array([names.index(str(found.names[index])) for index in known])
    dtype = human(resolution=resolution).vertices.dtype  # pyright: ignore[reportArgumentType]
    on_skin = Attachment(
        jnp.asarray(hold.corners[rows], jnp.int32),
        jnp.asarray(hold.barycentric[rows], dtype),
        jnp.full(len(known), height, dtype),
    )
    return SurfaceMarkers(on_skin, tuple(labels[index] for index in known))
