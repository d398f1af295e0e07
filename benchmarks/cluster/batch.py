"""Solve many short takes of markers by `jaxcap batch`: `python -m benchmarks.batch`.

Takes are pieces of a motion of CMU's, with 60 markers on the embedded human and noise of a millimetre. They are solved one after
the other in this process, then by batches on one and on two workers; the outputs have to be the same bytes. Then a
batch is run in which a worker is killed (SIGKILL) again and again, and one that is killed as a whole, with its
scheduler, and continued. Dask's overhead is the time of a job that does nothing, on one worker. Run it with nothing else beside.
"""

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
import psutil

import jaxcap as jc
from benchmarks._scenes import cmu_motion, shared_folder
from benchmarks.markers._markers import MarkerNoise, scene_of, true_subject
from benchmarks.report import finish, progress
from jaxcap.cli import main as jaxcap_main
from jaxcap.io.markers.subject import save_subject

#: jobs that do nothing, for Dask's own time
EMPTY_JOBS = 500


class Run(NamedTuple):
    """A batch that ended."""

    rows: list[dict]
    #: of the whole command, and from the end of the first job to that of the last one
    seconds: float
    steady: float


def write_takes(folder: Path, take: str, count: int, frames: int) -> None:
    """Write a subject and takes with its markers, each of another part of the motion."""
    subject = true_subject()
    motion, skeleton = cmu_motion(shared_folder(), take)
    motion = jc.retarget(motion, skeleton, subject.skeleton)
    motion = jax.tree.map(lambda leaf: leaf.astype(subject.offsets.dtype), motion)
    save_subject(folder / "subject.npz", subject)
    (folder / "takes").mkdir()
    starts = np.linspace(0, len(motion) - frames, count).round().astype(int)
    for number, start in enumerate(starts):
        piece = motion.slice(slice(int(start), int(start) + frames))
        scene = scene_of(subject, piece, MarkerNoise(gaps=0.02), number)
        jc.write_markers(folder / "takes" / f"{number:04d}.trc", scene.frames)


def start_batch(folder: Path, out: str, workers: int) -> subprocess.Popen:
    """Start a batch in a process of its own, whose workers are its children."""
    words = ["takes/{take}.trc", "--workers", str(workers), "--"]
    verb = ["markers", "solve", "subject.npz", "{input}", "-o", f"{out}/{{take}}.npz"]
    return subprocess.Popen(
        [sys.executable, "-m", "jaxcap", "batch", *words, *verb],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def run_batch(folder: Path, out: str, workers: int) -> Run:
    """Run a batch to its end."""
    start = time.perf_counter()
    errors = start_batch(folder, out, workers).communicate()[1]
    seconds = time.perf_counter() - start
    table = folder / out / "batch.jsonl"
    if not table.is_file():
        raise SystemExit(f"The batch wrote no table: {errors[-2000:]}")
    rows = [json.loads(line) for line in table.read_text().splitlines()]
    ends = [row["ended"] for row in rows if row["status"] == "done"]
    return Run(rows, seconds, max(ends) - min(ends))


def worker_processes(batch: psutil.Process) -> list[psutil.Process]:
    """List the worker processes of a batch."""
    found = []
    for process in batch.children(recursive=True):
        with contextlib.suppress(psutil.Error):
            if "spawn_main" in " ".join(process.cmdline()):
                found.append(process)
    return found


@contextlib.contextmanager
def killing(batch: subprocess.Popen, every: float) -> Iterator[list[int]]:
    """Kill a worker of a batch every few seconds during the block; yield the list of killed processes."""
    killed: list[int] = []
    stop = threading.Event()

    def kill() -> None:
        while not stop.wait(every):
            with contextlib.suppress(psutil.Error, IndexError):
                victim = worker_processes(psutil.Process(batch.pid))[len(killed) % 2]
                victim.kill()
                killed.append(victim.pid)

    thread = threading.Thread(target=kill, daemon=True)
    thread.start()
    try:
        yield killed
    finally:
        stop.set()
        thread.join()


def count_differences(folder: Path, out: str) -> int:
    """Count the outputs that are missing or differ from those of one process."""
    differing = 0
    for path in sorted((folder / "alone").glob("*.npz")):
        other = folder / out / path.name
        differing += not other.is_file() or other.read_bytes() != path.read_bytes()
    return differing


def dask_overhead_ms() -> float:
    """Measure the time of a job that does nothing, milliseconds."""
    with jc.batch.open_cluster(1) as client:
        sum(1 for _ in jc.batch.map_jobs(abs, range(20), client))
        start = time.perf_counter()
        sum(1 for _ in jc.batch.map_jobs(abs, range(EMPTY_JOBS), client))
        return 1000 * (time.perf_counter() - start) / EMPTY_JOBS


def memory_growth_mb(run: Run) -> float:
    """Measure by how much the memory of a worker grows from the second quarter of its jobs to the last one."""
    growth = [0.0]
    for worker in {row["worker"] for row in run.rows}:
        own = sorted((row["ended"], row["memory_mb"]) for row in run.rows if row["worker"] == worker)
        memory = np.array([size for _, size in own])
        if len(memory) >= 8:
            quarter = len(memory) // 4
            growth.append(float(memory[-quarter:].mean() - memory[quarter : 2 * quarter].mean()))
    return max(growth)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.batch", description=__doc__.splitlines()[0])
    parser.add_argument("--take", default="02_05")
    parser.add_argument("--jobs", type=int, default=40)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument(
        "--kill-every", type=float, default=20.0, help="seconds between two killed workers; 0 for none"
    )
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_takes(folder, options.take, options.jobs, options.frames)
        os.chdir(folder)
        (folder / "alone").mkdir()
        alone = []
        for take in sorted((folder / "takes").glob("*.trc")):
            start = time.perf_counter()
            with contextlib.redirect_stdout(sys.stderr):
                jaxcap_main(
                    ["markers", "solve", "subject.npz", f"takes/{take.name}", "-o", f"alone/{take.stem}.npz"]
                )
            alone.append(time.perf_counter() - start)
        progress(f"one process: {sum(alone[1:]) / len(alone[1:]):.2f} s a job after the first")
        runs = {}
        for workers in (1, 2):
            runs[workers] = run_batch(folder, f"on{workers}", workers)
            progress(
                f"{workers} workers: {runs[workers].seconds:.1f} s, {runs[workers].steady:.1f} s after the first job"
            )
        figures = {
            "speedup": runs[1].steady / runs[2].steady,
            "speedup_with_start": runs[1].seconds / runs[2].seconds,
            "dask_overhead_ms": dask_overhead_ms(),
            "batch_overhead_ms": 1000 * (runs[1].steady - sum(alone[1:])) / len(alone[1:]),
            "differing": sum(count_differences(folder, f"on{workers}") for workers in runs),
            "memory_growth_mb": memory_growth_mb(runs[1]),
            "worker_memory_mb": max(row["memory_mb"] for row in runs[1].rows),
        }
        seconds = {"alone": sum(alone), "one_worker": runs[1].seconds, "two_workers": runs[2].seconds}
        if options.kill_every:
            figures |= kill_workers(folder, options.kill_every) | kill_batch(folder, options.jobs)
    limits = {
        "speedup": (">=", 1.8),
        "dask_overhead_ms": ("<=", 30.0),
        "differing": ("==", 0),
        "killed_differing": ("==", 0),
        "killed_not_once": ("==", 0),
        "continued_differing": ("==", 0),
        "continued_redone": ("==", 0),
        "memory_growth_mb": ("<=", 50.0),
    }
    sizes = {"jobs": options.jobs, "frames": options.frames}
    finish("batch", figures, {name: limits[name] for name in limits if name in figures}, sizes, seconds)


def kill_workers(folder: Path, every: float) -> dict[str, float]:
    """Run a batch whose workers are killed; count the kills, and the jobs that are not done or not exactly once."""
    batch = start_batch(folder, "killed", 2)
    with killing(batch, every) as killed:
        batch.communicate()
    rows = [json.loads(line) for line in (folder / "killed" / "batch.jsonl").read_text().splitlines()]
    done = [row["key"] for row in rows if row["status"] == "done"]
    progress(f"{len(killed)} workers killed, {sum(row['attempts'] > 1 for row in rows)} jobs begun again")
    return {
        "killed_workers": len(killed),
        "killed_begun_again": sum(row["attempts"] > 1 for row in rows),
        "killed_differing": count_differences(folder, "killed"),
        "killed_not_once": len(list((folder / "takes").iterdir()))
        - len(set(done))
        + len(done)
        - len(set(done)),
    }


def kill_batch(folder: Path, jobs: int) -> dict[str, float]:
    """Kill a batch with its scheduler when half of its jobs are done, and continue it; count what is done again."""
    batch = start_batch(folder, "continued", 2)
    out = folder / "continued"
    while batch.poll() is None and len(list(out.glob("*.npz"))) < jobs // 2:
        time.sleep(0.05)
    workers = worker_processes(psutil.Process(batch.pid)) if batch.poll() is None else []
    batch.kill()
    batch.wait()
    # workers end by themselves when their scheduler is gone; those of the next batch should be alone
    _, alive = psutil.wait_procs(workers, timeout=30)
    for process in alive:
        process.kill()
    before = {path.name: path.stat().st_mtime_ns for path in out.glob("*.npz")}
    run = run_batch(folder, "continued", 2)
    redone = sum((out / name).stat().st_mtime_ns != time_ for name, time_ in before.items())
    progress(
        f"{len(before)} jobs were done before the scheduler was killed, {redone} of them were done again"
    )
    return {
        "continued_done_before": len(before),
        "continued_redone": redone,
        "continued_differing": count_differences(folder, "continued"),
        "continued_missing": jobs - sum(row["status"] == "done" for row in run.rows),
    }


if __name__ == "__main__":
    main()
