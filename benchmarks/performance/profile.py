"""Where a frame, a first frame, an adaptation, a calibration, learning and an import spend their time.

    python -m benchmarks.profile
    python -m benchmarks.profile --stages frame calibration --output profile.md --picture profile.png

Each stage runs in a process of its own without compiled functions, which gives the seconds of compilation; again, for its wall seconds;
and once more under JAX's profiler, for the shares of compiled programs, copies between host and device, and the host. The ten
largest programs are compared with what the machine can do, measured in the same run: bytes over the bandwidth of the
memory, and operations over the speed of products of matrices. XLA counts both once in each loop, and counts arrays in caches, so these are estimates.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

from benchmarks.performance._machine import Machine, measure_machine
from benchmarks.performance._stages import STAGES
from benchmarks.performance._trace import compile_in, trace
from benchmarks.report import finish, progress

#: programs of a stage that are kept, and the least share of a stage of those that are listed
KEPT, MIN_LISTED_SHARE = 10, 0.005
#: imported packages that are listed
PACKAGES = 6
PARTS = ("programs", "transfers", "host")


def profile_stage(name: str, small: bool) -> dict[str, Any]:
    """Profile one stage in this process."""
    jax.config.update("jax_enable_compilation_cache", False)
    stage = STAGES[name](small)
    jax.clear_caches()
    first, compiled = compile_in(stage.run)
    again, more = compile_in(stage.run)
    traced = trace(stage.run)
    # the profiler slows the host and the programs alike
    scale = again / traced.wall
    return {
        "unit": stage.unit,
        "count": stage.count,
        "first": first,
        "compile": compiled._asdict(),
        "compiled_again": more.programs,
        "wall": again,
        "traced_wall": traced.wall,
        "parts": {
            "programs": scale * traced.busy,
            "transfers": scale * traced.transfers,
            "host": scale * traced.host,
        },
        "programs": [
            program._replace(seconds=scale * program.seconds)._asdict() for program in traced.programs[:KEPT]
        ],
        "num_programs": len(traced.programs),
    }


def profile_import() -> dict[str, float]:
    """Measure the seconds of importing the package, by the package that is imported."""
    words = [sys.executable, "-X", "importtime", "-c", "import jaxcap"]
    begin = time.perf_counter()
    done = subprocess.run(words, stderr=subprocess.PIPE, text=True, check=True)
    found = {"wall": time.perf_counter() - begin}
    for line in done.stderr.splitlines():
        parts = line.removeprefix("import time:").split("|")
        if len(parts) == 3 and parts[0].strip().isdigit():
            package = parts[2].strip().split(".")[0]
            found[package] = found.get(package, 0.0) + 1e-6 * int(parts[0])
    return dict(sorted(found.items(), key=lambda item: -item[1])[: PACKAGES + 1])


def profile_all(
    names: list[str], small: bool, folder: Path, done: Callable[[dict[str, Any]], None]
) -> dict[str, Any]:
    """Profile stages, each in a process of its own, and write their files into `folder`; stages with a file are read from it.

    `done` is called with the stages so far after each.
    """
    found = {}
    for name in names:
        path = folder / f"{name}.json"
        if not path.exists():
            words = ["--one", name, "--output", str(path)] + (["--small"] if small else [])
            subprocess.run([sys.executable, "-m", "benchmarks.profile", *words], check=True)
        found[name] = json.loads(path.read_text())
        row = found[name]
        progress(
            f"{name}: first run {row['first']:.1f} s, then {1000 * row['wall'] / row['count']:.1f} ms a {row['unit']}"
        )
        done(found)
    return found


def tables(stages: dict[str, Any], imports: dict[str, float], machine: Machine) -> str:
    """Write the tables in Markdown."""
    lines = [
        f"Memory bandwidth {machine.bandwidth / 1e9:.1f} GB/s, products of matrices {machine.flops / 1e9:.0f} GFLOP/s (float32).",
        "",
        "| stage | first run, s | of this tracing, lowering, compiling | programs compiled; in a second run | later, ms each | compiled programs | copies | host |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in stages.values():
        compiled, each = row["compile"], 1000 * row["wall"] / row["count"]
        shares = " | ".join(f"{row['parts'][part] / row['wall']:.0%}" for part in PARTS)
        steps = ", ".join(f"{compiled[part]:.1f}" for part in ("trace", "lower", "compile"))
        lines.append(
            f"| {row['unit']} | {row['first']:.1f} | {steps} | {compiled['programs']}; {row['compiled_again']} | {each:.2f} | {shares} |"
        )
    lines += [
        "",
        "| stage | program | calls | ms a call | share of the stage | share of the bandwidth | of matrix products |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in stages.values():
        for program in row["programs"]:
            seconds = max(program["seconds"], 1e-9)
            if seconds < MIN_LISTED_SHARE * row["wall"]:
                continue
            lines.append(
                f"| {row['unit']} | `{program['name']}` | {program['calls']} | {1000 * seconds / max(program['calls'], 1):.2f} | "
                f"{seconds / row['wall']:.0%} | {program['bytes'] / seconds / machine.bandwidth:.0%} | "
                f"{program['flops'] / seconds / machine.flops:.1%} |"
            )
    if imports:
        parts = ", ".join(f"`{name}` {taken:.2f} s" for name, taken in imports.items() if name != "wall")
        lines += ["", f"`import jaxcap` takes {imports['wall']:.2f} s with the start of Python: {parts}."]
    return "\n".join(lines) + "\n"


def draw(path: Path, stages: dict[str, Any]) -> None:
    """Draw the shares of each stage, and its compilation."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.6), dpi=150)
    canvas = FigureCanvasAgg(figure)
    shares, seconds = figure.subplots(1, 2, sharey=True)
    names, left = [row["unit"] for row in stages.values()], [0.0] * len(stages)
    for part, label in zip(PARTS, ("compiled programs", "copies", "host"), strict=True):
        share = [100 * row["parts"][part] / row["wall"] for row in stages.values()]
        shares.barh(names, share, left=left, label=label)
        left = [a + b for a, b in zip(left, share, strict=True)]
    left = [0.0] * len(stages)
    for part in ("trace", "lower", "compile"):
        taken = [row["compile"][part] for row in stages.values()]
        seconds.barh(
            names,
            taken,
            left=left,
            label={"trace": "tracing", "lower": "lowering", "compile": "compiling"}[part],
        )
        left = [a + b for a, b in zip(left, taken, strict=True)]
    shares.set_xlabel("share of the time of a later run, %")
    seconds.set_xlabel("seconds of the first run")
    shares.invert_yaxis()
    for axis in (shares, seconds):
        axis.legend(frameon=False, fontsize=8, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    figure.tight_layout()
    canvas.print_png(path)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.profile", description=__doc__.splitlines()[0])
    parser.add_argument("--stages", nargs="+", choices=STAGES, default=list(STAGES))
    parser.add_argument("--small", action="store_true", help="small data, to try the benchmark")
    parser.add_argument("--no-import", action="store_true", help="leave out the import of the package")
    parser.add_argument("--output", type=Path, help="write the tables to a Markdown file")
    parser.add_argument("--picture", type=Path, help="write a PNG of the shares")
    parser.add_argument(
        "--keep",
        type=Path,
        help="folder for the measurements of each stage; stages in it are not measured again",
    )
    parser.add_argument("--one", choices=STAGES, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        options.output.write_text(json.dumps(profile_stage(options.one, options.small)))
        return
    begin, machine = time.perf_counter(), measure_machine()
    imports = {} if options.no_import else profile_import()

    def write(stages: dict[str, Any]) -> None:
        if options.output:
            options.output.write_text(tables(stages, imports, machine))
        if options.picture:
            draw(options.picture, stages)

    with tempfile.TemporaryDirectory() as temporary:
        folder = options.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        stages = profile_all(options.stages, options.small, folder, write)
    progress(tables(stages, imports, machine))
    figures: dict[str, Any] = {
        "bandwidth_gigabytes_per_second": machine.bandwidth / 1e9,
        "products_gigaflops": machine.flops / 1e9,
        "import_seconds": imports.get("wall"),
    }
    limits = {}
    for name, row in stages.items():
        figures[f"{name}_ms"] = 1000 * row["wall"] / row["count"]
        figures[f"{name}_host_share"] = row["parts"]["host"] / row["wall"]
        figures[f"{name}_programs"] = row["compile"]["programs"]
        figures[f"{name}_compiled_again"] = row["compiled_again"]
        # a second run on the same data must find every program compiled
        limits[f"{name}_compiled_again"] = ("==", 0)
    compiling = {
        name: sum(row["compile"][part] for part in ("trace", "lower", "compile"))
        for name, row in stages.items()
    }
    finish(
        "profile",
        {name: value for name, value in figures.items() if value is not None},
        limits,
        {"small": options.small},
        {"run": time.perf_counter() - begin, "compile": compiling},
    )


if __name__ == "__main__":
    main()
