"""Adapt the embedded human to a real subject (Vlasic et al. 2008): `python -m benchmarks.adapt_crane`.

    python -m benchmarks.adapt_crane --frames 30 --picture crane.png

The capture's meshes go in as clouds: 8,000 of their vertices a frame, in random order, with normals. The template is the
embedded human, a stranger in other clothes. The error is the distance from a cloud's points to the surface of the
adapted, posed body.
"""

import argparse
import time
from pathlib import Path

import equinox as eqx
import numpy as np

import jaxcap as jc
from benchmarks._crane import frame_cloud, load_crane
from benchmarks._scenes import shared_folder
from benchmarks.report import finish, progress
from jaxcap.adapt.adapt_body import adapt_body
from jaxcap.adapt.prepare import make_adapt_task
from jaxcap.adapt.task import AdaptState, plan_stages
from jaxcap.metrics import scan_to_surface
from jaxcap.report.distance_pictures import FrameView, draw_views

POINTS, RATE = 8000, 30.0

_posed = eqx.filter_jit(jc.pose_body)


def distances(state: AdaptState, clouds: list[jc.Cloud]) -> list[np.ndarray]:
    """Compute the distances of the points of every cloud from the surface, metres."""
    faces = np.asarray(state.body.faces)
    return [
        scan_to_surface(np.asarray(cloud.points, float), np.asarray(_posed(state.body, state.motion[n]).vertices, float), faces)
        for n, cloud in enumerate(clouds)
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.adapt_crane", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--frames", type=int, help="number of frames")
    parser.add_argument("--picture", type=Path, help="write a PNG of four frames")
    options = parser.parse_args()
    crane = load_crane(shared_folder())
    count = min(options.frames or len(crane.frames), len(crane.frames))
    clouds = [frame_cloud(crane, frame, POINTS) for frame in range(count)]
    template = jc.human(joints="tracking", resolution="medium")
    task = make_adapt_task(template, clouds, RATE)
    begin, stages, states = time.perf_counter(), plan_stages(task.settings), []
    for state in adapt_body(task):
        states.append(state)
        progress(
            f"{stages[state.done - 1]}: {state.history[-1][1]:.2f} mm, {time.perf_counter() - begin:.0f} s"
        )
    seconds, last = time.perf_counter() - begin, states[-1]
    off, before = (np.concatenate(distances(state, clouds)) for state in (last, states[1]))
    by_frame = [float(np.median(frame)) for frame in distances(last, clouds)]
    if options.picture:
        each, views = distances(last, clouds), []
        for n in (round(share * (count - 1)) for share in (0.0, 0.33, 0.66, 1.0)):
            vertices = np.asarray(_posed(last.body, last.motion[n]).vertices)
            views.append(FrameView(f"frame {n}", vertices, np.asarray(clouds[n].points), each[n]))
        draw_views(options.picture, views, np.asarray(last.body.faces), "The human, adapted to a subject")
    finish(
        "adapt_crane",
        {
            "median_mm": 1000 * float(np.median(off)),
            "mean_mm": 1000 * float(off.mean()),
            "percentile_90_mm": 1000 * float(np.quantile(off, 0.9)),
            "worst_frame_median_mm": 1000 * max(by_frame),
            "size_alone_median_mm": 1000 * float(np.median(before)),
            "lost": float(len(last.lost)),
        },
        {"median_mm": ("<=", 5.0), "lost": ("<=", 0.0)},
        {"frames": count, "points": POINTS, "vertices": len(template.vertices)},
        {"run": seconds},
    )


if __name__ == "__main__":
    main()
