"""Fingers and thumbs of a placed human: free where the meshes show that they move, else fixed to the hand."""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ...body.skeleton import Skeleton
from ...body.symmetry import left_right_pairs_by_name
from ...geometry.procrustes import group_moments, rigid_errors, rigid_motions

#: a small joint is free if its rotation explains at least this share of the squared error of its part as one with the hand
MIN_EXPLAINED = 0.5
#: and if that error, root mean square, is at least this share of the height of the body (1 mm for a person)
MIN_ERROR_SHARE = 6e-4
#: a part rotates about its own joint if that point's squared distance between the part and the bone before it is at most this
#: share of the same distance of the parent's joint (median; at most 0.5 where it does, at least 2 on a real wrist)
MAX_DISTANCE_RATIO = 0.7
#: the least number of vertices of a part, and of that of its parent, as a share of the part
MIN_VERTICES, MIN_PARENT_SHARE = 6, 0.25


def free_small_joints(
    skeleton: Skeleton,
    rest: Float[np.ndarray, "V 3"],
    shapes: Float[np.ndarray, "F V 3"],
    labels: Int[np.ndarray, "V"],
) -> Skeleton:
    """Convert fixed joints with a part of their own to ball joints if the meshes show that the part rotates.

    The vertices of the joint's subtree and those of its parent are moved as one rigid body, and as two. If the parent
    has too few vertices, the largest part below it decides: if it rotates about its own joint, and not about the parent's, then
    all parts below the parent are free, and the parent only rotates about the bone that leads to it. So a hand that
    bends at the base of the fingers has a wrist that only twists. Else the largest part replaces the parent, so that the thumb
    of a hand that bends at the wrist is compared with the fingers. Joints without vertices of their own, such as those that carry
    the hips, stay fixed.

    **Arguments:** `labels` are the bones of the vertices; `rest` is their position in the shape of the skeleton.
    """
    kinds, axes = list(skeleton.kinds), np.array(skeleton.axes)
    centres = np.asarray(skeleton.centres, float)
    least = MIN_ERROR_SHARE * float(np.ptp(rest, axis=0).max())
    sides = {joint: pair for pair in left_right_pairs_by_name(skeleton.names) for joint in pair}
    below = skeleton.descendants
    sizes = np.array([below[joint][labels].sum() for joint in range(skeleton.num_joints)])
    fixed = (np.array(kinds) == "fixed") & np.isin(np.arange(len(kinds)), labels) & (sizes >= MIN_VERTICES)
    small = np.flatnonzero(fixed).tolist()
    for parent in sorted({skeleton.parents[joint] for joint in small}):
        parts = [joint for joint in small if skeleton.parents[joint] == parent]
        bone = centres[parent] - centres[skeleton.parents[parent]]
        largest = max(parts, key=lambda joint: sizes[joint])
        is_small = (labels == parent).sum() < max(MIN_VERTICES, MIN_PARENT_SHARE * sizes[largest])
        is_ball = kinds[parent] == skeleton.kinds[parent] == "ball" and np.linalg.norm(bone) > 0
        if is_small and not is_ball:
            continue
        pair = sides.get(largest, (largest,))
        if is_small and _rotates_about_itself(pair, skeleton, rest, shapes, labels, least):
            rotating = parts
            kinds[parent], axes[parent, 0] = "revolute", bone / np.linalg.norm(bone)
        else:
            base = below[largest][labels] if is_small else labels == parent
            rotating = [
                joint for joint in parts if _part_rotates(below[joint][labels], base, rest, shapes, least)
            ]
        for joint in rotating:
            kinds[joint] = "ball"
    return dataclasses.replace(skeleton, kinds=tuple(kinds), axes=jnp.asarray(axes, skeleton.axes.dtype))


def _part_rotates(
    own: np.ndarray, base: np.ndarray, rest: np.ndarray, shapes: np.ndarray, least: float
) -> bool:
    """Test whether the vertices of a part, a mask, move otherwise than those of its base."""
    whole, alone, others = (_error(rest, shapes, rows) for rows in (own | base, own, base))
    explained = 1 - (alone + others) / max(whole, 1e-300)
    return bool(explained >= MIN_EXPLAINED and np.sqrt(whole / ((own | base).sum() * len(shapes))) >= least)


def _rotates_about_itself(
    joints: Sequence[int],
    skeleton: Skeleton,
    rest: np.ndarray,
    shapes: np.ndarray,
    labels: np.ndarray,
    least: float,
) -> bool:
    """Test whether parts rotate, relative to the parent of their parent, about their own joints rather than that of the parent.

    A centre of rotation is the same point of both parts in all meshes; the median over the meshes of both sides is compared. The
    mesh at rest, in which no point is moved, does not count.
    """
    centres = np.asarray(skeleton.centres, float)
    posed = np.abs(shapes - rest).max((1, 2)) > 0
    about_itself, about_parent = [], []
    for joint in joints:
        parent = skeleton.parents[joint]
        groups = np.stack([skeleton.descendants[joint][labels], labels == skeleton.parents[parent]])
        if groups.sum(1).min() < MIN_VERTICES:
            continue
        turns, shifts = rigid_motions(group_moments(groups.astype(float), rest, shapes.transpose(1, 0, 2)))
        for centre, distances in ((centres[joint], about_itself), (centres[parent], about_parent)):
            distances.append(np.sum(((turns[0] - turns[1]) @ centre + shifts[0] - shifts[1])[posed] ** 2, 1))
    if not about_itself or not posed.any():
        return False
    itself, at_parent = (np.median(np.concatenate(distances)) for distances in (about_itself, about_parent))
    return bool(itself <= MAX_DISTANCE_RATIO * at_parent and at_parent >= least**2)


def _error(rest: np.ndarray, shapes: np.ndarray, rows: np.ndarray) -> float:
    """Compute the squared error of the best rigid motions of some vertices."""
    ones = np.ones((1, int(rows.sum())))
    return float(rigid_errors(group_moments(ones, rest[rows], shapes[:, rows].transpose(1, 0, 2)))[0])
