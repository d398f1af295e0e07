"""Joint centres between rigid parts: the point that both parts move alike."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.distance import cdist

from ..parts.surface_graph import SurfaceGraph, boundary_edges

#: rounds of updating the residual variance, and with it the weight of the prior
ROUNDS = 5
#: all frames together count as at most this many independent ones, as skin deforms alike in similar poses
INDEPENDENT = 3
#: least residual, as a share of the boundary radius, so that exactly rigid data can be solved
FLOOR = 1e-3


class PartBoundaries(NamedTuple):
    """Boundaries between parts, one row for each adjacent pair."""

    #: (P, 2), the lesser part first
    pairs: Int[np.ndarray, "P 2"]
    #: centroid of the common boundary in the rest mesh
    centroids: Float[np.ndarray, "P 3"]
    #: root mean square distance of the boundary from its centroid, metres
    radii: Float[np.ndarray, "P"]
    #: length of the boundary, metres; zero for parts that do not touch
    lengths: Float[np.ndarray, "P"]
    #: distance between parts that do not touch, metres
    gaps: Float[np.ndarray, "P"]


class Centres(NamedTuple):
    """The best common point of each pair of parts."""

    #: in the rest mesh
    points: Float[np.ndarray, "P 3"]
    #: root mean square distance between the positions of the point under the two parts, metres
    residuals: Float[np.ndarray, "P"]


def find_boundaries(
    surface: SurfaceGraph, labels: Int[np.ndarray, "V"], rest: Float[np.ndarray, "V 3"], count: int
) -> PartBoundaries:
    """Find the boundaries between parts.

    If the parts of a disconnected mesh are not all connected, also return the gaps between every two parts of
    different pieces.
    """
    pairs, crossing = boundary_edges(surface, labels)
    keys, place = np.unique(pairs, axis=0, return_inverse=True)
    place = place.ravel()
    ends = rest[surface.edges[crossing]]
    middles = ends.mean(1)
    # on a mesh of equilateral triangles, each crossing edge represents half an edge length of boundary; edges
    # that only connect pieces have almost no weight
    weights = np.where(surface.is_mesh_edge[crossing], 0.5 * surface.lengths[crossing], 0.0)
    lengths = np.bincount(place, weights, len(keys))
    shares = np.maximum(weights, 1e-9)
    shares = shares / np.bincount(place, shares, len(keys))[place]
    centres = np.stack([np.bincount(place, shares * middles[:, i], len(keys)) for i in range(3)], 1)
    spread = np.bincount(place, shares * np.sum((middles - centres[place]) ** 2, 1), len(keys))
    jumps = np.bincount(place, shares * np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1), len(keys))
    gaps = np.where(lengths > 0, 0.0, jumps)
    seams = PartBoundaries(keys, centres, np.sqrt(spread), lengths, gaps)
    return _with_gaps(seams, labels, rest, count)


def find_centres(
    boundaries: PartBoundaries,
    rotations: Float[np.ndarray, "F K 3 3"],
    translations: Float[np.ndarray, "F K 3"],
    size: float,
    error: float = 0.0,
) -> Centres:
    """Find the points `c` with the least sum over frames of `|T_a c - T_b c|^2`.

    A hinge leaves the position along its axis undetermined, and parts that do not rotate leave all of it. The
    centroid of the boundary therefore serves as a normal prior with the standard deviation of the boundary
    radius, against the estimated variance of the residuals. Parts that bend without a fixed centre have their
    best point far away: a centre is constrained to the sphere through its boundary.

    **Arguments:** `size` of the body, metres, bounds the boundary radius from below; `error` of the parts,
    metres, bounds the residuals from below.
    """
    frames = len(rotations)
    a, b = boundaries.pairs.T
    turn = rotations[:, a] - rotations[:, b]
    shift = translations[:, b] - translations[:, a] - np.einsum("fpab,pb->fpa", turn, boundaries.centroids)
    values, axes = np.linalg.eigh(np.einsum("fpai,fpaj->pij", turn, turn))
    values = np.maximum(values, 0.0)
    along = np.einsum("pij,fpai,fpa->pj", axes, turn, shift)
    radii = np.maximum(boundaries.radii, 0.01 * size)
    variances = (0.1 * radii) ** 2
    points, residuals = boundaries.centroids, np.zeros(len(radii))
    for _ in range(ROUNDS):
        pull = max(1.0, frames / INDEPENDENT) * variances / radii**2
        steps = _bounded_steps(values, along, pull, radii)
        away = np.einsum("pij,pj->pi", axes, steps)
        points = boundaries.centroids + away
        gap = np.einsum("fpab,pb->fpa", turn, away) - shift
        residuals = np.sqrt(np.mean(np.sum(gap * gap, -1), 0))
        variances = np.maximum(np.maximum(residuals, error) ** 2 / 3, (FLOOR * radii) ** 2)
    return Centres(points, residuals)


def _bounded_steps(values: np.ndarray, along: np.ndarray, pull: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Solve (P, 3) `along / (values + pull)`, with `pull` raised until each step is within its radius."""
    solve = lambda weight: along / (values + weight[:, None])  # noqa: E731
    low, high = pull, np.maximum(pull, np.linalg.norm(along, axis=1) / radii)
    for _ in range(40):
        middle = np.sqrt(low * high)
        far = np.linalg.norm(solve(middle), axis=1) > radii
        low, high = np.where(far, middle, low), np.where(far, high, middle)
    inside = np.linalg.norm(solve(pull), axis=1) <= radii
    return solve(np.where(inside, pull, high))


def _with_gaps(seams: PartBoundaries, labels: np.ndarray, rest: np.ndarray, count: int) -> PartBoundaries:
    owner = np.arange(count)
    for a, b in seams.pairs[seams.lengths > 0]:
        owner[owner == owner[b]] = owner[a]
    if len(np.unique(owner)) == 1:
        return seams
    touching = seams.lengths > 0
    seams = PartBoundaries(*(field[touching] for field in seams))
    rows = []
    for a in range(count):
        for b in range(a + 1, count):
            if owner[a] != owner[b]:
                p, q = _thinned(rest[labels == a]), _thinned(rest[labels == b])
                gaps = cdist(p, q)
                i, j = np.unravel_index(np.argmin(gaps), gaps.shape)
                rows.append(((a, b), (p[i] + q[j]) / 2, gaps[i, j]))
    pairs, middles, gaps = (np.array(column) for column in zip(*rows, strict=True))
    none = np.zeros(len(rows))
    more = PartBoundaries(pairs, middles, none, none, gaps)
    return PartBoundaries(*(np.concatenate(both) for both in zip(seams, more, strict=True)))


def _thinned(points: np.ndarray, count: int = 500) -> np.ndarray:
    return points[:: max(1, len(points) // count)]
