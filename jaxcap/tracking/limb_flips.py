"""Correction of flipped limb ends: a hand resembles the same hand turned over, and small steps do not lead
from one to the other.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ..arguments import checked
from ..body.body import Body
from ..body.pose import Pose
from ..geometry import rotation
from ..observe import thin_cloud
from ..observe.clouds import Cloud
from .expectation_maximisation.pose_log_density import COMPARISON_SIGMA
from .search.anneal import anneal_each
from .search.initialise import FINE_POINTS
from .track_frame import Tracker

#: standard deviations that fall from half the width of a hand, metres: larger ones flip a hand back
SIGMAS = (0.03, 0.025, 0.02, 0.02, 0.02, 0.015, 0.015, 0.015)
#: gain of log-likelihood required of a flip: seven times as likely. A flip that is undone by annealing gains
#: by rounding only
MIN_GAIN = 2.0


class LimbFlip(NamedTuple):
    """A half turn of a joint that flips a limb end, `wxyz` in the axes of the world at rest."""

    end: int
    joint: int
    quaternion: Float[np.ndarray, "4"]


@checked
def flip_limb_ends(tracker: Tracker, clouds: Sequence[Cloud], poses: Sequence[Pose]) -> list[Pose]:
    """Flip limb ends where that makes the clouds of all given frames together likelier; otherwise return the
    same poses.

    An end is rotated by half a turn about the line from its joint to the centre of its surface, or together
    with the bone above it about that bone, and annealed from there, as in a search. One frame may be
    ambiguous if few points are on a hand; the flip is the same in all frames of one sequence.
    """
    turns, sigmas = limb_flips(tracker.body), jnp.asarray(SIGMAS, poses[0].rotations.dtype)
    few = [thin_cloud(cloud, FINE_POINTS) for cloud in clouds]
    alone = np.concatenate([np.zeros((1, len(turns)), bool), np.eye(len(turns), dtype=bool)])
    likelihoods = np.zeros(len(alone))
    for cloud, pose in zip(few, poses, strict=True):
        means = anneal_each(tracker, cloud, _apply_flips(pose, turns, alone), sigmas, COMPARISON_SIGMA)[1]
        likelihoods += float(cloud.weights.sum()) * np.asarray(means, float)
    gains = likelihoods[1:] - likelihoods[0]
    # the best of the flips of each end
    better = np.array(
        [
            gain > MIN_GAIN
            and gain == max(other for other, way in zip(gains, turns, strict=True) if way.end == turn.end)
            for gain, turn in zip(gains, turns, strict=True)
        ],
        bool,
    )
    if not better.any():
        return list(poses)
    # all flips that are better separately together, in every row, as that shape is compiled already
    both = np.tile(better, (len(alone), 1))
    return [
        jax.tree.map(
            lambda leaf: leaf[0], anneal_each(tracker, cloud, _apply_flips(pose, turns, both), sigmas)[0]
        )
        for cloud, pose in zip(few, poses, strict=True)
    ]


def limb_ends(body: Body) -> tuple[int, ...]:
    """Find ball joints with a surface and without a rotating joint below them."""
    skeleton = body.skeleton
    turning = np.array([kind not in ("fixed", "translate") for kind in skeleton.kinds])
    parts = np.asarray(body.skin.dominant_bones())
    return tuple(
        joint
        for joint, kind in enumerate(skeleton.kinds)
        if kind == "ball"
        and (turning & skeleton.descendants[joint]).sum() == 1
        and skeleton.descendants[joint][parts].any()
    )


def limb_flips(body: Body) -> tuple[LimbFlip, ...]:
    """List the flips of each end: alone, and with the bone above it if that is a ball joint."""
    skeleton, parts = body.skeleton, np.asarray(body.skin.dominant_bones())
    vertices, centres = np.asarray(body.vertices, float), np.asarray(skeleton.centres, float)
    turns = []
    for end in limb_ends(body):
        middle, above = vertices[skeleton.descendants[end][parts]].mean(0), skeleton.parents[end]
        turns.append(LimbFlip(end, end, _half_turn(middle - centres[end])))
        if above >= 0 and skeleton.kinds[above] == "ball":
            turns.append(LimbFlip(end, above, _half_turn(centres[end] - centres[above])))
    return tuple(turns)


def _half_turn(axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4"]:
    """Make half a turn about a line."""
    return np.append(0.0, axis / max(np.linalg.norm(axis), 1e-9))


def _apply_flips(pose: Pose, turns: Sequence[LimbFlip], mask: Bool[np.ndarray, "P T"]) -> Pose:
    """Apply the flips of each row of `mask` to a pose."""
    count = len(mask)
    rotations = jnp.tile(pose.rotations, (count, 1, 1))
    for number, way in enumerate(turns):
        steps = np.where(mask[:, number, None], way.quaternion, [1.0, 0, 0, 0])
        turned = rotation.multiply(rotations[:, way.joint], jnp.asarray(steps, rotations.dtype))
        rotations = rotations.at[:, way.joint].set(turned)
    return Pose(jnp.tile(pose.translations, (count, 1, 1)), rotations, jnp.tile(pose.scale, count))
