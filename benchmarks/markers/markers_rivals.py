"""Compare calibration and inverse kinematics with other programs: `python -m benchmarks.markers_rivals --venvs FOLDER`.

The embedded human under a take of CMU's, some 60 markers with a millimetre of noise, from a template with bones 8 %
and markers 14 mm off: 100 of 300 frames to calibrate, all to solve. Each rival runs in a virtual environment of
its own, which is made under FOLDER where it is not there, in a process of its own, one after the other; one that
does not install, or ends before its time, is named and left out. Momentum and nimblephysics calibrate and solve;
OpenSim solves with the subject that we calibrated, as its scaling has no joint centres of its own. Errors are those
of the centres of joints that turn (20 degrees or more), in the world, over all frames (`determined`: only along the directions
that our calibration calls determined); seconds are those after compilation. Run nothing else at the same time.
"""

import argparse
import tempfile
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks._scenes import cmu_motion, shared_folder
from benchmarks.markers._markers import (
    MarkerNoise,
    Scene,
    determined_projection,
    perturb_template,
    pose_all,
    rotation_spread,
    scene_of,
    true_subject,
)
from benchmarks.markers._rivals.environments import RIVALS, environment, run_rival
from benchmarks.report import finish, progress
from jaxcap.body.kinematics import forward_kinematics
from jaxcap.edit.retargeting.retarget import retarget
from jaxcap.markers.calibration.calibrate import Calibration, calibrate
from jaxcap.markers.motion.inverse_kinematics import solve_markers
from jaxcap.markers.subject import Subject

MIN_ANGLE = np.radians(20.0)
BONES, PLACEMENT = 0.08, 0.014


def make_rival_scene(shared: Path, take: str, frames: int, seed: int) -> Scene:
    """Make frames that are spread over the take, close enough for each to start at the previous one."""
    truth = true_subject()
    motion, skeleton = cmu_motion(shared, take)
    step = max(1, len(motion) // frames)
    motion = retarget(motion.slice(slice(None, None, step)).slice(slice(frames)), skeleton, truth.skeleton)
    scene = scene_of(truth, jax.tree.map(lambda leaf: leaf.astype(jnp.float32), motion), MarkerNoise(), seed)
    return scene._replace(template=perturb_template(truth, np.random.default_rng(seed), BONES, PLACEMENT))


def mirrored(names: tuple[str, ...]) -> np.ndarray:
    """Find the mirrored joint (J,) of each joint; joints in the middle are their own."""
    swap = {
        "Left": "Right",
        "Right": "Left",
        "LHip": "RHip",
        "RHip": "LHip",
        "LThumb": "RThumb",
        "RThumb": "LThumb",
    }
    other = []
    for name in names:
        start = next((one for one in swap if name.startswith(one)), None)
        other.append(names.index(name.replace(start, swap[start], 1)) if start else names.index(name))
    return np.array(other)


def pairs(names: tuple[str, ...]) -> list[tuple[str, str]]:
    other = mirrored(names)
    return [(name, names[other[joint]]) for joint, name in enumerate(names) if other[joint] > joint]


def determined_errors(
    scene: Scene, found: Calibration, joints: np.ndarray, turning: np.ndarray
) -> np.ndarray:
    """Compute errors of joints (F, K), metres, without directions that our calibration reports as poorly determined, such as
    the axis of a hinge."""
    away, skeleton = joints - scene.joints, scene.truth.skeleton
    turned = jax.lax.map(lambda pose: forward_kinematics(skeleton, pose).rotations, scene.motion.poses)
    turned, errors = np.asarray(turned, float), []
    for joint in found.joints:
        if joint in turning:
            local = np.einsum("fba,fb->fa", turned[:, skeleton.parents[joint]], away[:, joint])
            errors.append(np.linalg.norm(local @ determined_projection(found, joint), axis=1))
    return np.array(errors).T


def write_scene(path: Path, scene: Scene, chosen: np.ndarray, own: Subject) -> None:
    """Write the template, the markers, and our calibrated subject for programs that only solve."""
    template, skeleton = scene.template, scene.template.skeleton
    np.savez(
        path,
        names=np.array(skeleton.names),
        parents=np.array(skeleton.parents),
        turns=np.array([kind in ("ball", "free") for kind in skeleton.kinds]),
        mirror=mirrored(skeleton.names),
        centres=np.asarray(skeleton.centres, float),
        bones=np.asarray(template.bones),
        offsets=np.asarray(template.offsets, float),
        labels=np.array(template.labels),
        places=np.asarray(scene.frames.positions, float),
        seen=np.asarray(scene.frames.visible),
        rate=scene.frames.rate,
        chosen=chosen,
        own_centres=np.asarray(own.skeleton.centres, float),
        own_offsets=np.asarray(own.offsets, float),
    )


def measure_ours(
    scene: Scene, chosen: np.ndarray, repeats: int = 3
) -> tuple[Calibration, dict[str, float | np.ndarray]]:
    symmetry = pairs(scene.template.skeleton.names)
    taken, each = [], []
    for _ in range(repeats):
        start = time.perf_counter()
        found = calibrate(scene.frames[chosen], scene.template, symmetry=symmetry)
        taken.append(time.perf_counter() - start)
    for _ in range(repeats + 1):
        start = time.perf_counter()
        solved = solve_markers(found.subject, scene.frames)
        jax.block_until_ready(solved.motion)
        each.append((time.perf_counter() - start) / len(scene.frames))
    _, joints = pose_all(found.subject, solved.motion.poses, jnp.zeros_like(scene.frames.positions))
    return found, {
        "joints": np.asarray(joints, float),
        "calibrate_seconds": float(np.median(taken[1:])),
        "solve_seconds": float(np.median(each[1:])),
        "markers_mm": 1000 * float(np.sqrt(np.nanmean(np.asarray(solved.residuals) ** 2))),
    }


def judge(
    scene: Scene, own: Calibration, chosen: np.ndarray, turning: np.ndarray, outcome
) -> dict[str, float]:
    """Compute the figures of an outcome: errors of joints, millimetres, and times."""
    joints = np.asarray(outcome["joints"], float)
    away = np.linalg.norm(joints - scene.joints, axis=-1)
    determined = determined_errors(scene, own, joints, turning)
    reached = {
        "solve_joints_mm": 1000 * float(away[:, turning].mean()),
        "solve_determined_mm": 1000 * float(determined.mean()),
        "solve_markers_mm": float(outcome["markers_mm"]),
        "solve_ms": 1000 * float(outcome["solve_seconds"]),
    }
    if "calibrate_seconds" in outcome:
        reached["calibrate_joints_mm"] = 1000 * float(away[chosen][:, turning].mean())
        reached["calibrate_determined_mm"] = 1000 * float(determined[chosen].mean())
        reached["calibrate_seconds"] = float(outcome["calibrate_seconds"])
    return reached


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.markers_rivals", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--venvs", type=Path, default=Path.home() / ".cache" / "jaxcap" / "rivals")
    parser.add_argument("--rivals", nargs="*", choices=list(RIVALS), default=list(RIVALS))
    parser.add_argument("--take", default="02_05")
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(12)))
    parser.add_argument(
        "--repeats", type=int, default=3, help="number of timed runs of our own calibration and solve"
    )
    parser.add_argument("--limit", type=float, default=3000.0, help="time limit of each rival, seconds")
    options = parser.parse_args()
    begun, left_out = {}, set()
    every: dict[str, dict[int, dict[str, float]]] = {}
    for number, seed in enumerate(options.seeds):
        scene = make_rival_scene(shared_folder(), options.take, options.frames, seed)
        chosen = np.linspace(0, len(scene.frames) - 1, options.count).round().astype(int)
        turning = np.flatnonzero(rotation_spread(scene.motion) >= MIN_ANGLE)
        turning = turning[turning > 0]
        own, outcome = measure_ours(scene, chosen, options.repeats)
        outcomes = {"jaxcap": outcome}
        with tempfile.TemporaryDirectory() as folder:
            given = Path(folder) / "scene.npz"
            write_scene(given, scene, chosen, own.subject)
            # the others take much longer, and get the first scene only
            for name in [one for one in options.rivals if one == "momentum" or number == 0]:
                python = environment(name, options.venvs)
                start = time.perf_counter()
                outcome = None if python is None else run_rival(name, python, given, options.limit)
                begun[f"{name}_{seed}"] = time.perf_counter() - start
                if outcome is None:
                    left_out.add(name)
                else:
                    outcomes[name] = outcome
        for name, outcome in outcomes.items():
            reached = judge(scene, own, chosen, turning, outcome)
            every.setdefault(name, {})[seed] = reached
            progress(
                f"seed {seed}, {name}: "
                + ", ".join(f"{figure} {value:.4g}" for figure, value in reached.items())
            )
    figures, limits = summarise(every)
    sizes = {
        "frames": options.frames,
        "chosen": options.count,
        "seeds": len(options.seeds),
        "left_out": sorted(left_out),
    }
    finish("markers_rivals", figures, limits, sizes, begun)


def summarise(every: dict[str, dict[int, dict[str, float]]]):
    """Average the figures over the scenes, and compare ours with each rival's in the scenes that it had."""
    figures: dict[str, float] = {}
    limits: dict[str, tuple[str, float]] = {}
    for name, by_seed in every.items():
        rows, ours = list(by_seed.values()), [every["jaxcap"][seed] for seed in by_seed]
        for figure in rows[0]:
            figures[f"{name}_{figure}"] = float(np.mean([row[figure] for row in rows]))
        if name == "jaxcap":
            continue
        for figure in ("calibrate_joints_mm", "calibrate_seconds", "solve_joints_mm", "solve_ms"):
            if figure in rows[0]:
                share = np.mean([row[figure] for row in ours]) / np.mean([row[figure] for row in rows])
                figures[f"{name}_{figure}_share"] = float(share)
                limits[f"{name}_{figure}_share"] = ("<", 1.0)
    if "momentum" in every:
        medians = [
            np.median([every[name][seed]["calibrate_joints_mm"] for seed in every["momentum"]])
            for name in ("jaxcap", "momentum")
        ]
        figures["momentum_median_joints_share"] = float(medians[0] / medians[1])
        limits["momentum_calibrate_joints_mm_share"] = limits["momentum_median_joints_share"] = ("<=", 0.8)
        limits["momentum_calibrate_seconds_share"] = ("<=", 1 / 3)
    return figures, limits


if __name__ == "__main__":
    main()
