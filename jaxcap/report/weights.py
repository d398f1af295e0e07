"""Figures of a body's skin and joints (Adaptation, fig. 3.7)."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..arguments import checked
from ..body.body import Body
from ..body.skin import SwingTwistSkin
from ..geometry import rotation
from ..io.system.atomic import atomic_path
from ..learn.skeleton.given_centres import GivenCentres
from .pictures import new_figure
from .render import INK, distinct_colours, draw_surface, rotate_view, set_frame, view_axes

#: colours of the axes x (twist), y and z of a joint; degrees of the two views
AXES, VIEWS = ("#d7263d", "#2e9e4f", "#2a5fd0"), (25.0, 115.0)
#: degrees of the views of a skeleton
SIDES = (0.0, 90.0, 45.0)
NEUTRAL = np.array([0.86, 0.86, 0.86])


@checked
def weight_pictures(folder: str | Path, body: Body) -> list[Path]:
    """Write `weights.png`: parts, weights and joints of a body at rest, from two sides. Returns the files.

    Every joint has a colour. A vertex mixes those of its joints by their weights. For a swing-twist skin,
    swing and twist weights are shown separately; grey is the share that only the base bone moves.

    **Raises:** `InputError` if a file cannot be written.
    """
    count = body.skeleton.num_joints
    palette = distinct_colours(count)
    skin = body.skin
    panels: list[tuple[str, Float[np.ndarray, "V 3"]]]
    if isinstance(skin, SwingTwistSkin):
        panels = [("base parts", palette[np.asarray(skin.bases)])]
        for label, weights in (("swing weights", skin.swing), ("twist weights", skin.twist)):
            shares = np.asarray(weights, float)
            left = np.clip(1.0 - shares.sum(1, keepdims=True), 0.0, 1.0)
            panels.append((label, shares @ palette + left * NEUTRAL))
    else:
        panels = [
            ("parts", palette[np.asarray(skin.dominant_bones())]),
            ("weights", np.asarray(skin.bone_weights(count), float) @ palette),
        ]
    path = Path(folder) / "weights.png"
    with atomic_path(path) as beside:
        _draw(beside, body, panels, palette)
    return [path]


@checked
def skeleton_picture(path: str | Path, body: Body, given: GivenCentres | None = None) -> Path:
    """Draw the skeleton of a body inside its surface from three sides, with the names of the joints that move.

    Hollow circles are `given` positions, where the anatomy or another skeleton has the joints.

    **Raises:** `InputError` if the file cannot be written.
    """
    vertices, faces = np.asarray(body.vertices, float), np.asarray(body.faces)
    views = [rotate_view(view_axes(vertices), degrees) for degrees in SIDES]
    boxes = [((vertices @ view.T).min(0)[:2], (vertices @ view.T).max(0)[:2]) for view in views]
    palette = distinct_colours(body.skeleton.num_joints)
    canvas, figure = new_figure(13.0, 7.5)
    for plot, view, box in zip(figure.subplots(1, len(views), squeeze=False)[0], views, boxes, strict=True):
        draw_surface(plot, vertices, faces, view, opacity=0.3)
        _draw_skeleton(plot, body, view, palette, 0.0)
        centres = np.asarray(body.skeleton.centres, float) @ view.T
        if given is not None:
            before = np.asarray(given.centres, float) @ view.T
            plot.scatter(before[:, 0], before[:, 1], s=46, facecolors="none", edgecolors=INK, zorder=7)
        for name, kind, centre in zip(body.skeleton.names, body.skeleton.kinds, centres, strict=True):
            if kind != "fixed":
                plot.annotate(name, centre[:2], (4, 3), textcoords="offset points", fontsize=5.5, zorder=8)
        set_frame(plot, *box)
    figure.subplots_adjust(left=0.005, right=0.995, top=0.99, bottom=0.01, wspace=0.02)
    with atomic_path(Path(path)) as part:
        canvas.print_png(part)
    return Path(path)


def _draw(path: Path, body: Body, panels: list[tuple[str, np.ndarray]], palette: np.ndarray) -> None:
    vertices, faces = np.asarray(body.vertices, float), np.asarray(body.faces)
    axes = view_axes(vertices)
    views = [rotate_view(axes, degrees) for degrees in VIEWS]
    boxes = [((vertices @ view.T).min(0)[:2], (vertices @ view.T).max(0)[:2]) for view in views]
    width, height = (max(high[side] - low[side] for low, high in boxes) for side in (0, 1))
    wide = float(np.clip(4.2 * width / height, 1.9, 6.0))
    count = len(panels) + 1
    canvas, figure = new_figure(wide * count, len(views) * min(4.2, wide * height / width) + 0.5)
    plots = figure.subplots(len(views), count, squeeze=False)
    for row, (view, box) in enumerate(zip(views, boxes, strict=True)):
        for plot, (label, paint) in zip(plots[row], panels, strict=False):
            draw_surface(plot, vertices, faces, view, paint)
            set_frame(plot, *box, label if row == 0 else "")
        draw_surface(plots[row, -1], vertices, faces, view, opacity=0.35)
        _draw_skeleton(plots[row, -1], body, view, palette, 0.035 * height)
        set_frame(plots[row, -1], *box, "joints, twist axis red" if row == 0 else "")
    figure.subplots_adjust(left=0.005, right=0.995, top=0.955, bottom=0.01, wspace=0.02, hspace=0.02)
    canvas.print_png(path)


def _draw_skeleton(plot: Any, body: Body, view: np.ndarray, palette: np.ndarray, length: float) -> None:
    """Draw bones as lines, joints as dots, and the axes of each joint's own frame, x longest."""
    skeleton = body.skeleton
    centres = np.asarray(skeleton.centres, float) @ view.T
    frames = np.asarray(rotation.to_matrix(skeleton.orientations), float)
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            ends = centres[[parent, joint]]
            plot.plot(ends[:, 0], ends[:, 1], color=INK, linewidth=1.6, solid_capstyle="round", zorder=4)
        for axis, colour in enumerate(AXES):
            reach = length * (1.6 if axis == 0 else 0.8)
            end = centres[joint] + reach * (view @ frames[joint][:, axis])
            plot.plot(
                [centres[joint, 0], end[0]],
                [centres[joint, 1], end[1]],
                color=colour,
                linewidth=1.3,
                zorder=5,
            )
    plot.scatter(centres[:, 0], centres[:, 1], c=palette, s=26, edgecolors=INK, linewidths=0.7, zorder=6)
