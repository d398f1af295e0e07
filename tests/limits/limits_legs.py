"""A person whose legs move, for tests of joint limits."""

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

import jaxcap as jc


def hinged(skeleton: jc.Skeleton) -> jc.Skeleton:
    """Knees as hinges, whose axes define those of thigh and shank exactly."""
    kinds = [
        "revolute" if name in ("LeftLeg", "RightLeg") else kind
        for name, kind in zip(skeleton.names, skeleton.kinds, strict=True)
    ]
    return jc.make_skeleton(skeleton.names, skeleton.parents, kinds, skeleton.centres, axes=skeleton.axes)


HUMAN = hinged(jc.human(resolution="low").skeleton)
PAIRS = (("LeftUpLeg", "LeftLeg"), ("RightUpLeg", "RightLeg"))


def quaternions(turns: Rotation) -> np.ndarray:
    return turns.as_quat(scalar_first=True)


def leg_motion(seed: int, frames: int = 240, size: float = 0.7) -> jc.Motion:
    """Hips that turn any way, and knees that bend; the arms rest."""
    rng = np.random.default_rng(seed)
    rotations = np.tile([1.0, 0, 0, 0], (frames, HUMAN.num_joints, 1))
    for hip, knee in PAIRS:
        waves = np.sin(np.arange(frames)[:, None] * rng.uniform(0.02, 0.2, 3) + rng.uniform(0, 6, 3))
        rotations[:, HUMAN.index(hip)] = quaternions(Rotation.from_rotvec(size * waves))
        bend = 0.6 * (1 + np.sin(0.13 * np.arange(frames) + seed))
        rotations[:, HUMAN.index(knee)] = quaternions(Rotation.from_rotvec(bend[:, None] * [1.0, 0, 0]))
    still = jnp.zeros((frames, HUMAN.num_joints, 3))
    return jc.Motion(jc.Pose(still, jnp.asarray(rotations), jnp.ones(frames)), 30.0)
