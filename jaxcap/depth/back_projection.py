"""Rays and points of the pixels of depth images."""

import functools

import numpy as np
from jaxtyping import Float

from ..geometry.camera import Camera


def camera_rays(camera: Camera) -> Float[np.ndarray, "H W 3"]:
    """Return the ray of each pixel's centre in the camera's frame, with depth one; read-only."""
    focal, middle = (np.asarray(a, float).tolist() for a in (camera.focal, camera.principal_point))
    return _rays(camera.width, camera.height, *focal, *middle)


def measured_points(camera: Camera, depth: Float[np.ndarray, "H W"]) -> Float[np.ndarray, "N 3"]:
    """Compute the points of the measured pixels in the world, row by row, metres."""
    rotation, translation = (np.asarray(a, float) for a in (camera.rotation, camera.translation))
    measured = depth > 0
    return (camera_rays(camera)[measured] * depth[measured][:, None] - translation) @ rotation


def world_points(
    camera: Camera, depth: Float[np.ndarray, "H W"], step: int = 1
) -> Float[np.ndarray, "h w 3"]:
    """Compute the points of every `step`-th row and column in the world, metres; zero where nothing was measured."""
    rotation, translation = (np.asarray(a, float) for a in (camera.rotation, camera.translation))
    z = depth[::step, ::step, None]
    return np.where(z > 0, (camera_rays(camera)[::step, ::step] * z - translation) @ rotation, 0.0)


@functools.lru_cache(maxsize=32)
def _rays(width: int, height: int, fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    across, down = np.meshgrid((np.arange(width) - cx) / fx, (np.arange(height) - cy) / fy)
    rays = np.stack([across, down, np.ones_like(across)], -1)
    rays.setflags(write=False)
    return rays
