"""The unweighted terms of the objective (Adaptation, section 4.1.3)."""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..body.body import Body, pose_body
from ..body.pose import Motion, Pose
from ..body.skeleton import Skeleton
from ..body.symmetry import length_differences
from ..energy.energy import AbstractEnergy
from .poses.sliding_window import temporal_energy


class Terms(NamedTuple):
    """The value of each term."""

    #: mean weighted squared distance of a pair (eq. 4.4), metres squared
    data: float
    #: mean of the pose prior over frames (eq. 4.7)
    pose: float
    #: mean squared second difference of rotation vectors (eq. 4.9), radians squared
    temporal: float
    #: mean squared change of the Laplacian vectors (eq. 4.11), metres squared
    shape: float
    #: summed squared differences of paired bones' lengths (eq. 4.13), metres squared
    symmetry: float
    #: mean over frames of the user's energies, in units of a log-likelihood
    user: float = 0.0


def pose_energy(prior: AbstractEnergy, body: Body, poses: Pose) -> float:
    """Compute the mean energy of a prior over stacked poses."""
    return float(_pose_energy(prior, body, poses))


def symmetry_energy(skeleton: Skeleton, mirrored: Sequence[tuple[int, int]]) -> float:
    """Sum the squared differences of paired bones' lengths (eq. 4.13)."""
    differences, _ = length_differences(skeleton, mirrored)
    return float(jnp.sum(differences**2))


def motion_energy(skeleton: Skeleton, motion: Motion, excluded: Collection[int] = ()) -> float:
    """Compute the temporal energy of a motion (eq. 4.9); zero for fewer than three frames.

    The frames `excluded` are excluded if at least three others are left; else all are used.
    """
    every = np.arange(len(motion))
    frames = np.setdiff1d(every, list(excluded))
    frames = frames if len(frames) > 2 else every
    poses = jax.tree.map(lambda leaf: leaf[frames], motion.poses)
    since = jnp.asarray(np.diff(frames), float)
    return float(temporal_energy(skeleton, poses, since)) if len(frames) > 2 else 0.0


def balancing_weight(data: float, term: float) -> float:
    """Compute the weight that balances a term with the data (eqs. 4.15, 4.16); zero for a zero term."""
    return data / term if term > 1e-12 else 0.0


@eqx.filter_jit
def _pose_energy(prior: AbstractEnergy, body: Body, poses: Pose) -> Float[Array, ""]:
    def of_frame(pose):
        residual = prior.residual(pose_body(body, pose))
        return residual @ residual

    return jnp.mean(jax.lax.map(of_frame, poses))
