"""The left-right symmetry of a surface as data."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from .judge_map import MapQuality
from .point_map import PointMap


class SurfaceSymmetry(NamedTuple):
    """The left-right symmetry of a surface: a map of its V vertices to points on it."""

    #: three vertices and their weights: the mirrored point of each vertex
    corners: Int[np.ndarray, "V 3"]
    weights: Float[np.ndarray, "V 3"]
    #: 1 and -1 on the two sides, 0 on the middle; the surface does not show which side is left
    sides: Int[np.ndarray, "V"]
    quality: MapQuality

    @property
    def mirrored(self) -> Int[np.ndarray, "V"]:
        """The vertex nearest to the mirrored point of each vertex."""
        return PointMap(self.corners, self.weights).nearest

    def mirrored_points(self, vertices: Float[np.ndarray | Array, "V 3"]) -> Float[np.ndarray, "V 3"]:
        """Compute the mirrored point of each vertex in one mesh; it is on the other side, in the same pose."""
        return PointMap(self.corners, self.weights).pull_back(np.asarray(vertices))

    def decimated(self, kept: Int[np.ndarray, "S"], nearest: Int[np.ndarray, "V"]) -> "SurfaceSymmetry":
        """Restrict the map to some vertices, by the nearest one of them to each vertex."""
        return SurfaceSymmetry(
            nearest[self.corners[kept]], self.weights[kept], self.sides[kept], self.quality
        )
