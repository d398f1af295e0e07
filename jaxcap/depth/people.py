"""Several people in a depth image of a room."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from ..arguments import checked
from ..geometry.camera import Camera
from ..value_checks import check_at_least
from .background import Background
from .candidates import (
    MAX_DISTANCE,
    MAX_EXTENT,
    MIN_AREA,
    MIN_EXTENT,
    Candidate,
    belongs,
    surface_gap,
)
from .check_depths import keep_measured
from .person import check_measured, mask_of, nobody, searched_image, segment_surfaces

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
    background: Background | None = None,
) -> list[Bool[np.ndarray, "H W"]]:
    """Find the pixels of at most `count` people, nearest first; people who touch are one mask.

    As `find_person`: floors, walls and the background are removed, the other pixels are grouped into connected surfaces, and
    surfaces of a person's size are people, unless they are much lower than the nearest one. Smaller surfaces are added to
    the person next to them.

    **Arguments:** `depth`, metres, zero for pixels without measurement; `where` names the image in messages; `up`,
    the vertical of the camera's world; `background` of `estimate_background`.

    **Raises:** `InputError` as `search_person`; `NoPersonError` if nothing was measured, or no surface has the size of a
    person.
    """
    check_at_least("find_people", 1, count=count)
    depth = keep_measured(depth)
    check_measured(camera, depth, where)
    search = segment_surfaces(camera, depth, background, where)
    image = searched_image(camera, search)
    people = [[one] for one in choose_people(search.candidates, count, up)]
    if not people:
        raise nobody(where)
    others = [one for one in search.candidates if all(one.label != person[0].label for person in people)]
    # larger pieces first, so that smaller ones find them
    for one in sorted(others, key=lambda one: -one.area):
        own = min(people, key=lambda person: min(surface_gap(piece.points, one.points) for piece in person))
        # a larger surface is another person, or furniture
        if belongs(one, own, image, max_large_gap=0.0):
            own.append(one)
    return [mask_of(search, [piece.label for piece in own], depth) for own in people]


def choose_people(
    candidates: Sequence[Candidate], count: int, up: tuple[float, float, float] = (0.0, 1.0, 0.0)
) -> list[Candidate]:
    """Choose the largest surface of each of at most `count` people, nearest first; none if nobody is there."""
    largest = MAX_EXTENT * (1.0 if count == 1 else TOUCHING)
    large = [
        one
        for one in candidates
        if one.area >= MIN_AREA and MIN_EXTENT <= one.extent <= largest and one.distance <= MAX_DISTANCE
    ]
    large.sort(key=lambda one: one.distance / one.area**0.25)
    heights = [_height(one, up) for one in large]
    return [
        one for one, height in zip(large, heights, strict=True) if height >= MIN_HEIGHT_SHARE * heights[0]
    ][:count]


def _height(one: Candidate, up: tuple[float, float, float]) -> float:
    low, high = np.quantile(one.points @ (np.asarray(up) / np.linalg.norm(up)), [0.02, 0.98])
    return float(high - low)
