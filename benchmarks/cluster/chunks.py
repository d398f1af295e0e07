"""Track one long sequence in chunks on two workers, and compare the poses with those of one worker: `python -m benchmarks.chunks`.

    python -m benchmarks.chunks
    python -m benchmarks.chunks --frames 240 --resolution low --points 800 --chunks 3

A motion of CMU's, forwards and backwards again and again, is scanned on the embedded human, with noise and outliers. Around the first
of two boundaries of chunks nobody is in the clouds, which show scattered points only; around the second one the motion is three times as fast.
`jaxcap track` runs with `--workers 1`, with `--workers 2`, and with two workers of
which one is killed (SIGKILL), and the whole program after that, and which is then resumed; and without chunks. Errors are those of joints, in all frames with
a person that are good. The speed-up is that of the wall time; run it with
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
import numpy as np
import psutil
from jaxtyping import Float, Int

import jaxcap as jc
from benchmarks._scenes import Noise, human_motion, scan_frame, shared_folder
from benchmarks.cluster.batch import worker_processes
from benchmarks.report import finish, progress
from jaxcap.io.meshes.mesh import Mesh, write_mesh
from jaxcap.tracking.chunks.division import count_chunks, divide_frames

#: frames before and after a boundary without a person, and with a fast motion; fewer in chunks shorter than `LONG_CHUNK`
HIDDEN, FAST, LONG_CHUNK = (90, 30), (60, 30), 200
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


def start_track(folder: Path, out: str, options: list[str]) -> subprocess.Popen:
    """Start `jaxcap track` in a process of its own."""
    words = ["track", "body.npz", "clouds/cloud_%06d.ply", "-o", out, *options]
    return subprocess.Popen(
        [sys.executable, "-m", "jaxcap", *words],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def run_track(folder: Path, out: str, options: list[str]) -> float:
    """Track to the end; return the seconds."""
    start = time.perf_counter()
    running = start_track(folder, out, options)
    errors = running.communicate()[1]
    if running.returncode:
        raise SystemExit(f"{out}: {errors[-2000:]}")
    seconds = time.perf_counter() - start
    progress(f"{out}: {seconds:.1f} s")
    return seconds


def run_killed(folder: Path, out: str, options: list[str], seconds: float) -> int:
    """Kill a worker after a third of the time of a run, and the program after two thirds; resume. Return how many were killed."""
    running, killed = start_track(folder, out, options), 0
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
        run_track(folder, out, [*options, "--resume"])
    return killed


def joints_of(body: jc.Body, motion: jc.Motion) -> Float[np.ndarray, "F J 3"]:
    """Compute the joints of a motion, metres."""
    return np.stack([np.asarray(_pose_body(body, motion[k]).joints) for k in range(motion.num_frames)])


def tracked_joints(folder: Path, out: str, body: jc.Body) -> Float[np.ndarray, "F J 3"]:
    """Compute the joints of a result, metres."""
    return joints_of(body, jc.load_motion(folder / out / "motion.npz"))


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
    parser.add_argument(
        "--chunks", type=int, help="number of chunks, at least 3; by default as jaxcap chooses"
    )
    parser.add_argument("--no-kill", action="store_true", help="leave out the run that is killed")
    parser.add_argument("--only-chunks", action="store_true", help="leave out the run without chunks")
    options = parser.parse_args()
    subject = jc.human(resolution="medium")
    joints = "tracking" if options.resolution == "low" else "full"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        body = jc.human(resolution=options.resolution, joints=joints)
        jc.save_body(folder / "body.npz", body)
        (folder / "clouds").mkdir()
        motion = human_motion(shared_folder(), options.take, subject)
        number = options.chunks or count_chunks(options.frames)
        begins = [chunk.begin for chunk in divide_frames(options.frames, number)]
        share = min(begins[1] / LONG_CHUNK, 1.0)
        hidden, fast = (
            range(begins[at] - int(share * before), begins[at] + int(share * after))
            for at, (before, after) in ((number // 3, HIDDEN), (2 * number // 3, FAST))
        )
        times = motion_times(options.frames, len(motion), fast)
        write_clouds(folder / "clouds", subject, motion, times, hidden, options.points)
        progress(f"{options.frames} clouds; nobody in frames {hidden}, fast in {fast}")
        on_one, on_two = (["--chunks", str(number), "--workers", workers] for workers in ("1", "2"))
        seconds = {"one_worker": run_track(folder, "one", on_one)}
        seconds["two_workers"] = run_track(folder, "two", on_two)
        one, two = (tracked_joints(folder, out, body) for out in ("one", "two"))
        # the joints of the scanned person that the tracked body has
        rows = [subject.skeleton.names.index(name) for name in body.skeleton.names]
        truth = joints_of(subject, motion)[times][:, rows]
        report = json.loads((folder / "two" / "chunks.json").read_text())
        mm = 1000 * np.linalg.norm(one - two, axis=2).max(1)
        there = ~np.isin(np.arange(len(mm)), list(hidden))
        figures: dict[str, object] = {
            "speedup": seconds["one_worker"] / seconds["two_workers"],
            "max_mm": float(mm.max()),
            "equal_frames": int((mm == 0).sum()),
            "repeated_frames": sum(boundary["num_repeated"] for boundary in report["boundaries"]),
            "dependent_chunks": sum(not boundary["independent"] for boundary in report["boundaries"]),
            "not_joined": sum(not boundary["joined"] for boundary in report["boundaries"]),
        }
        compared = [("chunks", "two", two)]
        if not options.only_chunks:
            seconds["no_chunks"] = run_track(folder, "plain", [])
            figures["speedup_to_no_chunks"] = seconds["no_chunks"] / seconds["two_workers"]
            compared.append(("no_chunks", "plain", tracked_joints(folder, "plain", body)))
        for name, out, found in compared:
            good = there & (verdicts_of(folder, out) == "good")
            errors = 1000 * np.linalg.norm(found - truth, axis=2)
            figures[f"{name}_not_good_frames"] = int((there & ~good).sum())
            figures[f"{name}_median_mm"] = float(np.median(errors[good]))
            figures[f"{name}_p99_mm"] = float(np.percentile(errors[good].max(1), 99))
        distances = [boundary["distance"] for boundary in report["boundaries"]]
        figures["largest_boundary_mm"] = float(1000 * max((d for d in distances if d is not None), default=0))
        if not options.no_kill:
            killed = run_killed(folder, "killed", on_two, seconds["two_workers"])
            three = tracked_joints(folder, "killed", body)
            figures["killed_processes"] = killed
            figures["killed_max_mm"] = float(1000 * np.linalg.norm(two - three, axis=2).max())
    limits = {
        "speedup": (">=", 1.8),
        "max_mm": ("<=", BOUND_MM),
        "not_joined": ("==", 0),
        "killed_max_mm": ("<=", BOUND_MM),
    }
    sizes = {"frames": options.frames, "points": options.points, "vertices": len(body.vertices)}
    sizes |= {"chunks": number}
    finish("chunks", figures, {key: limits[key] for key in limits if key in figures}, sizes, seconds)


if __name__ == "__main__":
    main()
