"""Bones with two markers: labels in exchange turn them by half a turn, and fit as well."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...body.pose import Motion
from ...geometry import rotation
from ..subject import Subject

#: largest misfit of two markers with exchanged labels, metres
MAX_MISFIT = 0.03
#: number of updates of a joint's mean rotation
NUM_UPDATES = 5


def undo_half_turns(subject: Subject, motion: Motion) -> Motion:
    """Rotate bones back in frames in which they are nearer to half a turn from their mean rotation.

    These are the ends of the skeleton with two markers at equal distances from the joint. Half a turn about the line
    from the joint to the middle of the markers exchanges these, so that no distance distinguishes their labels.
    The mean rotation is that of the take, started from the rest pose.
    """
    rotations = np.array(motion.poses.rotations, float)
    for joint, axis in _symmetric_bones(subject).items():
        half = np.array([0.0, *axis])
        both = np.stack(
            [rotations[:, joint], np.asarray(rotation.multiply(rotations[:, joint], half), float)]
        )
        mean = np.array([1.0, 0.0, 0.0, 0.0])
        for _ in range(NUM_UPDATES):
            agreement = both @ mean
            turned = np.abs(agreement[1]) > np.abs(agreement[0])
            chosen = np.where(turned[:, None], both[1], both[0])
            chosen = chosen * np.where(chosen @ mean < 0, -1.0, 1.0)[:, None]
            mean = chosen.mean(0) / max(float(np.linalg.norm(chosen.mean(0))), 1e-9)
        rotations[:, joint] = chosen
    return eqx.tree_at(
        lambda m: m.poses.rotations, motion, jnp.asarray(rotations, motion.poses.rotations.dtype)
    )


def _symmetric_bones(subject: Subject) -> dict[int, Float[np.ndarray, "3"]]:
    """Find the bones without children whose two markers can be exchanged, and the axis of the half turn."""
    skeleton, bones = subject.skeleton, np.asarray(subject.bones)
    centres, offsets = np.asarray(skeleton.centres, float), np.asarray(subject.offsets, float)
    used, found = np.asarray(subject.weights) > 0, {}
    for joint in range(skeleton.num_joints):
        below = [
            child
            for child in range(skeleton.num_joints)
            if skeleton.descendants[joint][child] and child != joint
        ]
        mine = np.flatnonzero((bones == joint) & used)
        if len(mine) != 2 or np.isin(bones[used], below).any() or skeleton.kinds[joint] != "ball":
            continue
        a, b = offsets[mine] - centres[joint]
        middle = (a + b) / 2
        axis = middle / max(float(np.linalg.norm(middle)), 1e-9)
        turned = 2 * axis * (axis @ a) - a
        if np.linalg.norm(turned - b) < MAX_MISFIT:
            found[joint] = axis
    return found
