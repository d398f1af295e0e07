"""Figures of a joint's limits: samples, voxels, and the surface around them (Limits, figures 5 and 8)."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..arguments import checked
from ..batched_map import map_batches
from ..io.system.atomic import atomic_path
from ..limits.implicit_surface import LimitSurface
from ..limits.primitives import Primitives, radii, signed_distance
from .pictures import new_figure
from .render import INK, draw_surface, rotate_view, set_frame, view_axes

#: view angle of a quaternion's chart, degrees
VIEW_ANGLE = 30.0
#: number of keyframes that are shown; largest number of samples and cubes in a picture
MAX_KEYFRAMES, MAX_POINTS = 4, 6000
SAMPLE_COLOUR, SURFACE_COLOUR, CONTOUR_COLOUR = "#1c7293", np.array([0.95, 0.76, 0.31]), "#f2803c"
VOXEL_COLOUR = np.array([0.56, 0.72, 0.84])


@checked
def draw_limits(
    path: str | Path,
    surface: LimitSurface,
    points: Float[np.ndarray, "F 3"],
    parent_points: Float[np.ndarray, "F 3"] | None = None,
) -> None:
    """Write a PNG of one joint's limits with the samples from which they were learned, in its chart.

    For an independent joint it shows samples, voxels and surface. For one with a parent it shows the same at
    some keyframes, in descending order of their numbers of samples.

    **Raises:** `InputError` if the file cannot be written.
    """
    if surface.parent is None or parent_points is None:
        shown, near = [0], [np.ones(len(points), bool)]
    else:
        totals = np.asarray(surface.counts.sum(1))
        shown = np.argsort(-totals)[:MAX_KEYFRAMES].tolist()
        keys = np.asarray(surface.keys)
        home = np.argmin(((parent_points[:, None] - keys[None]) ** 2).sum(-1), 1)
        near = [home == key for key in shown]
    flat = surface.chart.dimension < 3
    columns = 1 if flat else 3
    canvas, figure = new_figure(
        4.2 * columns + (2.2 if flat else 0.3),
        (1.6 if surface.chart.dimension == 1 else 3.9) * len(shown) + 1.1,
    )
    plots = figure.subplots(len(shown), columns, squeeze=False)
    for row, (key, samples) in enumerate(zip(shown, near, strict=True)):
        primitives = _at_keyframe(surface, key)
        draw = _draw_flat if flat else _draw_solid
        draw(plots[row], surface, primitives, points[samples])
        if surface.parent is not None:
            plots[row, 0].set_title(
                f"{surface.parent} near keyframe {key}: {int(samples.sum())} samples",
                fontsize=9,
                color=INK,
            )
    coupled = "" if surface.parent is None else f", coupled to {surface.parent}"
    count = surface.centres.shape[1]
    figure.suptitle(
        f"{surface.joint}{coupled}\n{len(points)} samples, {count} primitives, voxels of at least "
        f"{np.degrees(4 * float(surface.unit)):.2g} degrees",
        fontsize=10,
        color=INK,
    )
    total = figure.get_figheight()
    figure.subplots_adjust(
        left=0.1 if flat else 0.06,
        right=0.97,
        top=1 - 0.85 / total,
        bottom=0.5 / total,
        wspace=0.08,
        hspace=0.6,
    )
    with atomic_path(Path(path)) as beside:
        canvas.print_png(beside)


def _at_keyframe(surface: LimitSurface, key: int) -> Primitives:
    return Primitives(
        surface.centres[key], surface.thickness[key], surface.unit, surface.level, surface.stiffness
    )


def _draw_solid(plots: Any, surface: LimitSurface, primitives: Primitives, points: np.ndarray) -> None:
    view = rotate_view(view_axes(np.diag([1.0, 2.0, 0.5])), VIEW_ANGLE)
    view = np.array([[1.0, 0, 0], [0, np.cos(0.35), -np.sin(0.35)], [0, np.sin(0.35), np.cos(0.35)]]) @ view
    vertices, faces = surface_mesh(primitives)
    seen = vertices @ view.T
    low, high = seen.min(0)[:2], seen.max(0)[:2]
    dots = points[:: max(1, len(points) // MAX_POINTS)] @ view.T
    plots[0].scatter(dots[:, 0], dots[:, 1], s=1.2, c=SAMPLE_COLOUR, linewidths=0, rasterized=True)
    cubes, sides = _voxel_mesh(primitives, surface)
    draw_surface(plots[1], cubes, sides, view, VOXEL_COLOUR)
    draw_surface(plots[2], vertices, faces, view, SURFACE_COLOUR)
    for plot, title in zip(plots, ("samples, as quaternions", "voxels", "surface"), strict=True):
        set_frame(plot, low, high, title)


def _draw_flat(plots: Any, surface: LimitSurface, primitives: Primitives, points: np.ndarray) -> None:
    """Draw a chart of one angle as a histogram with the allowed range, and one of two angles as a map."""
    plot, reach = plots[0], float(jnp.max(radii(primitives)))
    low = np.asarray(primitives.centres.min(0)) - 3 * reach
    high = np.asarray(primitives.centres.max(0)) + 3 * reach
    if surface.chart.dimension == 1:
        across = np.linspace(low[0], high[0], 400)
        inside = _signed_distances(primitives, np.stack([across, 0 * across, 0 * across], 1)) <= 0
        counts, edges = np.histogram(points[:, 0], bins=80, range=(low[0], high[0]))
        plot.fill_between(
            np.degrees(2 * across), 0, inside * max(counts.max(), 1) * 2, color=SURFACE_COLOUR, linewidth=0, alpha=0.6,
            label="allowed",
        )  # fmt: skip
        plot.stairs(counts, np.degrees(2 * edges), fill=True, color=SAMPLE_COLOUR, label="samples")
        # a logarithmic scale keeps small counts visible
        plot.set_yscale("symlog")
        plot.set_xlabel("angle from the centre, degrees", fontsize=8, color=INK)
        plot.set_ylabel("number of samples", fontsize=8, color=INK)
        plot.legend(
            loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, fontsize=8, labelcolor=INK, frameon=False
        )
    else:
        x, y = (np.linspace(low[i], high[i], 160) for i in range(2))
        grid = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
        distances = _signed_distances(primitives, np.pad(grid, ((0, 0), (0, 1)))).reshape(160, 160)
        plot.contourf(
            np.degrees(2 * x),
            np.degrees(2 * y),
            distances.T,
            levels=[-np.inf, 0],
            colors=[SURFACE_COLOUR],
            alpha=0.6,
        )
        plot.contour(np.degrees(2 * x), np.degrees(2 * y), distances.T, levels=[0], colors=[CONTOUR_COLOUR])
        dots = points[:: max(1, len(points) // MAX_POINTS)]
        plot.scatter(
            np.degrees(2 * dots[:, 0]), np.degrees(2 * dots[:, 1]), s=1.2, c=SAMPLE_COLOUR, linewidths=0
        )
        plot.set_xlabel("first angle, degrees", fontsize=8, color=INK)
        plot.set_ylabel("second angle, degrees", fontsize=8, color=INK)
    plot.tick_params(labelsize=8, colors=INK)
    for side in ("top", "right"):
        plot.spines[side].set_visible(False)


def surface_mesh(primitives: Primitives) -> tuple[Float[np.ndarray, "V 3"], np.ndarray]:
    """Triangulate the surface: a ball around every primitive, expanded to the level, without its interior."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=2)
    centres, reach = np.asarray(primitives.centres, float), np.asarray(radii(primitives), float)
    # coincident primitives are drawn once
    _, once = np.unique(np.round(np.column_stack([centres, reach]), 6), axis=0, return_index=True)
    centres, reach = centres[once], reach[once]
    further = 1.6 * float(primitives.unit) / float(primitives.stiffness) * float(primitives.level)
    directions = np.asarray(ball.vertices, float)
    low = np.broadcast_to(reach[:, None], (len(centres), len(directions))).copy()
    high = low + further
    place = lambda at: (centres[:, None] + at[..., None] * directions).reshape(-1, 3)  # noqa: E731
    buried = _signed_distances(primitives, place(high)).reshape(low.shape) <= 0
    for _ in range(8):
        middle = (low + high) / 2
        inside = _signed_distances(primitives, place(middle)).reshape(low.shape) <= 0
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    faces = (np.asarray(ball.faces)[None] + len(directions) * np.arange(len(centres))[:, None, None]).reshape(
        -1, 3
    )
    return place(low), faces[~buried.reshape(-1)[faces].all(1)]


def _voxel_mesh(primitives: Primitives, surface: LimitSurface) -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    box = trimesh.creation.box()
    centres = np.asarray(primitives.centres, float)
    widths = 2 * np.asarray(radii(primitives), float) / np.sqrt(surface.chart.dimension)
    vertices = centres[:, None] + widths[:, None, None] * np.asarray(box.vertices, float)
    faces = np.asarray(box.faces)[None] + 8 * np.arange(len(centres))[:, None, None]
    return vertices.reshape(-1, 3), faces.reshape(-1, 3)


def _signed_distances(primitives: Primitives, points: np.ndarray) -> np.ndarray:
    return np.asarray(_map_signed_distance(primitives, jnp.asarray(points)))


@jax.jit
def _map_signed_distance(primitives: Primitives, points):
    return map_batches(lambda place: signed_distance(primitives, place), points, 256)
