"""Learn a real subject (Vlasic et al. 2008) from registered meshes: `python -m benchmarks.learn_crane`.

    python -m benchmarks.learn_crane --every 8 --rounds 2

Every second mesh is learned from with default options; the others are fitted with the learned body.
The error is the distance of a mesh's vertex to the nearest point of the body's surface, mean and
standard deviation over vertices and meshes, as the thesis has it (8.6 mm on a comparable capture). Then the same with
correctives (`learn_correctives`), whose strength and rank are chosen by folds of the training meshes alone.
"""

import argparse
import time
from pathlib import Path

import numpy as np

import jaxcap as jc
from benchmarks._scenes import shared_folder
from benchmarks.learning._learning import (
    crane_meshes,
    fitted_vertices,
    learn,
    posed_vertices,
    root_mean_square,
    surface_distances,
    vertex_errors_mm,
    without_cache,
)
from benchmarks.report import finish, progress
from jaxcap.cli.learn.correctives import describe_correctives
from jaxcap.learn.correctives.learn_correctives import learn_correctives
from jaxcap.observe.meshes import MeshSequence
from jaxcap.report.distance_pictures import FrameView, draw_views


def scores(
    body: jc.Body,
    motion: jc.Motion,
    training: MeshSequence,
    held_out: MeshSequence,
    prefix: str,
    picture: Path | None,
) -> dict[str, float]:
    """Compute the errors of a body in the training meshes, and in the held-out ones, to which it is fitted."""
    figures = {}
    fitted = fitted_vertices(body, held_out)
    halves = (("training", training, posed_vertices(body, motion)), ("held_out", held_out, fitted))
    for name, meshes, posed in halves:
        distances = surface_distances(meshes, posed)
        errors = vertex_errors_mm(posed, meshes.vertices)
        figures |= {
            f"{prefix}{name}_surface_mm": distances.mean(),
            f"{prefix}{name}_surface_sd_mm": distances.std(),
            f"{prefix}{name}_surface_worst_mesh_mm": distances.mean(1).max(),
            f"{prefix}{name}_vertex_mm": errors.mean(),
            f"{prefix}{name}_vertex_rms_mm": root_mean_square(errors),
        }
        progress(f"  {prefix}{name}: {distances.mean():.2f} mm (sd {distances.std():.2f}) to the surface")
        if picture and name == "held_out":
            shown = sorted({round(share * (len(meshes) - 1)) for share in (0.0, 0.33, 0.66, 1.0)})
            views = [
                FrameView(
                    f"{distances[f].mean():.1f} mm", posed[f], np.asarray(meshes[f]), distances[f] / 1000
                )
                for f in shown
            ]
            draw_views(picture, views, np.asarray(body.faces), "crane, learned, held-out meshes")
            progress(f"picture: {picture}")
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.learn_crane", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--joints", type=int, default=18)
    parser.add_argument("--every", type=int, default=1, help="use every n-th mesh of both halves only")
    parser.add_argument("--rounds", type=int, help="maximum number of learning rounds")
    parser.add_argument("--no-correctives", action="store_true", help="leave out the body with correctives")
    parser.add_argument("--picture", type=Path, help="write a PNG of four held-out meshes")
    options = parser.parse_args()
    extra = {} if options.rounds is None else {"rounds": options.rounds}

    without_cache()
    training, held_out = (half[:: options.every] for half in crane_meshes(shared_folder()))
    run = learn(training, joints=options.joints, **extra)

    figures = scores(run.body, run.motion, training, held_out, "", options.picture)
    seconds = dict(run.seconds)
    if not options.no_correctives:
        start = time.perf_counter()
        found = learn_correctives(run.body, run.motion, training)
        seconds["correctives"] = time.perf_counter() - start
        for line in describe_correctives(found):
            progress(f"  {line}")
        figures |= scores(found.body, found.motion, training, held_out, "corrected_", None)
        figures |= {
            "corrected_rank": found.choice.rank,
            "left_out_vertex_rms_mm": 1000 * found.choice.error_without,
            "corrected_left_out_vertex_rms_mm": 1000 * found.choice.error_with,
        }
    figures["minutes"] = run.seconds["total"] / 60
    limits = {
        "training_surface_mm": ("<=", 6.0),
        "held_out_surface_mm": ("<=", 7.0),
        "minutes": ("<=", 3.0),
        **({} if options.no_correctives else {"corrected_held_out_surface_mm": ("<=", 3.8)}),
    }
    sizes = {
        "meshes": len(training),
        "held_out": len(held_out),
        "vertices": training.vertices.shape[1],
        "joints": run.body.skeleton.num_joints - 1,
        "rounds": len(run.rounds),
    }
    finish("learn_crane", figures, limits, sizes, seconds)


if __name__ == "__main__":
    main()
