"""Points that a program has computed from markers, such as joint centres and midpoints."""

from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...arguments import checked
from ...geometry.linear import least_squares
from ...geometry.sampling import even_indices
from .pair_distances import pair_distance_ranges

#: largest root mean square error of a computed point, metres: files store tenths of millimetres
MAX_ERROR = 2e-4
#: largest error as a share of the range of the distances between the sources. Markers on a rigid body are functions of each
#: other as well, but only as exactly as their distances are constant
MAX_ERROR_SHARE = 0.05
#: number of frames that are compared, and the fewest
NUM_FRAMES, MIN_FRAMES = 40, 20
#: number of markers, those at the most constant distances, that are tried as sources in threes
NUM_PARTNERS = 5


class ComputedPoint(NamedTuple):
    """A point that is an exact function of two or three others."""

    marker: int
    sources: tuple[int, ...]
    #: root mean square error, metres
    error: float


@checked
def find_computed_points(
    positions: Float[np.ndarray, "F M 3"], seen: Bool[np.ndarray, "F M"]
) -> tuple[ComputedPoint, ...]:
    """Find the points that are exact functions of two or three other markers, while these move against each other.

    A function of two is a point on their line, at a constant share of their distance. One of three is a constant sum of edges,
    unit edges and the unit normal of their triangle, as joint centres are by regression equations. A marker has noise of its
    own, and follows others by a millimetre at best. Sources of a computed point are markers.
    """
    some = even_indices(len(positions), NUM_FRAMES, nearest=True)
    ranges = pair_distance_ranges(positions, seen)
    positions, seen = positions[some], seen[some]
    candidates = [
        found
        for marker in range(seen.shape[1])
        if seen[:, marker].sum() >= MIN_FRAMES
        for found in (
            *_on_lines(positions, seen, ranges, marker),
            *_of_triangles(positions, seen, ranges, marker),
        )
    ]
    found: dict[int, ComputedPoint] = {}
    sources: set[int] = set()
    # of three points on a line, the one between the others is computed; lines first
    for one in sorted(
        candidates, key=lambda c: (len(c.sources), not _is_between(positions, seen, c), c.error)
    ):
        if one.marker not in found and one.marker not in sources and not set(one.sources) & set(found):
            found[one.marker] = one
            sources.update(one.sources)
    return tuple(sorted(found.values()))


def _on_lines(
    positions: Float[np.ndarray, "F M 3"], seen: Bool[np.ndarray, "F M"], ranges: np.ndarray, marker: int
) -> list[ComputedPoint]:
    """Find the pairs of markers on whose line a marker is, at a constant share of their distance."""
    shown = (seen & seen[:, marker, None]).astype(float)
    away = np.where(shown[..., None] > 0, positions - positions[:, marker, None], 0.0)
    counts = shown.T @ shown
    # over the frames with all three visible: squared distances of the first, and products with the second
    squares = np.sum(away**2, 2).T @ shown
    products = np.einsum("fia,fja->ij", away, away, optimize=True)
    along = np.maximum(squares + squares.T - 2 * products, 1e-12)
    rest = np.maximum(squares - (squares - products) ** 2 / along, 0.0)
    errors = np.sqrt(rest / np.maximum(counts, 1))
    exact = (counts >= MIN_FRAMES) & (errors < np.minimum(MAX_ERROR, MAX_ERROR_SHARE * np.nan_to_num(ranges)))
    exact[marker] = exact[:, marker] = False
    return [
        ComputedPoint(marker, (i, j), float(errors[i, j])) for i, j in np.argwhere(np.triu(exact, 1)).tolist()
    ]


def _of_triangles(
    positions: Float[np.ndarray, "F M 3"], seen: Bool[np.ndarray, "F M"], ranges: np.ndarray, marker: int
) -> list[ComputedPoint]:
    """Find the triangles of which a marker is a function."""
    order = np.argsort(np.where(np.isnan(ranges[marker]), np.inf, ranges[marker]), kind="stable")
    partners = [int(k) for k in order if k != marker and np.isfinite(ranges[marker, k])][:NUM_PARTNERS]
    found = []
    for three in combinations(partners, 3):
        shown = seen[:, [marker, *three]].all(1)
        if shown.sum() < MIN_FRAMES:
            continue
        spread = float(np.nanmax(ranges[np.ix_(three, three)]))
        corners = positions[shown][:, list(three)]
        error = _triangle_error(corners, positions[shown, marker] - corners[:, 0])
        if error < min(MAX_ERROR, MAX_ERROR_SHARE * spread):
            found.append(ComputedPoint(marker, three, error))
    return found


def _triangle_error(corners: Float[np.ndarray, "F 3 3"], away: Float[np.ndarray, "F 3"]) -> float:
    """Compute the root mean square error of a point as the best function of a triangle, metres."""
    edges = corners[:, [1, 2, 2]] - corners[:, [0, 0, 1]]
    lengths = np.linalg.norm(edges, axis=2, keepdims=True)
    normal = np.cross(edges[:, 0], edges[:, 1])
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    units = edges / np.maximum(lengths, 1e-12)
    across = np.cross(normal[:, None], units)
    parts = np.concatenate([edges[:, :2], units, across, normal[:, None]], 1)
    rows = parts.transpose(0, 2, 1).reshape(-1, parts.shape[1])
    share = least_squares(rows, away.ravel())
    return float(np.sqrt(np.mean(np.sum((rows @ share - away.ravel()).reshape(-1, 3) ** 2, 1))))


def _is_between(
    positions: Float[np.ndarray, "F M 3"], seen: Bool[np.ndarray, "F M"], point: ComputedPoint
) -> bool:
    if len(point.sources) != 2:
        return False
    first, second = point.sources
    shown = seen[:, [point.marker, first, second]].all(1)
    at = positions[shown]
    inside = np.sum((at[:, first] - at[:, point.marker]) * (at[:, second] - at[:, point.marker]), 1)
    return bool(np.mean(inside < 0) > 0.5)
