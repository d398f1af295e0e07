"""A depth camera that does not move, and what is computed once for all of its images."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...geometry.camera import Camera
from ...observe.planes import PLANE_DISTANCE, Plane
from ..back_projection import camera_rays
from ..background import Background, nearest_background


class ImageBox(NamedTuple):
    """Some rows and columns of an image, and the depths of interest there, metres."""

    rows: slice
    columns: slice
    nearest: float
    farthest: float


class FixedCamera:
    """A camera with its rays, and with the floor, the walls and the `background` that it sees."""

    def __init__(self, camera: Camera, background: Background | None = None):
        self.camera, self.background = camera, background
        self.rotation, self.translation = (
            np.asarray(a, float) for a in (camera.rotation, camera.translation)
        )
        self.focal, self.middle = (np.asarray(a, float) for a in (camera.focal, camera.principal_point))
        self.rays = camera_rays(camera)
        self._slopes = np.zeros((0, camera.height, camera.width), np.float32)
        self._offsets: list[float] = []
        #: depths from which on a pixel shows background
        self._limit = None if background is None else nearest_background(background).astype(np.float32)
        #: whether floor and walls were looked for
        self.is_searched = False

    def set_planes(self, planes: Sequence[Plane]) -> None:
        """Remember the floor and the walls of the room."""
        self.is_searched = True
        normals = [self.rotation @ plane.normal for plane in planes]
        self._slopes = np.array([self.rays @ normal for normal in normals], np.float32).reshape(
            -1, *self._slopes.shape[1:]
        )
        self._offsets = [
            float(plane.offset + self.translation @ normal)
            for plane, normal in zip(planes, normals, strict=True)
        ]

    def on_room(
        self, depth: Float[np.ndarray, "h w"], box: ImageBox, step: int = 1
    ) -> Bool[np.ndarray, "h w"]:
        """Test which pixels of a box, every `step`-th with these depths, are on the floor, on a wall or on the background."""
        on = np.zeros(depth.shape, bool)
        for slope, offset in zip(self._slopes, self._offsets, strict=True):
            on |= np.abs(depth * slope[box.rows, box.columns][::step, ::step] - offset) < PLANE_DISTANCE
        if self._limit is not None:
            on |= depth > self._limit[box.rows, box.columns][::step, ::step]
        return on

    def points(
        self, depth: Float[np.ndarray, "h w"], box: ImageBox, step: int = 1
    ) -> Float[np.ndarray, "N 3"]:
        """Compute the points of the measured pixels of a box, with rows and columns `step` apart, row by row, world."""
        measured = depth > 0
        rays = self.rays[box.rows, box.columns][::step, ::step]
        return (rays[measured] * depth[measured][:, None] - self.translation) @ self.rotation

    def box_around(self, points: Float[np.ndarray, "N 3"], margin: float, multiple: int) -> ImageBox | None:
        """Compute the box around points of the world with a `margin`, metres; None if the image does not show it.

        Its sides are on multiples of `multiple` pixels.
        """
        there = points @ self.rotation.T + self.translation
        there = there[there[:, 2] > margin]
        if not len(there):
            return None
        nearest, farthest = float(there[:, 2].min()), float(there[:, 2].max())
        pixels = self.focal * there[:, :2] / there[:, 2:] + self.middle
        wide = margin * self.focal / max(nearest, margin)
        size = np.array([self.camera.width, self.camera.height])
        low = np.clip(np.floor((pixels.min(0) - wide) / multiple).astype(int) * multiple, 0, size)
        high = np.clip(np.ceil((pixels.max(0) + wide) / multiple).astype(int) * multiple, 0, size)
        if (high <= low).any():
            return None
        return ImageBox(
            slice(int(low[1]), int(high[1])),
            slice(int(low[0]), int(high[0])),
            nearest - margin,
            farthest + margin,
        )
