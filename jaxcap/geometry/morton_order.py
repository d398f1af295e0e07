"""Spatial sorting of points."""

import numpy as np
from jaxtyping import Array, Float


def spatial_order(points: Float[Array | np.ndarray, "N 3"], weights=None) -> np.ndarray:
    """Compute an order `(N,)` of points along a Morton curve, so that neighbours in space are near in
    memory.

    Points whose `weights (N,)` are zero come last. In NumPy, once for each cloud.
    """
    points = np.asarray(points, float)
    real = np.ones(len(points), bool) if weights is None else np.asarray(weights) > 0
    if not real.any():
        return np.arange(len(points))
    low, high = points[real].min(0), points[real].max(0)
    scaled = np.clip((points - low) / max((high - low).max(), 1e-12), 0.0, 1.0)
    cells = np.where(real[:, None], scaled * 1023, 0.0).astype(np.int64)
    key = np.zeros(len(points), np.int64)
    for bit in range(10):
        for axis in range(3):
            key |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.lexsort((key, ~real))
