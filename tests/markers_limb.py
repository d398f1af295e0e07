"""A trunk with two arms of two bones each, with markers on all of them, in random motion."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxcap.body.pose import Motion, Pose
from jaxcap.body.skeleton import make_skeleton
from jaxcap.geometry import rotation
from jaxcap.markers.subject import Subject, make_subject, marker_positions
from jaxcap.observe.markers import MarkerFrames

NAMES = ("trunk", "left_arm", "left_hand", "right_arm", "right_hand")
CENTRES = np.array([[0.0, 0, 0], [0.2, 0.3, 0], [0.5, 0.3, 0], [-0.2, 0.3, 0], [-0.5, 0.3, 0]])
BONES = np.repeat(np.arange(5), [4, 4, 3, 4, 3])


def truth() -> Subject:
    skeleton = make_skeleton(NAMES, [-1, 0, 1, 0, 3], ["free"] + ["ball"] * 4, CENTRES)
    rng = np.random.default_rng(5)
    out = np.sign(CENTRES[BONES, :1]) * [[0.15, 0, 0]]
    offsets = CENTRES[BONES] + out + 0.08 * rng.normal(size=(len(BONES), 3))
    labels = [f"{NAMES[bone]}_{number}" for number, bone in enumerate(BONES)]
    return make_subject(skeleton, BONES, offsets, labels, deviations=np.full(len(BONES), 1e-3))


def moving(rng, frames: int = 40, hinge: int | None = None, size: float = 0.5, dtype=float) -> Motion:
    """Every joint turns at random, smoothly; joint `hinge` about its z axis only."""
    phases, speeds = rng.uniform(0, 6.28, (5, 3)), rng.uniform(0.05, 0.25, (5, 3))
    turns = size * np.sin(phases + speeds * np.arange(frames)[:, None, None])
    if hinge is not None:
        turns[:, hinge, :2] = 0.0
    shifts = np.zeros((frames, 5, 3))
    shifts[:, 0] = 0.01 * np.arange(frames)[:, None] * [1.0, 0, 0.5]
    rotations = rotation.exp(jnp.asarray(turns, dtype))
    return Motion(Pose(jnp.asarray(shifts, dtype), rotations, jnp.ones(frames, dtype)), 100.0)


_all_places = eqx.filter_jit(
    lambda subject, poses: jax.lax.map(lambda p: marker_positions(subject, p), poses)
)


def seen_by(subject: Subject, motion: Motion, rng, noise: float = 1e-3) -> MarkerFrames:
    places = np.array(_all_places(subject, motion.poses))
    places += noise * rng.normal(size=places.shape)
    return MarkerFrames(places, np.ones(places.shape[:2], bool), subject.labels, motion.rate)


def wrong(subject: Subject, rng) -> Subject:
    """Bones 8 % off, alike on both sides, and markers 15 mm."""
    factors = 1 + 0.08 * rng.choice([-1, 1], 2)
    centres = np.array(subject.skeleton.centres)
    for arm, hand in ((1, 2), (3, 4)):
        old = CENTRES[hand] - CENTRES[arm]
        centres[arm] = factors[0] * CENTRES[arm]
        centres[hand] = centres[arm] + factors[1] * old
    off = rng.normal(size=(len(BONES), 3))
    off *= 0.015 / np.linalg.norm(off, axis=1, keepdims=True)
    offsets = subject.offsets + (centres - CENTRES)[BONES] + off
    return eqx.tree_at(
        lambda s: (s.skeleton.centres, s.offsets, s.deviations),
        subject,
        (jnp.asarray(centres), offsets, jnp.full(len(BONES), 0.01)),
    )


def bone_lengths(subject: Subject) -> np.ndarray:
    """Of both upper arms."""
    centres = np.asarray(subject.skeleton.centres)
    return np.linalg.norm(centres[[2, 4]] - centres[[1, 3]], axis=1)
