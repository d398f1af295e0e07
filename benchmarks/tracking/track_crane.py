"""Track a real subject (Vlasic et al. 2008) in clouds without correspondences.

    python -m benchmarks.track_crane
    python -m benchmarks.track_crane --frames 20 --picture crane.png

The body is one frame of the capture, rigged without hand work. Each frame is 5,000 of its
vertices in random order, with normals. The error is the distance of every vertex of the posed
body from the same vertex of the frame; a body moved by bones cannot follow clothes, and 18 free
rigid parts fitted with the true correspondences reach 13 mm (18 on the worst frame).
"""

import argparse
import time
from pathlib import Path

import equinox as eqx
import jax
import numpy as np

import jaxcap as jc
from benchmarks._crane import frame_cloud, load_crane, rig_crane, true_distances
from benchmarks._scenes import shared_folder
from benchmarks.report import finish, progress
from jaxcap.metrics import scan_to_surface
from jaxcap.report.distance_pictures import FrameView, draw_views

_posed = eqx.filter_jit(jc.pose_body)


def swapped_parts(body: jc.Body, vertices: np.ndarray, truth: np.ndarray) -> list[str]:
    """List parts that are nearer to the true position of their mirrored part than to their own."""
    names, parts = body.skeleton.names, np.asarray(body.skin.dominant_bones())
    middles = {name: parts == bone for bone, name in enumerate(names) if (parts == bone).any()}
    swapped = []
    for name, members in middles.items():
        other = name.replace("Left", "Right") if "Left" in name else name.replace("Right", "Left")
        if other != name and other in middles:
            here, own, twin = vertices[members].mean(0), truth[members].mean(0), truth[middles[other]].mean(0)
            if np.linalg.norm(here - twin) < np.linalg.norm(here - own):
                swapped.append(name)
    return swapped


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.track_crane", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--frames", type=int, help="number of frames to track")
    parser.add_argument("--rigged", type=int, default=0, help="frame from which the body is built")
    parser.add_argument("--picture", type=Path, help="write a PNG of four frames")
    options = parser.parse_args()

    crane = load_crane(shared_folder())
    count = min(options.frames or len(crane.frames), len(crane.frames))
    start = time.perf_counter()
    body = rig_crane(crane, options.rigged)
    rigging = time.perf_counter() - start
    tracker = jc.make_tracker(body)
    clouds = [frame_cloud(crane, frame) for frame in range(count)]

    errors, lost, swapped, seconds, meshes = [], [], [], [], []
    stream = jc.fit.track_frames(tracker, clouds, search=True)
    for frame in range(count):
        start = time.perf_counter()
        tracked = jax.block_until_ready(next(stream))
        seconds.append(time.perf_counter() - start)
        vertices = np.asarray(_posed(body, tracked.pose).vertices)
        errors.append(1000 * true_distances(crane, frame, vertices).mean())
        lost += [frame] if tracked.lost else []
        swapped += [(frame, part) for part in swapped_parts(body, vertices, crane.frames[frame])]
        meshes.append(vertices)
        if frame % 10 == 0 or tracked.lost:
            progress(
                f"frame {frame}: {errors[-1]:.1f} mm{', lost' if tracked.lost else ''}, {seconds[-1]:.2f} s"
            )
    if swapped:
        progress(f"swapped: {swapped[:20]}")
    if options.picture:
        shown = sorted({round(share * (count - 1)) for share in (0.0, 0.33, 0.66, 1.0)})
        views = []
        for f in shown:
            points = np.asarray(clouds[f].points, float)
            distances = scan_to_surface(points, meshes[f].astype(float), np.asarray(body.faces))
            views.append(FrameView(f"frame {f}: {errors[f]:.1f} mm", meshes[f], points, distances))
        draw_views(options.picture, views, np.asarray(body.faces), "crane, tracked")
        progress(f"picture: {options.picture}")
    figures = {
        "mean_mm": float(np.mean(errors)),
        "worst_frame_mm": float(np.max(errors)),
        "worst_frame": int(np.argmax(errors)),
        "lost": len(lost),
        "swapped": len(swapped),
        "frames_per_second": (count - 1) / sum(seconds[1:]) if count > 1 else float("nan"),
        "median_frame_ms": 1000 * float(np.median(seconds[1:])) if count > 1 else float("nan"),
    }
    limits = {
        "mean_mm": ("<=", 22.0),
        "worst_frame_mm": ("<=", 35.0),
        "lost": ("==", 0),
        "swapped": ("==", 0),
    }
    sizes = {"frames": count, "points": 5000, "vertices": len(body.vertices), "rigged_frame": options.rigged}
    finish(
        "track_crane",
        figures,
        limits,
        sizes,
        {"rig": rigging, "first_frame_compile": seconds[0], "run": sum(seconds[1:])},
    )


if __name__ == "__main__":
    main()
