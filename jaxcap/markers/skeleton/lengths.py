"""Bone lengths from joint positions: mean, least squares, and global least squares."""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...fit.alternate import iterate_until_converged
from ...geometry.linear import inverse_symmetric, solve_symmetric
from .segment_tree import SegmentTree

LengthMethod = Literal["mean", "least_squares", "global"]
#: maximal number of iterations over directions and lengths
MAX_ITERATIONS = 40
#: factor on the variance of a joint in frames where it is not known
UNKNOWN_VARIANCE_FACTOR = 1e6


class _LengthState(NamedTuple):
    """Lengths by group, and the joints of a skeleton with fixed lengths."""

    lengths: np.ndarray
    joints: np.ndarray


def joint_trajectories(tree: SegmentTree) -> tuple[Float[np.ndarray, "F K 3"], Bool[np.ndarray, "F K"]]:
    """Compute the position of each segment's joint with its parent in every frame, metres.

    Return also a mask of known positions. A position is the mean of the two segments' predictions, or that
    of the segment with a known frame.
    """
    frames = tree.augmented.frames
    count, number = frames.known.shape
    positions, known = np.zeros((count, number, 3)), np.zeros((count, number), bool)
    for k, joint in enumerate(tree.joints):
        if joint is None:
            continue
        total = np.zeros((count, 1))
        for segment, place in ((joint.parent, joint.in_parent), (joint.child, joint.in_child)):
            if not np.isfinite(place).all():
                continue
            ok = frames.known[:, segment, None]
            at = frames.rotations[:, segment] @ place + frames.origins[:, segment]
            positions[:, k] += np.where(ok, at, 0.0)
            total += ok
        known[:, k] = total[:, 0] > 0
        positions[:, k] /= np.maximum(total, 1)
    return positions, known


def list_bones(tree: SegmentTree) -> list[tuple[int, int]]:
    """List the bones between two joints as `(segment, child segment)`.

    A bone goes from a segment's joint with its parent to the joint with its child. A root has no joint of
    its own.
    """
    return [(p, k) for k, p in enumerate(tree.parents) if p >= 0 and tree.parents[p] >= 0]


def estimate_bone_lengths(
    positions: Float[np.ndarray, "F K 3"],
    known: Bool[np.ndarray, "F K"],
    joint_pairs: list[tuple[int, int]],
    method: LengthMethod = "global",
    *,
    left_right_pairs: list[tuple[int, int]] | None = None,
    deviations: Float[np.ndarray, "K"] | None = None,
) -> Float[np.ndarray, "B"]:
    """Estimate the length of each bone, metres; NaN for a bone with ends that are never known together.

    - `"mean"`: the mean distance of its ends over the frames (Silaghi et al. 1998).
    - `"least_squares"`: the minimum of `sum (|a - b|^2 - l^2)^2`, the root mean square distance.
    - `"global"`: the poses of all frames and all lengths together. It minimises the distances between the
      joints of the data and those of a skeleton with fixed lengths. Along the bone directions of a frame the
      distances are linear in the joints, with the covariance `J J^T`, as neighbouring bones share a joint.
      For given directions the lengths are the generalised least squares solution. Directions and lengths
      alternate until convergence.

    **Arguments:** `joint_pairs` the joints at the ends of each of B bones, a forest; `left_right_pairs` pairs of left and
    right bones with equal length; `deviations` of the joints, metres, by default all equal.

    **Raises:** `ValueError` for a method that does not exist.
    """
    if method not in ("mean", "least_squares", "global"):
        raise ValueError(
            f"There is no method '{method}' for lengths; expected mean, least_squares or global."
        )
    if not joint_pairs:
        return np.zeros(0)
    a, b = (np.array(side) for side in zip(*joint_pairs, strict=True))
    both = known[:, a] & known[:, b]
    away = positions[:, b] - positions[:, a]
    group = _group_bones(len(joint_pairs), left_right_pairs or [])
    spread = np.eye(int(group.max()) + 1)[group]
    distances = np.where(both, np.linalg.norm(away, axis=-1), 0.0)
    counts = spread.T @ both.sum(0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = (spread.T @ distances.sum(0)) / counts
        square = np.sqrt((spread.T @ (distances**2).sum(0)) / counts)
    if method != "global":
        return (mean if method == "mean" else square)[group]
    seen = both.any(1)
    usable = np.flatnonzero(counts > 0)
    positions, known, both = positions[seen], known[seen], both[seen]
    variances = np.ones(positions.shape[1]) if deviations is None else np.asarray(deviations, float) ** 2
    spans = np.where(known, variances, UNKNOWN_VARIANCE_FACTOR * variances.max())
    number = np.arange(len(joint_pairs))

    def step(fit: _LengthState) -> _LengthState:
        along = fit.joints[:, b] - fit.joints[:, a]
        units = along / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-12)
        rows = np.zeros((len(positions), len(joint_pairs), positions.shape[1], 3))
        rows[:, number, b] += units
        rows[:, number, a] -= units
        # distances of the data along the directions, and their covariance
        measured = np.einsum("fbkd,fkd->fb", rows, positions)
        weighted = rows * spans[:, None, :, None]
        shared = np.einsum("fbkd,fckd->fbc", weighted, rows)
        inverse = inverse_symmetric(shared + 1e-12 * spans.max() * np.eye(len(b)))
        total = spread.T @ inverse.sum(0) @ spread
        side = spread.T @ np.einsum("fbc,fc->b", inverse, measured)
        new = fit.lengths.copy()
        new[usable] = solve_symmetric(total[np.ix_(usable, usable)], side[usable])
        multipliers = np.einsum("fbc,fc->fb", inverse, measured - new[group])
        return _LengthState(new, positions - np.einsum("fb,fbkd->fkd", multipliers, weighted))

    start = _LengthState(np.where(np.isnan(mean), 0.1, mean), positions)
    lengths = iterate_until_converged(step, start, MAX_ITERATIONS, 1e-9, min_iterations=0).lengths
    return np.where(counts[group] > 0, lengths[group], np.nan)


def _group_bones(count: int, left_right_pairs: list[tuple[int, int]]) -> np.ndarray:
    group = np.arange(count)
    for one, other in left_right_pairs:
        group[group == group[other]] = group[one]
    return np.unique(group, return_inverse=True)[1].ravel()
