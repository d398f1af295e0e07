"""Plots in a common style: scans on surfaces, coloured by distance, and charts with descriptive titles."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ..metrics import scan_to_surface
from .render import INK, draw_shadow, draw_surface, raise_view, rotate_view, set_frame, visible_points

#: from near to far, as in the picture of `jaxcap demo`
DISTANCE_COLOURS = ("#0b6e8f", "#17a398", "#f2b134", "#d7263d")
#: colours of surfaces, of the lines of charts in their order, and of secondary elements
SKIN = np.array([0.66, 0.73, 0.81])
BLUE, RED, GREEN, AMBER, QUIET = "#0b6e8f", "#d7263d", "#3a9d5d", "#e0942a", "#9aa5b1"
#: view of people, slightly from the side and from above
PERSON = raise_view(rotate_view(np.eye(3), 22.0), 9.0)


def distance_colours() -> Any:
    """Return the colour map of distances."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("distance", DISTANCE_COLOURS)


def draw_person(
    plot: Any,
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "T 3"],
    view: Float[np.ndarray, "3 3"] = PERSON,
    colours: Float[np.ndarray, "V 3"] | Float[np.ndarray, "3"] = SKIN,
    floor: float | None = None,
) -> Float[np.ndarray, "V 3"]:
    """Draw a lit surface with its shadow; return the vertices in view coordinates."""
    draw_shadow(plot, vertices, faces, view, floor)
    return draw_surface(plot, vertices, faces, view, colours)


def draw_scan(
    plot: Any,
    points: Float[np.ndarray, "N 3"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "T 3"],
    view: Float[np.ndarray, "3 3"] = PERSON,
    far: float = 0.012,
    size: float = 3.0,
) -> Float[np.ndarray, "N"]:
    """Draw the visible points of a scan, coloured by their distance from a surface; return the distances,
    metres.

    Distances of `far` metres and more have the last colour.
    """
    distances = scan_to_surface(np.asarray(points, float), np.asarray(vertices, float), np.asarray(faces))
    seen = np.asarray(points, float) @ view.T
    shown = visible_points(np.asarray(vertices, float) @ view.T, seen)
    plot.scatter(
        *seen[shown, :2].T, c=distances[shown], cmap=distance_colours(), vmin=0.0, vmax=far, s=size,
        linewidths=0, alpha=0.9, zorder=3,
    )  # fmt: skip
    return distances


def distance_bar(figure: Any, far: float = 0.012, label: str = "distance from point to surface, mm") -> None:
    """Add the colour scale of distances below the plots of a figure, and make room for it."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    height = figure.get_figheight()
    figure.subplots_adjust(bottom=0.62 / height)
    place = figure.add_axes((0.32, 0.40 / height, 0.36, 0.09 / height))
    bar = figure.colorbar(
        ScalarMappable(Normalize(0.0, 1000 * far), distance_colours()), cax=place, orientation="horizontal", extend="max",
    )  # fmt: skip
    bar.set_label(label, fontsize=8, color=INK)
    bar.ax.tick_params(labelsize=7, colors=INK, length=2)
    bar.outline.set_visible(False)


def frame_together(plots: Any, seen: Sequence[Float[np.ndarray, "V 3"]], titles: Sequence[str]) -> None:
    """Frame all plots by the common bounding box of their contents, each with its title."""
    low, high = np.min([some.min(0) for some in seen], 0)[:2], np.max([some.max(0) for some in seen], 0)[:2]
    for plot, title in zip(plots, titles, strict=True):
        set_frame(plot, low, high, title)


def style_chart(plot: Any, title: str, x_label: str = "", y_label: str = "") -> None:
    """Set the title of a chart, which states its message, its axis labels, and a grid in the background."""
    plot.set_title(title, fontsize=10, color=INK, loc="left", pad=9, fontweight="semibold")
    plot.set_xlabel(x_label, fontsize=8.5, color=INK)
    plot.set_ylabel(y_label, fontsize=8.5, color=INK)
    plot.grid(axis="y", color="#e4e8ed", linewidth=0.8)
    plot.set_axisbelow(True)
    plot.tick_params(which="both", labelsize=8, colors="#52606d", length=0)
    for side in ("top", "right", "left"):
        plot.spines[side].set_visible(False)
    plot.spines["bottom"].set_color("#c3cad3")


def label_point(plot: Any, text: str, at: Any, colour: str = INK, **more: Any) -> None:
    """Label a point with a few words in its colour."""
    plot.annotate(
        text, at, textcoords="offset points", fontsize=8.5, color=colour, **({"xytext": (6, 4)} | more)
    )
