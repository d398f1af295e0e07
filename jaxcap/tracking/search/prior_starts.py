"""Starts of a search at the mean of a pose prior, for joints that a cloud does not show."""

import jax
import jax.numpy as jnp
import numpy as np

from ...body.kinematics import forward_kinematics
from ...body.pose import Pose, rest_pose
from ...body.skeleton import Skeleton
from ...energy.priors.gaussian_pose_prior import GaussianPrior
from ...geometry import rotation

#: first joints of the limbs that one start moves to the mean, as roles of the joints of a prior
LIMBS = (
    ("LeftArm",),
    ("RightArm",),
    ("LeftArm", "RightArm"),
    ("LeftUpLeg",),
    ("RightUpLeg",),
    ("LeftUpLeg", "RightUpLeg"),
)


def mean_pose(prior: GaussianPrior, skeleton: Skeleton) -> Pose:
    """Make the mean pose of a prior, with the root at rest."""
    rest, joints = rest_pose(skeleton), jnp.asarray(prior.joints)
    turns = rotation.exp(rotation.rotate(skeleton.orientations[joints], prior.mean))
    return Pose(rest.translations, rest.rotations.at[joints].set(turns), rest.scale)


def limb_starts(prior: GaussianPrior, skeleton: Skeleton, poses: Pose) -> Pose:
    """Move one or two limbs of each of P stacked poses to the mean of the prior; `(L P, ...)` for the L of `LIMBS`."""
    mean, joints = mean_pose(prior, skeleton).rotations, prior.joints_of_roles
    moved = []
    for limb in LIMBS:
        below = np.any([skeleton.descendants[joints[name]] for name in limb], axis=0)
        moved.append(jnp.where(below[:, None], mean, poses.rotations))
    translations, scale = (jnp.concatenate([leaf] * len(LIMBS)) for leaf in (poses.translations, poses.scale))
    return Pose(translations, jnp.concatenate(moved), scale)


def upright_starts(prior: GaussianPrior, skeleton: Skeleton, poses: Pose) -> Pose:
    """Move spine and legs of each of P stacked poses to the mean of the prior, and keep the chest where it is.

    In a pose found for a person whose legs are out of the image, the hips may be turned as of a person who sits. The joint
    below which both arms are counts as the chest. The root has to be free.
    """
    mean, root = mean_pose(prior, skeleton).rotations, skeleton.parents.index(-1)
    arms = [skeleton.descendants[:, prior.joints_of_roles[name]] for name in ("LeftArm", "RightArm")]
    chest = int(max(np.flatnonzero(arms[0] & arms[1]), key=lambda joint: skeleton.depths[joint]))
    kept = skeleton.descendants[chest].copy()
    kept[chest], kept[root] = False, True

    def of_pose(pose: Pose) -> Pose:
        before = forward_kinematics(skeleton, pose)
        moved = Pose(pose.translations, jnp.where(kept[:, None], pose.rotations, mean), pose.scale)
        after = forward_kinematics(skeleton, moved)
        # the rigid motion that moves the chest back
        back = before.rotations[chest] @ after.rotations[chest].T / pose.scale**2
        away = (before.translations[chest] - back @ after.translations[chest]) / pose.scale
        centre = skeleton.centres[root]
        translation = back @ (centre + pose.translations[root]) + away - centre
        turned = rotation.multiply(rotation.from_matrix(back), pose.rotations[root])
        return Pose(
            moved.translations.at[root].set(translation), moved.rotations.at[root].set(turned), pose.scale
        )

    return jax.vmap(of_pose)(poses)


def prior_starts(prior: GaussianPrior, skeleton: Skeleton, poses: Pose) -> list[Pose]:
    """Make all starts at the mean of a prior from P stacked poses: `limb_starts`, and `upright_starts` if the root is free.

    There are none if the prior has no joints of a person's limbs.
    """
    if not {name for limb in LIMBS for name in limb} <= set(prior.roles):
        return []
    starts = [limb_starts(prior, skeleton, poses)]
    if skeleton.kinds[skeleton.parents.index(-1)] == "free":
        starts.append(upright_starts(prior, skeleton, poses))
    return starts
