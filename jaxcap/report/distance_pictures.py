"""Pictures of fitted surfaces under their clouds, coloured by distance."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .pictures import new_figure
from .render import INK, draw_surface, rotate_view, visible_points


class FrameView(NamedTuple):
    """A fitted surface and its cloud in one frame, metres, y up."""

    title: str
    vertices: Float[np.ndarray, "V 3"]
    points: Float[np.ndarray, "N 3"]
    #: distance of each point to the surface, metres
    distances: Float[np.ndarray, "N"]


#: points farther from the surface than this have the last colour, metres
MAX_DISTANCE = 0.012
SKIN = np.array([0.62, 0.69, 0.78])
DISTANCE_COLOURS = ("#0b6e8f", "#17a398", "#f2b134", "#d7263d")
#: from the front and slightly from the side
VIEW = rotate_view(np.eye(3), -18.0)


def draw_views(
    path: str | Path, views: Sequence[FrameView], faces: Int[np.ndarray, "F 3"], title: str
) -> None:
    """Write a PNG with the views side by side, seen from the front and slightly from the side."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    colours = LinearSegmentedColormap.from_list("distance", DISTANCE_COLOURS)
    scale = Normalize(0.0, 1000 * MAX_DISTANCE)
    seen = [np.concatenate([view.vertices, view.points]) @ VIEW.T for view in views]
    low = np.min([each.min(0) for each in seen], 0) - 0.1
    high = np.max([each.max(0) for each in seen], 0) + 0.1
    canvas, figure = new_figure(4.0 * len(views), 6.6)
    for plot, view in zip(figure.subplots(1, len(views), squeeze=False)[0], views, strict=True):
        vertices = draw_surface(plot, view.vertices, faces, VIEW, SKIN)
        points = np.asarray(view.points, float) @ VIEW.T
        order = visible_points(vertices, points)
        plot.scatter(
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
        plot.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        plot.set_axis_off()
        plot.set_title(view.title, fontsize=12, color=INK)
    figure.suptitle(title, fontsize=15, color=INK, y=0.975)
    figure.subplots_adjust(left=0.01, right=0.99, top=0.885, bottom=0.12, wspace=0.0)
    place = figure.add_axes((0.33, 0.075, 0.34, 0.016))
    bar = figure.colorbar(ScalarMappable(scale, colours), cax=place, orientation="horizontal", extend="max")
    bar.set_label("distance from point to surface, millimetres", fontsize=10, color=INK)
    bar.ax.tick_params(labelsize=9, colors=INK, length=2)
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    canvas.print_png(path)
