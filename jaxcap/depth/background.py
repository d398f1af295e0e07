"""The background behind a person: for each pixel the farthest depth on which several frames agree."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..arguments import checked
from ..errors import InputError
from ..geometry.camera import Camera
from ..geometry.sampling import even_indices
from .attached import find_attached
from .check_depths import check_depth_scale, check_image_size_of, keep_measured

#: largest number of frames of a sequence that are compared, and of their values in memory
MAX_FRAMES, MAX_VALUES = 30, 64_000_000
#: fewest frames of a sequence that has no empty frames
MIN_FRAMES = 10
#: share of the frames that have to agree on a depth, and least number of them in a sequence with people
MIN_SHARE, MIN_SUPPORT = 0.05, 3
#: standard deviation of a depth `z` before it is measured: of structured light, `NOISE + NOISE_GROWTH * z^2`, metres
NOISE, NOISE_GROWTH = 0.0015, 0.0025
#: depths within so many standard deviations are of one surface
NUM_DEVIATIONS = 4.0
#: least tolerance, metres; width of the ranges of depth in which noise is measured, metres; least number of values there
MIN_TOLERANCE, NOISE_RANGE, MIN_VALUES = 0.02, 0.25, 500


class Background(NamedTuple):
    """The surface behind a person that never moves, by pixel."""

    #: metres along the optical axis; zero where it is not known
    depth: Float[np.ndarray, "H W"]
    #: a pixel is in front of the background if it is nearer by more than this, metres
    tolerance: Float[np.ndarray, "H W"]
    #: number of frames that agree on the depth
    support: Int[np.ndarray, "H W"]
    #: what cannot be decided, in a sentence without a full stop; empty if nothing
    doubt: str = ""


@checked
def estimate_background(
    camera: Camera,
    depths: Sequence[Float[np.ndarray, "H W"]],
    *,
    empty: bool = False,
    where: str = "the background",
) -> Background:
    """Estimate the background of one camera that does not move.

    The background of a pixel is the farthest depth on which several frames agree. Its tolerance is a multiple of the
    noise that the frames show at that depth, and at least 2 cm.

    Frames that show nobody (`empty`) decide every pixel. In frames that show people, a surface that never moves is
    furniture or a person who stands still. It is background only if no moving surface is attached to it: an arm that
    moves keeps the trunk out of the background. If no surface moves at all, nothing but floors and walls is known, and
    `doubt` says so.

    **Arguments:** `depths`, metres, zero where nothing was measured; of a long sequence at most `MAX_FRAMES` spread
    frames are used; `where` names the sequence in messages.

    **Raises:** `InputError` if there are no images, an image has another size than the camera's, or depths that cannot be
    in metres.
    """
    if not len(depths):
        raise InputError(f"{where}: there are no images; give at least one.")
    most = max(MIN_FRAMES, min(MAX_FRAMES, MAX_VALUES // (camera.width * camera.height)))
    frames = []
    for number in even_indices(len(depths), most, nearest=True).tolist():
        name = f"{where}, image {number}"
        check_image_size_of(camera, depths[number], "image", name)
        frames.append(keep_measured(depths[number]).astype(np.float32))
    images = np.stack(frames)
    check_depth_scale(images, where)
    if not empty and len(images) < MIN_FRAMES:
        return unknown_background(
            camera,
            f"{len(images)} {'frame is' if len(images) == 1 else 'frames are'} too few to distinguish furniture from people; give at least {MIN_FRAMES} frames, "
            "or empty frames",
        )
    least = max(1, len(images) // 4) if empty else max(MIN_SUPPORT, round(MIN_SHARE * len(images)))
    depth, support = farthest_depths(images, least)
    tolerance = measure_tolerance(images, depth, support)
    if empty:
        return Background(depth, tolerance, support)
    attached, moved = find_attached(camera, images, depth, tolerance)
    doubt = ""
    if not moved:
        doubt = (
            "no surface with the size of a person moves, so a person who stands still cannot be distinguished from "
            "furniture; give empty frames, or masks"
        )
    return Background(np.where(attached, 0.0, depth), tolerance, np.where(attached, 0, support), doubt)


def unknown_background(camera: Camera, doubt: str) -> Background:
    """Make a background of which no pixel is known."""
    nothing = np.zeros((camera.height, camera.width))
    return Background(nothing, nothing, nothing.astype(int), doubt)


def is_background(background: Background, depth: Float[np.ndarray, "H W"]) -> Bool[np.ndarray, "H W"]:
    """Test which pixels are not in front of a known background."""
    return depth > nearest_background(background)


def nearest_background(background: Background) -> Float[np.ndarray, "H W"]:
    """Compute the depth beyond which a pixel shows background, metres; infinite where it is not known."""
    return np.where(background.depth > 0, background.depth - background.tolerance, np.inf)


def take_background(background: Background, step: int) -> Background:
    """Take every `step`-th row and column of a background."""
    depth, tolerance, support = (image[::step, ::step] for image in background[:3])
    return Background(depth, tolerance, support, background.doubt)


def farthest_depths(
    images: Float[np.ndarray, "F H W"], least: int
) -> tuple[Float[np.ndarray, "H W"], Int[np.ndarray, "H W"]]:
    """Find the farthest depth of each pixel on which at least `least` images agree, and their number.

    Images agree if their depths differ by at most `NUM_DEVIATIONS` standard deviations of structured light.
    """
    order = -np.sort(-images, axis=0)
    depth = np.zeros(images.shape[1:], images.dtype)
    support = np.zeros(images.shape[1:], int)
    for first in range(len(order) - least + 1):
        near = order[first + least - 1]
        lowest = order[first] - NUM_DEVIATIONS * default_noise(order[first])
        found = (support == 0) & (near > 0) & (near >= lowest)
        if not found.any():
            continue
        # those from the first one on, to the lowest
        count = np.sum(order[first:, found] >= lowest[found], axis=0)
        depth[found] = np.take_along_axis(order[first:, found], (count // 2)[None], 0)[0]
        support[found] = count
    return depth.astype(float), support


def default_noise(depth: np.ndarray) -> np.ndarray:
    """Compute the standard deviation of depths of structured light, metres."""
    return NOISE + NOISE_GROWTH * depth**2


def measure_tolerance(
    images: Float[np.ndarray, "F H W"], depth: Float[np.ndarray, "H W"], support: Int[np.ndarray, "H W"]
) -> Float[np.ndarray, "H W"]:
    """Measure the noise of depths in ranges of depth, and return the tolerance of each pixel.

    The noise is that of structured light where fewer than `MIN_VALUES` pixels of a range are known from several images.
    """
    near = np.abs(images - depth) <= NUM_DEVIATIONS * default_noise(depth)
    count = np.maximum(near.sum(0), 1)
    spread = np.sqrt(np.sum(np.where(near, images - depth, 0.0) ** 2, 0) / count)
    known = (support >= 5) & (depth > 0)
    ranges = np.round(depth / NOISE_RANGE).astype(int)
    noise = default_noise(depth)
    for number in np.unique(ranges[known]):
        chosen = known & (ranges == number)
        if np.count_nonzero(chosen) >= MIN_VALUES:
            # oblique surface and edges are noisier than most pixels
            noise[ranges == number] = np.quantile(spread[chosen], 0.9)
    return np.maximum(NUM_DEVIATIONS * noise, MIN_TOLERANCE)
