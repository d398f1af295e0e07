"""Covariances from the residuals themselves, whose errors are alike within a region of the surface.

With `H` the normal matrix and `g_b` the gradient of the residuals of region `b`, the covariance of the minimiser is
`H^-1 (sum_b g_b g_b^T) H^-1` (Huber 1967; White 1980; for groups with errors that are alike Liang and Zeger 1986). Errors of different
regions are independent; those within one may be alike, also from frame to frame.

At the minimum the gradients sum to zero, so a direction that a single region determines has no spread, and B regions spread in
fewer than B directions. In every direction the spread is therefore at least that of independent errors, `s^2 H`, with the variance
`s^2` of the residuals.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...body.body import Body, pose_body
from ...body.pose import Pose
from ...body.retraction import retract
from ...geometry.linear import inverse_symmetric, raise_spread
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
    #: sum of the squared residuals, and their number
    squares: float
    count: int


class ReducedFrame(NamedTuple):
    """A frame without its pose."""

    matrix: Float[np.ndarray, "K K"]
    sides: Float[np.ndarray, "B K"]
    #: inverse of the matrix of the pose, and how the pose follows the coefficients, negative
    inverse: Float[np.ndarray, "D D"]
    follow: Float[np.ndarray, "D K"]
    #: sum of the squared residuals, and their number less that of the pose's coordinates
    squares: float
    freedom: int


def surface_regions(vertices: Float[Array | np.ndarray, "V 3"]) -> Int[np.ndarray, "V"]:
    """Divide the vertices of a surface at rest into regions of equal numbers."""
    count = len(vertices)
    regions = np.empty(count, int)
    regions[np.asarray(spatial_order(np.asarray(vertices)))] = np.arange(count) * NUM_REGIONS // count
    return regions


def frame_sums(
    rows: Float[Array, "P 3 N"], residual: Float[Array, "P 3"], regions: Int[Array, "P"]
) -> tuple[Float[Array, "N N"], Float[Array, "B N"], Float[Array, ""], Int[Array, ""]]:
    """Sum the equations of the points of a frame: matrix, gradients of the regions, squared residuals, and their number.

    **Arguments:** `rows`, the derivatives of the residuals; points without any are not counted.
    """
    flat = rows.reshape(-1, rows.shape[2])
    by_point = jnp.sum(residual[:, :, None] * rows, 1)
    sides = jax.ops.segment_sum(by_point, regions, NUM_REGIONS)
    return flat.T @ flat, sides, jnp.sum(residual**2), jnp.sum(jnp.any(flat != 0, 1))


def unstack_equations(sums: tuple[Array, ...]) -> list[RegionEquations]:
    """Split the stacked sums of F frames (`frame_sums`) into their equations, in double precision."""
    matrices, sides, squares, counts = (np.asarray(each, float) for each in sums)
    return [
        RegionEquations(*each[:2], float(each[2]), int(each[3]))
        for each in zip(matrices, sides, squares, counts, strict=True)
    ]


def joint_derivatives(
    body_at: Callable[[Float[Array, "K"]], Body], pose: Pose, dofs: int, count: int
) -> Float[Array, "J 3 N"]:
    """Differentiate the joints by the pose and by the `count` coefficients."""

    def joints(d: Float[Array, "N"]) -> Float[Array, "J 3"]:
        body = body_at(d[dofs:])
        return pose_body(body, retract(body.skeleton, pose, d[:dofs])).joints

    return jax.jacfwd(joints)(jnp.zeros(dofs + count, pose.translations.dtype))


def eliminate_pose(frame: RegionEquations, count: int) -> ReducedFrame:
    """Eliminate the pose of a frame; the last `count` unknowns are coefficients."""
    dofs = len(frame.matrix) - count
    own, coupling = frame.matrix[:dofs, :dofs], frame.matrix[:dofs, dofs:]
    inverse = inverse_symmetric(_curved(own))
    follow = inverse @ coupling
    return ReducedFrame(
        frame.matrix[dofs:, dofs:] - coupling.T @ follow,
        frame.sides[:, dofs:] - frame.sides[:, :dofs] @ follow,
        inverse,
        follow,
        frame.squares,
        frame.count - dofs,
    )


def coefficient_covariance(frames: Sequence[ReducedFrame]) -> Float[np.ndarray, "K K"]:
    """Compute the covariance of the coefficients of one person, who has a standard normal distribution among people."""
    matrix, sides = sum(frame.matrix for frame in frames), sum(frame.sides for frame in frames)
    assert isinstance(matrix, np.ndarray) and isinstance(sides, np.ndarray)
    diagonal = np.diagonal(matrix)
    freedom = sum(frame.freedom for frame in frames) - len(matrix)
    spread = _covariance(_curved(matrix), sides, sum(frame.squares for frame in frames), freedom)
    # a coefficient without an effect has the deviation of people
    spread += np.diag(np.where(diagonal > 0, 0.0, 1.0 / MIN_CURVATURE))
    return spread @ inverse_symmetric(spread + np.eye(len(spread)))


def pose_covariance(frame: RegionEquations, reduced: ReducedFrame) -> Float[np.ndarray, "D D"]:
    """Compute the covariance of the pose of a frame with known coefficients."""
    dofs = len(reduced.inverse)
    own = _curved(frame.matrix[:dofs, :dofs])
    return _covariance(own, frame.sides[:, :dofs], frame.squares, frame.count - dofs)


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


def _covariance(
    matrix: Float[np.ndarray, "N N"], sides: Float[np.ndarray, "B N"], squares: float, freedom: int
) -> Float[np.ndarray, "N N"]:
    """Compute the covariance from the gradients of the regions, at least that of independent errors in every direction."""
    occupied = int(np.any(sides != 0, 1).sum())
    spread = occupied / max(occupied - 1, 1) * sides.T @ sides
    inverse = inverse_symmetric(matrix)
    return inverse @ raise_spread(matrix, spread, squares / max(freedom, 1)) @ inverse


def _curved(matrix: Float[np.ndarray, "N N"]) -> Float[np.ndarray, "N N"]:
    """Give the coordinates that nothing determines a curvature."""
    diagonal = np.diagonal(matrix)
    return matrix + np.diag(np.where(diagonal > 0, MIN_CURVATURE * diagonal, 1.0))
