"""Surface that never moves, but may belong to a person who stands on one spot."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import binary_opening, maximum_filter

from ..geometry.camera import Camera
from ..observe.planes import Plane, find_planes, on_planes
from .back_projection import world_points
from .candidates import OTHER, connect_pixels, is_piece, list_candidates, search_step

#: share of a connected surface that has to move, so that all of it may be a person
MIN_MOVING_SHARE = 0.02
#: surface may be a person if it is attached to one in so many frames, and in this share of those with a person who moves
MIN_ATTACHED_FRAMES, MIN_ATTACHED_SHARE = 2, 0.4


def find_attached(
    camera: Camera,
    images: Float[np.ndarray, "F H W"],
    depth: Float[np.ndarray, "H W"],
    tolerance: Float[np.ndarray, "H W"],
) -> tuple[Bool[np.ndarray, "H W"], bool]:
    """Find the pixels of the farthest depths that may belong to a person, and whether a person moves.

    In each frame, connected surfaces are found after floors and walls are removed. A person-sized surface moves if some of
    its pixels are nearer than the farthest `depth` by more than the `tolerance`. Its other pixels never move, and neither
    does surface next to it, but they may belong to the person: the trunk of a person who moves only the arms. In most
    frames such surface is next to a moving one: the arms are nearer than the farthest depth even at rest, because other
    frames show the wall behind them. Surface that is alone in most frames is furniture. If nobody moves, every surface
    except floors and walls may belong to a person.

    **Arguments:** `images`, frames of one camera that does not move, metres.
    """
    step = search_step(depth.shape)
    far, bound = depth[::step, ::step], (depth - tolerance)[::step, ::step]
    planes = find_planes(world_points(camera, depth, step)[far > 0], np.asarray(camera.eye, float))
    attached, alone = np.zeros(far.shape, int), np.zeros(far.shape, int)
    surfaces, moved = np.zeros(far.shape, bool), 0
    for image in images:
        z = image[::step, ::step].astype(float)
        nearer = (far > 0) & (z < bound)
        labels, moving = _find_moving(camera, image.astype(float), z, nearer, planes, step)
        surfaces |= labels > 0
        moved += bool(moving)
        if moving:
            person = np.isin(labels, moving)
            attached += person & ~nearer
            alone += (labels > 0) & ~person & ~nearer
    if moved < MIN_ATTACHED_FRAMES:
        unknown, moved = surfaces, 0
    else:
        least = np.maximum(MIN_ATTACHED_FRAMES, MIN_ATTACHED_SHARE * (attached + alone))
        unknown = attached >= least
    # pixels between the searched ones, and edges next to them
    wide = np.kron(maximum_filter(unknown, 3), np.ones((step, step), bool))
    return wide[: depth.shape[0], : depth.shape[1]], bool(moved)


def _find_moving(
    camera: Camera,
    image: Float[np.ndarray, "H W"],
    z: Float[np.ndarray, "h w"],
    nearer: Bool[np.ndarray, "h w"],
    planes: list[Plane],
    step: int,
) -> tuple[Int[np.ndarray, "h w"], list[int]]:
    """Label the surfaces of a frame, and list those of people who move, with the surfaces next to them."""
    points = world_points(camera, image, step)
    free = (z > 0) & ~on_planes(planes, points)
    labels = connect_pixels(z, free)
    areas = (z * step / float(np.mean(np.asarray(camera.focal)))) ** 2
    # moving pixels without moving neighbours are noise
    moves = binary_opening(free & nearer, np.ones((2, 2)))
    moving_area = np.bincount(labels.reshape(-1), np.where(moves, areas, 0.0).reshape(-1), labels.max() + 1)
    candidates = list_candidates(labels, points, areas, np.asarray(camera.eye, float))
    people = [
        one
        for one in candidates
        if one.found == OTHER and moving_area[one.label] >= MIN_MOVING_SHARE * one.area
    ]
    others = [one for one in candidates if all(one.label != person.label for person in people)]
    near = [one.label for one in others if any(is_piece(person.points, one.points) for person in people)]
    return labels, [*(one.label for one in people), *near]
