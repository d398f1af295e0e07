"""Covariances from the residuals themselves, whose errors are alike within a region of the surface.

With `H` the normal matrix and `g_b` the gradient of the residuals of region `b`, the covariance of the minimiser is
`H^-1 (sum_b g_b g_b^T) H^-1` (Huber 1967; White 1980; for groups with errors that are alike Liang and Zeger 1986). Errors of different
regions are independent; those within one may be alike, also from frame to frame.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from ...geometry.linear import inverse_symmetric
from ...geometry.sampling import spatial_order

#: number of regions of a surface
NUM_REGIONS = 64
#: curvature of coordinates that nothing determines, as a share of their own
MIN_CURVATURE = 1e-9


class RegionEquations(NamedTuple):
    """The equations of a frame by its D pose coordinates, followed by the K coefficients."""

    matrix: Float[np.ndarray, "N N"]
    #: the gradient of each of B regions
    sides: Float[np.ndarray, "B N"]


class ReducedFrame(NamedTuple):
    """A frame without its pose."""

    matrix: Float[np.ndarray, "K K"]
    sides: Float[np.ndarray, "B K"]
    #: inverse of the matrix of the pose, and how the pose follows the coefficients, negative
    inverse: Float[np.ndarray, "D D"]
    follow: Float[np.ndarray, "D K"]


def surface_regions(vertices: Float[Array | np.ndarray, "V 3"]) -> Int[np.ndarray, "V"]:
    """Divide the vertices of a surface at rest into regions of equal numbers."""
    count = len(vertices)
    regions = np.empty(count, int)
    regions[np.asarray(spatial_order(np.asarray(vertices)))] = np.arange(count) * NUM_REGIONS // count
    return regions


def eliminate_pose(frame: RegionEquations, count: int) -> ReducedFrame:
    """Eliminate the pose of a frame; the last `count` unknowns are coefficients."""
    dofs = len(frame.matrix) - count
    own, coupling = frame.matrix[:dofs, :dofs], frame.matrix[:dofs, dofs:]
    diagonal = np.diagonal(own)
    inverse = inverse_symmetric(own + np.diag(np.where(diagonal > 0, MIN_CURVATURE * diagonal, 1.0)))
    follow = inverse @ coupling
    return ReducedFrame(
        frame.matrix[dofs:, dofs:] - coupling.T @ follow,
        frame.sides[:, dofs:] - frame.sides[:, :dofs] @ follow,
        inverse,
        follow,
    )


def coefficient_covariance(frames: Sequence[ReducedFrame]) -> Float[np.ndarray, "K K"]:
    """Compute the covariance of the coefficients of one person, who has a standard normal distribution among people."""
    matrix, sides = sum(frame.matrix for frame in frames), sum(frame.sides for frame in frames)
    assert isinstance(matrix, np.ndarray) and isinstance(sides, np.ndarray)
    diagonal = np.diagonal(matrix)
    inverse = inverse_symmetric(matrix + np.diag(np.where(diagonal > 0, MIN_CURVATURE * diagonal, 1.0)))
    spread = inverse @ _spread(sides) @ inverse
    # a coefficient without an effect has the deviation of people
    spread += np.diag(np.where(diagonal > 0, 0.0, 1.0 / MIN_CURVATURE))
    return spread @ inverse_symmetric(spread + np.eye(len(spread)))


def pose_covariance(frame: RegionEquations, reduced: ReducedFrame) -> Float[np.ndarray, "D D"]:
    """Compute the covariance of the pose of a frame with known coefficients."""
    dofs = len(reduced.inverse)
    return reduced.inverse @ _spread(frame.sides[:, :dofs]) @ reduced.inverse


def joint_distances(
    joints: Float[np.ndarray, "J 3 N"],
    frame: RegionEquations,
    reduced: ReducedFrame,
    covariance: Float[np.ndarray, "K K"],
) -> Float[np.ndarray, "J"]:
    """Compute the expected distances of the joints from the true ones, root mean squares in metres.

    They have a part of the frame's own pose, and one of the coefficients, with which the pose goes along. **Arguments:** `joints`,
    the derivatives of the joints; `covariance` of the coefficients.
    """
    dofs = len(reduced.inverse)
    by_pose = joints[..., :dofs]
    by_shape = joints[..., dofs:] - by_pose @ reduced.follow
    own = np.einsum("jan,nm,jam->j", by_pose, pose_covariance(frame, reduced), by_pose)
    shared = np.einsum("jak,kl,jal->j", by_shape, covariance, by_shape)
    return np.sqrt(np.maximum(own + shared, 0.0))


def _spread(sides: Float[np.ndarray, "B N"]) -> Float[np.ndarray, "N N"]:
    return len(sides) / max(len(sides) - 1, 1) * sides.T @ sides
