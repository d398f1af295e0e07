"""Synthetic optical markers on the embedded human, and a perturbed template."""

from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

import jaxcap as jc
from benchmarks._scenes import cmu_motion
from jaxcap.body.kinematics import joint_positions
from jaxcap.geometry import rotation
from jaxcap.markers.calibration.calibrate import Calibration
from jaxcap.markers.subject import Subject, make_subject
from jaxcap.observe.markers import MarkerFrames

#: markers on each bone of the left side or the middle; the right side is as the left
LAYOUT = {
    "Hips": 4, "LowerBack": 2, "Spine": 2, "Spine1": 3, "Neck": 2, "Neck1": 2, "Head": 3, "LeftShoulder": 2, "LeftArm": 3,
    "LeftForeArm": 3, "LeftHand": 3, "LeftUpLeg": 3, "LeftLeg": 3, "LeftFoot": 2, "LeftToeBase": 2,
}  # fmt: skip


class MarkerNoise(NamedTuple):
    """The errors of simulated markers."""

    #: standard deviation along each axis, metres
    noise: float = 0.001
    #: share of frames that each marker is missing, in bursts of `burst` frames
    gaps: float = 0.0
    burst: int = 25
    #: share of frames in which two markers have each other's place
    swaps: float = 0.0
    #: metres that skin moves at the largest angle of the joints beside it
    skin: float = 0.0


class Scene(NamedTuple):
    """Frames of markers, the true subject, and the initial template."""

    frames: MarkerFrames
    truth: Subject
    motion: jc.Motion
    joints: Float[np.ndarray, "F J 3"]
    template: Subject
    swapped: Bool[np.ndarray, "F M"]


def distant_vertices(
    vertices: np.ndarray, own: np.ndarray, count: int, least: float, rng: np.random.Generator
) -> list[int]:
    """Choose vertices of a bone far from each other, at random: distances count for `least` to 1 times."""
    chosen: list[int] = []
    for _ in range(count):
        distances = [np.linalg.norm(vertices[own] - vertices[c], axis=1) for c in chosen]
        far = np.min(distances, axis=0) if distances else rng.uniform(size=len(own))
        chosen.append(int(own[np.argmax(far * rng.uniform(least, 1.0, len(own)))]))
    return chosen


def true_subject(seed: int = 0, dtype=jnp.float32) -> Subject:
    """Place about 60 markers on the surface of the embedded human, spread over the vertices of each bone."""
    body = jc.human(joints="tracking", resolution="low")
    skeleton, vertices = body.skeleton, np.asarray(body.vertices, float)
    influence = np.asarray(body.skin.bone_weights(skeleton.num_joints))
    rng = np.random.default_rng(seed)
    bones, places, labels = [], [], []
    for name in skeleton.names:
        count = LAYOUT.get(name.replace("Right", "Left"), 0)
        joint = skeleton.index(name)
        own = np.flatnonzero(influence[:, joint] > 0.5 * influence.max(1).mean())
        own = own if len(own) >= count else np.argsort(-influence[:, joint])[: 4 * count]
        chosen = distant_vertices(vertices, own, count, 0.8, rng)
        bones += [joint] * count
        places += [vertices[c] for c in chosen]
        labels += [f"{name}{number}" for number in range(count)]
    subject = make_subject(skeleton, bones, np.array(places), labels, deviations=np.full(len(bones), 1e-3))
    return jax.tree.map(lambda leaf: leaf.astype(dtype) if leaf.dtype.kind == "f" else leaf, subject)


def make_scene(
    shared: Path,
    take: str,
    trouble: MarkerNoise = MarkerNoise(),
    seed: int = 0,
    rate: float = 120.0,
    frames: int | None = None,
    dtype=jnp.float32,
) -> Scene:
    """Simulate the markers of a CMU take on the subject, with errors."""
    truth = true_subject(dtype=dtype)
    motion, skeleton = cmu_motion(shared, take)
    motion = motion.slice(slice(None, None, round(120.0 / rate))).slice(slice(frames))
    motion = jc.retarget(motion, skeleton, truth.skeleton)
    return scene_of(truth, jax.tree.map(lambda leaf: leaf.astype(dtype), motion), trouble, seed)


def scene_of(truth: Subject, motion: jc.Motion, trouble: MarkerNoise, seed: int) -> Scene:
    rng = np.random.default_rng(seed)
    shifts = _skin_motion(truth, motion, trouble.skin, rng)
    places, joints = (np.array(x, float) for x in pose_all(truth, motion.poses, jnp.asarray(shifts)))
    places, seen, swapped = corrupt_markers(places, trouble, rng)
    dtype = truth.offsets.dtype
    seen_frames = MarkerFrames(np.asarray(places, dtype), seen, truth.labels, motion.rate)
    return Scene(seen_frames, truth, motion, joints, perturb_template(truth, rng), swapped)


def corrupt_markers(
    places: Float[np.ndarray, "F M 3"], trouble: MarkerNoise, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "F M 3"], Bool[np.ndarray, "F M"], Bool[np.ndarray, "F M"]]:
    """Add noise, swapped labels and gaps: places, zeros in gaps; which are seen; which are swapped."""
    count, markers = places.shape[:2]
    places = places + trouble.noise * rng.normal(size=places.shape)
    swapped = np.zeros((count, markers), bool)
    for frame in range(count):
        # each swap puts two markers in the wrong place
        for _ in range(rng.binomial(markers, trouble.swaps / 2)):
            a, b = rng.choice(markers, 2, replace=False)
            places[frame, [a, b]] = places[frame, [b, a]]
            swapped[frame, [a, b]] = True
    seen = ~_bursts(count, markers, trouble, rng)
    return np.where(seen[..., None], places, 0.0), seen, swapped


def perturb_template(
    truth: Subject, rng: np.random.Generator, bones: float = 0.08, placement: float = 0.015
) -> Subject:
    """Scale every bone of the true subject by up to `bones`, left and right alike, and move every marker by `placement`
    metres in a random direction."""
    skeleton = truth.skeleton
    centres, old = np.array(skeleton.centres, float), np.asarray(skeleton.centres, float)
    factors = {name.replace("Right", "Left"): rng.choice([-1, 1]) * bones for name in skeleton.names}
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            factor = 1 + factors[skeleton.names[joint].replace("Right", "Left")]
            centres[joint] = centres[parent] + factor * (old[joint] - old[parent])
    off = rng.normal(size=truth.offsets.shape)
    off *= placement / np.linalg.norm(off, axis=1, keepdims=True)
    places = np.asarray(truth.offsets, float) + (centres - old)[np.asarray(truth.bones)] + off
    dtype = truth.offsets.dtype
    return eqx.tree_at(
        lambda s: (s.skeleton.centres, s.offsets, s.deviations),
        truth,
        (jnp.asarray(centres, dtype), jnp.asarray(places, dtype), jnp.full(len(off), 0.01, dtype)),
    )


def determined_projection(found: Calibration, joint: int) -> Float[np.ndarray, "3 3"]:
    """Compute the projection of a joint's error, at rest, that removes directions that the calibration reports as poorly
    determined, such as the axis of a hinge."""
    hardly = np.array([one.direction for one in found.imprecise_directions if one.joint == joint]).reshape(
        -1, 3
    )
    return np.eye(3) - hardly.T @ hardly


def rotation_spread(motion: jc.Motion) -> Float[np.ndarray, "J"]:
    """Compute twice the standard deviation of each joint's rotation about its mean, radians."""
    q = np.asarray(motion.poses.rotations, float)
    _, vectors = np.linalg.eigh(np.einsum("fja,fjb->jab", q, q))
    middle = vectors[..., -1]
    apart = 2 * np.arccos(np.clip(np.abs(np.einsum("fja,ja->fj", q, middle)), 0, 1))
    return 2 * np.sqrt((apart**2).mean(0))


def _skin_motion(truth: Subject, motion: jc.Motion, size: float, rng) -> Float[np.ndarray, "F M 3"]:
    """Move each marker along a random direction, in proportion to the angle of one of its bone's joints, by up to `size`."""
    angles = np.linalg.norm(np.asarray(rotation.log(motion.poses.rotations), float), axis=-1)
    angles -= angles.mean(0)
    bones, children = np.asarray(truth.bones), {}
    for joint, parent in enumerate(truth.skeleton.parents):
        children.setdefault(parent, joint)
    shares = rng.uniform(0.3, 1.0, len(bones))
    other = np.array([children.get(bone, bone) for bone in bones])
    driven = np.where(rng.uniform(size=len(bones)) < 0.5, angles[:, bones], angles[:, other])
    driven = driven / np.maximum(np.abs(driven).max(0), 0.5)
    directions = rng.normal(size=(len(bones), 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return (size * shares * driven)[..., None] * directions


def _bursts(count: int, markers: int, trouble: MarkerNoise, rng) -> Bool[np.ndarray, "F M"]:
    gone = np.zeros((count, markers), bool)
    length = min(trouble.burst, max(1, count // 4))
    while gone.mean() < trouble.gaps:
        start, marker = rng.integers(-length, count), rng.integers(markers)
        gone[max(start, 0) : max(start + length, 0), marker] = True
    return gone


@eqx.filter_jit
def pose_all(subject: Subject, poses: jc.Pose, shifts):
    def of_frame(frame):
        pose, shift = frame
        transforms = jc.forward_kinematics(subject.skeleton, pose)
        r, t = transforms.rotations[subject.bones], transforms.translations[subject.bones]
        places = jnp.einsum("mab,mb->ma", r, subject.offsets + shift) + t
        return places, joint_positions(subject.skeleton, transforms)

    return jax.lax.map(of_frame, (poses, shifts.astype(subject.offsets.dtype)))
