"""Shaded surfaces in figures: depth-sorted triangles, coloured by vertex, with shadows; visible points."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ..geometry.mesh import area_normals, vertex_normals

PAPER, INK, CLAY = "#ffffff", "#1f2933", np.array([0.80, 0.79, 0.76])
#: direction towards the light in the view frame, and strength: from the upper left, and a weaker one from the
#: right
LIGHTS = ((np.array([-0.45, 0.65, 0.61]), 0.58), (np.array([0.80, 0.05, 0.45]), 0.20))
AMBIENT = 0.36
#: strength and exponent of the specular reflection of the upper left light
GLOSS, GLOSS_EXPONENT = 0.10, 18
#: meshes with fewer triangles are subdivided once, for smooth shading
MIN_FACES = 9_000
#: colour of a shadow, and the light's direction for shadows, metres per metre down
SHADOW, SHADOW_DIRECTION = "#e2e6ec", np.array([0.22, -1.0, -0.32])


def view_axes(vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "3 3"]:
    """Choose a view of an upright body from the front: its longest side up, its shallowest towards the eye.

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


def rotate_view(axes: Float[np.ndarray, "3 3"], degrees: float) -> Float[np.ndarray, "3 3"]:
    """Rotate the body in a view about the vertical, to its left for positive degrees."""
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
    """Draw the triangles that face the eye into matplotlib axes, with smooth shading; return the vertices in
    view coordinates."""
    from matplotlib.collections import PolyCollection

    seen = whole = np.asarray(vertices, float) @ view.T
    faces, colours = np.asarray(faces), np.broadcast_to(colours, seen.shape)
    if len(faces) < MIN_FACES:
        seen, faces, colours = _subdivide(seen, faces, colours)
    corners = seen[faces]
    normals = vertex_normals(seen, faces)
    light = np.full(len(seen), AMBIENT)
    for direction, strength in LIGHTS:
        light += strength * np.clip(normals @ (direction / np.linalg.norm(direction)), 0.0, 1.0)
    between = LIGHTS[0][0] / np.linalg.norm(LIGHTS[0][0]) + np.array([0.0, 0.0, 1.0])
    gloss = GLOSS * np.clip(normals @ (between / np.linalg.norm(between)), 0.0, 1.0) ** GLOSS_EXPONENT
    shaded = np.clip(colours * light[:, None] + gloss[:, None], 0.0, 1.0)
    front = np.flatnonzero(area_normals(corners)[:, 2] > 0)
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
    return whole


def draw_shadow(
    plot: Any,
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "T 3"],
    view: Float[np.ndarray, "3 3"],
    floor: float | None = None,
) -> Float[np.ndarray, "V 3"]:
    """Draw the shadow of a surface on the floor; return its vertices in view coordinates.

    `floor` is the height of the floor, metres along y; below its lowest vertex if None. A `view` from above
    (`raise_view`) shows the shadow.
    """
    from matplotlib.collections import PolyCollection

    vertices = np.asarray(vertices, float)
    height = vertices[:, 1] - (vertices[:, 1].min() if floor is None else floor)
    seen = (vertices + np.maximum(height, 0.0)[:, None] * SHADOW_DIRECTION) @ view.T
    plot.add_collection(
        PolyCollection(
            list(seen[np.asarray(faces)][..., :2]), facecolors=SHADOW, edgecolors=SHADOW, linewidths=0.6,
            rasterized=True, zorder=1,
        )
    )  # fmt: skip
    return seen


def raise_view(view: Float[np.ndarray, "3 3"], degrees: float) -> Float[np.ndarray, "3 3"]:
    """Rotate a view so that the eye looks down by an angle, degrees."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ view


def visible_points(
    vertices: Float[np.ndarray, "V 3"], points: Float[np.ndarray, "N 3"], cell: float = 0.03
) -> Int[np.ndarray, "M"]:
    """Find the points that a surface does not hide; return their indices, far ones first.

    Points and vertices are in view coordinates. A point is hidden by the nearest vertex of its grid `cell`,
    metres.
    """
    corner = np.minimum(vertices.min(0), points.min(0))[:2]
    cells, asked = (np.floor((some[:, :2] - corner) / cell).astype(int) for some in (vertices, points))
    shape = np.maximum(cells.max(0), asked.max(0)) + 1
    nearest = np.full(shape, -np.inf)
    np.maximum.at(nearest, tuple(cells.T), vertices[:, 2])
    open_ones = np.flatnonzero(points[:, 2] > nearest[tuple(asked.T)] - cell)
    return open_ones[np.argsort(points[open_ones, 2])]


def set_frame(plot: Any, low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"], title: str = "") -> None:
    """Set the limits of axes to a bounding box with a margin, hide their lines, and set a title."""
    margin = 0.04 * float((high - low).max())
    plot.set(
        xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin), aspect="equal"
    )
    plot.set_axis_off()
    if title:
        plot.set_title(title, fontsize=9.5, color=INK)


def _subdivide(seen: np.ndarray, faces: np.ndarray, colours: np.ndarray) -> tuple[np.ndarray, ...]:
    """Subdivide each triangle into four, at the midpoints of its edges."""
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
    once, which = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True)
    middles = len(seen) + which.reshape(-1, 3)
    a, b, c = faces.T
    ab, bc, ca = middles.T
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return (
        np.concatenate([seen, seen[once].mean(1)]),
        np.concatenate([np.stack(corners, 1) for corners in quarters]),
        np.concatenate([colours, colours[once].mean(1)]),
    )


def distinct_colours(count: int) -> Float[np.ndarray, "K 3"]:
    """Generate distinct colours, most of all for consecutive numbers."""
    from matplotlib.colors import hsv_to_rgb

    number = np.arange(count)
    hues = (0.58 + 0.6180339887 * number) % 1.0
    return hsv_to_rgb(np.stack([hues, 0.52 + 0.2 * (number % 3 == 1), 0.95 - 0.2 * (number % 3 == 2)], 1))
