"""The frame of each segment over time, from its visible markers."""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...geometry.linear import pseudo_inverse
from ...geometry.procrustes import nearest_rotation
from ...geometry.sampling import even_indices
from ..robust import MEDIAN_SQUARED_LENGTH
from ..rotation_centres.estimator_parts import geman_mcclure_weights
from .segment_sets import Segments

#: maximal number of iterations for the shape of a segment
MAX_ITERATIONS = 8
#: number of frames that a shape is estimated from, evenly over the take
MAX_SHAPE_FRAMES = 400
#: a segment is a line where its second singular value is below this share of its first
COLLINEAR_RATIO = 0.05


class SegmentFrames(NamedTuple):
    """Rigid motions of K segments over F frames, `x = rotations p + origins`."""

    rotations: Float[np.ndarray, "F K 3 3"]
    origins: Float[np.ndarray, "F K 3"]
    #: true where three markers that span a plane were visible
    known: Bool[np.ndarray, "F K"]
    #: position of each marker in its segment's frame, metres; zero where it has none
    local_positions: Float[np.ndarray, "M 3"]

    def residuals(
        self, positions: Float[np.ndarray, "F M 3"], seen: Bool[np.ndarray, "F M"], segments: Segments
    ) -> Float[np.ndarray, "F M"]:
        """Compute the distance of each marker from its predicted position, metres; NaN where not known."""
        owner = segments.marker_segments
        r, o = self.rotations[:, owner], self.origins[:, owner]
        away = np.linalg.norm(np.einsum("fmab,mb->fma", r, self.local_positions) + o - positions, axis=-1)
        return np.where(seen & self.known[:, owner] & (owner >= 0), away, np.nan)

    def noise(
        self, positions: Float[np.ndarray, "F M 3"], seen: Bool[np.ndarray, "F M"], segments: Segments
    ) -> tuple[Float[np.ndarray, "K"], Float[np.ndarray, "K"]]:
        """Estimate the noise of each segment.

        Return the variance of its markers about their positions, metres squared a coordinate, and the
        resulting variance of its rotation about an axis, radians squared.
        """
        off = self.residuals(positions, seen, segments)
        marker_noise, rotation_noise = np.zeros(segments.num_segments), np.zeros(segments.num_segments)
        for k, members in enumerate(segments.members):
            if not self.known[:, k].any():
                continue
            marker_noise[k] = coordinate_variance(off[:, list(members)], len(members))
            p = self.local_positions[list(members)]
            p = p - p.mean(0)
            inertia = np.sum(p * p) * np.eye(3) - p.T @ p
            rotation_noise[k] = marker_noise[k] * float(np.trace(pseudo_inverse(inertia, symmetric=True))) / 3
        return marker_noise, rotation_noise


def coordinate_variance(residuals: Float[np.ndarray, "*shape"], num_markers: int) -> float:
    """Estimate the variance of a coordinate from distances after rigid fits, metres squared; zero if all are NaN.

    Robust, by the median of the squared distances. Each fit adapts six of the 3N coordinates of its `num_markers` markers.
    """
    if not np.isfinite(residuals).any():
        return 0.0
    return float(np.nanmedian(residuals**2)) / MEDIAN_SQUARED_LENGTH * num_markers / max(num_markers - 2, 1)


def fit_segment_frames(
    positions: Float[np.ndarray, "F M 3"],
    seen: Bool[np.ndarray, "F M"],
    segments: Segments,
    method: Literal["procrustes", "axes"] = "procrustes",
) -> SegmentFrames:
    """Fit the frames of all segments.

    The axes of a segment are the paper's. The origin is at the weighted centre of mass. The x axis points to
    the marker with the largest distance times weight. The xy plane contains the marker with the largest
    distance from that axis times weight. With `"axes"` they are computed in every frame with all markers
    visible. With `"procrustes"` they are computed once, in the mean shape, which is then fitted to all
    visible markers: at least three, weighted, and robustly from four on. Segments with fewer than three
    markers, or with markers on a line, are known in no frame.
    """
    count, number = len(positions), segments.num_segments
    rotations = np.tile(np.eye(3), (count, number, 1, 1))
    origins = np.zeros((count, number, 3))
    known = np.zeros((count, number), bool)
    template = np.zeros((positions.shape[1], 3))
    for k, members in enumerate(segments.members):
        chosen = list(members)
        weights = segments.weights[chosen]
        x, s = positions[:, chosen], seen[:, chosen]
        shape = mean_shape(x, s, weights)
        if shape is None:
            continue
        axes, origin, (far, off) = shape_axes(shape, weights)
        shape = (shape - origin) @ axes
        template[chosen] = shape
        if method == "axes":
            known[:, k] = s.all(1)
            origins[:, k] = np.einsum("fma,m->fa", x, weights) / weights.sum()
            rotations[:, k] = _axes_from_directions(x[:, far] - origins[:, k], x[:, off] - origins[:, k])
        else:
            rotations[:, k], origins[:, k], known[:, k] = align_shape(shape, x, s, weights)
    return SegmentFrames(rotations, origins, known, template)


def shape_axes(
    shape: Float[np.ndarray, "N 3"], weights: Float[np.ndarray, "N"]
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"], tuple[int, int]]:
    """Compute the paper's axes as columns, the origin, and the indices of the two defining markers."""
    origin = weights @ shape / weights.sum()
    away = shape - origin
    far = int(np.argmax(np.linalg.norm(away, axis=1) * weights))
    x = away[far] / np.linalg.norm(away[far])
    off = int(np.argmax(np.linalg.norm(away - np.outer(away @ x, x), axis=1) * weights))
    return _axes_from_directions(away[None, far], away[None, off])[0], origin, (far, off)


def mean_shape(
    x: Float[np.ndarray, "F N 3"], seen: Bool[np.ndarray, "F N"], weights: Float[np.ndarray, "N"]
) -> Float[np.ndarray, "N 3"] | None:
    """Estimate the mean shape of N markers by generalised Procrustes analysis (Gower 1975) with gaps.

    None where fewer than three are visible together, or where they are on a line.
    """
    if x.shape[1] < 3 or not (seen.sum(1) >= 3).any():
        return None
    some = even_indices(len(x), MAX_SHAPE_FRAMES, nearest=True)
    if (np.asarray(seen[some].sum(1)) == seen.sum(1).max()).any():
        x, seen = x[some], seen[some]
    counts = np.asarray(seen.sum(1))
    full = np.flatnonzero(counts == counts.max())
    # start from the frame with the most typical distances
    distances = np.linalg.norm(x[full][:, :, None] - x[full][:, None], axis=-1)
    both = seen[full][:, :, None] & seen[full][:, None]
    usual = np.nanmedian(np.where(both, distances, np.nan), axis=0, keepdims=True) if both.all() else None
    off = np.zeros(len(full)) if usual is None else np.abs(distances - usual).sum((1, 2))
    start = full[int(np.argmin(off))]
    shape, have = x[start].copy(), seen[start].copy()
    for _ in range(MAX_ITERATIONS):
        r, o, ok = align_shape(shape, x, seen & have, weights, rounds=2)
        if not ok.any():
            return None
        back = np.einsum("fba,fnb->fna", r[ok], x[ok] - o[ok, None])
        s = seen[ok]
        had = have
        have = np.asarray(s.any(0))
        new = shape.copy()
        for n in np.flatnonzero(have):
            # weights by distance, as weights by coordinate would depend on the world's orientation
            mine = back[s[:, n], n]
            about = shape[n] if had[n] else mine.mean(0)
            for _ in range(3):
                about = np.average(
                    mine, axis=0, weights=geman_mcclure_weights(np.linalg.norm(mine - about, axis=1))
                )
            new[n] = about
        moved = np.abs(new - shape).max()
        shape = new
        if had.all() and moved < 1e-9:
            break
    if not have.all():
        # a marker that is never visible with three others has no position in the shape
        return None
    return shape if spans_plane(shape[None], np.ones((1, len(shape)), bool))[0] else None


def align_shape(
    shape: Float[np.ndarray, "N 3"],
    x: Float[np.ndarray, "F N 3"],
    seen: Bool[np.ndarray, "F N"],
    weights: Float[np.ndarray, "N"],
    rounds: int = 4,
) -> tuple[Float[np.ndarray, "F 3 3"], Float[np.ndarray, "F 3"], Bool[np.ndarray, "F"]]:
    """Fit a shape to its visible markers in every frame; return rotations, origins and a mask of known
    frames."""
    w = weights * seen
    known = (seen.sum(1) >= 3) & spans_plane(np.broadcast_to(shape, x.shape), seen)
    r, o = _weighted_procrustes(shape, x, w)
    if len(shape) >= 4:
        for _ in range(rounds):
            off = np.linalg.norm(np.einsum("fab,nb->fna", r, shape) + o[:, None] - x, axis=-1)
            inside = off[seen & known[:, None]]
            if inside.size == 0:
                break
            scale = max(3.0 * float(np.median(inside)), 1e-6)
            r, o = _weighted_procrustes(shape, x, w / (1 + (off / scale) ** 2) ** 2)
    return r, o, known


def spans_plane(shape: Float[np.ndarray, "F N 3"], seen: Bool[np.ndarray, "F N"]) -> Bool[np.ndarray, "F"]:
    """Test in each frame if the visible markers span a plane."""
    patterns, place = np.unique(seen, axis=0, return_inverse=True)
    extents = np.zeros(len(patterns), bool)
    for i, pattern in enumerate(patterns):
        if pattern.sum() >= 3:
            some = shape[np.argmax(place.ravel() == i)][pattern]
            values = np.linalg.svd(some - some.mean(0), compute_uv=False)
            extents[i] = values[1] > COLLINEAR_RATIO * values[0]
    return extents[place.ravel()]


def two_marker_frames(
    first: Float[np.ndarray, "F 3"],
    second: Float[np.ndarray, "F 3"],
    base: Float[np.ndarray, "F 3"],
    seen: Bool[np.ndarray, "F"],
) -> tuple[Float[np.ndarray, "F 3 3"], Float[np.ndarray, "F 3"], Bool[np.ndarray, "F"]]:
    """Compute frames of a segment of two markers that a hinge joins to another (Silaghi et al. 1998).

    The x axis goes from the first marker to the second. The xy plane contains a marker of the base segment,
    which stays in that plane as the hinge rotates. Not known where the three are on a line.
    """
    along, aside = second - first, base - first
    high = np.linalg.norm(np.cross(along, aside), axis=-1)
    flat = high > COLLINEAR_RATIO * np.linalg.norm(along, axis=-1) * np.linalg.norm(aside, axis=-1)
    return _axes_from_directions(along, aside), 0.5 * (first + second), seen & flat


def _axes_from_directions(x_direction: np.ndarray, plane_direction: np.ndarray) -> np.ndarray:
    """Build rotations (F, 3, 3) with x along the first direction and the xy plane through the second.

    The columns are the axes.
    """
    x = x_direction / np.maximum(np.linalg.norm(x_direction, axis=-1, keepdims=True), 1e-300)
    z = np.cross(x, plane_direction)
    z = z / np.maximum(np.linalg.norm(z, axis=-1, keepdims=True), 1e-300)
    return np.stack([x, np.cross(z, x), z], -1)


def _weighted_procrustes(
    shape: np.ndarray, x: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    mass = np.maximum(weights.sum(1), 1e-300)
    shape_mean = weights @ shape / mass[:, None]
    target_mean = np.einsum("fn,fna->fa", weights, x) / mass[:, None]
    cross = np.einsum("fn,fna,fnb->fab", weights, x - target_mean[:, None], shape[None] - shape_mean[:, None])
    r = nearest_rotation(cross)
    return r, target_mean - np.einsum("fab,fb->fa", r, shape_mean)
