"""The joints of a person, from meshes in the topology of another body and from the rotations of the bones."""

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from ...body.body import Body
from ...body.kinematics import forward_kinematics
from ...body.pose import Pose
from ...body.skeleton import Skeleton
from ...geometry.procrustes import group_moments
from ..anatomy.joint_evidence import MIN_LENGTH

#: rotation of a joint, radians, from which on the surface around it says little of its centre
MAX_BEND = 0.35
#: least and greatest size of a bone, as a multiple of that of the body
MIN_SIZE, MAX_SIZE = 0.6, 1.6


def joints_of_surface(
    body: Body, around: Float[np.ndarray, "F J 3"], poses: Pose, targets: Float[Array, "F V 3"]
) -> tuple[Float[np.ndarray, "J 3"], Float[np.ndarray, "F J 3"]]:
    """Estimate the joints of a person at rest, and in each mesh, given the rotations of bones.

    A joint that bends little is where the surface around it has it, one that bends where its two bones have it
    (`joints_of_bones`). Bones at rest are the means over the meshes, mostly of those in which their joints bend little.

    **Arguments:** `around`, the joints in each mesh by the surface around them (`regress_joints`).
    """
    skeleton = body.skeleton
    meshes = np.asarray(targets, float)
    turns = np.asarray(_bone_rotations(skeleton, poses), float)
    cosines = np.clip(np.abs(np.asarray(poses.rotations, float)[..., 0]), 0.0, 1.0)
    bends = 2 * np.arccos(cosines)
    parents = np.array(skeleton.parents)
    bends[:, parents < 0] = 0.0
    weights = 1.0 / (1.0 + (bends / MAX_BEND) ** 2) ** 2
    between = joints_of_bones(body, turns, meshes)
    between = np.where(np.isfinite(between), between, around)
    posed = between + weights[..., None] * (around - between)
    rest = np.asarray(skeleton.centres, float)
    centres = rest.copy()
    for joint, parent in enumerate(parents):
        if parent < 0:
            continue
        if np.linalg.norm(rest[joint] - rest[parent]) < MIN_LENGTH:
            centres[joint] = centres[parent]
            continue
        bones = np.einsum("fba,fb->fa", turns[:, parent], posed[:, joint] - posed[:, parent])
        shares = weights[:, joint] * weights[:, parent]
        centres[joint] = centres[parent] + shares @ bones / shares.sum()
    return centres, posed


def joints_of_bones(
    body: Body, turns: Float[np.ndarray, "F J 3 3"], meshes: Float[np.ndarray, "F V 3"]
) -> Float[np.ndarray, "F J 3"]:
    """Estimate the joints in each mesh as the mean of where the bones on both sides have them.

    A bone is that of the body, rotated, and as long and as wide as its vertices show. Not finite for joints whose bones have no
    vertices.
    """
    rest = np.asarray(body.vertices, float)
    centres, parents = np.asarray(body.skeleton.centres, float), np.array(body.skeleton.parents)
    shares = np.asarray(body.skin.bone_weights(len(parents)), float).T
    own, posed = (
        group_moments(shares, rest, rest[:, None]),
        group_moments(shares, rest, meshes.swapaxes(0, 1)),
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        middle, there = own.source / own.mass[:, None], posed.target / posed.mass[:, None, None]
        spread = own.cross[:, 0] - own.source[:, :, None] * middle[:, None]
        moved = posed.cross - posed.target[..., None] * middle[:, None, None]
        moved = np.einsum("fjba,jfbc->jfac", turns, moved)
        axes = _bone_axes(body.skeleton, middle)
        along = np.einsum("ja,jab,jb->j", axes, spread, axes)
        stretch = np.einsum("ja,jfab,jb->jf", axes, moved, axes)
        width = (np.trace(moved, axis1=2, axis2=3) - stretch) / (np.trace(spread, axis1=1, axis2=2) - along)[
            :, None
        ]
        stretch, width = (np.clip(size, MIN_SIZE, MAX_SIZE) for size in (stretch / along[:, None], width))

    def joint_by(bones: np.ndarray) -> Float[np.ndarray, "F J 3"]:
        """Compute each joint as a point of one bone."""
        arms, axis = centres - middle[bones], axes[bones]
        part = np.sum(arms * axis, 1, keepdims=True) * axis
        scaled = stretch[bones, :, None] * part[:, None] + width[bones, :, None] * (arms - part)[:, None]
        return there[bones].swapaxes(0, 1) + np.einsum("fjab,jfb->fja", turns[:, bones], scaled)

    below, above = joint_by(np.arange(len(parents))), joint_by(np.maximum(parents, 0))
    above[:, parents < 0] = np.nan
    both = np.stack([below, above])
    known = np.isfinite(both)
    counts = known.sum(0)
    return np.where(counts > 0, np.where(known, both, 0.0).sum(0) / np.maximum(counts, 1), np.nan)


def _bone_axes(skeleton: Skeleton, middle: Float[np.ndarray, "J 3"]) -> Float[np.ndarray, "J 3"]:
    """Compute the direction of each bone at rest: to its first child, or to the middle of its vertices."""
    centres, parents = np.asarray(skeleton.centres, float), np.array(skeleton.parents)
    axes = middle - centres
    for joint in range(len(parents) - 1, -1, -1):
        arm = centres[joint] - centres[parents[joint]]
        if parents[joint] >= 0 and np.linalg.norm(arm) >= MIN_LENGTH:
            axes[parents[joint]] = arm
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)


@eqx.filter_jit
def _bone_rotations(skeleton, poses: Pose) -> Float[Array, "F J 3 3"]:
    return jax.vmap(lambda pose: forward_kinematics(skeleton, pose).rotations)(poses)
