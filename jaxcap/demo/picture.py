"""A figure of a tracked performance: the fitted surface, shaded, under its cloud."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..geometry.mesh import area_normals


class View(NamedTuple):
    """One frame of the figure; metres, y up."""

    title: str
    vertices: Float[np.ndarray, "V 3"]
    points: Float[np.ndarray, "N 3"]
    #: distance of each point to the surface, metres
    distances: Float[np.ndarray, "N"]


#: points farther from the surface than this have the last colour, metres
MAX_DISTANCE = 0.012
SKIN, PAPER, INK = np.array([0.62, 0.69, 0.78]), "#ffffff", "#1f2933"
LIGHT = np.array([-0.45, 0.6, 0.66])


def draw_views(path: str | Path, views: Sequence[View], faces: Int[np.ndarray, "F 3"], title: str) -> None:
    """Write a PNG with the views side by side, seen from the front and slightly from the side."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize
    from matplotlib.figure import Figure

    colours = LinearSegmentedColormap.from_list("distance", ["#0b6e8f", "#17a398", "#f2b134", "#d7263d"])
    scale = Normalize(0.0, 1000 * MAX_DISTANCE)
    turned = [(_rotate_about_vertical(view.vertices), _rotate_about_vertical(view.points)) for view in views]
    low = np.min([vertices.min(0) for vertices, _ in turned], 0) - 0.1
    high = np.max([vertices.max(0) for vertices, _ in turned], 0) + 0.1
    figure = Figure(figsize=(4.0 * len(views), 6.6), dpi=150, facecolor=PAPER)
    canvas = FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(views), squeeze=False)[0]
    for axis, view, (vertices, points) in zip(axes, views, turned, strict=True):
        _shade(axis, vertices, np.asarray(faces))
        # only the front half of the cloud, far points below near ones
        near = _visible_points(vertices, points)
        order = near[np.argsort(points[near, 2])]
        axis.scatter(
            points[order, 0],
            points[order, 1],
            c=1000 * view.distances[order],
            cmap=colours,
            norm=scale,
            s=2.6,
            linewidths=0,
            alpha=0.9,
            zorder=3,
        )
        axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        axis.set_axis_off()
        axis.set_title(view.title, fontsize=12, color=INK)
    figure.suptitle(title, fontsize=15, color=INK, y=0.975)
    figure.subplots_adjust(left=0.01, right=0.99, top=0.885, bottom=0.12, wspace=0.0)
    place = figure.add_axes((0.33, 0.075, 0.34, 0.016))
    bar = figure.colorbar(ScalarMappable(scale, colours), cax=place, orientation="horizontal", extend="max")
    bar.set_label("distance from point to surface, millimetres", fontsize=10, color=INK)
    bar.ax.tick_params(labelsize=9, colors=INK, length=2)
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    canvas.print_png(path)


def _rotate_about_vertical(
    points: Float[np.ndarray, "N 3"], degrees: float = -18.0
) -> Float[np.ndarray, "N 3"]:
    """Rotate points about the vertical; x is right, y up, z towards the viewer."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.asarray(points, float) @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])


def _shade(axis, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> None:
    """Draw the front-facing triangles, far ones first, lit from the upper left."""
    from matplotlib.collections import PolyCollection

    corners = vertices[faces]
    flat = area_normals(corners)
    # averaged normals of the corners, so that triangle edges do not show
    smooth = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(smooth, faces[:, corner], flat)
    normals = smooth[faces].sum(1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    front = np.flatnonzero(flat[:, 2] > 0)
    front = front[np.argsort(corners[front, :, 2].mean(1))]
    light = np.clip(normals[front] @ (LIGHT / np.linalg.norm(LIGHT)), 0.0, 1.0)
    colour = np.clip((0.45 + 0.62 * light)[:, None] * SKIN, 0.0, 1.0)
    axis.add_collection(
        PolyCollection(
            list(corners[front, :, :2]), facecolors=colour, edgecolors=colour, linewidths=0.25, zorder=2
        )
    )


def _visible_points(
    vertices: Float[np.ndarray, "V 3"], points: Float[np.ndarray, "N 3"], pixel: float = 0.03
) -> Int[np.ndarray, "M"]:
    """Find the indices of the points that the surface does not occlude."""
    corner = np.minimum(vertices.min(0), points.min(0))[:2]
    cells, asked = (np.floor((a[:, :2] - corner) / pixel).astype(int) for a in (vertices, points))
    width = int(max(cells[:, 0].max(), asked[:, 0].max())) + 1
    height = int(max(cells[:, 1].max(), asked[:, 1].max())) + 1
    nearest = np.full(width * height, -np.inf)
    np.maximum.at(nearest, cells[:, 1] * width + cells[:, 0], vertices[:, 2])
    return np.flatnonzero(points[:, 2] > nearest[asked[:, 1] * width + asked[:, 0]] - pixel)
