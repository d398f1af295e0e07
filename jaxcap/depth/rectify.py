"""Depth images and masks without the distortion of lenses."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ..arguments import checked
from ..errors import InputError
from ..geometry.camera import Camera
from ..geometry.lens import Lens, distort, largest_radius
from .check_depths import keep_measured

#: largest tangent of the angle between a rectified ray and the optical axis, 75 degrees
MAX_TANGENT = 3.7
#: rays along each axis by which the size of a rectified image is found
NUM_RAYS = 601
#: largest side of a rectified image relative to that of the recorded one
MAX_GROWTH = 2.0
#: largest relative difference of neighbouring depths that are interpolated; beyond it is an edge
MAX_STEP = 0.02


class Rectification(NamedTuple):
    """The pinhole camera of rectified images, and the place of each of their pixels in the recorded image."""

    #: without a lens, at the same place and with the same focal lengths
    camera: Camera
    #: columns and rows in the recorded image
    pixels: Float[np.ndarray, "H W 2"]
    #: pixels whose place is within the recorded image
    inside: Bool[np.ndarray, "H W"]


@checked
def make_rectification(camera: Camera) -> Rectification:
    """Find the pinhole camera that sees what a camera with a lens sees, and where its pixels were recorded.

    Its image is as large as the recorded rays need, and at most twice as wide and high as the recorded one: rays more than
    that off the axis are lost, and so are those that the model of the lens maps to pixels twice.

    **Raises:** `InputError` if the lens maps no ray into the image.
    """
    lens = camera.lens
    if lens is None:
        raise InputError(
            "The camera has no lens, and its images need no rectification; use them as they are."
        )
    focal, middle = np.asarray(camera.focal, float), np.asarray(camera.principal_point, float)
    size = np.array([camera.width, camera.height])
    largest = float(largest_radius(lens))
    axis = np.linspace(-MAX_TANGENT, MAX_TANGENT, NUM_RAYS)
    rays = np.stack(np.meshgrid(axis, axis), -1)
    seen = _is_seen(lens, rays, focal, middle, size, largest)
    if not seen.any():
        raise InputError(
            f"The lens with the coefficients {np.asarray(lens.coefficients).tolist()} shows nothing in its image; check the "
            "calibration."
        )
    # rays of the border are between those of the grid
    step = axis[1] - axis[0]
    bounds = np.stack([rays[seen].min(0) - step, rays[seen].max(0) + step])
    # not more than the limit of growth, on both sides of the principal point
    reach = 0.5 * MAX_GROWTH * size / focal
    low, high = np.clip(bounds, -reach, reach) * focal
    low, high = np.floor(low), np.ceil(high)
    low, high = _crop(lens, low, high, focal, middle, size, largest)
    wide, tall = (int(n) for n in high - low + 1)
    there = np.stack(np.meshgrid(np.arange(wide), np.arange(tall)), -1) + low
    rays = there / focal
    pixels = np.asarray(distort(lens, jnp.asarray(rays)), float) * focal + middle
    inside = _is_seen(lens, rays, focal, middle, size, largest)
    rectified = Camera(camera.rotation, camera.translation, camera.focal, jnp.asarray(-low), wide, tall)
    return Rectification(rectified, pixels, inside)


@checked
def rectify_depth(rectification: Rectification, depth: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "H W"]:
    """Rectify a depth image, metres: interpolated on surfaces, the nearest pixel at edges; zero where nothing was measured."""
    depth = keep_measured(depth)
    corner = np.clip(
        np.floor(rectification.pixels).astype(int), 0, np.array([depth.shape[1], depth.shape[0]]) - 2
    )
    x, y = corner[..., 0], corner[..., 1]
    near = np.stack([depth[y, x], depth[y, x + 1], depth[y + 1, x], depth[y + 1, x + 1]])
    across, down = np.moveaxis(np.clip(rectification.pixels - corner, 0.0, 1.0), -1, 0)
    weights = np.stack([(1 - across) * (1 - down), across * (1 - down), (1 - across) * down, across * down])
    smooth = (near.min(0) > 0) & (near.max(0) - near.min(0) <= MAX_STEP * near.max(0))
    mean = np.sum(weights * near, 0)
    nearest = depth[_nearest(rectification, depth.shape)]
    return np.where(rectification.inside, np.where(smooth, mean, nearest), 0.0)


@checked
def rectify_mask(rectification: Rectification, mask: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "H W"]:
    """Rectify a mask by the nearest pixel; false outside of the recorded image."""
    return mask[_nearest(rectification, mask.shape)] & rectification.inside


def _nearest(rectification: Rectification, shape: tuple[int, int]) -> tuple[Int[np.ndarray, "H W"], ...]:
    columns, rows = np.moveaxis(np.round(rectification.pixels).astype(int), -1, 0)
    return np.clip(rows, 0, shape[0] - 1), np.clip(columns, 0, shape[1] - 1)


def _is_seen(
    lens: Lens, rays: np.ndarray, focal: np.ndarray, middle: np.ndarray, size: np.ndarray, largest: float
) -> Bool[np.ndarray, "*rays"]:
    """Test which rays come into the recorded image, at one pixel only."""
    pixels = np.asarray(distort(lens, jnp.asarray(rays)), float) * focal + middle
    inside = ((pixels >= -0.5) & (pixels < size - 0.5)).all(-1)
    return inside & (np.linalg.norm(rays, axis=-1) < largest)


def _crop(
    lens: Lens,
    low: np.ndarray,
    high: np.ndarray,
    focal: np.ndarray,
    middle: np.ndarray,
    size: np.ndarray,
    largest: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Narrow a range of pixels to those of rays within the recorded image."""
    columns, rows = np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1)
    seen = _is_seen(lens, np.stack(np.meshgrid(columns, rows), -1) / focal, focal, middle, size, largest)
    across, down = columns[seen.any(0)], rows[seen.any(1)]
    return np.array([across[0], down[0]]), np.array([across[-1], down[-1]])
