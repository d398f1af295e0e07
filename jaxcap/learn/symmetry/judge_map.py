"""Measures of a map of a surface onto itself: distances kept, orientation, consistency, and how far it moves points."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from .intrinsic_surface import IntrinsicSurface, geodesic_distances
from .point_map import PointMap
from .spectral_basis import SpectralBasis

#: eigenfunctions whose gradients show the orientation, without the constant one
GRADIENTS = slice(1, 20)
#: a vertex is consistent if its mirror's mirror is within this share of the largest distance on the surface
CONSISTENT = 0.03


class DistanceSamples(NamedTuple):
    """Geodesic distances from some sampled vertices to all, metres."""

    vertices: Int[np.ndarray, "S"]
    distances: Float[np.ndarray, "S V"]

    @property
    def size(self) -> float:
        """The largest distance on the surface, metres."""
        return float(self.distances.max())


class MapQuality(NamedTuple):
    """Measures of a map of a surface onto itself."""

    #: median change of the geodesic distances between points, metres
    deviation: float
    #: the same as a share of the largest distance on the surface
    relative_deviation: float
    #: the change of distance, as the same share, that 99 % of the pairs of points do not exceed
    largest_deviation: float
    #: share of the area that the map, applied twice, brings back
    consistent: float
    #: share of the area where the map reverses the orientation, as a reflection does
    reversed: float
    #: the largest distance from a point to its image, as a share of the largest distance on the surface
    reach: float


def judge_map(
    surface: IntrinsicSurface, basis: SpectralBasis, found: PointMap, samples: DistanceSamples
) -> MapQuality:
    """Measure a map."""
    size = samples.size
    images = geodesic_distances(surface, found.nearest[samples.vertices])
    changes = np.abs(found.pull_back(images.T) - samples.distances.T)
    deviation = float(np.median(changes))
    twice = found.pull_back(found.pull_back(samples.distances.T))
    away = np.abs(twice - samples.distances.T).max(1)
    backward = is_reversed(surface, basis, found)
    return MapQuality(
        deviation,
        deviation / size,
        float(np.quantile(changes, 0.99)) / size,
        float(basis.areas @ (away < CONSISTENT * size)),
        float(basis.areas @ backward),
        float(displacements(found, samples).max()) / size,
    )


def displacements(found: PointMap, samples: DistanceSamples) -> Float[np.ndarray, "V"]:
    """Estimate the geodesic distance from each vertex to its image, metres.

    By the triangle inequality it is at least the difference of their distances to any sample, and about that to a sample near
    the vertex.
    """
    return np.abs(found.pull_back(samples.distances.T) - samples.distances.T).max(1)


def is_reversed(surface: IntrinsicSurface, basis: SpectralBasis, found: PointMap) -> Bool[np.ndarray, "V"]:
    """Test where a map reverses the orientation.

    The gradients of two functions span a signed area in each triangle. A map that reverses the orientation changes
    the sign of the areas of the functions that are pulled back, against those at the image.
    """
    functions = basis.functions[:, GRADIENTS]
    here = _signed_areas(surface, found.pull_back(functions))
    there = found.pull_back(_signed_areas(surface, functions) / basis.areas[:, None])
    return np.asarray(np.sum(here * there, 1) < 0)


def _signed_areas(surface: IntrinsicSurface, functions: Float[np.ndarray, "V C"]) -> Float[np.ndarray, "V P"]:
    """Compute the signed areas of pairs of functions, summed over the triangles of each vertex."""
    a, b, c = (functions[surface.faces[:, corner]] for corner in range(3))
    first, second = np.triu_indices(functions.shape[1], 1)
    u, v = b - a, c - a
    areas = u[:, first] * v[:, second] - u[:, second] * v[:, first]
    return surface.corner_matrix @ areas
