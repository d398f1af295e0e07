"""A short performance of the embedded human: walking on the spot and waving."""

import jax
import jax.numpy as jnp
import numpy as np

from ...geometry import rotation
from ..pose import Motion, Pose
from ..skeleton import Skeleton

X, Z = np.eye(3)[[0, 2]]
#: steps a second, of both feet together, and swings of the waving hand
STEPS, SWINGS = 1.0, 1.6


def walk_and_wave(skeleton: Skeleton, seconds: float = 2.0, rate: float = 30.0) -> Motion:
    """Generate the motion for a skeleton with the human's joint names; it starts smoothly from rest.

    Angles are about the axes of the world at rest: x to the left, y up, z to the front.
    """
    time = np.arange(round(seconds * rate)) / rate
    begin = _smoothstep(time / 0.5)
    stride = 2 * np.pi * STEPS * time
    turns: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}

    def turn(name: str, axis: np.ndarray, degrees: np.ndarray) -> None:
        turns.setdefault(name, []).append((axis, np.radians(begin * degrees)))

    for side, phase in (("Left", stride), ("Right", stride + np.pi)):
        lift = np.maximum(np.sin(phase), 0.0) ** 1.5
        turn(f"{side}UpLeg", X, -48 * lift)
        turn(f"{side}Leg", X, 62 * lift)
        turn(f"{side}Foot", X, -10 * lift)
    # arms swing opposite to the legs; the left one is down, the right one is raised and waves
    turn("LeftArm", Z, -22 + 0 * time)
    turn("LeftArm", X, 26 * np.sin(stride))
    turn("LeftForeArm", X, -18 + 12 * np.sin(stride))
    raised = _smoothstep((time - 0.1) / 0.7)
    wave = np.sin(2 * np.pi * SWINGS * time)
    turn("RightArm", Z, -78 * raised)
    turn("RightForeArm", Z, raised * (-38 + 26 * wave))
    turn("RightHand", Z, raised * 14 * np.roll(wave, 2))
    turn("Spine", Z, 4 * np.sin(stride))
    turn("Spine1", X, 3 * np.cos(2 * stride))
    turn("Neck", Z, 5 * raised + 0 * time)
    rotations = np.tile([1.0, 0, 0, 0], (len(time), skeleton.num_joints, 1))
    for name, parts in turns.items():
        joint = skeleton.index(name)
        for axis, angles in parts:
            step = np.asarray(
                jax.vmap(rotation.about_axis, (None, 0))(jnp.asarray(axis), jnp.asarray(angles))
            )
            rotations[:, joint] = rotation.multiply(jnp.asarray(rotations[:, joint]), jnp.asarray(step))
    translations = np.zeros((len(time), skeleton.num_joints, 3))
    translations[:, 0] = begin[:, None] * np.stack(
        [0.02 * np.sin(stride), 0.012 * np.cos(2 * stride), 0.01 * np.sin(2 * stride)], 1
    )
    dtype = skeleton.centres.dtype
    poses = Pose(jnp.asarray(translations, dtype), jnp.asarray(rotations, dtype), jnp.ones(len(time), dtype))
    return Motion(poses, rate)


def _smoothstep(share: np.ndarray) -> np.ndarray:
    """Interpolate from 0 to 1 with zero slope at both ends (smoothstep)."""
    share = np.clip(share, 0.0, 1.0)
    return share * share * (3 - 2 * share)
