"""Rooms around a moving person, as triangle meshes: floor, walls, a table and a chair."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..arguments import checked
from ..errors import InputError

#: distances of the back wall and of the side walls from the person, and height of walls, metres
BACK_DISTANCE, SIDE_DISTANCE, WALL_HEIGHT = 0.9, 1.6, 2.6
#: thickness of walls, of the floor, of boards and of legs, metres
WALL_THICKNESS, BOARD_THICKNESS, LEG_THICKNESS = 0.1, 0.04, 0.05
#: distance of furniture from the person, metres
FURNITURE_DISTANCE = 0.35
#: width, height and depth of a table, and of a chair's seat, metres; height of a chair's back
TABLE, SEAT, CHAIR_HEIGHT = (1.2, 0.74, 0.7), (0.44, 0.46, 0.44), 0.9


class Room(NamedTuple):
    """The surface of a room, metres, y up."""

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]


@checked
def make_room(low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"], furnished: bool = True) -> Room:
    """Make a room around the box from `low` to `high` in which a person moves, metres, y up.

    The floor is at the lowest point. A wall is behind the person (towards -z) and one on each side; the front is open
    for cameras. A table is behind the person on the right of the image, a chair on the left.

    **Raises:** `InputError` if `high` is below `low` along an axis.
    """
    if not (high >= low).all():
        raise InputError(f"make_room: the box reaches from {low} to {high}; expected larger values last.")
    floor, back = low[1], low[2] - BACK_DISTANCE
    left, right, front = low[0] - SIDE_DISTANCE, high[0] + SIDE_DISTANCE, high[2] + 6.0
    top = floor + WALL_HEIGHT
    boxes = [
        _box([left, floor - WALL_THICKNESS, back], [right, floor, front]),
        _box([left, floor, back - WALL_THICKNESS], [right, top, back]),
        _box([left - WALL_THICKNESS, floor, back], [left, top, front]),
        _box([right, floor, back], [right + WALL_THICKNESS, top, front]),
    ]
    if furnished:
        boxes += _table(np.array([high[0] + FURNITURE_DISTANCE, floor, back + 0.05]))
        boxes += _chair(np.array([low[0] - FURNITURE_DISTANCE - SEAT[0], floor, back + 0.3]))
    return _join(boxes)


def _table(corner: Float[np.ndarray, "3"]) -> list[Room]:
    return [*_legs(corner, TABLE), _board(corner, TABLE)]


def _chair(corner: Float[np.ndarray, "3"]) -> list[Room]:
    rest = corner + [0, SEAT[1], 0]
    back = _box(rest, rest + [SEAT[0], CHAIR_HEIGHT - SEAT[1], BOARD_THICKNESS])
    return [*_legs(corner, SEAT), _board(corner, SEAT), back]


def _board(corner: Float[np.ndarray, "3"], size: tuple[float, float, float]) -> Room:
    width, height, depth = size
    return _box(corner + [0, height - BOARD_THICKNESS, 0], corner + [width, height, depth])


def _legs(corner: Float[np.ndarray, "3"], size: tuple[float, float, float]) -> list[Room]:
    width, height, depth = size
    ends = [(x, z) for x in (0.0, width - LEG_THICKNESS) for z in (0.0, depth - LEG_THICKNESS)]
    return [
        _box(corner + [x, 0, z], corner + [x + LEG_THICKNESS, height - BOARD_THICKNESS, z + LEG_THICKNESS])
        for x, z in ends
    ]


def _box(low, high) -> Room:
    """Make a box between two corners, with outward triangles."""
    import trimesh

    low, high = np.asarray(low, float), np.asarray(high, float)
    box = trimesh.creation.box(bounds=[low, high])
    return Room(np.asarray(box.vertices, float), np.asarray(box.faces, int))


def _join(parts: list[Room]) -> Room:
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.faces + start for part, start in zip(parts, first, strict=False)]
    return Room(np.concatenate([part.vertices for part in parts]), np.concatenate(faces))
