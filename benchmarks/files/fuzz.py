"""Fuzz the readers of all formats: each must return data or a clear error, quickly and in little memory.

Whole files are written by the library and taken from the shared captures (`../shared`, or `JAXCAP_SHARED`), and each is
damaged in many ways: bits, cuts, splices, counts, NaN, nesting, bombs, cycles. The same files in every run.
"""

import argparse
import collections
import os
import tempfile
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from benchmarks.files._fuzz_damage import damage
from benchmarks.files._fuzz_nasty import nasty_files
from benchmarks.files._fuzz_pool import Reading, read_all
from benchmarks.files._fuzz_read import FAULTS, OUTCOMES
from benchmarks.files._fuzz_seeds import FORMATS, Seed, make_seeds
from benchmarks.report import finish, progress

#: fewer files say little
MIN_FILES = 6000


def main(arguments: Sequence[str] | None = None) -> None:
    options = _options(arguments)
    start = time.perf_counter()
    shared = Path(os.environ.get("JAXCAP_SHARED") or Path(__file__).resolve().parents[3] / "shared")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        seeds = make_seeds(folder / "seeds", shared / "data")
        files = write_files(folder, seeds, options.variants, options.seed, options.only)
        written = time.perf_counter() - start
        progress(f"{len(files)} files of {len({format for format, _ in files})} formats in {written:.0f} s")
        readings = []
        for reading in read_all(files, options.processes):
            readings.append(reading)
            if reading.outcome in FAULTS:
                progress(
                    f"{reading.outcome}: {reading.path.parent.name}/{reading.path.name}: {reading.detail}"
                )
                if options.keep is not None:
                    options.keep.mkdir(parents=True, exist_ok=True)
                    kept = options.keep / f"{reading.format}+{reading.path.parent.name}+{reading.path.name}"
                    kept.write_bytes(reading.path.read_bytes())
            if len(readings) % 500 == 0:
                progress(f"{len(readings)} of {len(files)} files are read")
    _finish(readings, len(seeds), written, time.perf_counter() - start)


def write_files(
    folder: Path, seeds: Sequence[Seed], variants: int, seed: int, only: Iterable[str] = ()
) -> list[tuple[str, Path]]:
    """Write valid files, `variants` damaged ones of each format, and handmade ones; return them by format."""
    files: list[tuple[str, Path]] = []
    by_format: dict[str, list[Seed]] = collections.defaultdict(list)
    for one in seeds:
        by_format[one.format].append(one)
    for format in only or FORMATS:
        rng = np.random.default_rng([seed, FORMATS.index(format)])
        place = folder / format
        place.mkdir()
        for one in by_format[format]:
            files.append((format, _write(place / "whole" / one.name, one.data)))
        for number in range(variants):
            one = by_format[format][number % len(by_format[format])]
            other = seeds[rng.integers(len(seeds))]
            name = one.name.split("-", 1)[1]
            files.append(
                (format, _write(place / f"{number:04d}" / name, damage(name, one.data, other.data, rng)))
            )
    for format, name, data in nasty_files():
        if not only or format in only:
            files.append((format, _write(folder / format / "by_hand" / name, data)))
    return files


def _write(path: Path, data: bytes) -> Path:
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(data)
    return path


def _finish(readings: Sequence[Reading], seeds: int, written: float, total: float) -> None:
    counts = {outcome: sum(r.outcome == outcome for r in readings) for outcome in OUTCOMES}
    by_format: dict[str, dict[str, int]] = {}
    for reading in readings:
        found = by_format.setdefault(reading.format, {})
        found[reading.outcome] = found.get(reading.outcome, 0) + 1
    for format, found in sorted(by_format.items()):
        said = ", ".join(f"{found[outcome]} {outcome}" for outcome in OUTCOMES if outcome in found)
        progress(f"{format:12} {said}")
    slowest = max(readings, key=lambda r: r.seconds)
    largest = max(readings, key=lambda r: r.memory)
    progress(f"slowest {slowest.seconds:.2f} s: {slowest.path.parent.name}/{slowest.path.name}")
    progress(f"largest {largest.memory / 1e6:.0f} MB: {largest.path.parent.name}/{largest.path.name}")
    figures = {
        "files": len(readings),
        "formats": len(by_format),
        **{outcome.replace(" ", "_"): count for outcome, count in counts.items()},
        "slowest_s": slowest.seconds,
        "largest_mb": largest.memory / 1e6,
        "by_format": by_format,
    }
    limits = {fault.replace(" ", "_"): ("==", 0.0) for fault in FAULTS} | {"files": (">=", float(MIN_FILES))}
    sizes = {"whole_files": seeds, "files": len(readings)}
    finish("fuzz", figures, limits, sizes, {"writing": written, "total": total})


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fuzz", description=__doc__)
    parser.add_argument("--variants", type=int, default=200, help="number of damaged files of each format")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument(
        "--only", nargs="*", default=[], choices=FORMATS, help="formats to test; all by default"
    )
    parser.add_argument("--keep", type=Path, help="folder for the files that were read incorrectly")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    main()
