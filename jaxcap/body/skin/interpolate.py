"""Interpolation of vertex values at points in triangles."""

import numpy as np
from jaxtyping import Array, Float, Int

AnyArray = Array | np.ndarray


def clamp_barycentric(barycentric: Float[AnyArray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    """Project barycentric coordinates into the triangle: at least zero, with sum one."""
    barycentric = np.maximum(np.asarray(barycentric, float), 0.0)
    return barycentric / barycentric.sum(axis=1, keepdims=True)


def interpolate(
    values: Float[AnyArray, "V K"], corners: Int[AnyArray, "N 3"], barycentric: Float[AnyArray, "N 3"]
) -> Float[np.ndarray, "N K"]:
    """Interpolate rows of numbers between the triangles' corners, in float64."""
    values = np.asarray(values, float)
    return np.einsum("nc,ncj->nj", clamp_barycentric(barycentric), values[np.asarray(corners)])


def interpolate_weights(
    weights: Float[AnyArray, "V K"], corners: Int[AnyArray, "N 3"], barycentric: Float[AnyArray, "N 3"]
) -> Float[np.ndarray, "N K"]:
    """Interpolate skinning weights between the triangles' corners, and normalise rows to sum one."""
    carried = interpolate(weights, corners, barycentric)
    return carried / carried.sum(axis=1, keepdims=True)
