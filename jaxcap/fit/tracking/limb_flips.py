"""Ends of limbs that lie the wrong way up: a hand is much like the same hand turned over, and a tracker does not
come from the one to the other by small steps."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...arguments import checked
from ...body.body import Body
from ...body.pose import Pose
from ...geometry import rotation
from ...observe import Cloud, thin_cloud
from .initialise import FINE_POINTS, anneal_each
from .track_frame import Tracker

#: deviations that fall from half the width of a hand, metres: wider ones turn a hand back to where it was
SIGMAS = (0.03, 0.025, 0.02, 0.02, 0.02, 0.015, 0.015, 0.015)
#: log-likelihood by which an end has to be better turned over: seven times as likely. One that comes back by itself gains
#: by rounding only
WORTH = 2.0


class Turn(NamedTuple):
    """Half a turn of a joint by which an end of a limb is turned over, `wxyz` in the axes of the world at rest."""

    end: int
    joint: int
    turn: Float[np.ndarray, "4"]


@checked
def turn_over(tracker: Tracker, clouds: Sequence[Cloud], poses: Sequence[Pose]) -> list[Pose]:
    """Poses of some frames of one sequence, with every end of a limb turned over where the clouds of all of them
    together are likelier then; the same poses where none is.

    An end is turned by half a turn about the line from its joint to the middle of its surface, or with the bone above it
    about that, and all is annealed from there, as in a search. One frame may be mistaken where few points are on a hand;
    whether it is over is the same in all.
    """
    turns, sigmas = half_turns(tracker.body), jnp.asarray(SIGMAS, poses[0].rotations.dtype)
    few = [thin_cloud(cloud, FINE_POINTS) for cloud in clouds]
    alone = np.concatenate([np.zeros((1, len(turns)), bool), np.eye(len(turns), dtype=bool)])
    likelihoods = np.zeros(len(alone))
    for cloud, pose in zip(few, poses, strict=True):
        means = anneal_each(tracker, cloud, _turned(pose, turns, alone), sigmas)[1]
        likelihoods += float(cloud.weights.sum()) * np.asarray(means, float)
    gains = likelihoods[1:] - likelihoods[0]
    # of the ways to turn an end the best one
    better = np.array(
        [
            gain > WORTH
            and gain == max(other for other, way in zip(gains, turns, strict=True) if way.end == turn.end)
            for gain, turn in zip(gains, turns, strict=True)
        ],
        bool,
    )
    if not better.any():
        return list(poses)
    # all that are better by themselves at once, in every row, as that is compiled
    both = np.tile(better, (len(alone), 1))
    return [
        jax.tree.map(lambda leaf: leaf[0], anneal_each(tracker, cloud, _turned(pose, turns, both), sigmas)[0])
        for cloud, pose in zip(few, poses, strict=True)
    ]


def limb_ends(body: Body) -> tuple[int, ...]:
    """Joints that turn freely, below which none turns, and which have a surface."""
    skeleton = body.skeleton
    turning = np.array([kind not in ("fixed", "translate") for kind in skeleton.kinds])
    parts = np.asarray(body.skin.parts())
    return tuple(
        joint
        for joint, kind in enumerate(skeleton.kinds)
        if kind == "ball"
        and (turning & skeleton.descent[joint]).sum() == 1
        and skeleton.descent[joint][parts].any()
    )


def half_turns(body: Body) -> tuple[Turn, ...]:
    """The ways to turn each end over: by itself, and with the bone above it where that turns freely."""
    skeleton, parts = body.skeleton, np.asarray(body.skin.parts())
    vertices, centres = np.asarray(body.vertices, float), np.asarray(skeleton.centres, float)
    turns = []
    for end in limb_ends(body):
        middle, above = vertices[skeleton.descent[end][parts]].mean(0), skeleton.parents[end]
        turns.append(Turn(end, end, _half(middle - centres[end])))
        if above >= 0 and skeleton.kinds[above] == "ball":
            turns.append(Turn(end, above, _half(centres[end] - centres[above])))
    return tuple(turns)


def _half(along: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4"]:
    """Half a turn about a line."""
    return np.append(0.0, along / max(np.linalg.norm(along), 1e-9))


def _turned(pose: Pose, turns: Sequence[Turn], which: Bool[np.ndarray, "P T"]) -> Pose:
    """A pose for each row of `which`, with these turns."""
    count = len(which)
    rotations = jnp.tile(pose.rotations, (count, 1, 1))
    for number, way in enumerate(turns):
        steps = np.where(which[:, number, None], way.turn, [1.0, 0, 0, 0])
        turned = rotation.multiply(rotations[:, way.joint], jnp.asarray(steps, rotations.dtype))
        rotations = rotations.at[:, way.joint].set(turned)
    return Pose(jnp.tile(pose.translations, (count, 1, 1)), rotations, jnp.tile(pose.scale, count))
