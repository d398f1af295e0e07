"""Interpolation of vertex values at points in triangles."""

import numpy as np
from jaxtyping import Array, Float, Int

AnyArray = Array | np.ndarray


def inside(shares: Float[AnyArray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    """Project barycentric coordinates into the triangle: at least zero, with sum one."""
    shares = np.maximum(np.asarray(shares, float), 0.0)
    return shares / shares.sum(axis=1, keepdims=True)


def interpolate(
    rows: Float[AnyArray, "V K"], corners: Int[AnyArray, "N 3"], shares: Float[AnyArray, "N 3"]
) -> Float[np.ndarray, "N K"]:
    """Interpolate rows of numbers between the triangles' corners, in float64."""
    rows = np.asarray(rows, float)
    return np.einsum("nc,ncj->nj", inside(shares), rows[np.asarray(corners)])


def interpolate_weights(
    rows: Float[AnyArray, "V K"], corners: Int[AnyArray, "N 3"], shares: Float[AnyArray, "N 3"]
) -> Float[np.ndarray, "N K"]:
    """Interpolate skinning weights between the triangles' corners, and normalise rows to sum one."""
    carried = interpolate(rows, corners, shares)
    return carried / carried.sum(axis=1, keepdims=True)
