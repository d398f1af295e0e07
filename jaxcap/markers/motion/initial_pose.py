"""Initial poses without a previous estimate: each bone is aligned to its markers, from the root outwards."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...body.pose import Pose
from ...body.retraction import project
from ...body.skeleton import Skeleton
from ...geometry import rotation
from ...geometry.procrustes import nearest_rotation
from ...stacking import concatenate_trees
from ..subject import Subject

#: weights of a descendant bone's markers, by the number of joints between
DESCENDANT_WEIGHTS = (1.0, 0.3, 0.05)
#: weight of the prior that a bone keeps the parent's rotation, metres squared
PARENT_PRIOR_WEIGHT = 1e-3


def estimate_initial_poses(
    subject: Subject, positions: Float[Array, "F M 3"], seen: Bool[Array, "F M"]
) -> Pose:
    """Estimate an initial pose of every frame independently.

    The bone of the root is aligned to its own markers and those of the next bones. Then, from joint to joint
    outwards, each centre is where the parent carries it, and each bone takes the rotation with the least
    squared distances to its markers (Wahba's problem). If these leave the rotation undetermined, it is
    that of the parent.

    In a frame with fewer than three markers about the root, the root keeps its previous pose.
    """
    skeleton, count = subject.skeleton, len(positions)
    centres, offsets = np.asarray(skeleton.centres, float), np.asarray(subject.offsets, float)
    targets, bones = np.asarray(positions, float), np.asarray(subject.bones)
    weights = np.asarray(seen, float) * np.asarray(subject.weights, float)
    depths, descent = skeleton.depths, skeleton.descendants
    rotations = np.zeros((count, skeleton.num_joints, 3, 3))
    origins = np.zeros((count, skeleton.num_joints, 3))
    for joint, parent in enumerate(skeleton.parents):
        steps = np.where(descent[joint][bones], depths[bones] - depths[joint], len(DESCENDANT_WEIGHTS))
        share = weights * np.array([*DESCENDANT_WEIGHTS, 0.0])[np.minimum(steps, len(DESCENDANT_WEIGHTS))]
        if parent < 0:
            # a skeleton may have several roots
            own = weights * descent[joint][bones]
            share, source, target, origin = _root_alignment(share, own, offsets, targets, centres[joint])
            above = np.broadcast_to(np.eye(3), (count, 3, 3))
        else:
            above = rotations[:, parent]
            origin = origins[:, parent] + above @ (centres[joint] - centres[parent])
            target = targets - origin[:, None]
            source = np.broadcast_to(offsets - centres[joint], target.shape)
        if skeleton.kinds[joint] in ("fixed", "translate") and parent >= 0:
            rotations[:, joint], origins[:, joint] = above, origin
            continue
        cross = np.einsum("fm,fma,fmb->fab", share, target, source)
        rotations[:, joint] = nearest_rotation(cross + PARENT_PRIOR_WEIGHT * above)
        origins[:, joint] = origin
        if parent < 0:
            # so far the origin is the position of the source's centroid
            middle = (share @ offsets) / np.maximum(share.sum(1), 1e-12)[:, None]
            shifts = np.einsum("fab,fb->fa", rotations[:, joint], centres[joint] - middle)
            origins[:, joint] += shifts
            known = (share > 0).sum(1) >= 3
            _fill_unknown_frames(known, rotations[:, joint], origins[:, joint])
    dtype = skeleton.centres.dtype
    return _poses_from_frames(skeleton, jnp.asarray(rotations, dtype), jnp.asarray(origins, dtype))


def estimate_separate_poses(
    subject: Subject, positions: Float[Array, "F M 3"], seen: Bool[Array, "F M"]
) -> Pose:
    """Estimate an initial pose of every frame, where the frames do not follow each other in time.

    In a frame with fewer than three markers about the root, the root has its pose at rest.
    """
    return concatenate_trees(
        [
            estimate_initial_poses(subject, positions[k : k + 1], seen[k : k + 1])
            for k in range(len(positions))
        ]
    )


def _root_alignment(share, weights, offsets, targets, centre):
    """Centre sources and targets at their weighted means.

    All markers are used where the root's own and the next bones' markers are fewer than three.
    """
    few = (share > 0).sum(1) < 3
    share = np.where(few[:, None], weights, share)
    total = np.maximum(share.sum(1), 1e-12)[:, None]
    middle, origin = (share @ offsets) / total, np.einsum("fm,fma->fa", share, targets) / total
    return share, offsets[None] - middle[:, None], targets - origin[:, None], origin


def _fill_unknown_frames(known, rotations, origins) -> None:
    """Replace unknown frames by the last known frame, or by the first known one at the start."""
    if not known.any():
        rotations[:], origins[:] = np.eye(3), 0.0
        return
    last = np.maximum.accumulate(np.where(known, np.arange(len(known)), -1))
    last = np.where(last < 0, np.argmax(known), last)
    rotations[:], origins[:] = rotations[last], origins[last]


@eqx.filter_jit
def _poses_from_frames(
    skeleton: Skeleton, rotations: Float[Array, "F J 3 3"], origins: Float[Array, "F J 3"]
) -> Pose:
    parents = np.array(skeleton.parents)
    top = (parents < 0)[:, None, None]
    above = jnp.where(top, jnp.eye(3, dtype=rotations.dtype), rotations[:, np.maximum(parents, 0)])
    local = rotation.from_matrix(jnp.swapaxes(above, 2, 3) @ rotations)
    shifts = jnp.where(top[..., 0], origins - skeleton.centres, 0.0)
    return jax.vmap(project, (None, 0))(skeleton, Pose(shifts, local, jnp.ones(len(origins), shifts.dtype)))
