"""The features of poses on which correctives depend, and the combinations of them that the poses show."""

from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int

from ...body.pose import Pose
from ...body.skin import AbstractPoseFeatures

#: least sum of squares of a combination over the meshes: a tenth of the weight of the weakest prior
MIN_INFORMATION = 0.01


class PoseBasis(NamedTuple):
    """Orthonormal combinations of the features of each joint."""

    #: each row combines the features of one joint
    rows: Float[np.ndarray, "K P"]
    joints: Int[np.ndarray, "K"]


def make_pose_basis(values: Float[np.ndarray, "F P"], num_of_joint: int) -> PoseBasis:
    """Find the combinations of each joint's features that vary in the poses: principal axes about zero, the rest pose.

    Along the other combinations the prior keeps the displacements at zero. Without them there are far fewer unknowns.
    """
    rows, joints = [np.zeros((0, values.shape[1]))], []
    for joint in range(1, 1 + values.shape[1] // num_of_joint):
        columns = slice(num_of_joint * (joint - 1), num_of_joint * joint)
        own = values[:, columns]
        squares, axes = np.linalg.eigh(own.T @ own)
        kept = axes[:, squares > MIN_INFORMATION].T
        row = np.zeros((len(kept), values.shape[1]))
        row[:, columns] = kept
        rows.append(row)
        joints += [joint] * len(kept)
    return PoseBasis(np.concatenate(rows), np.array(joints, int))


@eqx.filter_jit
def pose_values(features: AbstractPoseFeatures, poses: Pose) -> Float[Array, "F P"]:
    """Compute the features of all poses."""
    return jax.vmap(features.of_rotations)(poses.rotations)
