"""Simulated stereo points of a moving arm: few, one-sided, noisy, with quantised depth."""

from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

import jaxcap as jc
from benchmarks._scenes import Noise, human_motion, scan_frame
from jaxcap.geometry import rotation

#: what is looked at, from the trunk outwards
ARM = ("RightArm", "RightForeArm", "RightHand")
#: points of a whole body that is seen without noise, of which some are the arm's
DENSE = Noise(points=4000, deviation=0.0, tilt=0.0, outliers=0.0)


class Stereo(NamedTuple):
    """The errors of simulated stereo points."""

    #: points of the arm at most, before some are dropped
    points: int = 300
    #: standard deviation along each axis, metres
    deviation: float = 0.015
    #: share that finds no match
    dropped: float = 0.2
    #: depth comes in multiples of this, metres
    step: float = 0.02


STEREO = Stereo()


class ArmFrames(NamedTuple):
    """Several motions in sequence; F frames of N points."""

    #: of the tracked body, the pelvis at rest
    truth: jc.Pose
    points: Float[np.ndarray, "F N 3"]
    #: zero where there is no point
    weights: Float[np.ndarray, "F N"]
    #: the first frame of each motion
    first: Bool[np.ndarray, "F"]


def simulate_arm(
    shared: Path,
    takes: tuple[str, ...],
    tracked: jc.Body,
    frames: int | None = None,
    every: int = 1,
    stereo: Stereo = STEREO,
) -> ArmFrames:
    """Simulate takes of the database on the full embedded human, seen from the front of its pelvis.

    The first `frames` of each take are used, or all, and of these every `every`-th.
    """
    subject = jc.human()
    poses, points, weights, first = [], [], [], []
    for take in takes:
        motion = human_motion(shared, take, subject, frames).slice(slice(None, None, every))
        for frame in range(motion.num_frames):
            rng = np.random.default_rng([int(part) for part in take.split("_")] + [frame])
            pose = reset_root(motion[frame])
            some, there = simulate_frame(subject, pose, stereo, rng)
            poses.append(jc.body.project(tracked.skeleton, pose))
            points.append(some)
            weights.append(there)
            first.append(frame == 0)
    truth = jc.stack_poses(poses).poses
    return ArmFrames(truth, np.stack(points), np.stack(weights), np.array(first))


def reset_root(pose: jc.Pose) -> jc.Pose:
    """Reset the root to its rest position and rotation, as the cameras move with it."""
    return jc.Pose(
        pose.translations.at[0].set(0.0), pose.rotations.at[0].set(rotation.identity()), pose.scale
    )


def simulate_frame(
    body: jc.Body, pose: jc.Pose, stereo: Stereo, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N"]]:
    """Simulate the points of the arm and their weights in one frame, without occluded ones."""
    seen = scan_frame(body, pose, rng, DENSE, "camera").cloud
    whole = np.asarray(seen.points, float)[np.asarray(seen.weights) > 0]
    vertices = np.asarray(_posed(body, pose).vertices, float)
    on_arm = descendants(body.skeleton, ARM[0])[np.asarray(body.skin.dominant_bones())]
    whole = whole[on_arm[KDTree(vertices).query(whole)[1]]]
    chosen = whole[rng.permutation(len(whole))[: stereo.points]]
    chosen = chosen + stereo.deviation * rng.normal(size=chosen.shape)
    chosen[:, 2] = stereo.step * np.round(chosen[:, 2] / stereo.step)
    points, weights = np.zeros((stereo.points, 3)), np.zeros(stereo.points)
    points[: len(chosen)] = chosen
    weights[: len(chosen)] = rng.uniform(size=len(chosen)) >= stereo.dropped
    return points, weights


def descendants(skeleton: jc.Skeleton, joint: str) -> Bool[np.ndarray, "J"]:
    """Find the descendants of a joint, including itself."""
    return np.asarray(skeleton.descendants[skeleton.index(joint)], bool)


def twists(
    skeleton: jc.Skeleton, joint: str, truth: Float[np.ndarray, "F 4"], found: Float[np.ndarray, "F 4"]
) -> Float[np.ndarray, "F"]:
    """Compute the twist of the error of a joint's rotation about its bone, degrees."""
    axis = rotation.rotate(skeleton.orientations[skeleton.index(joint)], jnp.array([1.0, 0.0, 0.0]))
    between = rotation.multiply(rotation.conjugate(jnp.asarray(truth)), jnp.asarray(found))
    twist = rotation.swing_twist(between, axis)[1]
    return np.degrees(2 * np.arctan2(np.linalg.norm(twist[:, 1:], axis=1), np.abs(twist[:, 0])))


_posed = eqx.filter_jit(jc.pose_body)
