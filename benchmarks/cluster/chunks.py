"""Track one long sequence in chunks on two workers, and compare the poses with those of one run: `python -m benchmarks.chunks`.

    python -m benchmarks.chunks
    python -m benchmarks.chunks --frames 240 --resolution low --points 800 --overlap 30

A motion of CMU's, forwards and backwards again and again, is scanned on the embedded human, with noise and outliers. Around the first
boundary of two chunks nobody is in the clouds, which show scattered points only; around the second one the motion is three times as fast.
`jaxcap track` runs with `--workers 1`, which is one run from the first frame to the last, with `--workers 2`, and with two workers of
which one is killed (SIGKILL), and the whole program after that, and which is then resumed. The speed-up is that of the wall time; run it with
no other load. Clouds that are a period of the motion apart are one file on the disk.
"""

import argparse
import contextlib
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
import psutil
from jaxtyping import Float, Int

import jaxcap as jc
from benchmarks._scenes import Noise, human_motion, scan_frame, shared_folder
from benchmarks.cluster.batch import worker_processes
from benchmarks.report import finish, progress
from jaxcap.io.meshes.mesh import Mesh, write_mesh

#: frames around a boundary without a person, and with a fast motion, as shares of the overlap
HIDDEN, FAST = 1.5, 1.0
#: factor of the fast motion
SPEED = 3
#: the bound that was asked for, millimetres
BOUND_MM = 0.1

_pose_body = eqx.filter_jit(jc.pose_body)


def motion_times(frames: int, length: int, fast: range) -> Int[np.ndarray, "F"]:
    """Choose the frame of a motion of some length for each frame of the sequence: forwards and backwards, faster in some frames."""
    steps = np.where(np.isin(np.arange(frames), np.arange(fast.start, fast.stop)), SPEED, 1)
    along = np.concatenate([[0], np.cumsum(steps)[:-1]]) % (2 * length - 2)
    return np.minimum(along, 2 * length - 2 - along)


def write_clouds(
    folder: Path, body: jc.Body, motion: jc.Motion, times: Int[np.ndarray, "F"], hidden: range, points: int
) -> str:
    """Write a cloud for each frame; return the pattern of their names."""
    files: dict[int, Path] = {}
    for frame, time_ in enumerate(times.tolist()):
        path = folder / f"cloud_{frame:06d}.ply"
        if frame in hidden:
            rng = np.random.default_rng(frame)
            scattered = rng.uniform([-1.5, 0.0, -1.5], [1.5, 2.0, 1.5], (points, 3))
            write_mesh(path, Mesh(scattered, np.zeros((0, 3), int), rng.normal(size=scattered.shape)))
        elif time_ in files:
            path.hardlink_to(files[time_])
        else:
            scan = scan_frame(body, motion[time_], np.random.default_rng(time_), Noise(points=points)).cloud
            real = np.asarray(scan.weights) > 0
            cloud = Mesh(
                np.asarray(scan.points, float)[real],
                np.zeros((0, 3), int),
                np.asarray(scan.normals, float)[real],
            )
            write_mesh(path, cloud)
            files[time_] = path
    return str(folder / "cloud_%06d.ply")


def start_track(folder: Path, out: str, workers: int, options: list[str]) -> subprocess.Popen:
    """Start `jaxcap track` in a process of its own."""
    words = ["track", "body.npz", "clouds/cloud_%06d.ply", "-o", out, "--workers", str(workers), *options]
    return subprocess.Popen(
        [sys.executable, "-m", "jaxcap", *words],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def run_track(folder: Path, out: str, workers: int, options: list[str]) -> float:
    """Track to the end; return the seconds."""
    start = time.perf_counter()
    running = start_track(folder, out, workers, options)
    errors = running.communicate()[1]
    if running.returncode:
        raise SystemExit(f"{out}: {errors[-2000:]}")
    seconds = time.perf_counter() - start
    progress(f"{out}: {seconds:.1f} s")
    return seconds


def run_killed(folder: Path, out: str, options: list[str], seconds: float) -> int:
    """Kill a worker after a third of the time of a run, and the program after two thirds; resume. Return how many were killed."""
    running, killed = start_track(folder, out, 2, options), 0
    start = time.perf_counter()
    while running.poll() is None and time.perf_counter() - start < 0.4 * seconds:
        time.sleep(0.1)
    with contextlib.suppress(psutil.Error, IndexError):
        worker_processes(psutil.Process(running.pid))[0].kill()
        killed += 1
    while running.poll() is None and time.perf_counter() - start < 0.7 * seconds:
        time.sleep(0.1)
    workers = []
    with contextlib.suppress(psutil.Error):
        workers = worker_processes(psutil.Process(running.pid))
    if running.poll() is None:
        running.kill()
        killed += 1
    running.communicate()
    # workers end by themselves when their scheduler is gone
    _, alive = psutil.wait_procs(workers, timeout=60)
    for process in alive:
        process.kill()
    if not (folder / out / "motion.npz").is_file():
        run_track(folder, out, 2, [*options, "--resume"])
    return killed


def joints_of(folder: Path, out: str, body: jc.Body) -> Float[np.ndarray, "F J 3"]:
    """Compute the joints of a result, metres."""
    poses = jc.load_motion(folder / out / "motion.npz").poses
    count = len(poses.scale)
    return np.stack(
        [
            np.asarray(_pose_body(body, jax.tree.map(lambda leaf, row=row: leaf[row], poses)).joints)
            for row in range(count)
        ]
    )


def verdicts_of(folder: Path, out: str) -> np.ndarray:
    """List the verdicts of a result."""
    rows = json.loads((folder / out / "statistics.json").read_text())["frames"]
    return np.array([row["verdict"] for row in rows])


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.chunks", description=__doc__.splitlines()[0])
    parser.add_argument("--take", default="02_05")
    parser.add_argument("--frames", type=int, default=20_000)
    parser.add_argument("--points", type=int, default=5000)
    parser.add_argument("--resolution", default="medium", choices=("low", "medium"))
    parser.add_argument("--chunks", type=int, default=4, help="at least 3")
    parser.add_argument("--overlap", type=int, default=60)
    parser.add_argument("--no-kill", action="store_true")
    options = parser.parse_args()
    subject = jc.human(resolution="medium")
    joints = "tracking" if options.resolution == "low" else "full"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        body = jc.human(resolution=options.resolution, joints=joints)
        jc.save_body(folder / "body.npz", body)
        (folder / "clouds").mkdir()
        motion = human_motion(shared_folder(), options.take, subject)
        bounds = np.linspace(0, options.frames, options.chunks + 1).round().astype(int)
        hidden, fast = (
            range(int(bound - share * options.overlap), int(bound + share * options.overlap / 2))
            for bound, share in zip(bounds[1:3], (HIDDEN, FAST), strict=True)
        )
        times = motion_times(options.frames, len(motion), fast)
        write_clouds(folder / "clouds", subject, motion, times, hidden, options.points)
        progress(f"{options.frames} clouds; nobody in frames {hidden}, fast in {fast}")
        chunked = ["--chunks", str(options.chunks), "--overlap", str(options.overlap)]
        seconds = {"one_run": run_track(folder, "one", 1, [])}
        seconds["two_workers"] = run_track(folder, "two", 2, chunked)
        one, two = (joints_of(folder, out, body) for out in ("one", "two"))
        verdicts = verdicts_of(folder, "one"), verdicts_of(folder, "two")
        report = json.loads((folder / "two" / "chunks.json").read_text())
        mm = 1000 * np.linalg.norm(one - two, axis=2).max(1)
        # a verdict that differs has consequences for some frames
        named = np.isin(np.arange(len(mm)), [k + i for k in report["unsure"] for i in range(options.overlap)])
        outside = mm > BOUND_MM
        figures: dict[str, object] = {
            "speedup": seconds["one_run"] / seconds["two_workers"],
            "outside_frames": int(outside.sum()),
            "outside_not_named": int((outside & ~named).sum()),
            "named_frames": len(report["unsure"]),
            "equal_frames": int((mm == 0).sum()),
            "median_mm": float(np.median(mm)),
            "p99_mm": float(np.percentile(mm, 99)),
            "max_mm": float(mm.max()),
            "other_verdicts": int((verdicts[0] != verdicts[1]).sum()),
            "not_good_frames": int((verdicts[0] != "good").sum()),
            "repeated_frames": sum(boundary["num_repeated"] for boundary in report["boundaries"]),
            "not_joined": sum(not boundary["joined"] for boundary in report["boundaries"]),
            "boundaries": report["boundaries"],
        }
        if not options.no_kill:
            killed = run_killed(folder, "killed", chunked, seconds["two_workers"])
            three = joints_of(folder, "killed", body)
            figures["killed_processes"] = killed
            figures["killed_max_mm"] = float(1000 * np.linalg.norm(two - three, axis=2).max())
    limits = {
        "speedup": (">=", 1.8),
        "outside_not_named": ("==", 0),
        "not_joined": ("==", 0),
        "killed_max_mm": ("<=", BOUND_MM),
    }
    sizes = {"frames": options.frames, "points": options.points, "vertices": len(body.vertices)}
    sizes |= {"chunks": options.chunks, "overlap": options.overlap}
    finish("chunks", figures, {key: limits[key] for key in limits if key in figures}, sizes, seconds)


if __name__ == "__main__":
    main()
