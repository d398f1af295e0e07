"""Errors of depth images, with one function for each kind."""

import numpy as np
from jaxtyping import Float

from .ray_casting import DepthImage
from .settings import Scanner


def apply_errors(
    scanner: Scanner, image: DepthImage, focal: float, rng: np.random.Generator
) -> Float[np.ndarray, "H W"]:
    """Apply all errors of a scanner to a depth image, metres; zero for pixels without measurement.

    **Arguments:** `focal`, the horizontal focal length of the image, pixels.
    """
    seen = image._replace(depth=remove_shadow(image.depth, scanner.baseline * focal))
    depth = remove_grazing(seen, scanner.max_grazing_angle)
    gap = np.maximum(scanner.gap, continuous_jump(depth, scanner.max_grazing_angle, focal))
    depth = lose_edges(depth, scanner.edge_loss, gap, rng)
    depth = lose_holes(depth, scanner.holes, scanner.hole_size, rng)
    depth = add_flying_pixels(depth, scanner.flying, gap, scanner.flying_reach, rng)
    depth = add_noise(depth, noise_deviation(scanner, image), rng)
    depth = quantise(depth, scanner.depth_step)
    if scanner.depth_unit > 0:
        depth = np.round(depth / scanner.depth_unit) * scanner.depth_unit
    return np.where((depth >= scanner.min_range) & (depth <= scanner.max_range), depth, 0.0)


def remove_shadow(depth: Float[np.ndarray, "H W"], focal_baseline: float) -> Float[np.ndarray, "H W"]:
    """Remove depths of surface that a second eye on the right does not see, behind surface that hides it.

    A pixel in column `u` is in column `u - focal * baseline / z` of the second eye's image. In the order of columns from
    the right, surface is hidden if surface farther right is in the same column of that image or in one on the left.
    """
    if focal_baseline == 0:
        return depth
    columns = np.arange(depth.shape[1]) - focal_baseline / np.where(depth > 0, depth, np.inf)
    columns = np.where(depth > 0, columns, np.inf)
    behind = np.minimum.accumulate(columns[:, ::-1], axis=1)[:, ::-1]
    hidden = np.zeros(depth.shape, bool)
    hidden[:, :-1] = columns[:, :-1] >= behind[:, 1:]
    return np.where(hidden, 0.0, depth)


def continuous_jump(
    depth: Float[np.ndarray, "H W"], max_angle: float, focal: float
) -> Float[np.ndarray, "H W"]:
    """Compute the difference in depth of neighbouring pixels on a surface at the largest measurable angle, metres.

    **Arguments:** `max_angle`, degrees, limited to 85; `focal`, pixels.
    """
    return depth * np.tan(np.radians(min(max_angle, 85.0))) / focal


def lose_edges(
    depth: Float[np.ndarray, "H W"], share: float, gap: Float[np.ndarray, "H W"], rng: np.random.Generator
) -> Float[np.ndarray, "H W"]:
    """Remove a share of the depths with a neighbour that is nearer or farther by more than `gap`, metres."""
    if share == 0:
        return depth
    edge = np.zeros(depth.shape, bool)
    for one, other in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        step = np.abs(depth[one] - depth[other])
        jump = (depth[one] > 0) & (depth[other] > 0) & (step > np.minimum(gap[one], gap[other]))
        edge[one] |= jump
        edge[other] |= jump
    return np.where(edge & (rng.random(depth.shape) < share), 0.0, depth)


def remove_grazing(image: DepthImage, max_angle: float) -> Float[np.ndarray, "H W"]:
    """Remove depths with an angle between normal and ray above `max_angle` degrees; 90 removes none."""
    return np.where(image.incidence_cosines >= np.cos(np.radians(max_angle)) - 1e-12, image.depth, 0.0)


def lose_holes(
    depth: Float[np.ndarray, "H W"], share: float, size: float, rng: np.random.Generator
) -> Float[np.ndarray, "H W"]:
    """Remove a share of the measured depths in holes of about `size` pixels.

    Holes are at the highest values of smooth noise, with a threshold that gives the share.
    """
    from scipy.ndimage import gaussian_filter

    lost = depth.copy()
    if share > 0:
        field = gaussian_filter(rng.normal(size=depth.shape), size / 2)
        measured = np.flatnonzero(depth > 0)
        order = np.argsort(-field.reshape(-1)[measured], kind="stable")
        lost.reshape(-1)[measured[order[: round(share * len(measured))]]] = 0.0
    return lost


def add_flying_pixels(
    depth: Float[np.ndarray, "H W"],
    share: float,
    gap: float | Float[np.ndarray, "H W"],
    max_shift: float,
    rng: np.random.Generator,
) -> Float[np.ndarray, "H W"]:
    """Move back a share of the pixels in front of a discontinuity (flying pixels).

    A pixel is in front of one if a neighbour, above, below, left or right, is farther by more than `gap`,
    metres, or without measurement. It moves by a random share of the distance to the farthest of them, at
    most `max_shift`, metres.
    """
    flown = depth.copy()
    if share > 0:
        jump = discontinuities(depth, max_shift)
        edge = np.flatnonzero((depth > 0) & (jump > gap))
        chance, way = rng.random((2, *depth.shape)).reshape(2, -1)
        chosen = edge[np.argsort(chance[edge], kind="stable")[: round(share * len(edge))]]
        flown.reshape(-1)[chosen] += way[chosen] * np.minimum(jump.reshape(-1)[chosen], max_shift)
    return flown


def discontinuities(depth: Float[np.ndarray, "H W"], missing_jump: float) -> Float[np.ndarray, "H W"]:
    """Compute how much farther the farthest of a pixel's four neighbours is, metres.

    A neighbour without measurement counts as `missing_jump`, metres. The image's border is no discontinuity.
    """
    framed = np.pad(depth, 1, mode="edge")
    around = np.stack([framed[:-2, 1:-1], framed[2:, 1:-1], framed[1:-1, :-2], framed[1:-1, 2:]])
    return np.where(around > 0, around - depth, missing_jump).max(0)


def noise_deviation(scanner: Scanner, image: DepthImage) -> Float[np.ndarray, "H W"]:
    """Compute the standard deviation of each depth by distance and angle, metres (Nguyen et al. 2012)."""
    depth = np.where(image.depth > 0, image.depth, 1.0)
    angle = np.arccos(np.clip(image.incidence_cosines, 0.05, 1.0))
    oblique = scanner.noise_angle / np.sqrt(depth) * (angle / (np.pi / 2 - angle)) ** 2
    return scanner.noise + scanner.noise_growth * (depth - scanner.noise_from) ** 2 + oblique


def add_noise(
    depth: Float[np.ndarray, "H W"], deviation: Float[np.ndarray, "H W"], rng: np.random.Generator
) -> Float[np.ndarray, "H W"]:
    """Add Gaussian noise of a standard deviation for each pixel, metres."""
    noisy = depth + deviation * rng.normal(size=depth.shape)
    return np.where((depth > 0) & (noisy > 0), noisy, 0.0)


def quantise(depth: Float[np.ndarray, "H W"], step: float) -> Float[np.ndarray, "H W"]:
    """Quantise inverse depths to whole multiples of `step` (1/metres), as cameras with whole disparities do.

    Successive depths differ by about `step` metres at 1 m, and by `step * z^2` at `z`.
    """
    if step == 0:
        return depth
    disparity = np.round(1.0 / (np.where(depth > 0, depth, 1.0) * step))
    return np.where((depth > 0) & (disparity > 0), 1.0 / (step * np.maximum(disparity, 1.0)), 0.0)
