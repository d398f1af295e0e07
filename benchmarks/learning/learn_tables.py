"""Reproduce the thesis's tables on a known body and on a real subject: `python -m benchmarks.learn_tables`.

    python -m benchmarks.learn_tables --output tables.md --keep rows.json
    python -m benchmarks.learn_tables --scenes human --resolution low --every 8 --rounds 2

Mean and standard deviation of the distance of a mesh's vertex to the nearest point of the learned
body's surface, over vertices and meshes (Adaptation, table 3.1 and section 3.3.1): over the number
of joints, over the shape conformance weight alpha, with and without symmetry. Meshes that were
learned from, and held-out ones fitted with the learned body. With `--keep`, rows that the file has
are not learned again.
"""

import argparse
import json
from pathlib import Path

import jax
import numpy as np

from benchmarks._scenes import shared_folder
from benchmarks.learning._learning import (
    crane_meshes,
    fitted_vertices,
    learn,
    make_synthetic_meshes,
    posed_vertices,
    surface_distances,
)
from benchmarks.report import finish, progress

#: what is the default, and what the thesis varies (table 3.1, figure 3.11, figure 3.10)
DEFAULTS = {"joints": 18, "alpha": 100.0, "symmetry": True}
VARIATIONS = {
    "joints": (15, 16, 17, 18),
    "alpha": (0.0, 100.0, 10000.0),
    "symmetry": (True, False),
}
HEADINGS = {"joints": "joints", "alpha": "alpha", "symmetry": "symmetry"}

Row = dict[str, float]


def load_scenes(options):
    """Load the training and held-out meshes of each scene by name."""
    shared = shared_folder()
    if "human" in options.scenes:
        scene = make_synthetic_meshes(shared, resolution=options.resolution)
        yield "human", scene.training[:: options.every], scene.held_out[:: options.every]
    if "crane" in options.scenes:
        yield "crane", *(half[:: options.every] for half in crane_meshes(shared))


def learned_row(training, held_out, settings: dict, extra: dict) -> Row:
    """Learn one body, and compute its distances from the meshes, millimetres."""
    run = learn(training, **settings, **extra)
    near = surface_distances(training, posed_vertices(run.body, run.motion))
    far = surface_distances(held_out, fitted_vertices(run.body, held_out))
    row = {"mean": near.mean(), "sd": near.std(), "held_out_mean": far.mean(), "held_out_sd": far.std()}
    return {name: float(value) for name, value in row.items()} | {"seconds": run.seconds["total"]}


def label(scene: str, settings: dict) -> str:
    return f"{scene} joints {settings['joints']} alpha {settings['alpha']:g} symmetry {settings['symmetry']}"


def table(scene: str, name: str, rows: dict[str, Row]) -> list[str]:
    """Format one table as Markdown, with settings as columns as in the thesis."""
    columns = [(value, rows[label(scene, DEFAULTS | {name: value})]) for value in VARIATIONS[name]]
    shown = [{True: "with", False: "without"}[v] if isinstance(v, bool) else f"{v:g}" for v, _ in columns]
    lines = [f"| {scene}, {HEADINGS[name]} | " + " | ".join(shown) + " |", "|---" * (len(columns) + 1) + "|"]
    parts = {
        "mean (standard deviation), mm": ("mean", "sd"),
        "held out": ("held_out_mean", "held_out_sd"),
    }
    for title, (mean, sd) in parts.items():
        lines.append(
            f"| {title} | " + " | ".join(f"{row[mean]:.2f} ({row[sd]:.2f})" for _, row in columns) + " |"
        )
    return [*lines, ""]


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.learn_tables", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--scenes", nargs="*", choices=("human", "crane"), default=["human", "crane"])
    parser.add_argument(
        "--resolution", choices=("full", "medium", "low"), default="full", help="resolution of the human"
    )
    parser.add_argument("--every", type=int, default=1, help="use every n-th mesh only")
    parser.add_argument("--rounds", type=int, help="maximum number of learning rounds")
    parser.add_argument("--output", type=Path, help="write the tables to a Markdown file")
    parser.add_argument("--keep", type=Path, help="JSON file of the finished rows, read and updated")
    options = parser.parse_args()
    extra = {} if options.rounds is None else {"rounds": options.rounds}

    kept: dict[str, Row] = {}
    if options.keep and options.keep.is_file():
        kept = json.loads(options.keep.read_text())
    lines, figures, sizes = [], {}, {}
    for scene, training, held_out in load_scenes(options):
        sizes[scene] = {
            "meshes": len(training), "held_out": len(held_out), "vertices": training.vertices.shape[1]
        }  # fmt: skip
        rows: dict[str, Row] = {}
        for settings in [DEFAULTS | {name: value} for name in VARIATIONS for value in VARIATIONS[name]]:
            # the resolution, the meshes and the rounds make another row of the same settings
            key = label(scene, settings)
            long = f"{key}, {sizes[scene]} rounds {options.rounds}"
            if long not in kept:
                progress(key)
                kept[long] = learned_row(training, held_out, settings, extra)
                # compiled functions stay mapped into memory, and a process may map only so many pieces
                jax.clear_caches()
                if options.keep:
                    options.keep.write_text(json.dumps(kept, indent=1))
            rows[key] = kept[long]
        for name in VARIATIONS:
            lines += table(scene, name, rows)
        figures |= {f"{key}: {part}": row[part] for key, row in rows.items() for part in row}
    progress("\n".join(lines))
    if options.output:
        options.output.write_text("\n".join(lines))
    seconds = {"run": float(np.sum([value for key, value in figures.items() if key.endswith("seconds")]))}
    finish("learn_tables", figures, sizes=sizes, seconds=seconds)


if __name__ == "__main__":
    main()
