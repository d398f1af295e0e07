"""Shaded surfaces in pictures: triangles from far to near, coloured by vertex."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

PAPER, INK, CLAY = "#ffffff", "#1f2933", np.array([0.80, 0.79, 0.76])
#: from the upper left, and a weaker one from the right; towards the light, in the frame of the eye
LIGHTS = ((np.array([-0.45, 0.65, 0.61]), 0.58), (np.array([0.80, 0.05, 0.45]), 0.20))
AMBIENT = 0.36


def view_axes(vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "3 3"]:
    """The rotation that shows a body upright from the front: its longest side up, its shallowest to the eye.

    Rows are right, up, and towards the eye.
    """
    sides = np.ptp(vertices, axis=0)
    up = int(np.argmax(sides))
    rest = [axis for axis in range(3) if axis != up]
    depth = min(rest, key=lambda axis: sides[axis])
    axes = np.zeros((3, 3))
    axes[1, up], axes[2, depth] = 1.0, 1.0
    axes[0] = np.cross(axes[1], axes[2])
    return axes


def turned(axes: Float[np.ndarray, "3 3"], degrees: float) -> Float[np.ndarray, "3 3"]:
    """The same view after the body is turned about the vertical, to its left for positive degrees."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ axes


def draw_surface(
    plot: Any,
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "T 3"],
    view: Float[np.ndarray, "3 3"],
    colours: Float[np.ndarray, "V 3"] | Float[np.ndarray, "3"] = CLAY,
    opacity: float = 1.0,
) -> Float[np.ndarray, "V 3"]:
    """Draw the triangles that face the eye into matplotlib axes, smoothly lit; returns the vertices as seen."""
    from matplotlib.collections import PolyCollection

    seen = np.asarray(vertices, float) @ view.T
    corners = seen[faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(seen)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], flat)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    light = np.full(len(seen), AMBIENT)
    for direction, strength in LIGHTS:
        light += strength * np.clip(normals @ (direction / np.linalg.norm(direction)), 0.0, 1.0)
    shaded = np.clip(np.broadcast_to(colours, seen.shape) * light[:, None], 0.0, 1.0)
    front = np.flatnonzero(flat[:, 2] > 0)
    front = front[np.argsort(corners[front, :, 2].mean(1))]
    paint = shaded[faces[front]].mean(1)
    plot.add_collection(
        PolyCollection(
            list(corners[front, :, :2]),
            facecolors=paint,
            edgecolors=paint if opacity == 1.0 else "none",
            linewidths=0.3,
            alpha=opacity,
            rasterized=True,
            zorder=2,
        )
    )
    return seen


def frame(plot: Any, low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"], title: str = "") -> None:
    """Axes without lines around what is shown, as wide as it is."""
    margin = 0.04 * float((high - low).max())
    plot.set(
        xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin), aspect="equal"
    )
    plot.set_axis_off()
    if title:
        plot.set_title(title, fontsize=9.5, color=INK)


def distinct_colours(count: int) -> Float[np.ndarray, "K 3"]:
    """Colours that differ, neighbours in number most."""
    from matplotlib.colors import hsv_to_rgb

    number = np.arange(count)
    hues = (0.58 + 0.6180339887 * number) % 1.0
    return hsv_to_rgb(np.stack([hues, 0.52 + 0.2 * (number % 3 == 1), 0.95 - 0.2 * (number % 3 == 2)], 1))
