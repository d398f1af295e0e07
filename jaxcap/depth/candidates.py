"""Connected surfaces in front of the background, and which of them are a person."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

#: image size for the search, pixels on the longest side
SEARCH_SIDE = 160
#: neighbouring pixels are on one surface if their depths differ by less than this share of the depth
CONTINUITY = 0.04
#: pieces of a person, such as an arm in front of the trunk, are nearer than this to each other, metres
MAX_PIECE_GAP = 0.25
#: larger pieces, such as legs below a trunk that leans, and pieces next to other pieces are nearer than this, metres;
#: a smaller area than this next to other pieces, square metres, may be as far away as a piece: a head above raised arms
MAX_SMALL_GAP, HEAD_AREA = 0.12, 0.03
#: a surface of a hand's size that nothing supports may be as far away as the length of a forearm, which a hand that is stretched
#: out towards the camera hides; its least area, square metres, and largest extent, metres
MAX_HAND_GAP, MIN_HAND_AREA, MAX_HAND_EXTENT = 0.5, 2e-3, 0.3
#: largest angle at the camera between such a hand and the person, degrees
MAX_HAND_ANGLE = 5.0
#: what supports a surface is nearer than this, metres; largest number of such points, as a share of those of the surface
SUPPORT_DISTANCE, MAX_SUPPORT_SHARE = 0.1, 0.1
#: extents of a visible person, metres: the longest side, and the least area of its surface, square metres
MIN_EXTENT, MAX_EXTENT, MIN_AREA = 0.3, 2.3, 0.06
#: farther surface is no person, metres; smaller surface is noise, square metres
MAX_DISTANCE, MIN_PIECE_AREA = 8.0, 1e-3
#: smaller surfaces are not joined with others to a person, square metres
MIN_JOINED_AREA = 0.01
#: what a candidate was found to be
PERSON, PIECE, OTHER = "the person", "a piece of the person", "farther away than the person"
TOO_SMALL, TOO_LARGE, TOO_FAR = "too small", "too large", "too far away"


class Candidate(NamedTuple):
    """A connected surface in an image, without floors, walls and background."""

    #: its number in the image of labels
    label: int
    #: some of its points in the world, metres
    points: Float[np.ndarray, "N 3"]
    #: visible area, square metres
    area: float
    #: the longest side of its box, metres
    extent: float
    #: median distance from the camera, metres
    distance: float
    #: one of the constants above
    found: str


class SearchedImage(NamedTuple):
    """An image as it is searched, with every so-many-th row and column."""

    #: of each pixel, the number of its candidate
    labels: Int[np.ndarray, "h w"]
    #: in the world, metres; zero where nothing was measured
    points: Float[np.ndarray, "h w 3"]
    #: position of the camera
    eye: Float[np.ndarray, "3"]


def search_step(shape: tuple[int, ...]) -> int:
    """Return the number of rows and columns from one searched pixel to the next."""
    return max(1, -(-max(shape) // SEARCH_SIDE))


def connect_pixels(z: Float[np.ndarray, "h w"], free: Bool[np.ndarray, "h w"]) -> Int[np.ndarray, "h w"]:
    """Label connected `free` pixels with continuous depths, from 1; zero for others."""
    index = np.arange(z.size).reshape(z.shape)
    links = []
    for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        near = free[a] & free[b] & (np.abs(z[a] - z[b]) < CONTINUITY * np.minimum(z[a], z[b]))
        links.append(np.stack([index[a][near], index[b][near]], 1))
    i, j = np.concatenate(links).T
    _, of = connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(z.size, z.size)), directed=False)
    labels = np.zeros(z.size, int)
    _, labels[free.reshape(-1)] = np.unique(of[free.reshape(-1)], return_inverse=True)
    labels[free.reshape(-1)] += 1
    return labels.reshape(z.shape)


def list_candidates(
    labels: Int[np.ndarray, "h w"],
    points: Float[np.ndarray, "h w 3"],
    areas: Float[np.ndarray, "h w"],
    eye: Float[np.ndarray, "3"],
) -> list[Candidate]:
    """Measure labelled surfaces, and judge each alone: those of a person's size are `OTHER`.

    **Arguments:** `areas`, that of each pixel's surface, square metres; `eye`, the position of the camera, metres.
    """
    total = np.bincount(labels.reshape(-1), areas.reshape(-1))
    candidates = []
    for label in np.flatnonzero(total >= MIN_PIECE_AREA):
        if label == 0:
            continue
        few = points[labels == label]
        extent = _extent(few)
        distance = float(np.median(np.linalg.norm(few - eye, axis=1)))
        area = float(total[label])
        if extent > MAX_EXTENT:
            found = TOO_LARGE
        elif area < MIN_AREA or extent < MIN_EXTENT:
            found = TOO_SMALL
        else:
            found = TOO_FAR if distance > MAX_DISTANCE else OTHER
        candidates.append(Candidate(int(label), few, area, extent, distance, found))
    return candidates


def join_small(
    labels: Int[np.ndarray, "h w"], candidates: list[Candidate]
) -> tuple[Int[np.ndarray, "h w"], bool]:
    """Give small surfaces next to each other one label, if together they have the size of a person.

    Arms in front of the trunk may divide a person into surfaces that are all too small. Return whether there are such
    surfaces; surfaces that have the size of a person alone are preferred, and then nothing is joined. Of several groups the
    largest one is joined.
    """
    small = [one for one in candidates if one.found == TOO_SMALL and one.area >= MIN_JOINED_AREA]
    if len(small) < 2 or any(one.found == OTHER for one in candidates):
        return labels, False
    near = np.array([[is_piece(one.points, other.points) for other in small] for one in small])
    _, groups = connected_components(near, directed=False)
    joined = [[small[row] for row in np.flatnonzero(groups == group)] for group in np.unique(groups)]
    largest = max(joined, key=lambda group: sum(one.area for one in group))
    whole = join_candidates(largest)
    if whole.area < MIN_AREA or not MIN_EXTENT <= whole.extent <= MAX_EXTENT:
        return labels, False
    return np.where(np.isin(labels, [one.label for one in largest]), whole.label, labels), True


def choose_person(candidates: list[Candidate], image: SearchedImage) -> list[Candidate]:
    """Mark the nearest surface of a person's size as the person, and smaller ones next to it as its pieces."""
    right = [one for one in candidates if one.found == OTHER]
    if not right:
        return candidates
    first = min(right, key=lambda one: one.distance / one.area**0.25)
    found, person = {first.label: PERSON}, [first]
    for one in sorted(candidates, key=lambda one: -one.area):
        if one.label != first.label and belongs(one, person, image):
            found[one.label] = PIECE
            person.append(one)
    return [one._replace(found=found.get(one.label, one.found)) for one in candidates]


def belongs(
    one: Candidate, person: list[Candidate], image: SearchedImage, max_large_gap: float = MAX_SMALL_GAP
) -> bool:
    """Test if a surface is a piece of a person: of its largest surface, which is the first, and the pieces so far.

    A surface larger than the first is a piece if it is nearer than `max_large_gap`, metres.
    """
    first, points = person[0], np.concatenate([piece.points for piece in person])
    gap = MAX_PIECE_GAP if one.area < first.area else max_large_gap
    chain = MAX_PIECE_GAP if one.area < HEAD_AREA else MAX_SMALL_GAP
    return (
        is_piece(first.points, one.points, gap)
        or is_piece(points, one.points, chain)
        or is_stretched_hand(one, points, image)
    )


def is_stretched_hand(one: Candidate, person: Float[np.ndarray, "N 3"], image: SearchedImage) -> bool:
    """Test if a surface may be a hand that is stretched out towards the camera and hides its arm.

    It has the size of a hand, is seen next to the person, not farther away than a forearm, and nothing supports it.
    """
    if not MIN_HAND_AREA <= one.area < HEAD_AREA or one.extent > MAX_HAND_EXTENT:
        return False
    if not is_piece(person, one.points, MAX_HAND_GAP):
        return False
    rays, others = (rows - image.eye for rows in (one.points, person))
    rays, others = (rows / np.linalg.norm(rows, axis=1, keepdims=True) for rows in (rays, others))
    if surface_gap(others, rays) > np.radians(MAX_HAND_ANGLE):
        return False
    measured = np.any(image.points != 0, axis=-1) & (image.labels != one.label)
    return is_unsupported(one.points, image.points[measured])


def is_unsupported(points: Float[np.ndarray, "N 3"], others: Float[np.ndarray, "M 3"]) -> bool:
    """Test if few other points are near a surface. Things on a table or a wall are supported by it."""
    if not len(others):
        return True
    near = KDTree(points).query(others, distance_upper_bound=SUPPORT_DISTANCE)[0] < np.inf
    return int(near.sum()) < MAX_SUPPORT_SHARE * len(points)


def join_candidates(parts: list[Candidate]) -> Candidate:
    """Measure several surfaces together, such as a person and its pieces; the rest is that of the first."""
    points = np.concatenate([one.points for one in parts])
    area = sum(one.area for one in parts)
    return parts[0]._replace(points=points, area=area, extent=_extent(points))


def is_piece(
    points: Float[np.ndarray, "N 3"], others: Float[np.ndarray, "M 3"], max_gap: float = MAX_PIECE_GAP
) -> bool:
    """Test if two surfaces are near enough to each other, and together small enough, to be of one person."""
    both = np.concatenate([points, others])
    return _extent(both) <= MAX_EXTENT and surface_gap(points, others) < max_gap


def _extent(points: Float[np.ndarray, "N 3"]) -> float:
    low, high = np.quantile(points, [0.02, 0.98], axis=0)
    return float((high - low).max())


def surface_gap(one: Float[np.ndarray, "N 3"], other: Float[np.ndarray, "M 3"]) -> float:
    """Compute the smallest distance of some points of a surface to another one, metres."""
    return float(KDTree(one).query(other[:: max(1, len(other) // 200)])[0].min())
