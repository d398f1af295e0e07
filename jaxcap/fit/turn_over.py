"""Ends of limbs that lie the wrong way up: a hand is much like the same hand turned over, and a tracker does not
come from the one to the other by small steps."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..body.body import Body
from ..body.pose import Pose
from ..geometry import rotation
from ..observe import Cloud, thin_cloud
from .initialise import FINE_POINTS, anneal
from .track import Tracker

#: deviations that fall from half the width of a hand, metres: wider ones turn a hand back to where it was
SIGMAS = (0.03, 0.025, 0.02, 0.02, 0.02, 0.015, 0.015, 0.015)
#: log-likelihood by which an end has to be better turned over: seven times as likely. One that comes back by itself gains
#: by rounding only
WORTH = 2.0


def turn_over(tracker: Tracker, clouds: Sequence[Cloud], poses: Sequence[Pose]) -> list[Pose]:
    """Poses of some frames of one sequence, with every end of a limb turned over where the clouds of all of them
    together are likelier then; the same poses where none is.

    An end is turned by half a turn about the line from its joint to the middle of its surface, and all is annealed from
    there, as in a search. One frame may be mistaken where few points are on a hand; whether it is over is the same in all.
    """
    ends = limb_ends(tracker.body)
    turns = _turns(tracker.body, ends)
    few = [thin_cloud(cloud, FINE_POINTS) for cloud in clouds]
    alone = np.concatenate([np.zeros((1, len(ends)), bool), np.eye(len(ends), dtype=bool)])
    likelihoods = np.zeros(len(alone))
    for cloud, pose in zip(few, poses, strict=True):
        means = _annealed(tracker, cloud, _turned(pose, ends, turns, alone))[1]
        likelihoods += float(cloud.weights.sum()) * np.asarray(means, float)
    better = likelihoods[1:] > likelihoods[0] + WORTH
    if not better.any():
        return list(poses)
    # all that are better by themselves at once, in every row, as that is compiled
    both = np.tile(better, (len(alone), 1))
    return [
        jax.tree.map(lambda leaf: leaf[0], _annealed(tracker, cloud, _turned(pose, ends, turns, both))[0])
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


def _turns(body: Body, ends: Sequence[int]) -> Float[np.ndarray, "E 4"]:
    """Half a turn of each end, in the axes of the world at rest."""
    vertices, centres = np.asarray(body.vertices, float), np.asarray(body.skeleton.centres, float)
    parts = np.asarray(body.skin.parts())
    along = np.array(
        [vertices[body.skeleton.descent[joint][parts]].mean(0) - centres[joint] for joint in ends]
    ).reshape(-1, 3)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    return np.concatenate([np.zeros((len(along), 1)), along], axis=1)


def _turned(pose: Pose, ends: Sequence[int], turns: np.ndarray, which: np.ndarray) -> Pose:
    """A pose for each row of `which (P, E)`, with these ends turned."""
    count, at = len(which), np.array(ends, int)
    rotations = jnp.tile(pose.rotations, (count, 1, 1))
    still = np.array([1.0, 0, 0, 0])
    steps = jnp.asarray(np.where(which[..., None], turns, still), rotations.dtype)
    rotations = rotations.at[:, at].set(rotation.multiply(rotations[:, at], steps))
    return Pose(jnp.tile(pose.translations, (count, 1, 1)), rotations, jnp.tile(pose.scale, count))


@eqx.filter_jit
def _annealed(tracker: Tracker, cloud: Cloud, starts: Pose) -> tuple[Pose, Float[Array, "P"]]:
    sigmas = jnp.asarray(SIGMAS, starts.rotations.dtype)

    def one(start: Pose) -> tuple[Pose, Float[Array, ""]]:
        estimate, score = anneal(tracker, cloud, start, sigmas)
        return estimate.pose, score

    return jax.lax.map(one, starts)
