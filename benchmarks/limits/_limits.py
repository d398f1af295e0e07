"""Scenes for benchmarks of joint limits: an analytic coupled limit, and motions of the CMU database."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from jaxcap.body.pose import Motion, Pose
from jaxcap.body.skeleton import Skeleton, make_skeleton
from jaxcap.io.registry import read_motion

#: pairs of the database's joints, parents first
PAIRS = (("lhumerus", "lradius"), ("rhumerus", "rradius"), ("lfemur", "ltibia"), ("rfemur", "rtibia"))


def cmu_motions(shared):
    """Load all motions of subjects 01 and 02, each with its subject's skeleton."""
    return [read_motion(path) for path in sorted((shared / "data" / "motion").glob("0*_*.amc"))]


def pair_skeleton() -> Skeleton:
    """Make a ball shoulder and a hinge elbow."""
    names, centres = ("shoulder", "elbow"), [[0.0, 0, 0], [0.3, 0, 0]]
    return make_skeleton(names, (-1, 0), ("ball", "revolute"), centres, axes=[[[1.0, 0, 0], [0, 1, 0]]] * 2)


def motion_of(skeleton: Skeleton, rotations: dict[str, np.ndarray], rate: float = 30.0) -> Motion:
    """Make a motion of some joints, from their rotations `(F, 4)` by name."""
    frames = len(next(iter(rotations.values())))
    turned = np.tile([1.0, 0, 0, 0], (frames, skeleton.num_joints, 1))
    for name, values in rotations.items():
        turned[:, skeleton.index(name)] = values
    still = jnp.zeros((frames, skeleton.num_joints, 3))
    return Motion(Pose(still, jnp.asarray(turned), jnp.ones(frames)), rate)


def uniform_rotations(rng: np.random.Generator, count: int) -> np.ndarray:
    """Sample rotations uniformly, `(count, 4)`."""
    q = rng.normal(size=(count, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def hinge_rotations(axis: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Make rotations about one axis, `(count, 4)`."""
    return np.concatenate([np.cos(angles / 2)[:, None], np.sin(angles / 2)[:, None] * axis], 1)


def mirrored_twist(rotations: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Invert the twist about `axis`, and keep the swing."""
    along = rotations[:, 1:] @ axis
    twist = np.concatenate([rotations[:, :1], along[:, None] * axis], 1)
    twist = Rotation.from_quat(twist, scalar_first=True)
    swing = Rotation.from_quat(rotations, scalar_first=True) * twist.inv()
    return (swing * twist.inv()).as_quat(scalar_first=True)


def true_slack(shoulder: np.ndarray, elbow: np.ndarray) -> np.ndarray:
    """`(F, 2)` radians by which poses of `pair_skeleton` are within an analytic limit that couples swing
    with twist and the elbow with the shoulder, negative beyond it.

    The upper arm swings by at most 45 degrees, its twist by 40 less half of the swing, to either side;
    the elbow bends from 0 to 120 degrees less one and a half of the twist, either way.
    """
    q = Rotation.from_quat(shoulder, scalar_first=True)
    pointing = q.apply([1.0, 0, 0])
    swing = np.arctan2(np.hypot(pointing[:, 1], pointing[:, 2]), pointing[:, 0])
    twist = 2 * np.arctan2(shoulder[:, 1], shoulder[:, 0])
    twist = (twist + np.pi) % (2 * np.pi) - np.pi
    # the slope of each bound against the angle between rotations makes slack a distance
    parent = np.minimum(
        np.radians(45) - swing, (np.radians(40) - swing / 2 - np.abs(twist)) / np.hypot(1.0, 0.5)
    )
    bend = 2 * np.arctan2(elbow[:, 1], elbow[:, 0])
    bend = (bend + np.pi) % (2 * np.pi) - np.pi
    top = (np.radians(120) - 1.5 * np.abs(twist) - bend) / np.hypot(1.0, 1.5)
    return np.stack([parent, np.minimum(bend, top)], 1)


def true_samples(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Sample poses uniformly within the analytic limit."""
    shoulders, elbows = [], []
    while sum(len(s) for s in shoulders) < count:
        angle = np.radians(75) * np.cbrt(rng.uniform(size=8 * count))
        vector = rng.normal(size=(8 * count, 3))
        vector *= (angle / np.linalg.norm(vector, axis=1))[:, None]
        shoulder = Rotation.from_rotvec(vector).as_quat(scalar_first=True)
        elbow = hinge_rotations(np.array([1.0, 0, 0]), rng.uniform(0, np.radians(120), len(vector)))
        good = (true_slack(shoulder, elbow) >= 0).all(1)
        shoulders.append(shoulder[good])
        elbows.append(elbow[good])
    return np.concatenate(shoulders)[:count], np.concatenate(elbows)[:count]


def clear_compiled() -> None:
    """Clear compiled functions, as each scene has other shapes."""
    jax.clear_caches()
