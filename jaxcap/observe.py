"""What sensors saw."""

import equinox as eqx
from jaxtyping import Array, Float


class Cloud(eqx.Module):
    """Points with unit normals and weights, metres; weight zero means padding.

    One frame is `(N, ...)`. A sequence is a list of clouds, or one cloud with a leading
    axis of frames, `(F, N, ...)`.
    """

    points: Float[Array, "*frames N 3"]
    normals: Float[Array, "*frames N 3"]
    weights: Float[Array, "*frames N"]
