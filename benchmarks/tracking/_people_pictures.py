"""Pictures of several tracked people and the points of their clouds."""

from pathlib import Path

import equinox as eqx
import numpy as np

import jaxcap as jc
from jaxcap.geometry.camera import look_at
from jaxcap.scanner.ray_casting import make_ray_mesh, render_depth

_pose_body = eqx.filter_jit(jc.pose_body)
#: of the people
COLOURS = ((0.9, 0.35, 0.3), (0.3, 0.6, 0.95), (0.4, 0.8, 0.4), (0.85, 0.7, 0.2))
#: number of drawn points of a cloud
NUM_POINTS = 1500


def draw_people(
    path: Path,
    trackers: list[jc.fit.Tracker],
    poses: list[list[jc.Pose]],
    clouds: list[jc.Cloud],
    count: int = 6,
) -> None:
    """Draw some frames, evenly spread: each person in a colour, from two sides, with points as dots."""
    from matplotlib.figure import Figure

    frames = np.unique(np.linspace(0, len(clouds) - 1, count).round().astype(int))
    figure = Figure(figsize=(3.6 * len(frames), 6.0))
    axes = figure.subplots(2, len(frames), squeeze=False)
    for column, frame in enumerate(frames):
        surfaces = [
            (np.asarray(_pose_body(tracker.body, own[frame]).vertices, float), np.asarray(tracker.body.faces))
            for tracker, own in zip(trackers, poses, strict=True)
        ]
        points = np.asarray(clouds[frame].points, float)[np.asarray(clouds[frame].weights) > 0]
        chosen = np.random.default_rng(0).permutation(len(points))[:NUM_POINTS]
        for row, eye in enumerate(([3.2, 1.8, 2.4], [0.0, 5.0, 0.8])):
            _draw(axes[row][column], surfaces, points[chosen], eye)
            axes[row][column].set_title(f"frame {frame}", fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=70)


def _draw(axis, surfaces: list[tuple[np.ndarray, np.ndarray]], points: np.ndarray, eye: list[float]) -> None:
    middle = np.median(points, 0)
    camera = look_at(np.asarray(eye) + [middle[0], 0, middle[2]], middle, 360, 300, 60)
    first = np.cumsum([0, *(len(vertices) for vertices, _ in surfaces)])
    faces = np.concatenate([f + start for (_, f), start in zip(surfaces, first, strict=False)])
    owners = np.repeat(np.arange(len(surfaces)), [len(f) for _, f in surfaces])
    image = render_depth(camera, make_ray_mesh(np.concatenate([v for v, _ in surfaces]), faces))
    shown = image.triangles >= 0
    picture = np.ones((*image.depth.shape, 3))
    colours = np.array(COLOURS)[owners[image.triangles[shown]] % len(COLOURS)]
    picture[shown] = colours * (0.3 + 0.7 * image.incidence_cosines[shown])[:, None]
    axis.imshow(picture)
    pixels = points @ np.asarray(camera.rotation, float).T + np.asarray(camera.translation, float)
    pixels = pixels[:, :2] / pixels[:, 2:] * np.asarray(camera.focal) + np.asarray(camera.principal_point)
    axis.scatter(*pixels.T, s=0.4, c="black")
    axis.set_xlim(0, camera.width)
    axis.set_ylim(camera.height, 0)
    axis.axis("off")
