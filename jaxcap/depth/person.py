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
from .back_projection import measured_points
from .planes import Plane, find_planes, on_planes
from .views import check_image_size_of

#: image size for the search, pixels on the longest side
SEARCH_SIDE = 160
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
    return find_person_and_planes(camera, depth, where)[0]


def find_person_and_planes(
    camera: Camera, depth: Float[np.ndarray, "H W"], where: str
) -> tuple[Bool[np.ndarray, "H W"], list[Plane]]:
    """Find the pixels of the person as `find_person` does, and the planes of floor and walls."""
    check_image_size_of(camera, depth, "image", where)
    step = search_step(depth.shape)
    points = np.zeros((*depth.shape, 3))
    points[depth > 0] = measured_points(camera, depth)
    z = depth[::step, ::step]
    if not (z > 0).any():
        raise InputError(f"{where}: nothing was measured; leave out this frame.")
    few = points[::step, ::step]
    planes = find_planes(few[z > 0], np.asarray(camera.eye, float))
    free = (depth > 0) & ~on_planes(planes, points)
    labels = connected_pixels(z, free[::step, ::step])
    focal = float(np.mean(np.asarray(camera.focal)))
    pieces = []
    for number in range(1, labels.max() + 1):
        chosen = labels == number
        pieces.append(_Piece(number, few[chosen], float(np.sum((z[chosen] * step / focal) ** 2))))
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
    return enlarge_mask(small, z, depth, free, step), planes


def search_step(shape: tuple[int, ...]) -> int:
    """Return the step between the rows and columns of an image that a search visits."""
    return max(1, -(-max(shape) // SEARCH_SIDE))


def _extent(points: Float[np.ndarray, "N 3"]) -> float:
    low, high = np.quantile(points, [0.02, 0.98], axis=0)
    return float((high - low).max())


def _gap(one: Float[np.ndarray, "N 3"], other: Float[np.ndarray, "M 3"]) -> float:
    return float(KDTree(one).query(other[:: max(1, len(other) // 200)])[0].min())


def connected_pixels(z: Float[np.ndarray, "h w"], free: Bool[np.ndarray, "h w"]) -> Int[np.ndarray, "h w"]:
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


def enlarge_mask(
    small: Bool[np.ndarray, "h w"],
    z: Float[np.ndarray, "h w"],
    depth: Float[np.ndarray, "H W"],
    free: Bool[np.ndarray, "H W"],
    step: int,
) -> Bool[np.ndarray, "H W"]:
    """Enlarge a mask to `free` pixels of its blocks, and of the blocks next to these, with a depth like theirs."""
    (rows, columns), (height, width) = depth.shape, small.shape
    blocks = np.pad(np.where(small, z, 0.0).astype(depth.dtype), 1)
    tolerance, person = CONTINUITY * depth, np.zeros(depth.shape, bool)
    for down in range(3):
        for across in range(3):
            near = blocks[down : down + height, across : across + width]
            wide = near.repeat(step, 0)[:rows].repeat(step, 1)[:, :columns]
            person |= np.abs(depth - wide) < tolerance
    return person & free
