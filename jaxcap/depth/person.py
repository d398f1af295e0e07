"""The person in a depth image of a room: without background, the most person-like connected surface."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..arguments import checked
from ..errors import NoPersonError
from ..geometry.camera import Camera
from ..observe.planes import Plane, find_planes, on_planes
from .back_projection import world_points
from .background import Background, is_background
from .candidates import (
    CONTINUITY,
    PERSON,
    PIECE,
    Candidate,
    SearchedImage,
    choose_person,
    connect_pixels,
    join_small,
    list_candidates,
    search_step,
)
from .check_depths import check_depth_scale, check_image_size_of, keep_measured


class PersonSearch(NamedTuple):
    """The steps of a search for the person in one image."""

    #: floors and walls, and the measured pixels on them
    planes: list[Plane]
    on_planes: Bool[np.ndarray, "H W"]
    #: measured pixels that are not in front of the background, and on no plane
    on_background: Bool[np.ndarray, "H W"]
    #: connected surfaces of the other pixels, and what each was found to be
    candidates: list[Candidate]
    #: the candidate of every `step`-th pixel, by its `label`
    labels: Int[np.ndarray, "h w"]
    #: their points in the world, metres; zero where nothing was measured
    points: Float[np.ndarray, "h w 3"]
    step: int
    #: the pixels of the person; none if nobody was found
    person: Bool[np.ndarray, "H W"]


@checked
def search_person(
    camera: Camera,
    depth: Float[np.ndarray, "H W"],
    background: Background | None = None,
    where: str = "the image",
) -> PersonSearch:
    """Search for the person that is nearest to the camera, and return every step of the search.

    Floors and walls are planes with many points. They and the `background` are removed. The remaining pixels are grouped
    into connected surfaces. The nearest surface of a person's size is the person. Smaller surfaces next to it are added,
    such as an arm in front of the trunk.

    **Arguments:** `depth`, metres, zero for pixels without measurement; `background` of `estimate_background`; `where`
    names the image in messages.

    **Raises:** `InputError` if an image has another size than the camera's, or depths that cannot be in metres.
    """
    depth = keep_measured(depth)
    search = segment_surfaces(camera, depth, background, where)
    candidates = choose_person(search.candidates, searched_image(camera, search))
    kept = [one.label for one in candidates if one.found in (PERSON, PIECE)]
    return search._replace(candidates=candidates, person=mask_of(search, kept, depth))


def segment_surfaces(
    camera: Camera, depth: Float[np.ndarray, "H W"], background: Background | None, where: str
) -> PersonSearch:
    """Remove planes and background, and group the remaining pixels into connected surfaces; no person is chosen yet.

    The errors are those of `search_person`.
    """
    check_image_size_of(camera, depth, "image", where)
    check_depth_scale(depth, where)
    step, measured, eye = search_step(depth.shape), depth > 0, np.asarray(camera.eye, float)
    points = world_points(camera, depth)
    z, few = depth[::step, ::step], points[::step, ::step]
    planes = find_planes(few[z > 0], eye)
    on_plane = measured & on_planes(planes, points)
    behind = np.zeros(depth.shape, bool)
    if background is not None:
        check_image_size_of(camera, background.depth, "background", where)
        behind = measured & ~on_plane & is_background(background, depth)
    free = measured & ~on_plane & ~behind
    labels = connect_pixels(z, free[::step, ::step])
    focal = float(np.mean(np.asarray(camera.focal)))
    areas = (z * step / focal) ** 2
    candidates = list_candidates(labels, few, areas, eye)
    if background is not None and not background.doubt:
        # otherwise small things next to each other may be furniture
        labels, is_joined = join_small(labels, candidates)
        candidates = list_candidates(labels, few, areas, eye) if is_joined else candidates
    nobody = np.zeros(depth.shape, bool)
    return PersonSearch(planes, on_plane, behind, candidates, labels, few, step, nobody)


def searched_image(camera: Camera, search: PersonSearch) -> SearchedImage:
    """Return the searched pixels of an image with its camera."""
    return SearchedImage(search.labels, search.points, np.asarray(camera.eye, float))


def mask_of(
    search: PersonSearch, labels: list[int], depth: Float[np.ndarray, "H W"]
) -> Bool[np.ndarray, "H W"]:
    """Return the pixels of some of the surfaces of `segment_surfaces`."""
    z = depth[:: search.step, :: search.step]
    free = (depth > 0) & ~search.on_planes & ~search.on_background
    return enlarge_mask(np.isin(search.labels, labels), z, depth, free, search.step)


@checked
def find_person(
    camera: Camera,
    depth: Float[np.ndarray, "H W"],
    where: str = "the image",
    background: Background | None = None,
) -> Bool[np.ndarray, "H W"]:
    """Find the pixels of the person that is nearest to the camera; see `search_person`, which has the arguments.

    **Raises:** `InputError` if an image has another size than the camera's, or depths that cannot be in metres;
    `NoPersonError` if nothing was measured, or no surface has the size of a person.
    """
    check_measured(camera, depth, where)
    return check_found(search_person(camera, depth, background, where), where).person


def check_measured(camera: Camera, depth: Float[np.ndarray, "H W"], where: str) -> None:
    """Check that an image of the camera has measured pixels.

    **Raises:** `InputError` if it has another size than the camera's; `NoPersonError` if nothing was measured.
    """
    check_image_size_of(camera, depth, "image", where)
    if not (depth > 0).any():
        raise NoPersonError(
            f"{where}: nothing was measured; check that the camera is not covered, or leave out this frame."
        )


def check_found(search: PersonSearch, where: str, takes_masks: bool = False) -> PersonSearch:
    """Return a search that found a person. Raises `NoPersonError` as of `nobody`."""
    if not search.person.any():
        raise nobody(where, takes_masks)
    return search


def nobody(where: str, takes_masks: bool = False) -> NoPersonError:
    """Make the error of an image in which no surface has the size of a person.

    It advises masks only if the caller `takes_masks`.
    """
    masks = ", or give masks" if takes_masks else ""
    return NoPersonError(
        f"{where}: no surface has the size of a person; if one is there, check the unit of depth and the intrinsics{masks}."
    )


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
