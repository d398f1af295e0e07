"""Hypotheses of where a standing person is among points without labels."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import cdist

from ...body.pose import Pose, rest_pose
from ...body.skeleton import Skeleton
from ...geometry import rotation
from ..subject import Subject, marker_positions

#: rotations of both arms from rest about the forward axis, radians: at rest, along the trunk, and to the sides
ARM_ANGLES = (0.0, -0.6, 0.7)
#: number of facings
NUM_FACINGS = 24
#: number of rounds of nearest landmarks and alignment; distance beyond which a point pulls no more, metres
NUM_ROUNDS, PULL = 12, 0.1
#: scales of a person relative to the mean one
MIN_SCALE, MAX_SCALE = 0.6, 1.3


class StandingHypothesis(NamedTuple):
    """A standing person, as a similarity of a pose of the mean person: `x = scale R p + t`."""

    #: angle of the facing about the vertical, radians
    facing: float
    scale: float
    shift: Float[np.ndarray, "3"]
    arms: int
    #: mean truncated squared distance of the points from the nearest landmarks, metres squared
    cost: float


def standing_poses(skeleton: Skeleton) -> list[Pose]:
    """Make poses of a standing person with the arms at several angles."""
    poses = []
    for angle in ARM_ANGLES:
        pose = rest_pose(skeleton)
        rotations = pose.rotations
        for side, sign in (("Left", 1.0), ("Right", -1.0)):
            turn = rotation.exp(jnp.array([0.0, 0.0, sign * angle], rotations.dtype))
            rotations = rotations.at[skeleton.index(f"{side}Arm")].set(turn)
        poses.append(Pose(pose.translations, rotations, pose.scale))
    return poses


def find_standing(points: Float[np.ndarray, "P 3"], subject: Subject) -> list[StandingHypothesis]:
    """Align a standing person to points with y up, from several facings; the best first.

    In turns, each point gets its nearest landmark, and the person is moved, turned about the vertical and scaled.
    """
    hypotheses = []
    for arms, pose in enumerate(standing_poses(subject.skeleton)):
        model = np.asarray(marker_positions(subject, pose), float)
        for facing in np.linspace(0, 2 * np.pi, NUM_FACINGS, endpoint=False):
            for at_head in (False, True):
                hypotheses.append(_align(points, model, float(facing), at_head, arms))
    return sorted(hypotheses, key=lambda one: one.cost)


def hypothesis_pose(subject: Subject, hypothesis: StandingHypothesis) -> Pose:
    """Make the pose of a hypothesis of a subject of its own size."""
    pose = standing_poses(subject.skeleton)[hypothesis.arms]
    turn = _about_vertical(hypothesis.facing)
    centre = np.asarray(subject.skeleton.centres[0], float)
    dtype = pose.rotations.dtype
    shift = hypothesis.shift + turn @ centre - centre
    return Pose(
        pose.translations.at[0].set(jnp.asarray(shift, dtype)),
        pose.rotations.at[0].set(rotation.from_matrix(jnp.asarray(turn, dtype))),
        pose.scale,
    )


def _align(
    points: Float[np.ndarray, "P 3"], model: Float[np.ndarray, "L 3"], facing: float, at_head: bool, arms: int
) -> StandingHypothesis:
    turn = _about_vertical(facing)
    end = np.max if at_head else np.min
    scale, shift = 1.0, points.mean(0) - turn @ model.mean(0)
    shift[1] = end(points[:, 1]) - end(model[:, 1])
    cost = np.inf
    for _ in range(NUM_ROUNDS):
        placed = scale * model @ turn.T + shift
        away = cdist(points, placed)
        nearest = away.argmin(1)
        distances = away[np.arange(len(points)), nearest]
        cost = float(np.mean(np.minimum(distances, PULL) ** 2))
        weights = 1.0 / (1.0 + (distances / PULL) ** 2) ** 2
        source, total = model[nearest], weights.sum()
        middle, target = weights @ source / total, weights @ points / total
        a, b = source - middle, points - target
        # the best angle about the vertical, then the best scale
        sine = float(np.sum(weights * (a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2])))
        cosine = float(np.sum(weights * (a[:, 0] * b[:, 0] + a[:, 2] * b[:, 2])))
        facing = float(np.arctan2(sine, cosine))
        turn = _about_vertical(facing)
        turned = a @ turn.T
        scale = float(np.sum(weights[:, None] * turned * b) / max(np.sum(weights[:, None] * a * a), 1e-9))
        scale = float(np.clip(scale, MIN_SCALE, MAX_SCALE))
        shift = target - scale * turn @ middle
    return StandingHypothesis(facing, scale, shift, arms, cost)


def _about_vertical(angle: float) -> Float[np.ndarray, "3 3"]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
