"""Starts of a search at the mean of a pose prior, for joints that a cloud does not show."""

import jax.numpy as jnp
import numpy as np

from ..body.pose import Pose, rest_pose
from ..body.skeleton import Skeleton
from ..energy.priors.gaussian_pose_prior import GaussianPrior
from ..geometry import rotation

#: first joints of the limbs that one start moves to the mean
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
    mean = mean_pose(prior, skeleton).rotations
    moved = []
    for limb in LIMBS:
        below = np.any([skeleton.descendants[skeleton.index(name)] for name in limb], axis=0)
        moved.append(jnp.where(below[:, None], mean, poses.rotations))
    translations, scale = (jnp.concatenate([leaf] * len(LIMBS)) for leaf in (poses.translations, poses.scale))
    return Pose(translations, jnp.concatenate(moved), scale)
