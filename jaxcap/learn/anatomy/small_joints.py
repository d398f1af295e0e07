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
    has too few vertices, the joint is free if the part rotates about it, and not about the joint of the parent, which then only
    rotates about the bone that leads to it: a hand that bends at the base of the fingers has a wrist that only twists. Joints
    without vertices of their own, such as those that carry the hips, stay fixed.

    **Arguments:** `labels` are the bones of the vertices; `rest` is their position in the shape of the skeleton.
    """
    kinds, axes = list(skeleton.kinds), np.array(skeleton.axes)
    centres = np.asarray(skeleton.centres, float)
    least = MIN_ERROR_SHARE * float(np.ptp(rest, axis=0).max())
    sides = {joint: pair for pair in left_right_pairs_by_name(skeleton.names) for joint in pair}
    below = skeleton.descendants
    for joint, kind in enumerate(kinds):
        parent = skeleton.parents[joint]
        own = below[joint][labels].sum()
        if kind != "fixed" or not (labels == joint).any() or own < MIN_VERTICES:
            continue
        if (labels == parent).sum() >= max(MIN_VERTICES, MIN_PARENT_SHARE * own):
            if _part_rotates(joint, skeleton, rest, shapes, labels, least):
                kinds[joint] = "ball"
        elif _rotates_about_itself(sides.get(joint, (joint,)), skeleton, rest, shapes, labels, least):
            kinds[joint], kinds[parent] = "ball", "revolute"
            bone = centres[parent] - centres[skeleton.parents[parent]]
            axes[parent, 0] = bone / np.linalg.norm(bone)
    return dataclasses.replace(skeleton, kinds=tuple(kinds), axes=jnp.asarray(axes, skeleton.axes.dtype))


def _part_rotates(
    joint: int, skeleton: Skeleton, rest: np.ndarray, shapes: np.ndarray, labels: np.ndarray, least: float
) -> bool:
    """Test whether the vertices below a joint move otherwise than those of its parent."""
    own = skeleton.descendants[joint][labels]
    base = (labels == skeleton.parents[joint]) & ~own
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

    A centre of rotation is the same point of both parts in all meshes; the median over the meshes of both sides is compared.
    """
    centres = np.asarray(skeleton.centres, float)
    about_itself, about_parent = [], []
    for joint in joints:
        parent = skeleton.parents[joint]
        groups = np.stack([skeleton.descendants[joint][labels], labels == skeleton.parents[parent]])
        if groups.sum(1).min() < MIN_VERTICES:
            continue
        turns, shifts = rigid_motions(group_moments(groups.astype(float), rest, shapes.transpose(1, 0, 2)))
        for centre, gaps in ((centres[joint], about_itself), (centres[parent], about_parent)):
            gaps.append(np.sum(((turns[0] - turns[1]) @ centre + shifts[0] - shifts[1]) ** 2, 1))
    if not about_itself:
        return False
    itself, at_parent = np.median(about_itself), np.median(about_parent)
    return bool(itself <= (1 - MIN_EXPLAINED) * at_parent and at_parent >= least**2)


def _error(rest: np.ndarray, shapes: np.ndarray, rows: np.ndarray) -> float:
    """Compute the squared error of the best rigid motions of some vertices."""
    ones = np.ones((1, int(rows.sum())))
    return float(rigid_errors(group_moments(ones, rest[rows], shapes[:, rows].transpose(1, 0, 2)))[0])
