"""Calibrate synthetic subjects with known ground truth: `python -m benchmarks.markers_synthetic`.

60 markers on the embedded human under CMU's motions, from a template with bones 8 % and markers 15 mm off: noise of a
millimetre alone, with gaps and swapped labels besides, and with skin that moves. Errors are those of joint centres in
the world, of joints that turn (20 degrees or more), with what is along directions that the calibration tells to be
hardly known left out; `full` has it in. Run it from the root of the checkout.
"""

import argparse
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from benchmarks._scenes import shared_folder
from benchmarks.markers._markers import (
    MarkerNoise,
    Scene,
    determined_projection,
    make_scene,
    pose_all,
    rotation_spread,
)
from benchmarks.report import finish, progress
from jaxcap.body.kinematics import forward_kinematics
from jaxcap.markers.calibration.calibrate import Calibration, calibrate
from jaxcap.markers.calibration.observability import bone_length_deviations

TAKES = ("02_05", "02_01", "01_01")
CASES = {"noise": MarkerNoise(), "gaps": MarkerNoise(gaps=0.1, swaps=0.01), "skin": MarkerNoise(skin=0.015)}
#: radians that a joint turns to be judged
MIN_ANGLE = np.radians(20.0)
NORMAL90 = 1.645


def calibration_errors(scene: Scene, found: Calibration) -> dict[str, np.ndarray | float]:
    subject, skeleton = found.subject, found.subject.skeleton
    _, joints = pose_all(subject, found.motion.poses, jnp.zeros_like(scene.frames.positions))
    away = np.asarray(joints) - scene.joints
    turned = rotation_spread(scene.motion)
    rotations = np.asarray(_rotations(skeleton, found.motion.poses))
    told, full, between = [], [], []
    for joint in found.joints:
        if turned[joint] < MIN_ANGLE:
            continue
        # directions are at rest, in the bone that the joint is the end of
        local = np.einsum("fba,fb->fa", rotations[:, skeleton.parents[joint]], away[:, joint])
        told.append(np.linalg.norm(local @ determined_projection(found, joint), axis=1).mean())
        full.append(np.linalg.norm(away[:, joint], axis=1).mean())
    ends = np.array([joint for joint in found.joints if skeleton.parents[joint] in found.joints])
    starts = np.array(skeleton.parents)[ends]

    def lengths(centres):
        return np.linalg.norm(np.asarray(centres)[ends] - np.asarray(centres)[starts], axis=1)

    off = lengths(skeleton.centres) - lengths(scene.truth.skeleton.centres)
    deviations = bone_length_deviations(subject, found.joints, found.covariance)[ends]
    known = (deviations < 0.005) & (turned[ends] > MIN_ANGLE) & (turned[starts] > MIN_ANGLE)
    between = np.abs(off) <= NORMAL90 * deviations
    return {
        "determined_mm": 1000 * float(np.mean(told)),
        "full_mm": 1000 * float(np.mean(full)),
        "length_mm": 1000 * float(np.abs(off[known]).mean()) if known.any() else float("nan"),
        "inside": between,
    }


@eqx.filter_jit
def _rotations(skeleton: jc.Skeleton, poses: jc.Pose):
    return jax.lax.map(lambda pose: forward_kinematics(skeleton, pose).rotations, poses)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.markers_synthetic", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--takes", nargs="+", default=TAKES)
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--count", type=int, default=100, help="number of frames of each calibration")
    parser.add_argument("--frames", type=int, help="number of frames of each take")
    options = parser.parse_args()
    shared, figures, seconds = shared_folder(), {}, {}
    for case in options.cases:
        rows, taken, converged = [], [], 0
        for seed in range(options.seeds):
            take = options.takes[seed % len(options.takes)]
            scene = make_scene(shared, take, CASES[case], seed, rate=60.0, frames=options.frames)
            start = time.perf_counter()
            found = calibrate(scene.frames, scene.template, num_frames=options.count)
            taken.append(time.perf_counter() - start)
            rows.append(calibration_errors(scene, found))
            good = found.converged and rows[-1]["determined_mm"] < (15.0 if case == "skin" else 5.0)
            converged += good
            progress(
                f"{case} {take} seed {seed}: {rows[-1]['determined_mm']:.2f} mm ({rows[-1]['full_mm']:.2f} in full), lengths "
                f"{rows[-1]['length_mm']:.2f} mm, inside {np.mean(rows[-1]['inside']):.2f}, {taken[-1]:.1f} s, "
                f"{'converged' if good else 'NOT converged'}; {len(found.messages)} messages"
            )
        for name in ("determined_mm", "full_mm", "length_mm"):
            figures[f"{case}_{name}"] = float(np.nanmean([row[name] for row in rows]))
        figures[f"{case}_converged_share"] = converged / options.seeds
        figures[f"{case}_covered_share"] = float(np.mean(np.concatenate([row["inside"] for row in rows])))
        seconds[case] = taken
    limits = {
        "noise_determined_mm": ("<=", 1.4), "gaps_determined_mm": ("<=", 2.2), "skin_determined_mm": ("<=", 5.0),
        "skin_length_mm": ("<=", 3.0), **{f"{case}_covered_share": (">=", 0.85) for case in CASES},
        **{f"{case}_converged_share": (">=", 0.95) for case in CASES},
    }  # fmt: skip
    limits = {name: limit for name, limit in limits.items() if name.split("_")[0] in options.cases}
    finish("markers_synthetic", figures, limits, {"seeds": options.seeds, "takes": options.takes}, seconds)


if __name__ == "__main__":
    main()
