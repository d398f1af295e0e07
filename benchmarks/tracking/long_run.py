"""Track 20,000 frames of 1,000 points by the command line, and check that time and memory do not grow.

    python -m benchmarks.long_run
    python -m benchmarks.long_run --frames 300 --block 100 --points 300

`jaxcap track` runs in a process of its own and is watched from outside: its journal says how many frames are done, the
operating system its memory and processor time. The last block of frames is held to the second one, in processor time,
since other programs take their share of the clock; seconds by the clock stand beside. A processor that is shared is not
always as fast: a fixed piece of work is timed beside the run all along, and the ratio is of times in units of it (as measured:
`raw_processor_ratio`). From the last frame to the end of the process results are written. The clouds are files, of which those a period of the motion apart are one on the disk.
Run it from the root of the checkout; Linux only.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

import jaxcap as jc
from benchmarks.report import finish, progress
from benchmarks.tracking._long_scene import make_limb, write_clouds
from jaxcap.io.archives.journal import read_header

#: seconds between two looks, and between two words
SAMPLE_INTERVAL, PROGRESS_INTERVAL = 0.05, 15.0
#: looks from one timing of the fixed work to the next
REFERENCE_EVERY = 10


class ProcessSample(NamedTuple):
    """The measurements of a run at one time."""

    seconds: float
    frames: int
    #: of the process and its threads, seconds
    processor: float
    #: resident, bytes
    memory: float
    #: the fixed work when it was last timed, seconds of the processor
    reference: float


class RunRecord(NamedTuple):
    """The measurements of a whole run, and its exit code."""

    looks: list[ProcessSample]
    end: float
    code: int


def fixed_work() -> float:
    """Measure the processor seconds of a fixed piece of work of a few milliseconds: matrix products and Python."""
    matrix = np.full((96, 96), 1e-3)
    start = time.thread_time()
    for _ in range(40):
        matrix = matrix @ matrix + 1e-3
        sum(number * number for number in range(500))
    return time.thread_time() - start


def sample_process(process: int, journal: Path, start: float, reference: float) -> ProcessSample:
    """Measure a running process and its journal."""
    frames = 0
    if journal.is_file():
        width = int(str(read_header(journal)["width"]))
        frames = (journal.stat().st_size - _records_offset(journal)) // (8 * width + 4)
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    ticks = os.sysconf("SC_CLK_TCK")
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    processor = (int(fields[11]) + int(fields[12])) / ticks
    return ProcessSample(
        time.perf_counter() - start, frames, processor, pages * os.sysconf("SC_PAGE_SIZE"), reference
    )


def _records_offset(journal: Path) -> int:
    """Find the offset of the records of a journal."""
    with open(journal, "rb") as file:
        return 12 + int.from_bytes(file.read(12)[8:], "little")


def watch(command: list[str], journal: Path) -> RunRecord:
    """Run a command and measure it until it ends."""
    start, looks, said, reference = time.perf_counter(), [], 0.0, fixed_work()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as running:
        while running.poll() is None:
            time.sleep(SAMPLE_INTERVAL)
            try:
                if len(looks) % REFERENCE_EVERY == 0:
                    reference = fixed_work()
                look = sample_process(running.pid, journal, start, reference)
            except (OSError, IndexError, jc.InputError):
                # it has ended, or not written its journal's head
                continue
            if not look.memory:
                continue
            looks.append(look)
            if look.seconds - said > PROGRESS_INTERVAL:
                said = look.seconds
                progress(f"{look.frames} frames, {look.seconds:.0f} s, {look.memory / 1e6:.0f} MB")
    return RunRecord(looks, time.perf_counter() - start, running.returncode)


class Block(NamedTuple):
    """A block of frames: wall and processor seconds per frame; the largest memory, bytes; the median time of the fixed work,
    seconds."""

    clock: float
    processor: float
    memory: float
    reference: float


def block_figures(looks: list[ProcessSample], first: int, last: int) -> Block:
    """Summarise the measurements of the frames from `first` to `last`."""
    done = np.array([look.frames for look in looks])
    edges = np.interp([first, last], done, [look.seconds for look in looks])
    work = np.interp([first, last], done, [look.processor for look in looks])
    # what is written after the last frame is not of its block
    within = [look for look in looks if first <= look.frames < last]
    return Block(
        float(np.diff(edges)[0]) / (last - first),
        float(np.diff(work)[0]) / (last - first),
        max(look.memory for look in within),
        float(np.median([look.reference for look in within])),
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.long_run", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--frames", type=int, default=20_000)
    parser.add_argument("--points", type=int, default=1000)
    parser.add_argument("--block", type=int, default=1000, help="number of frames of each compared block")
    options = parser.parse_args()
    if options.frames < 3 * options.block:
        parser.error("give at least three blocks of frames")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        body = make_limb()
        jc.save_body(folder / "limb.npz", body)
        (folder / "clouds").mkdir()
        pattern = write_clouds(folder / "clouds", body, options.frames, options.points)
        code = "from jaxcap.cli import main; main()"
        words = ["track", str(folder / "limb.npz"), pattern, "-o", str(folder / "out")]
        run = watch([sys.executable, "-c", code, *words], folder / "out" / "journal")
        whole = run.code == 0 and jc.load_motion(folder / "out" / "motion.npz").num_frames == options.frames
    second = block_figures(run.looks, options.block, 2 * options.block)
    last = block_figures(run.looks, options.frames - options.block, options.frames)
    at_end = next((look for look in run.looks if look.frames >= options.frames), run.looks[-1])
    first = next((look.seconds for look in run.looks if look.frames > 0), run.end)
    frames_between = options.frames - 2 * options.block
    figures = {
        "processor_ratio": (last.processor / last.reference) / (second.processor / second.reference),
        "memory_ratio": last.memory / second.memory,
        "raw_processor_ratio": last.processor / second.processor,
        "clock_ratio": last.clock / second.clock,
        "reference_ratio": last.reference / second.reference,
        "finished_after_s": run.end - at_end.seconds,
        "finished_after_processor_s": run.looks[-1].processor - at_end.processor,
        "frame_ms": 1000 * last.clock,
        "frame_processor_ms": 1000 * last.processor,
        "memory_mb": last.memory / 1e6,
        "peak_mb": max(look.memory for look in run.looks) / 1e6,
        "whole": whole,
    }
    limits = {
        "processor_ratio": ("<=", 1.1),
        "memory_ratio": ("<=", 1.1),
        "finished_after_s": ("<=", 5.0),
        "whole": ("==", 1),
    }
    if frames_between >= 10_000:  # a shorter run grows by what the allocator happens to take
        growth = (last.memory - second.memory) / frames_between
        figures["memory_of_100000_mb"] = (second.memory + growth * 100_000) / 1e6
        limits["memory_of_100000_mb"] = ("<=", 2000.0)
    sizes = {
        "frames": options.frames,
        "points": options.points,
        "block": options.block,
        "vertices": len(body.vertices),
    }
    finish(
        "long_run",
        figures,
        limits,
        sizes,
        {"compile": first, "run": at_end.seconds - first, "whole": run.end},
    )


if __name__ == "__main__":
    main()
