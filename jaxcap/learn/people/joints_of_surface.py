"""The joints of a person, from meshes in the topology of another body and from the rotations of the bones."""

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from ...body.body import Body
from ...body.kinematics import forward_kinematics
from ...body.pose import Pose
from ...body.skeleton import Skeleton
from ...geometry.procrustes import Moments, group_moments
from ..anatomy.joint_evidence import MIN_LENGTH

#: rotation of a joint, radians, at which the surface around it and the bones on both sides of it count about alike
BEND_SCALE = 0.35
#: least and greatest size of a bone relative to that of the person
MIN_SIZE, MAX_SIZE = 0.6, 1.6
#: least share of a bone's extent along its axis, and across it, from which its size in this direction is estimated
MIN_SHARE = 1e-3


def joints_of_surface(
    body: Body, surface_joints: Float[np.ndarray, "F J 3"], poses: Pose, targets: Float[Array, "F V 3"]
) -> tuple[Float[np.ndarray, "J 3"], Float[np.ndarray, "F J 3"]]:
    """Estimate the joints of a person at rest, and in each mesh, given the rotations of bones.

    A joint that bends little is estimated from the surface around it, and one that bends from the two bones that it connects
    (`joints_of_bones`). Bones at rest are the means over the meshes, mostly of those in which their joints bend little.

    **Arguments:** `surface_joints`, the joints in each mesh by the surface around them (`regress_joints`).
    """
    skeleton = body.skeleton
    rotations = np.asarray(_bone_rotations(skeleton, poses), float)
    cosines = np.clip(np.abs(np.asarray(poses.rotations, float)[..., 0]), 0.0, 1.0)
    bends = 2 * np.arccos(cosines)
    parents = np.array(skeleton.parents)
    bends[:, parents < 0] = 0.0
    weights = 1.0 / (1.0 + (bends / BEND_SCALE) ** 2) ** 2
    bone_joints = joints_of_bones(body, rotations, np.asarray(targets, float))
    bone_joints = np.where(np.isfinite(bone_joints), bone_joints, surface_joints)
    posed = bone_joints + weights[..., None] * (surface_joints - bone_joints)
    rest = np.asarray(skeleton.centres, float)
    centres = rest.copy()
    for joint, parent in enumerate(parents):
        if parent < 0:
            continue
        if np.linalg.norm(rest[joint] - rest[parent]) < MIN_LENGTH:
            centres[joint] = centres[parent]
            continue
        bones = np.einsum("fba,fb->fa", rotations[:, parent], posed[:, joint] - posed[:, parent])
        shares = weights[:, joint] * weights[:, parent]
        centres[joint] = centres[parent] + shares @ bones / shares.sum()
    return centres, posed


def joints_of_bones(
    body: Body, rotations: Float[np.ndarray, "F J 3 3"], meshes: Float[np.ndarray, "F V 3"]
) -> Float[np.ndarray, "F J 3"]:
    """Estimate the joints in each mesh as the mean of their positions by the bones on both sides.

    A bone is that of the body, rotated and scaled (`_bone_sizes`); bones that are fixed to each other are one. Not finite for
    joints whose bones have no vertices, or all in one point.
    """
    skeleton = body.skeleton
    rest = np.asarray(body.vertices, float)
    centres, parents = np.asarray(skeleton.centres, float), np.array(skeleton.parents)
    moving = np.array(skeleton.moving_ancestors)
    shares = _moving_bone_weights(body).T
    own = group_moments(shares, rest, rest[:, None])
    posed = group_moments(shares, rest, meshes.swapaxes(0, 1))
    with np.errstate(invalid="ignore", divide="ignore"):
        rest_means, posed_means = own.source / own.mass[:, None], posed.target / posed.mass[:, None, None]
        axes = _bone_axes(skeleton, rest_means)
        stretch, width = _bone_sizes(own, posed, rotations, axes)

    def joints_by(bones: np.ndarray) -> Float[np.ndarray, "F J 3"]:
        """Compute each joint as a point of one bone."""
        offsets, axis = centres - rest_means[bones], axes[bones]
        along = np.sum(offsets * axis, 1, keepdims=True) * axis
        scaled = stretch[bones, :, None] * along[:, None] + width[bones, :, None] * (offsets - along)[:, None]
        return posed_means[bones].swapaxes(0, 1) + np.einsum("fjab,jfb->fja", rotations[:, bones], scaled)

    by_child, by_parent = joints_by(moving), joints_by(moving[np.maximum(parents, 0)])
    by_parent[:, parents < 0] = np.nan
    both = np.stack([by_child, by_parent])
    known = np.isfinite(both)
    counts = known.sum(0)
    return np.where(counts > 0, np.where(known, both, 0.0).sum(0) / np.maximum(counts, 1), np.nan)


def _moving_bone_weights(body: Body) -> Float[np.ndarray, "V J"]:
    """Sum the weights of each vertex over the bones that are fixed to each other; zero for fixed joints."""
    skeleton = body.skeleton
    weights = np.asarray(body.skin.bone_weights(skeleton.num_joints), float)
    summed = np.zeros_like(weights)
    np.add.at(summed.T, list(skeleton.moving_ancestors), weights.T)
    return summed


def _bone_sizes(
    own: Moments, posed: Moments, rotations: Float[np.ndarray, "F J 3 3"], axes: Float[np.ndarray, "J 3"]
) -> tuple[Float[np.ndarray, "J F"], Float[np.ndarray, "J F"]]:
    """Estimate the size of each bone in each mesh along its axis, and across it, relative to that at rest.

    It is the same in both directions for a bone without an axis, of zero, or without extent in one of them. Sizes are within
    `MIN_SIZE` and `MAX_SIZE` of the median over the bones. Not finite for bones of no extent.
    """
    rest_means = own.source / own.mass[:, None]
    spread = own.cross[:, 0] - own.source[:, :, None] * rest_means[:, None]
    cross = posed.cross - posed.target[..., None] * rest_means[:, None, None]
    cross = np.einsum("fjba,jfbc->jfac", rotations, cross)
    extent, shown = np.trace(spread, axis1=1, axis2=2), np.trace(cross, axis1=2, axis2=3)
    extent = np.where(extent > MIN_SHARE**2 * np.nanmax(extent), extent, np.nan)[:, None]
    whole = shown / extent
    along = np.einsum("ja,jab,jb->j", axes, spread, axes)[:, None]
    shown_along = np.einsum("ja,jfab,jb->jf", axes, cross, axes)
    has_axis = (along > MIN_SHARE * extent) & (extent - along > MIN_SHARE * extent)
    stretch = np.where(has_axis, shown_along / along, whole)
    width = np.where(has_axis, (shown - shown_along) / (extent - along), whole)
    size = np.nanmedian(whole)
    return size * np.clip(stretch / size, MIN_SIZE, MAX_SIZE), size * np.clip(
        width / size, MIN_SIZE, MAX_SIZE
    )


def _bone_axes(skeleton: Skeleton, means: Float[np.ndarray, "J 3"]) -> Float[np.ndarray, "J 3"]:
    """Compute the direction of each bone at rest: to its only child, or without children to the mean of its vertices.

    It is zero for a bone with several children, as the choice of one of them would not be symmetric.
    """
    centres, moving = np.asarray(skeleton.centres, float), skeleton.moving_ancestors
    children: dict[int, list[int]] = {}
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0 and moving[joint] == joint:
            bone = moving[parent]
            if np.linalg.norm(centres[joint] - centres[bone]) >= MIN_LENGTH:
                children.setdefault(bone, []).append(joint)
    axes = means - centres
    for bone, joints in children.items():
        axes[bone] = centres[joints[0]] - centres[bone] if len(joints) == 1 else 0.0
    return axes / np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), MIN_LENGTH)


@eqx.filter_jit
def _bone_rotations(skeleton, poses: Pose) -> Float[Array, "F J 3 3"]:
    return jax.vmap(lambda pose: forward_kinematics(skeleton, pose).rotations)(poses)
