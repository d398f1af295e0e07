"""Draw `assets/depth_*.png`, the pictures of `docs/depth.md`: a depth image, the person in it, and bodies fitted to the person.

    python -m scripts.depth_figures --runs /tmp/depth

Run it from the root of the checkout; the captures lie where the benchmarks look for them. The folder `--runs` keeps the
results of `jaxcap track`; what it contains is not tracked again.
"""

import argparse
import csv
import json
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from benchmarks._scenes import shared_folder
from jaxcap.depth import cloud_of_depths, find_person
from jaxcap.depth.back_projection import measured_points
from jaxcap.depth.candidates import search_step
from jaxcap.geometry.camera import Camera, project_points
from jaxcap.io.cameras import read_cameras
from jaxcap.report.pictures import new_figure
from jaxcap.report.render import CLAY, INK, draw_surface, raise_view, rotate_view, set_frame
from jaxcap.scanner.ray_casting import make_ray_mesh, render_depth
from jaxcap.tracking.judgement.region_samples import sample_regions
from jaxcap.view.figures.depth_layers import (
    CANDIDATES,
    LAYER_COLOURS,
    MEASURED,
    PERSON_LAYER,
    PLANES,
    explain_depth,
)

ASSETS = Path(__file__).resolve().parents[1] / "assets"
#: a frame of a person in a room, and frames of which only people are left
ROOM, PEOPLE = "pcl_person.pcd", "skeltrack_depth12_mm.npz"
#: the Kinect's intrinsics as Open3D writes them
KINECT = {"width": 640, "height": 480, "intrinsic_matrix": [525, 0, 0, 0, 525, 0, 319.5, 239.5, 1]}
#: frames with the body of average build and with the person's, and frames with parts that are not seen
SHAPES, PARTS = (1, 3, 6, 9), (3, 7)
SEEN, UNSEEN, DOT = np.array([0.97, 0.66, 0.31]), CLAY, "#1c7293"
#: of the person's pixels, and of pixels around that were not found to be the person
PERSON_COLOUR, LEFT_OUT = (0.44, 0.66, 0.80), (0.78, 0.60, 0.84)
#: number of drawn points of a view of a room; degrees from the camera to the eye
NUM_POINTS, OBLIQUE, SIDE = 40_000, -50.0, -75.0


class Fit(NamedTuple):
    """A tracked frame: its verdict, its depths, the person's pixels and points, and the posed body."""

    verdict: str
    depth: np.ndarray
    person: np.ndarray
    points: np.ndarray
    vertices: np.ndarray
    faces: np.ndarray
    #: of each vertex, if its part has points
    seen: np.ndarray


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=Path, required=True)
    parser.add_argument("--folder", type=Path, default=ASSETS)
    options = parser.parse_args()
    options.runs.mkdir(parents=True, exist_ok=True)
    intrinsics = options.runs / "kinect.json"
    intrinsics.write_text(json.dumps(KINECT), "utf-8")
    camera, data = read_cameras(intrinsics)[0], shared_folder() / "data" / "depth"
    depth = jc.io.read_depths(data / ROOM)[0].depths[0]
    draw_image(options.folder / "depth_image.png", camera, depth)
    draw_layers(options.folder / "depth_person.png", camera, depth)
    average = track(options.runs / "average", data / PEOPLE, intrinsics)
    fitted = track(options.runs / "fitted", data / PEOPLE, intrinsics, "--fit-shape")
    room = track(options.runs / "room", data / ROOM, intrinsics)
    bodies = [jc.human(resolution="medium", joints="tracking"), jc.load_body(fitted / "person.npz")]
    rows = [
        [read_fit(run, body, camera, data / PEOPLE, number) for number in SHAPES]
        for run, body in zip((average, fitted), bodies, strict=True)
    ]
    draw_shapes(options.folder / "depth_shape.png", camera, rows)
    shown = [read_fit(fitted, bodies[1], camera, data / PEOPLE, number) for number in PARTS]
    draw_parts(
        options.folder / "depth_parts.png",
        camera,
        [*shown, read_fit(room, bodies[0], camera, data / ROOM, 0)],
    )


def track(folder: Path, source: Path, cameras: Path, *options: str) -> Path:
    """Track the frames of a source, unless the folder has their motion; return the folder."""
    if not (folder / "motion.npz").exists():
        command = [
            sys.executable,
            "-m",
            "jaxcap",
            "track",
            "human",
            "--depth",
            str(source),
            "--cameras",
            str(cameras),
        ]
        subprocess.run([*command, "--background", "never", *options, "-o", str(folder)], check=True)
    return folder


def read_fit(folder: Path, body: jc.Body, camera: Camera, source: Path, number: int) -> Fit:
    """Read a tracked frame, and what is known of it."""
    with (folder / "statistics.csv").open(encoding="utf-8") as file:
        row = list(csv.DictReader(file))[number]
    depth = jc.io.read_depths(source)[number].depths[0]
    person = find_person(camera, depth)
    cloud = cloud_of_depths([camera], [depth], [person])
    posed = jc.pose_body(body, jc.load_motion(folder / "motion.npz")[number])
    return Fit(
        row["verdict"],
        depth,
        person,
        np.asarray(cloud.points, float)[np.asarray(cloud.weights) > 0],
        np.asarray(posed.vertices, float),
        np.asarray(body.faces),
        seen_vertices(body, row["unseen"].split("; ")),
    )


def seen_vertices(body: jc.Body, unseen: list[str]) -> np.ndarray:
    """Find the vertices of the parts that are not among those of the column `unseen`."""
    names, parents, parts = body.skeleton.names, body.skeleton.parents, sample_regions(body).joints
    seen = np.ones(len(names), bool)
    for joint, (name, parent) in enumerate(zip(names, parents, strict=True)):
        seen[joint] = name not in unseen if name in parts or parent < 0 else seen[parent]
    return seen[np.asarray(body.skin.dominant_bones())]


def draw_image(path: Path, camera: Camera, depth: np.ndarray) -> None:
    """Draw the depths of an image, and their points from the side."""
    canvas, figure = new_figure(8.0, 3.1)
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    shown = left.imshow(np.where(depth > 0, depth, np.nan), cmap="viridis_r", vmin=0.5, vmax=4.0)
    bar = figure.colorbar(shown, ax=left, fraction=0.035, pad=0.02)
    bar.set_label("depth, metres; white: nothing measured", fontsize=7, color=INK)
    bar.ax.tick_params(labelsize=7, colors=INK)
    left.set_axis_off()
    left.set_title("the image", fontsize=9, color=INK)
    points = measured_points(camera, depth)
    colours = shown.cmap(shown.norm(depth[depth > 0]))
    draw_points(right, [(points, colours)])
    right.set_title("its points from the side, and the camera", fontsize=9, color=INK)
    save(canvas, figure, path)


def draw_layers(path: Path, camera: Camera, depth: np.ndarray) -> None:
    """Draw the layers of `jaxcap view --depth`, in the image and from the side."""
    layers, _ = explain_depth(camera, depth)
    canvas, figure = new_figure(8.0, 3.1)
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    picture, step = np.ones((*depth.shape, 3)), search_step(depth.shape)
    # candidates are found in every `step`-th pixel, so they are drawn first, as squares
    for name in (CANDIDATES, PLANES, PERSON_LAYER):
        columns, rows = (
            np.rint(np.asarray(project_points(camera, jnp.asarray(layers[name].points))[0])).astype(int).T
        )
        for shift in np.ndindex((step, step) if name == CANDIDATES else (1, 1)):
            picture[rows + shift[0], columns + shift[1]] = np.array(LAYER_COLOURS[name]) / 255
        left.scatter([], [], s=25, color=np.array(LAYER_COLOURS[name]) / 255, label=name)
    for label, position in layers[PERSON_LAYER].labels:
        column, row = np.asarray(project_points(camera, jnp.asarray(position))[0])
        frame = {"facecolor": "white", "alpha": 0.85, "linewidth": 0, "pad": 1.5}
        left.text(column, row, label, fontsize=6.5, color=INK, ha="center", bbox=frame)
    left.imshow(picture)
    clouds = [
        (layers[name].points, np.array(paint) / 255)
        for name, paint in LAYER_COLOURS.items()
        if name != MEASURED
    ]
    left.set_axis_off()
    left.legend(fontsize=6.5, loc="lower center", ncols=3, frameon=False, bbox_to_anchor=(0.5, -0.1))
    left.set_title("the image", fontsize=9, color=INK)
    draw_points(right, clouds)
    right.set_title("its points from the side, and the camera", fontsize=9, color=INK)
    save(canvas, figure, path)


def draw_points(plot: Any, clouds: list[tuple[np.ndarray, np.ndarray]]) -> None:
    """Draw points with their colours, and the camera at the origin, obliquely from above."""
    view, chooser = raise_view(rotate_view(np.eye(3), OBLIQUE), 15.0), np.random.default_rng(0)
    points = np.concatenate([cloud for cloud, _ in clouds])
    colours = np.concatenate(
        [np.broadcast_to(paint, (len(cloud), paint.shape[-1])) for cloud, paint in clouds]
    )
    kept = chooser.choice(len(points), min(NUM_POINTS, len(points)), replace=False)
    seen = points[kept] @ view.T
    order = np.argsort(seen[:, 2])
    plot.scatter(*seen[order, :2].T, s=0.5, c=colours[kept][order], linewidths=0, rasterized=True)
    plot.scatter(0.0, 0.0, s=30, c=INK, marker="s")
    every = np.vstack([seen[:, :2], np.zeros((1, 2))])
    set_frame(plot, every.min(0), every.max(0))


def draw_shapes(path: Path, camera: Camera, rows: list[list[Fit]]) -> None:
    """Draw frames tracked with the average body, and below with the person's, over their images."""
    canvas, figure = new_figure(8.0, 3.5)
    for plots, row, label in zip(
        figure.subplots(2, len(SHAPES)), rows, ("average build", "--fit-shape"), strict=True
    ):
        for plot, fit in zip(plots, row, strict=True):
            draw_over(plot, camera, fit, np.full(len(fit.seen), True))
        plots[0].text(-0.04, 0.5, label, rotation=90, va="center", ha="right", transform=plots[0].transAxes,
                      fontsize=8, color=INK)  # fmt: skip
    save(canvas, figure, path)


def draw_parts(path: Path, camera: Camera, fits: list[Fit]) -> None:
    """Draw frames over their images, and below from the side with the points; parts without points are grey."""
    canvas, figure = new_figure(7.5, 5.6)
    plots = figure.subplots(2, len(fits), height_ratios=(1.0, 1.5))
    view = rotate_view(np.eye(3), SIDE)
    for above, below, fit in zip(*plots, fits, strict=True):
        draw_over(above, camera, fit, fit.seen)
        colours = np.where(fit.seen[:, None], SEEN, UNSEEN)
        seen = draw_surface(below, fit.vertices, fit.faces, view, colours)
        below.scatter(*(fit.points @ view.T)[:, :2].T, s=0.5, c=DOT, linewidths=0, rasterized=True, zorder=3)
        set_frame(below, seen.min(0)[:2], seen.max(0)[:2])
    save(canvas, figure, path)


def draw_over(plot: Any, camera: Camera, fit: Fit, seen: np.ndarray) -> None:
    """Draw the pixels of the person in blue, and over them the rendered body."""
    image = render_depth(camera, make_ray_mesh(fit.vertices, fit.faces))
    inside = image.triangles >= 0
    colours = np.where(seen[fit.faces[image.triangles]].mean(2)[..., None] > 0.5, SEEN, UNSEEN)
    shaded = colours * image.incidence_cosines[..., None] ** 0.6
    near = (fit.depth > 0) & (fit.depth < fit.depth[fit.person].max())
    below = np.where(fit.person[..., None], PERSON_COLOUR, np.where(near[..., None], LEFT_OUT, 1.0))
    plot.imshow(np.where(inside[..., None], 0.2 * below + 0.8 * shaded, below))
    plot.contour(fit.person, levels=[0.5], colors="#1d4e89", linewidths=0.6)
    plot.set_axis_off()
    plot.set_title(fit.verdict, fontsize=8, color=INK)


def save(canvas: Any, figure: Any, path: Path) -> None:
    """Write the figure with a palette of 128 colours."""
    from PIL import Image

    figure.tight_layout(pad=0.4)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
    picture.quantize(128, dither=Image.Dither.NONE).save(path, optimize=True)
    sys.stderr.write(f"written: {path}, {path.stat().st_size // 1024} kB\n")


if __name__ == "__main__":
    main()
