"""Disagreements of cameras: surface of the person that one camera sees in space that another one saw empty."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.ndimage import minimum_filter

from ..observe import DepthView
from .back_projection import measured_points
from .background import NUM_DEVIATIONS, default_noise

#: surface is in empty space if the other camera's is farther by more than this, also around it, metres
MIN_GAP = 0.05


class Disagreement(NamedTuple):
    """The points of the person of one camera that another camera could see, and those of them in empty space."""

    seen: int
    empty: int


def compare_views(views: Sequence[DepthView]) -> dict[tuple[int, int], Disagreement]:
    """Compare the person in the views of one frame, by the numbers of two cameras: the first one's points, the second one's space.

    Views of correct cameras disagree in noise and in pixels at edges alone. Wrong positions or directions put the
    person of one camera in front of what another one measured.
    """
    people = {number: points for number, view in enumerate(views) if len(points := _person_points(view))}
    return {
        (number, other): _count_empty(points, views[other])
        for number, points in people.items()
        for other in people
        if other != number
    }


def _person_points(view: DepthView) -> Float[np.ndarray, "N 3"]:
    person = (np.asarray(view.distances)[-1] == 0) & (np.asarray(view.depth) > 0)
    return measured_points(view.camera, np.where(person, np.asarray(view.depth, float), 0.0))


def _count_empty(points: Float[np.ndarray, "N 3"], view: DepthView) -> Disagreement:
    """Count the points that a view could see, and those in front of all that it measured around them."""
    camera, depth = view.camera, np.asarray(view.depth, float)
    rotation, translation, focal, middle = (
        np.asarray(a, float)
        for a in (camera.rotation, camera.translation, camera.focal, camera.principal_point)
    )
    local = points @ rotation.T + translation
    local = local[local[:, 2] > MIN_GAP]
    column, row = np.round(local[:, :2] / local[:, 2:] * focal + middle).astype(int).T
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    z, row, column = local[inside, 2], row[inside], column[inside]
    seen = depth[row, column] > 0
    z, row, column = z[seen], row[seen], column[seen]
    if not len(z):
        return Disagreement(0, 0)
    reach = int(np.ceil(MIN_GAP * float(focal.mean()) / float(np.median(z))))
    nearest = minimum_filter(np.where(depth > 0, depth, np.inf), 2 * reach + 1)[row, column]
    gap = np.maximum(MIN_GAP, NUM_DEVIATIONS * default_noise(nearest))
    return Disagreement(len(z), int((z < nearest - gap).sum()))
