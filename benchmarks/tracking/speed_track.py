"""Time tracking of a body of 5,000 vertices in clouds of 5,000 points.

    python -m benchmarks.speed_track
    python -m benchmarks.speed_track --frames 5 --small --picture cost.png

Four figures are held to limits: the E-step against one plain `argmin` a part in JAX, which gives
the same posterior, run in turns; the tracker's frames per second in its steady state, as a user
gets them from `jaxcap.fit.track_frames`, and their error; and the seconds from the start of a
process without any compiled function to its first tracked frame. Beside them stand the cost
against points and vertices, and one rigid registration of the same points by pycpd
(`pip install -e ".[bench]"`). Medians everywhere. Run it from the root of the checkout.
"""

import argparse
import functools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from benchmarks._scenes import (
    NOISE,
    Noise,
    ScannedFrame,
    human_motion,
    scan_frame,
    scan_motion,
    shared_folder,
)
from benchmarks.report import finish, progress
from benchmarks.tracking._estep import brute_force_posterior, part_members
from jaxcap.metrics import joint_errors
from jaxcap.tracking.expectation_maximisation.em_step import box_volume

TAKE, FRAMES = "02_05", 150
#: deviation at which E-steps are compared: the one that tracking this noise settles at, metres
SIGMA = 0.008
#: frames per second at 5,000 points and vertices, and at 10,000 points and 13,380 vertices
TARGET_RATE, LARGE_RATE = 120.0, 60.0
#: number of points and of frames of the second
LARGE_POINTS, LARGE_FRAMES = 10_000, 40
POINTS, RESOLUTIONS = (1250, 2500, 5000, 10000, 20000), ("low", "medium", "full")

_posed = eqx.filter_jit(jc.pose_body)
_track_frame = eqx.filter_jit(jc.fit.track_frame)


class Scene(NamedTuple):
    """The shared data of the parts of this benchmark."""

    subject: jc.Body
    #: of the subject, and the same of the tracked body
    motion: jc.Motion
    starts: jc.Motion
    tracker: jc.fit.Tracker
    scans: list[ScannedFrame]


def alternating_medians(functions: dict[str, Callable], repeats: int) -> dict[str, float]:
    """Measure the median seconds of compiled functions in alternation, so that other load affects all of them."""

    def timed(function):
        # not counted: what ran before has driven this one's data out of the caches
        jax.block_until_ready(function())
        start = time.perf_counter()
        jax.block_until_ready(function())
        return time.perf_counter() - start

    for function in functions.values():
        timed(function)
    rounds = [{name: timed(function) for name, function in functions.items()} for _ in range(repeats)]
    return {name: float(np.median([times[name] for times in rounds])) for name in functions}


@eqx.filter_jit
def e_step(tracker: jc.fit.Tracker, vertices, normals, cloud: jc.Cloud, sigma):
    mixture = tracker.mixture
    return jc.fit.posterior(
        tracker.parts,
        vertices,
        normals,
        cloud,
        sigma,
        normal_threshold=mixture.normal_threshold,
        outlier=mixture.outlier,
        box_volume=box_volume(cloud),
        candidates=mixture.candidates,
    )


def compare_e_steps(scene: Scene, repeats: int):
    """Time both E-steps, and compare their outlier posteriors, which depend on all parts."""
    tracker, cloud, sigma = scene.tracker, scene.scans[0].cloud, jnp.asarray(SIGMA)
    posed = _posed(tracker.body, scene.starts[0])
    # about the origin, where the rival's squares lose least; it is also spared the padding
    middle = jnp.mean(posed.vertices, 0)
    vertices, cloud = posed.vertices - middle, jc.Cloud(cloud.points - middle, cloud.normals, cloud.weights)
    count = int((cloud.weights > 0).sum())
    bare = jax.tree.map(lambda leaf: leaf[:count], cloud)
    brute = functools.partial(
        brute_force_posterior,
        vertices,
        posed.normals,
        bare,
        sigma,
        members=part_members(tracker.parts),
        normal_threshold=tracker.mixture.normal_threshold,
        outlier=tracker.mixture.outlier,
        box_volume=box_volume(cloud),
        chunk=250 if count % 250 == 0 else count,
    )
    ours = functools.partial(e_step, tracker, vertices, posed.normals, cloud, sigma)
    weights, _ = brute()
    differences = np.abs(np.asarray(ours().outlier)[:count] - np.asarray(weights)[:, -1])
    median = alternating_medians({"ours": ours, "brute": brute}, repeats)
    figures = {
        "e_step_ms": 1000 * median["ours"],
        "e_step_brute_force_ms": 1000 * median["brute"],
        "e_step_ratio": median["brute"] / median["ours"],
        "e_step_difference": differences.max(),
    }
    progress(
        f"E-step: {figures['e_step_ms']:.2f} ms, brute force {figures['e_step_brute_force_ms']:.1f} ms, "
        f"{figures['e_step_ratio']:.1f} times; outlier posteriors differ by {differences.max():.1e}"
    )
    return figures


def track_steadily(tracker: jc.fit.Tracker, start: jc.Pose, scans: list[ScannedFrame]):
    """Measure `track_frames` after its first two frames; also return the seconds of the first."""
    stream = jc.fit.track_frames(tracker, [scan.cloud for scan in scans], start=start)
    taken, joints, lost = [], [], 0
    for _ in scans:
        start = time.perf_counter()
        frame = jax.block_until_ready(next(stream))
        taken.append(time.perf_counter() - start)
        joints.append(np.asarray(_posed(tracker.body, frame.pose).joints))
        lost += frame.lost
    errors = 1000 * joint_errors(np.stack(joints), np.stack([scan.joints for scan in scans]))
    steady = np.array(taken[2:])
    figures = {
        "frame_ms": 1000 * np.median(steady),
        "frame_p90_ms": 1000 * np.percentile(steady, 90),
        "frames_per_second": 1 / np.median(steady),
        "frames_per_second_mean": len(steady) / steady.sum(),
        "tracked_mean_mm": errors.mean(),
        "tracked_lost": lost,
    }
    progress(
        f"tracker: {figures['frame_ms']:.1f} ms a frame, {figures['frames_per_second']:.1f} frames per second, mean error "
        f"{figures['tracked_mean_mm']:.2f} mm, first frame {taken[0]:.1f} s"
    )
    return figures, taken[0]


def track_large(shared: Path, subject: jc.Body) -> dict[str, float]:
    """Measure `track_frames` at 10,000 points and the embedded human's 13,380 vertices."""
    motion = human_motion(shared, TAKE, subject, LARGE_FRAMES)
    scans = scan_motion(subject, motion, NOISE._replace(points=LARGE_POINTS))
    found, _ = track_steadily(jc.make_tracker(subject), motion[0], scans)
    return {f"large_{name}": found[name] for name in ("frame_ms", "frames_per_second", "tracked_mean_mm")}


def cold_start(scene: Scene):
    """Measure the seconds of a process with one frame and an empty compilation cache; also return the end of each stage of
    `benchmarks/tracking/_cold_start.py`."""
    cloud, pose = scene.scans[0].cloud, scene.starts[0]
    with tempfile.TemporaryDirectory() as folder:
        path, real = Path(folder) / "scene.npz", np.asarray(cloud.weights) > 0
        np.savez(
            path,
            points=np.asarray(cloud.points)[real],
            normals=np.asarray(cloud.normals)[real],
            translations=pose.translations,
            rotations=pose.rotations,
        )
        empty = Path(folder) / "compiled"
        start = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks._cold_start", str(path)],
            env=os.environ | {"JAX_COMPILATION_CACHE_DIR": str(empty)},
            cwd=Path(__file__).resolve().parents[2],
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
        whole = time.perf_counter() - start
    stages = json.loads(done.stdout.splitlines()[-1])
    progress(f"cold start: {whole:.1f} s from process start to exit after the first frame; {stages}")
    return whole, stages


def cost(scene: Scene, points: tuple[int, ...], resolutions: tuple[str, ...], repeats: int):
    """Measure one row per size: points, vertices, milliseconds of an E-step and of a frame, and seconds of a frame's first
    call, which compiles."""
    medium = scene.tracker
    cases = [(count, medium) for count in points]
    for resolution in resolutions:
        body = jc.human(resolution=resolution)
        if len(body.vertices) != len(medium.body.vertices):
            cases.append((NOISE.points, jc.make_tracker(body)))
    rows = []
    for count, tracker in cases:
        rng = np.random.default_rng([1, count])
        cloud = scan_frame(scene.subject, scene.motion[0], rng, Noise(points=count)).cloud
        posed = _posed(tracker.body, scene.starts[0])
        state = jc.fit.start_state(tracker, scene.starts[0], SIGMA)
        begun = time.perf_counter()
        state, _ = jax.block_until_ready(_track_frame(tracker, state, cloud))
        compiled = time.perf_counter() - begun
        search = functools.partial(e_step, tracker, posed.vertices, posed.normals, cloud, jnp.asarray(SIGMA))
        frame = functools.partial(_track_frame, tracker, state, cloud)
        median = alternating_medians({"e_step": search, "frame": frame}, repeats)
        rows.append(
            {
                "points": count,
                "vertices": len(tracker.body.vertices),
                "e_step_ms": 1000 * median["e_step"],
                "frame_ms": 1000 * median["frame"],
                "compile_s": compiled,
            }
        )
        progress("cost: " + ", ".join(f"{key} {value:.6g}" for key, value in rows[-1].items()))
    return rows


def register_rigidly(scene: Scene, points: int | None):
    """Time one rigid coherent point drift (Myronenko and Song 2010; pycpd) of the posed body's vertices to the cloud, at its
    default settings; None if pycpd is not installed."""
    try:
        from pycpd import RigidRegistration
    except ImportError:
        progress('pycpd is not installed; install it with: pip install -e ".[bench]"')
        return None
    cloud = scene.scans[0].cloud
    target = np.asarray(cloud.points, float)[np.asarray(cloud.weights) > 0][:points]
    source = np.asarray(_posed(scene.tracker.body, scene.starts[0]).vertices, float)[:points]
    start = time.perf_counter()
    RigidRegistration(X=target, Y=source).register()
    return time.perf_counter() - start


def picture(path: Path, rows: list[dict[str, float]], points: int, vertices: int) -> None:
    """Plot the cost against points and against vertices."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.8), dpi=150)
    canvas = FigureCanvasAgg(figure)
    for axis, size, fixed, held in zip(
        figure.subplots(1, 2, sharey=True),
        ("points", "vertices"),
        ("vertices", "points"),
        (vertices, points),
        strict=True,
    ):
        chosen = sorted((row for row in rows if row[fixed] == held), key=lambda row: row[size])
        for key, label in (("frame_ms", "one frame"), ("e_step_ms", "one E-step")):
            axis.loglog([row[size] for row in chosen], [row[key] for row in chosen], "o-", label=label)
        measured = [row[size] for row in chosen]
        axis.set_xticks(measured, [f"{value:,}" for value in measured])
        axis.minorticks_off()
        axis.set_xlabel(f"{size}, with {held:,} {fixed}")
        axis.grid(True, alpha=0.25)
        axis.axhline(1000 / TARGET_RATE, color="grey", linewidth=0.8, linestyle="--")
    axis.legend(frameon=False)
    figure.axes[0].set_yticks(
        [1, 2, 5, 10, 20, 50, 100, 200], ["1", "2", "5", "10", "20", "50", "100", "200"]
    )
    figure.axes[0].set_ylabel(f"milliseconds (dashed: {TARGET_RATE:.0f} frames per second)")
    figure.tight_layout()
    canvas.print_png(path)
    progress(f"picture: {path}")


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.speed_track", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--frames", type=int, default=FRAMES)
    parser.add_argument("--repeats", type=int, default=30)
    parser.add_argument("--small", action="store_true", help="measure few sizes, and pycpd with 500 points")
    parser.add_argument("--no-pycpd", action="store_true", help="skip pycpd, which takes about a minute")
    parser.add_argument("--picture", type=Path, help="write a PNG of the cost against points and vertices")
    options = parser.parse_args()
    if options.frames < 3:
        parser.error("the steady state needs at least 3 frames")
    shared = shared_folder()
    subject, body = jc.human(), jc.human(resolution="medium")
    tracker, noise = jc.make_tracker(body), NOISE
    motion, starts = (human_motion(shared, TAKE, person, options.frames) for person in (subject, body))
    scene = Scene(subject, motion, starts, tracker, scan_motion(subject, motion, noise))

    whole, stages = cold_start(scene)
    figures: dict[str, object] = {"cold_start_s": whole}
    figures |= compare_e_steps(scene, options.repeats)
    tracked, first_frame = track_steadily(tracker, starts[0], scene.scans)
    figures |= tracked
    if not options.small:
        figures |= track_large(shared, subject)
    points, resolutions = ((1250, 5000), ("low",)) if options.small else (POINTS, RESOLUTIONS)
    figures["cost"] = rows = cost(scene, points, resolutions, options.repeats)
    if options.picture:
        picture(options.picture, rows, noise.points, len(body.vertices))
    if not options.no_pycpd:
        seconds = register_rigidly(scene, 500 if options.small else None)
        if seconds is not None:
            figures["pycpd_rigid_s"] = seconds
            figures["pycpd_frames"] = 1000 * seconds / figures["frame_ms"]
            progress(f"pycpd: {seconds:.1f} s, {figures['pycpd_frames']:.0f} times a tracked frame")
    limits = {
        "e_step_ratio": (">=", 40.0),
        "e_step_difference": ("<=", 1e-3),
        "frames_per_second": (">=", TARGET_RATE),
        "tracked_mean_mm": ("<=", 2.0),
        "tracked_lost": ("==", 0),
        "cold_start_s": ("<=", 6.0),
    } | ({} if options.small else {"large_frames_per_second": (">=", LARGE_RATE)})
    sizes = {
        "frames": options.frames,
        "points": noise.points,
        "vertices": len(body.vertices),
        "joints": body.skeleton.num_joints,
        "numbers": body.skeleton.num_dofs,
        "iterations": [tracker.iterations, tracker.max_iterations],
        "pycpd_points": 500 if options.small else noise.points,
        "sigma": SIGMA,
    }
    compiled = {"cold_start": stages, "first_frame": first_frame}
    finish(
        "speed_track",
        figures,
        limits,
        sizes,
        {"compile": compiled, "run": tracked["frame_ms"] * options.frames / 1000},
    )


if __name__ == "__main__":
    main()
