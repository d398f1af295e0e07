"""Several people in a depth image of a room."""

import numpy as np
from jaxtyping import Bool, Float

from ..arguments import checked
from ..errors import InputError
from ..geometry.camera import Camera
from ..value_checks import check_at_least
from .back_projection import measured_points
from .person import (
    MAX_EXTENT,
    MAX_PIECE_GAP,
    MIN_AREA,
    MIN_EXTENT,
    SEARCH_SIDE,
    _connected,
    _extent,
    _gap,
    _Piece,
    _refine,
)
from .planes import find_planes, on_planes
from .views import check_image_size_of

#: least area of a piece of a person, square metres
MIN_PIECE_AREA = 1e-3
#: people who touch are one surface, whose longest side may be larger than a person's by this factor
TOUCHING = 1.5
#: least height of a person, as a share of the nearest one's
MIN_HEIGHT_SHARE = 0.6


@checked
def find_people(
    camera: Camera,
    depth: Float[np.ndarray, "H W"],
    count: int = 2,
    where: str = "the image",
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
) -> list[Bool[np.ndarray, "H W"]]:
    """Find the pixels of at most `count` people, nearest first; people who touch are one mask.

    As `find_person`: floors and walls are planes, the other pixels are grouped into connected surfaces, and surfaces of a
    person's size are people, unless they are much lower than the nearest one. Smaller surfaces are added to the person next
    to them.

    **Arguments:** `depth`, metres, zero for pixels without measurement; `where` names the image in messages; `up`,
    the vertical of the camera's world.

    **Raises:** `InputError` if the image has another size than the camera's, or no surface has the size of a person.
    """
    check_at_least("find_people", 1, count=count)
    check_image_size_of(camera, depth, "image", where)
    step = max(1, -(-max(depth.shape) // SEARCH_SIDE))
    points = np.zeros((*depth.shape, 3))
    points[depth > 0] = measured_points(camera, depth)
    z, few = depth[::step, ::step], points[::step, ::step]
    if not (z > 0).any():
        raise InputError(f"{where}: nothing was measured; leave out this frame.")
    eye = np.asarray(camera.eye, float)
    free = (depth > 0) & ~on_planes(find_planes(few[z > 0], eye), points)
    labels = _connected(z, free[::step, ::step])
    focal = float(np.mean(np.asarray(camera.focal)))
    pieces = [
        _Piece(label, few[labels == label], float(np.sum((z[labels == label] * step / focal) ** 2)))
        for label in range(1, labels.max() + 1)
    ]
    largest = MAX_EXTENT * (1.0 if count == 1 else TOUCHING)
    large = [p for p in pieces if p.area >= MIN_AREA and MIN_EXTENT <= _extent(p.points) <= largest]
    if not large:
        raise InputError(
            f"{where}: no surface has the size of a person; check the unit of depth and the intrinsics, or give masks."
        )
    large.sort(key=lambda piece: _distance(piece, eye) / piece.area**0.25)
    heights = [_height(piece, up) for piece in large]
    tall = [height >= MIN_HEIGHT_SHARE * heights[0] for height in heights]
    people = [piece for piece, high in zip(large, tall, strict=True) if high][:count]
    kept: list[list[_Piece]] = [[person] for person in people]
    main = {person.label for person in people}
    for piece in pieces:
        if piece.label in main or piece.area < MIN_PIECE_AREA:
            continue
        gaps = [_gap(person.points, piece.points) for person in people]
        nearest = int(np.argmin(gaps))
        both = np.concatenate([people[nearest].points, piece.points])
        smaller = piece.area < people[nearest].area
        if smaller and gaps[nearest] < MAX_PIECE_GAP and _extent(both) <= largest:
            kept[nearest].append(piece)
    return [_refine(np.isin(labels, [piece.label for piece in own]), z, depth, free, step) for own in kept]


def _distance(piece: _Piece, eye: Float[np.ndarray, "3"]) -> float:
    return float(np.median(np.linalg.norm(piece.points - eye, axis=1)))


def _height(piece: _Piece, up: tuple[float, float, float]) -> float:
    low, high = np.quantile(piece.points @ (np.asarray(up) / np.linalg.norm(up)), [0.02, 0.98])
    return float(high - low)
