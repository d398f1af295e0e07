"""Build a skeleton from segments and joints: rest pose, bones, and marker positions on the bones."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ...body.pose import Pose
from ...body.retraction import project
from ...body.skeleton import Skeleton, make_skeleton
from ...geometry import rotation
from ...geometry.procrustes import nearest_rotation
from .segment_tree import SegmentTree


class AssembledSkeleton(NamedTuple):
    """A skeleton in which bone `j` is the segment `bone_segments[j]`."""

    skeleton: Skeleton
    bone_segments: tuple[int, ...]
    #: (M,) bone of each marker, -1 where it is on no bone
    bones: Int[np.ndarray, "M"]
    #: (M, 3) position of each marker in the world at rest, metres
    offsets: Float[np.ndarray, "M 3"]
    #: (J, 3, 3) and (J, 3): rotations and origins of the segments' frames at rest
    rest_rotations: Float[np.ndarray, "J 3 3"]
    rest_origins: Float[np.ndarray, "J 3"]


def assemble_skeleton(
    tree: SegmentTree, root: int, num_markers: int, lengths: dict[tuple[int, int], float]
) -> AssembledSkeleton:
    """Build the skeleton below one root. Its rest pose is that of the most typical frame.

    Joint centres are fixed in the frames of their parents. Bones in `lengths` are scaled to these lengths.
    The root is "free", a joint with an axis "revolute", any other joint "ball".
    """
    order = _usable_segments(tree, root)
    frames = tree.augmented.frames
    turns, origin = _choose_rest_frame(tree, order)
    origins = {root: origin}
    inner: dict[int, np.ndarray] = {}
    centres, axes, kinds = [], [], []
    for segment in order:
        joint = tree.joints[segment]
        axis = np.eye(3)[:2]
        if joint is None:
            children = [tree.joints[k] for k in order if tree.parents[k] == segment]
            positions = [child.in_parent for child in children if child is not None]
            centroid = np.mean(positions, axis=0) if len(positions) > 1 else np.zeros(3)
            centre, kind = turns[segment] @ centroid + origin, "free"
        else:
            place = joint.in_parent
            length = lengths.get((joint.parent, segment), np.nan)
            if np.isfinite(length):
                start = inner[joint.parent]
                away = place - start
                reach = float(np.linalg.norm(away))
                place = start + away * (length / reach if reach > 1e-9 else 1.0)
            centre = turns[joint.parent] @ place + origins[joint.parent]
            origins[segment] = centre - turns[segment] @ joint.in_child
            inner[segment] = joint.in_child
            kind = "ball"
            if joint.axis_in_parent is not None:
                kind, axis = "revolute", np.stack([turns[joint.parent] @ joint.axis_in_parent] * 2)
        centres.append(centre)
        axes.append(axis)
        kinds.append(kind)
    bones, offsets = np.full(num_markers, -1), np.zeros((num_markers, 3))
    for bone, segment in enumerate(order):
        for marker in tree.augmented.segments.members[segment]:
            if marker < num_markers:
                bones[marker] = bone
                offsets[marker] = turns[segment] @ frames.local_positions[marker] + origins[segment]
    parents = [order.index(tree.parents[k]) if k != root else -1 for k in order]
    names = [tree.augmented.segments.names[k] for k in order]
    ends = np.array([_bone_end(bone, parents, centres, bones, offsets) for bone in range(len(order))])
    skeleton = make_skeleton(
        names, parents, kinds, np.array(centres), _bone_orientations(np.array(centres), ends), np.array(axes)
    )
    rest = np.stack([turns[k] for k in order]), np.stack([origins[k] for k in order])
    return AssembledSkeleton(skeleton, tuple(order), bones, offsets, *rest)


def segment_poses(assembled: AssembledSkeleton, tree: SegmentTree) -> Pose:
    """Compute the poses of all frames from the segments' rotations and the position of the root segment.

    A segment without a known frame takes its rotation relative to the parent from the nearest frame in which
    it is known.
    """
    frames, skeleton = tree.augmented.frames, assembled.skeleton
    count = len(frames.known)
    local = np.zeros((count, len(assembled.bone_segments), 3, 3))
    shifts = np.zeros((count, len(assembled.bone_segments), 3))
    for bone, segment in enumerate(assembled.bone_segments):
        turned = frames.rotations[:, segment] @ assembled.rest_rotations[bone].T
        known = frames.known[:, segment]
        parent = skeleton.parents[bone]
        if parent >= 0:
            above = assembled.bone_segments[parent]
            known = known & frames.known[:, above]
            turned = (frames.rotations[:, above] @ assembled.rest_rotations[parent].T).swapaxes(
                -1, -2
            ) @ turned
        nearest = _nearest_known_frames(known)
        local[:, bone] = turned[nearest] if known.any() else np.eye(3)
        if parent < 0:
            centre = np.asarray(skeleton.centres[bone], float)
            moved = np.einsum("fab,b->fa", local[:, bone], assembled.rest_origins[bone] - centre)
            shifts[:, bone] = (frames.origins[:, segment] - centre)[nearest] - moved
    dtype = skeleton.centres.dtype
    poses = Pose(
        jnp.asarray(shifts, dtype), rotation.from_matrix(jnp.asarray(local, dtype)), jnp.ones(count, dtype)
    )
    return _project_poses(skeleton, poses)


@eqx.filter_jit
def _project_poses(skeleton: Skeleton, poses: Pose) -> Pose:
    return jax.vmap(project, (None, 0))(skeleton, poses)


def _nearest_known_frames(known: np.ndarray) -> np.ndarray:
    """Find the nearest known frame of each frame."""
    indices = np.flatnonzero(known)
    if len(indices) == 0:
        return np.arange(len(known))
    after = np.minimum(np.searchsorted(indices, np.arange(len(known))), len(indices) - 1)
    before = np.maximum(after - 1, 0)
    now = np.arange(len(known))
    return np.where(
        np.abs(indices[before] - now) < np.abs(indices[after] - now), indices[before], indices[after]
    )


def _usable_segments(tree: SegmentTree, root: int) -> list[int]:
    """List the segments with known frames, parents first, without the descendants of unknown segments."""
    usable = tree.augmented.frames.known.any(0)
    order, open_ = [], [root]
    while open_:
        segment = open_.pop(0)
        order.append(segment)
        open_ += [
            k
            for k, parent in enumerate(tree.parents)
            if parent == segment and usable[k] and np.isfinite(tree.joints[k].in_child).all()  # type: ignore[union-attr]
        ]
    return order


def _choose_rest_frame(tree: SegmentTree, order: list[int]) -> tuple[dict[int, np.ndarray], np.ndarray]:
    """Choose the frame with the most typical joint rotations. Return its rotations and the root's origin.

    World rotations; the root is known in this frame. A segment that is not known in it takes its mean
    rotation relative to the parent.
    """
    frames, root = tree.augmented.frames, order[0]
    off = np.where(frames.known[:, root], 0.0, np.inf)
    usual: dict[int, np.ndarray] = {}
    for k in order[1:]:
        parent = tree.parents[k]
        relative = frames.rotations[:, parent].swapaxes(-1, -2) @ frames.rotations[:, k]
        both = frames.known[:, parent] & frames.known[:, k]
        usual[k] = nearest_rotation(relative[both].sum(0)) if both.any() else np.eye(3)
        off += np.where(both, 3 - np.einsum("fab,ab->f", relative, usual[k]), 4.0)
    frame = int(np.argmin(off))
    turns = {root: frames.rotations[frame, root]}
    for k in order[1:]:
        parent = tree.parents[k]
        both = frames.known[frame, parent] & frames.known[frame, k]
        turns[k] = frames.rotations[frame, k] if both else turns[parent] @ usual[k]
    return turns, frames.origins[frame, root]


def _bone_end(bone: int, parents, centres, bones: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Compute the end of a bone: the mean of its child joints, otherwise the mean of its markers."""
    children = [centres[k] for k, parent in enumerate(parents) if parent == bone]
    members = offsets[bones == bone]
    return np.mean(children, axis=0) if children else (members.mean(0) if len(members) else centres[bone])


def _bone_orientations(centres: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Compute the quaternions that rotate the x axis to the directions of the bones."""
    away = ends - centres
    lengths = np.linalg.norm(away, axis=1, keepdims=True)
    away = np.where(lengths > 1e-6, away / np.maximum(lengths, 1e-12), [1.0, 0.0, 0.0])
    return np.asarray(rotation.shortest_arc(jnp.broadcast_to(jnp.eye(3)[0], away.shape), jnp.asarray(away)))
