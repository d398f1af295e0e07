"""Fingers and thumbs of a placed human: free where the meshes show that they move, else fixed to the hand."""

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from ...body.skeleton import Skeleton
from ...geometry.procrustes import group_moments, rigid_errors

#: a small joint is free if its rotation explains at least this share of the squared error of its part as one with the hand
MIN_EXPLAINED = 0.5
#: and if that error, root mean square, is at least this share of the height of the body (1 mm for a person)
MIN_ERROR_SHARE = 6e-4
#: the least number of vertices of a part
MIN_VERTICES = 6


def free_small_joints(
    skeleton: Skeleton,
    rest: Float[np.ndarray, "V 3"],
    shapes: Float[np.ndarray, "F V 3"],
    labels: Int[np.ndarray, "V"],
) -> Skeleton:
    """Convert fixed joints with a part of their own to ball joints if the meshes show that the part rotates.

    The vertices of the joint's subtree and those of its parent are moved rigidly, once together and once apart. Joints
    without vertices of their own, such as those that carry the hips, stay fixed.

    **Arguments:** `labels` are the bones of the vertices; `rest` is their position in the shape of the skeleton.
    """
    kinds = list(skeleton.kinds)
    parents, below = skeleton.parents, skeleton.descendants
    height = float(np.ptp(rest, axis=0).max())
    for joint, kind in enumerate(kinds):
        own = below[joint][labels]
        near = own | (labels == parents[joint])
        if kind != "fixed" or not (labels == joint).any() or own.sum() < MIN_VERTICES:
            continue
        base = near & ~own
        if base.sum() < MIN_VERTICES:
            continue
        whole, alone, others = (_error(rest, shapes, rows) for rows in (near, own, base))
        explained = 1 - (alone + others) / max(whole, 1e-300)
        error = np.sqrt(whole / (near.sum() * len(shapes)))
        if explained >= MIN_EXPLAINED and error >= MIN_ERROR_SHARE * height:
            kinds[joint] = "ball"
    return dataclasses.replace(skeleton, kinds=tuple(kinds))


def _error(rest: np.ndarray, shapes: np.ndarray, rows: np.ndarray) -> float:
    """Compute the squared error of the best rigid motions of some vertices."""
    ones = np.ones((1, int(rows.sum())))
    return float(rigid_errors(group_moments(ones, rest[rows], shapes[:, rows].transpose(1, 0, 2)))[0])
