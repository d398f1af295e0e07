"""Extremities of a surface, and the ways to exchange them that keep their distances."""

from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .intrinsic_surface import IntrinsicSurface, geodesic_distances

#: an extremity is the vertex with the largest mean distance within this share of the largest distance
REACH = 0.12
#: the most extremities, and the most local maxima that are tested
MOST, MOST_TESTED = 10, 40
#: largest relative difference of the mean distances, and of the distances, of exchanged extremities
MAX_DIFFERENCE = 0.2


class Extremities(NamedTuple):
    """Vertices at the ends of limbs, with their distances to all vertices."""

    vertices: Int[np.ndarray, "N"]
    #: geodesic, metres
    distances: Float[np.ndarray, "N V"]
    #: mean distance to the surface, metres
    means: Float[np.ndarray, "N"]


class Exchange(NamedTuple):
    """An exchange of extremities: which one each becomes, and the mean relative change of their distances."""

    partners: tuple[int, ...]
    change: float


def find_extremities(surface: IntrinsicSurface, means: Float[np.ndarray, "V"], size: float) -> Extremities:
    """Find the local maxima of the mean geodesic distance, the most prominent first.

    The mean distance to the whole surface does not change under a symmetry of the surface.

    **Arguments:** mean distances of all vertices, metres; `size`, the largest distance on the surface, metres.

    **Source:** Kim et al. 2010, "Moebius transformations for global intrinsic symmetry analysis".
    """
    free, found, rows = means > means.mean(), [], []
    for _ in range(MOST_TESTED):
        if not free.any() or len(found) == MOST:
            break
        vertex = int(np.argmax(np.where(free, means, -np.inf)))
        row = geodesic_distances(surface, np.array([vertex]))[0]
        near = row <= REACH * size
        # the slope of an extremity that was found before is no extremity
        if means[near].max() <= means[vertex]:
            found.append(vertex)
            rows.append(row)
        free &= ~near
    vertices = np.array(found, int)
    return Extremities(vertices, np.array(rows).reshape(-1, len(means)), means[vertices])


def list_exchanges(extremities: Extremities) -> list[Exchange]:
    """List the exchanges of extremities in pairs that keep their distances, the one with the least change first.

    Extremities without a partner stay.
    """
    distances, means = extremities.distances[:, extremities.vertices], extremities.means
    size = max(float(distances.max(initial=0.0)), 1e-300)
    alike = np.abs(means[:, None] - means) < MAX_DIFFERENCE * np.maximum(means[:, None], means)
    found: list[Exchange] = []

    def extend(pairs: tuple[tuple[int, int], ...]) -> None:
        partners = np.arange(len(means))
        for a, b in pairs:
            partners[[a, b]] = b, a
        changes = np.abs(distances - distances[np.ix_(partners, partners)]) / size
        paired = np.flatnonzero(partners != np.arange(len(means)))
        # further pairs do not change the distances between those paired already
        if changes[np.ix_(paired, paired)].max(initial=0.0) > MAX_DIFFERENCE:
            return
        if pairs and changes.max() < MAX_DIFFERENCE:
            found.append(Exchange(tuple(partners.tolist()), float(changes.mean())))
        least = max((a for a, _ in pairs), default=-1)
        for a, b in combinations(np.setdiff1d(np.arange(len(means)), paired).tolist(), 2):
            if a > least and alike[a, b]:
                extend((*pairs, (a, b)))

    extend(())
    return sorted(found, key=lambda exchange: exchange.change)
