"""Gaze: rotate chest, neck and head so that a line through the head points at a target.

After the applications of Adaptation, section 4.2.3: the gaze line goes from the back of the head to the point
between the eyes. The chest takes a tenth of the rotation, the neck four tenths and the head half. The
rotation is faded in and out by a sigmoid.
"""

from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..arguments import checked
from ..body.kinematics import forward_kinematics
from ..body.pose import Motion, Pose
from ..body.skeleton import Skeleton
from ..geometry import rotation
from ..limits.abstract_limits import AbstractLimits
from .gaze_line import GazeLine

#: fixed-point iterations that account for the motion of the eyes; each reduces the error at least four times
NUM_ITERATIONS = 30
#: least distance of a target from the point between the eyes, metres
MIN_TARGET_DISTANCE = 0.25


class GazeResult(NamedTuple):
    """A motion with a new gaze, and its errors."""

    motion: Motion
    #: (F,) fraction of the rotation that is applied in each frame, 0 to 1
    magnitude: Float[np.ndarray, "F"]
    #: (F,) angle between the line and the target before and after, degrees
    before: Float[np.ndarray, "F"]
    after: Float[np.ndarray, "F"]
    #: (F,) frames in which `max_angle` or limits restrict the rotation
    limited: Bool[np.ndarray, "F"]


@checked
def look_at_target(
    skeleton: Skeleton,
    motion: Motion,
    line: GazeLine,
    target: Float[np.ndarray | Array, "3"] | Float[np.ndarray | Array, "F 3"],
    shares: Mapping[str, float],
    *,
    is_direction: bool = False,
    first: int = 0,
    last: int | None = None,
    fade: float = 0.5,
    max_angle: float | None = None,
    limits: AbstractLimits | None = None,
) -> GazeResult:
    """Rotate the `line` of the head towards a target from frame `first` to `last`.

    All joints rotate about one world axis. Each takes its share of one angle, the smallest that aligns the
    line with the target, so the shares compose exactly to the whole rotation. Frames outside the range are
    returned unchanged.

    **Arguments:** `target` a point, metres, or with `is_direction` a direction in the world; one for all frames
    or one for each. `shares` names the joints, from the trunk to the head, with fractions that sum to 1; the
    last one carries the line (`gaze_shares` guesses them). `fade` is the duration of the fade at either end,
    seconds; `max_angle` the largest angle of the whole rotation, degrees. The joints are projected onto the
    `limits`; joints that were recorded beyond them come back gradually with the fade.

    **Raises:** `ValueError` for joints that do not exist or are not a chain, shares that do not sum to 1, a
    range that is not in the motion or too short for its fades, or a target within 25 cm of the eyes.
    """
    chain = _make_chain(skeleton, line, shares)
    first, last = _check_range(motion, first, last)
    magnitude = fade_weights(len(motion), first, last, fade * motion.rate)
    if max_angle is not None and not 0 < max_angle <= 180:
        raise ValueError(
            f"The largest rotation of the gaze is {max_angle:g} degrees; expected above 0 and at most 180."
        )
    goals = np.broadcast_to(np.asarray(target, float), (len(motion), 3))
    if not np.isfinite(goals).all():
        raise ValueError("The target of the gaze is not finite; give three finite numbers.")
    used = magnitude > 0
    eyes, looks = (np.asarray(x) for x in _all_eyes_and_directions(skeleton, line, motion.poses))
    lengths = np.linalg.norm(goals if is_direction else goals - eyes, axis=1)
    close = used & (lengths < (1e-9 if is_direction else MIN_TARGET_DISTANCE))
    if close.any():
        frame = int(np.argmax(close))
        raise ValueError(
            "The direction of the gaze has zero length; give a vector that is not zero."
            if is_direction
            else f"In frame {frame} the target is {100 * lengths[frame]:.0f} cm from the point between the eyes; expected "
            f"at least {100 * MIN_TARGET_DISTANCE:.0f} cm. Check its unit, and that it is in the world of the motion."
        )
    dtype = motion.poses.rotations.dtype
    cap = np.radians(180.0 if max_angle is None else max_angle)
    turned = _rotate_frames(
        skeleton,
        motion.poses,
        line,
        chain,
        jnp.asarray(goals, dtype),
        jnp.asarray(magnitude, dtype),
        jnp.asarray(cap, dtype),
        limits,
        is_direction,
    )
    rows = jnp.asarray(used)[:, None, None]
    poses = eqx.tree_at(
        lambda p: p.rotations, motion.poses, jnp.where(rows, turned.rotations, motion.poses.rotations)
    )
    moved, looked = (np.asarray(x) for x in _all_eyes_and_directions(skeleton, line, poses))
    before = _angles_between(looks, goals if is_direction else goals - eyes)
    after = _angles_between(looked, goals if is_direction else goals - moved)
    # an error at full magnitude means that `max_angle` or the limits are active
    limited = (magnitude == 1.0) & (after > 0.1)
    return GazeResult(Motion(poses, motion.rate), magnitude, before, after, limited)


def fade_weights(num_frames: int, first: int, last: int, fade_frames: float) -> Float[np.ndarray, "F"]:
    """Compute fade weights of each frame.

    They are 0 outside `first` to `last`. Within the range they rise as a sigmoid over `fade_frames` frames, stay
    at 1, and fall again. The sigmoid is the logistic function of `1/(1-t) - 1/t`: 0 and 1 at its ends with
    every derivative zero.

    **Raises:** `ValueError` if the two fades do not fit into the range.
    """
    if not 0 <= fade_frames < np.inf:
        raise ValueError(f"The fade takes {fade_frames:g} frames; expected at least 0.")
    if 2 * fade_frames > last - first:
        raise ValueError(
            f"Two fades of {fade_frames:g} frames do not fit into frames {first} to {last}; use a longer range or a "
            "shorter fade."
        )
    number = np.arange(num_frames)
    inside = (number >= first) & (number <= last)
    if fade_frames == 0:
        return inside.astype(float)
    share = np.clip(np.minimum(number - first, last - number) / fade_frames, 0.0, 1.0)
    between = (share > 0) & (share < 1)
    t = np.where(between, share, 0.5)
    exponent = np.clip(1.0 / t - 1.0 / (1.0 - t), -500.0, 500.0)
    return np.where(between, 1.0 / (1.0 + np.exp(exponent)), share) * inside


class _Chain(NamedTuple):
    """The joints that rotate, from the trunk on, and the share of each."""

    joints: Int[Array, "C"]
    parents: Int[Array, "C"]
    shares: Float[Array, "C"]


def _make_chain(skeleton: Skeleton, line: GazeLine, shares: Mapping[str, float]) -> _Chain:
    if not shares:
        raise ValueError("No joints are given for the gaze; name at least the head.")
    for name, share in shares.items():
        if name not in skeleton.names:
            raise ValueError(f"There is no joint '{name}'; the skeleton has {', '.join(skeleton.names)}.")
        kind = skeleton.kinds[skeleton.names.index(name)]
        if kind not in ("ball", "free"):
            raise ValueError(f"The joint '{name}' is {kind}; only ball and free joints can rotate the gaze.")
        if not share > 0:
            raise ValueError(f"The share of '{name}' is {share:g}; expected above 0.")
    if abs(sum(shares.values()) - 1.0) > 1e-6:
        raise ValueError(f"The shares of the joints add up to {sum(shares.values()):g}; expected a sum of 1.")
    joints = [skeleton.names.index(name) for name in shares]
    for above, below in pairwise(joints):
        if above == below or not skeleton.descendants[above, below]:
            raise ValueError(
                f"The joint '{skeleton.names[below]}' is not a descendant of '{skeleton.names[above]}'; name joints "
                "from the trunk to the head."
            )
    if not skeleton.descendants[joints[-1], line.joint]:
        raise ValueError(
            f"The gaze line is fixed to '{skeleton.names[line.joint]}', which is not a descendant of "
            f"'{skeleton.names[joints[-1]]}', the last joint that rotates; name joints of its chain."
        )
    dtype = skeleton.centres.dtype
    parents = [skeleton.parents[joint] for joint in joints]
    parts = np.array(list(shares.values())) / sum(shares.values())
    return _Chain(jnp.asarray(joints), jnp.asarray(parents), jnp.asarray(parts, dtype))


def _check_range(motion: Motion, first: int, last: int | None) -> tuple[int, int]:
    last = len(motion) - 1 if last is None else last
    if not 0 <= first <= last < len(motion):
        raise ValueError(
            f"Frames {first} to {last} are not in a motion of {len(motion)} frames; give frames from 0 to "
            f"{len(motion) - 1}."
        )
    return first, last


@eqx.filter_jit
def _rotate_frames(
    skeleton, poses: Pose, line, chain, targets, magnitude, max_angle, limits, is_direction: bool
) -> Pose:
    def one(frame):
        pose, goal, share = frame
        turn = jnp.zeros(3, pose.rotations.dtype)

        def again(_, turn):
            eyes, look = eyes_and_direction(skeleton, line, rotate_chain(skeleton, pose, chain, turn))
            wanted = goal if is_direction else goal - eyes
            more = rotation.shortest_arc(look, wanted / jnp.linalg.norm(wanted))
            return rotation.log(rotation.multiply(more, rotation.exp(turn)))

        turn = jax.lax.fori_loop(0, NUM_ITERATIONS, again, turn)
        angle = jnp.linalg.norm(turn)
        turn = turn * (share * jnp.minimum(1.0, max_angle / jnp.maximum(angle, 1e-9)))
        moved = rotate_chain(skeleton, pose, chain, turn)
        return moved if limits is None else _project_chain(limits, skeleton, pose, moved, chain, share)

    return jax.lax.map(one, (poses, targets, magnitude))


def rotate_chain(skeleton: Skeleton, pose: Pose, chain: _Chain, rotation_vector: Float[Array, "3"]) -> Pose:
    """Rotate every joint of a chain by its share of the world rotation vector `rotation_vector`; one pose.

    All joints share one axis, so the descendants of the last joint rotate by all of `rotation_vector`. The local
    rotation of a joint is `W^T exp(share * rotation_vector) W`, with `W` the previous rotation of its
    parent.
    """
    before = forward_kinematics(skeleton, pose).rotations / pose.scale
    above = jnp.where(
        (chain.parents < 0)[:, None, None], jnp.eye(3, dtype=before.dtype), before[chain.parents]
    )
    own = chain.shares[:, None] * jnp.einsum("cba,b->ca", above, rotation_vector)
    local = rotation.multiply(rotation.exp(own), pose.rotations[chain.joints])
    return Pose(pose.translations, pose.rotations.at[chain.joints].set(rotation.normalise(local)), pose.scale)


def eyes_and_direction(
    skeleton: Skeleton, line: GazeLine, pose: Pose
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Compute the position of the eyes, metres, and the unit gaze direction of one pose."""
    transforms = forward_kinematics(skeleton, pose)
    r, t = transforms.rotations[line.joint], transforms.translations[line.joint]
    return r @ line.eyes + t, r @ line.direction / pose.scale


@eqx.filter_jit
def _all_eyes_and_directions(skeleton, line, poses: Pose):
    return jax.lax.map(lambda pose: eyes_and_direction(skeleton, line, pose), poses)


def _project_chain(
    limits, skeleton, original: Pose, pose: Pose, chain: _Chain, fade: Float[Array, ""]
) -> Pose:
    """Project the joints of the chain onto their limits.

    As far as the gaze is faded out, they keep the violation of the pose `original`. A joint that was recorded
    beyond its limits so comes back into them as the gaze is faded in.
    """
    held, own = (limits.project(skeleton, p).rotations[chain.joints] for p in (pose, original))
    beyond = rotation.log(rotation.multiply(rotation.conjugate(own), original.rotations[chain.joints]))
    held = rotation.multiply(held, rotation.exp((1.0 - fade) * beyond))
    return Pose(pose.translations, pose.rotations.at[chain.joints].set(rotation.normalise(held)), pose.scale)


def _angles_between(directions: np.ndarray, targets: np.ndarray) -> np.ndarray:
    sine = np.linalg.norm(np.cross(directions, targets), axis=1)
    return np.degrees(np.arctan2(sine, np.sum(directions * targets, axis=1)))
