"""Project random invalid poses onto learned joint limits: `python -m benchmarks.limits_project`.

A shoulder with its elbow, learned from the CMU database. Every pose has to be allowed afterwards,
and no joint may be moved further than 1.1 times as far as the nearest sample that is allowed: of the
shoulder any, of the elbow, which comes after it, those that the shoulder as it is put then allows.
"""

import argparse

import jax.numpy as jnp
import numpy as np
from scipy.spatial import KDTree

from benchmarks._scenes import shared_folder
from benchmarks.limits._limits import cmu_motions, hinge_rotations, motion_of, uniform_rotations
from benchmarks.report import Timer, finish, progress
from jaxcap.body.skeleton import Skeleton, make_skeleton
from jaxcap.limits.frame_evaluation import allowed_frames, nearest_frames
from jaxcap.limits.learning.learn_limits import learn_limits
from jaxcap.limits.learning.samples import gather_samples

#: samples of the elbow that are tried
ELBOWS = 200
JOINTS = ("lhumerus", "lradius")


def pair_skeleton(skeleton: Skeleton) -> Skeleton:
    """Make a skeleton of the two joints alone."""
    rows = [skeleton.index(name) for name in JOINTS]
    return make_skeleton(
        JOINTS,
        (-1, 0),
        [skeleton.kinds[row] for row in rows],
        skeleton.centres[jnp.array(rows)],
        axes=skeleton.axes[jnp.array(rows)],
    )


def angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Compute the angles between rotations, radians."""
    signed = np.where(np.sum(a * b, -1, keepdims=True) < 0, -b, b)
    return 4 * np.arcsin(np.clip(np.linalg.norm(a - signed, axis=-1) / 2, 0.0, 1.0))


def nearest_shoulder(rotations: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Compute the angle of each rotation from the nearest sample, radians."""
    both = np.concatenate([samples, -samples])
    return 4 * np.arcsin(np.clip(KDTree(both).query(rotations)[0] / 2, 0.0, 1.0))


def nearest_elbow(limits, skeleton, after: np.ndarray, before: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Compute the angle of each elbow from the nearest of `ELBOWS` samples that its current shoulder allows."""
    bends = 2 * np.arctan2(np.linalg.norm(samples[:, 1:], axis=1), samples[:, 0])
    chosen = samples[np.argsort(bends)[np.linspace(0, len(bends) - 1, ELBOWS).astype(int)]]
    best = np.full(len(after), np.inf)
    for sample in chosen:
        tried = np.broadcast_to(sample, (len(after), 4))
        poses = motion_of(skeleton, {JOINTS[0]: after[:, 0], JOINTS[1]: tried})
        good = np.asarray(allowed_frames(limits, skeleton, poses))[:, 1]
        best = np.where(good, np.minimum(best, angles(before[:, 1], tried)), best)
    return best


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--poses", type=int, default=10_000)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    motions, rng = cmu_motions(shared_folder()), np.random.default_rng(3)
    skeleton = pair_skeleton(motions[0][0])
    samples = gather_samples(motions, JOINTS[1], JOINTS[0])
    assert samples.parent is not None
    limits = learn_limits({JOINTS[0]: samples.parent, JOINTS[1]: samples}, held_out="blocks")
    sizes = {s.joint: list(s.centres.shape[:2]) for s in limits.surfaces}
    progress(f"limits: keyframes and primitives {sizes}")

    drawn = 4 * options.poses
    poses = {JOINTS[0]: uniform_rotations(rng, drawn), JOINTS[1]: hinge_rotations(samples.axes[0], rng.uniform(-np.pi, np.pi, drawn))}  # fmt: skip
    motion = motion_of(skeleton, poses)
    invalid = np.flatnonzero(~np.asarray(allowed_frames(limits, skeleton, motion)).all(1))[: options.poses]
    motion = motion_of(skeleton, {name: values[invalid] for name, values in poses.items()})
    timer = Timer()
    for _ in range(options.repeats + 1):
        found = timer(nearest_frames, limits, skeleton, motion)
    good = np.asarray(allowed_frames(limits, skeleton, found)).all(1)
    before, after = (np.asarray(m.poses.rotations, float) for m in (motion, found))
    moved = angles(before, after)
    outside = ~np.asarray(allowed_frames(limits, skeleton, motion))
    shoulder = moved[:, 0] / nearest_shoulder(before[:, 0], samples.parent.rotations)
    elbow = moved[:, 1] / nearest_elbow(limits, skeleton, after, before, samples.rotations)
    ratio = np.concatenate([shoulder[outside[:, 0]], elbow[moved[:, 1] > 1e-3]])
    twice = np.asarray(nearest_frames(limits, skeleton, found).poses.rotations, float)
    figures = {
        "allowed_percent": 100 * good.mean(),
        "worst_ratio_to_nearest_sample": float(ratio.max()),
        "mean_ratio_to_nearest_sample": float(ratio.mean()),
        "moved_again_degrees": float(np.degrees(angles(after, twice).max())),
        "poses_per_second": len(invalid) / timer.median,
    }
    finish(
        "limits_project",
        figures,
        {
            "allowed_percent": (">=", 100.0),
            "worst_ratio_to_nearest_sample": ("<=", 1.1),
            "poses_per_second": (">=", 50_000),
        },
        {"poses": len(invalid), **sizes},
        timer.seconds,
    )


if __name__ == "__main__":
    main()
