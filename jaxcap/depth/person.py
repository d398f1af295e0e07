"""The person in a depth image of a room: without floor and walls, the most person-like connected surface."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from ..arguments import checked
from ..errors import InputError
from ..geometry.camera import Camera
from ..geometry.mesh import area_normals
from .back_projection import measured_points
from .views import check_image_size_of

#: image size for the search, pixels on the longest side
SEARCH_SIDE = 160
#: distance of points that belong to a plane, and share of all points that makes a plane floor or wall
PLANE_DISTANCE, MIN_PLANE_SHARE = 0.03, 0.12
#: number of planes that are looked for, and of tried triples of points for each
NUM_PLANES, NUM_TRIALS = 4, 200
#: largest share of points behind a wall, or below a floor
MAX_BEHIND = 0.05
#: neighbouring pixels are on one surface if their depths differ by less than this share of the depth
CONTINUITY = 0.04
#: pieces of a person, such as an arm in front of the trunk, are nearer than this to each other, metres
MAX_PIECE_GAP = 0.25
#: extents of a visible person, metres: the longest side, and the least area of its surface, square metres
MIN_EXTENT, MAX_EXTENT, MIN_AREA = 0.3, 2.3, 0.06


class _Piece(NamedTuple):
    """A connected surface in an image."""

    label: int
    points: Float[np.ndarray, "N 3"]
    #: visible area, square metres
    area: float


@checked
def find_person(
    camera: Camera, depth: Float[np.ndarray, "H W"], where: str = "the image"
) -> Bool[np.ndarray, "H W"]:
    """Find the pixels of the person that is nearest to the camera.

    Floors and walls are planes with many points. The remaining pixels are grouped into connected
    surfaces. The nearest surface of a person's size is the person. Smaller surfaces next to it are added, such as an
    arm in front of the trunk.

    **Arguments:** `depth`, metres, zero for pixels without measurement; `where` names the image in messages.

    **Raises:** `InputError` if the image has another size than the camera's, or no surface has the size of a person.
    """
    check_image_size_of(camera, depth, "image", where)
    step = max(1, -(-max(depth.shape) // SEARCH_SIDE))
    points = np.zeros((*depth.shape, 3))
    points[depth > 0] = measured_points(camera, depth)
    points = points[::step, ::step]
    z = depth[::step, ::step]
    measured = z > 0
    if not measured.any():
        raise InputError(f"{where}: nothing was measured; leave out this frame.")
    free = measured & ~_on_planes(points, measured, np.asarray(camera.eye, float))
    labels = _connected(z, free)
    focal = float(np.mean(np.asarray(camera.focal)))
    pieces = []
    for number in range(1, labels.max() + 1):
        chosen = labels == number
        pieces.append(_Piece(number, points[chosen], float(np.sum((z[chosen] * step / focal) ** 2))))
    large = [
        piece
        for piece in pieces
        if piece.area >= MIN_AREA and MIN_EXTENT <= _extent(piece.points) <= MAX_EXTENT
    ]
    if not large:
        raise InputError(
            f"{where}: no surface has the size of a person; check the unit of depth and the intrinsics, or give masks."
        )
    eye = np.asarray(camera.eye, float)
    first = min(
        large,
        key=lambda piece: float(np.median(np.linalg.norm(piece.points - eye, axis=1))) / piece.area**0.25,
    )
    kept, person = {first.label}, first.points
    for piece in sorted(pieces, key=lambda piece: -piece.area):
        if piece.label in kept or piece.area < 1e-3:
            continue
        both = np.concatenate([person, piece.points])
        if (
            piece.area < first.area
            and _gap(person, piece.points) < MAX_PIECE_GAP
            and _extent(both) <= MAX_EXTENT
        ):
            kept.add(piece.label)
    small = np.isin(labels, list(kept))
    return _refine(small, z, depth, step)


def _extent(points: Float[np.ndarray, "N 3"]) -> float:
    low, high = np.quantile(points, [0.02, 0.98], axis=0)
    return float((high - low).max())


def _gap(one: Float[np.ndarray, "N 3"], other: Float[np.ndarray, "M 3"]) -> float:
    return float(KDTree(one).query(other[:: max(1, len(other) // 200)])[0].min())


def _on_planes(
    points: Float[np.ndarray, "h w 3"], measured: Bool[np.ndarray, "h w"], eye: Float[np.ndarray, "3"]
) -> Bool[np.ndarray, "h w"]:
    """Find points on floors and walls, by random sample consensus."""
    rng, used, found = np.random.default_rng(0), np.zeros_like(measured), np.zeros_like(measured)
    count = measured.sum()
    for _ in range(NUM_PLANES):
        left = points[measured & ~used]
        if len(left) < 100:
            break
        triples = left[rng.integers(len(left), size=(NUM_TRIALS, 3))]
        normals = area_normals(triples)
        lengths = np.linalg.norm(normals, axis=1)
        good = lengths > 1e-6
        normals, offsets = normals[good] / lengths[good, None], triples[good, 0]
        offsets = np.sum(normals * offsets, 1)
        few = left[:: max(1, len(left) // 2000)]
        shares = np.mean(np.abs(few @ normals.T - offsets) < PLANE_DISTANCE, 0)
        best = int(np.argmax(shares))
        if shares[best] * len(left) < MIN_PLANE_SHARE * count:
            break
        heights = points @ normals[best] - offsets[best]
        heights = heights * np.sign(eye @ normals[best] - offsets[best])
        on = measured & (np.abs(heights) < PLANE_DISTANCE)
        # nothing is behind a wall or below a floor, but much is behind a plane through a person
        behind = float(np.mean(heights[measured] < -2 * PLANE_DISTANCE))
        if behind < MAX_BEHIND and _is_wide(points[on]):
            found |= on
        used |= on
    return found


def _is_wide(points: Float[np.ndarray, "N 3"]) -> bool:
    """Test if points extend farther than a person's back."""
    low, high = np.quantile(points, [0.05, 0.95], axis=0)
    return bool(np.sort(high - low)[1] > 0.8 or np.sort(high - low)[2] > 1.5)


def _connected(z: Float[np.ndarray, "h w"], free: Bool[np.ndarray, "h w"]) -> Int[np.ndarray, "h w"]:
    """Label connected pixels with continuous depths, from 1; zero for others."""
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


def _refine(
    small: Bool[np.ndarray, "h w"], z: Float[np.ndarray, "h w"], depth: Float[np.ndarray, "H W"], step: int
) -> Bool[np.ndarray, "H W"]:
    """Enlarge a mask to pixels of its blocks with a depth like that of the block's pixel."""
    size = depth.shape
    wide = np.kron(np.where(small, z, 0.0), np.ones((step, step)))[: size[0], : size[1]]
    return (depth > 0) & (np.abs(depth - wide) < CONTINUITY * depth)
