"""The correctives of a learned body in its report: a picture, and numbers for each joint."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...arguments import checked
from ...body.body import Body
from ...body.skin import CorrectedSkin
from ...body.skin.corrected import corrective_units
from ...io.system.atomic import atomic_path
from ...learn.correctives.learn_correctives import LearnedCorrectives
from ..pictures import HEAT_COLOURS, new_figure, round_up
from ..render import INK, draw_surface, rotate_view, set_frame, view_axes

#: degrees of the views of the surface
VIEWS = (25.0, 205.0)
#: colours of errors without and with correctives, and of the largest and the root mean square displacements
COLOURS = ("#e8743b", "#2a5fd0")


@checked
def corrective_picture(path: str | Path, found: LearnedCorrectives) -> Path:
    """Draw how far correctives move the surface, where and by which joints, and the errors of left-out poses.

    Without used correctives only the errors are drawn.

    **Raises:** `InputError` if the file cannot be written.
    """
    canvas, figure = new_figure(13.0, 8.0)
    figure.set_layout_engine("constrained", w_pad=0.15, h_pad=0.08)
    grid = figure.add_gridspec(2, 4, height_ratios=(2.2, 1.0))
    if found.is_used:
        _draw_surfaces(figure, [figure.add_subplot(grid[0, column]) for column in (0, 1)], found)
        _draw_joints(figure.add_subplot(grid[0, 2:]), found)
    _draw_errors(figure.add_subplot(grid[1, :]), found)
    with atomic_path(Path(path)) as part:
        canvas.print_png(part)
    return Path(path)


def corrective_report(found: LearnedCorrectives) -> dict[str, Any]:
    """Convert the evidence for correctives to a dictionary for JSON, in metres."""
    choice, joints = found.choice, found.by_joint
    return {
        "used": found.is_used,
        "strength": choice.strength,
        "rank": choice.rank,
        "left_out_vertex_rmse": {"without": choice.error_without, "with": choice.error_with},
        "left_out_vertex_rmse_per_mesh": {
            "without": choice.errors_without.tolist(),
            "with": choice.errors_with.tolist(),
        },
        "joints": [
            {"joint": name, "rank": int(rank), "largest": float(largest), "rms": float(rms)}
            for name, rank, largest, rms in zip(
                joints.names, joints.ranks, joints.largest, joints.rms, strict=True
            )
        ],
    }


def largest_displacements(found: LearnedCorrectives) -> Float[np.ndarray, "V"]:
    """Compute the largest displacement of each vertex over the poses of the meshes, metres."""
    skin = found.body.skin
    if not isinstance(skin, CorrectedSkin):
        return np.zeros(len(found.body.vertices))
    directions = np.asarray(skin.directions, float)
    largest = np.zeros(len(directions))
    for units in np.asarray(corrective_units(skin, found.motion.poses), float):
        largest = np.maximum(largest, np.linalg.norm(directions @ units, axis=1))
    return largest


def _draw_surfaces(figure: Any, plots: list[Any], found: LearnedCorrectives) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    body: Body = found.body
    vertices, faces = np.asarray(body.vertices, float), np.asarray(body.faces)
    moved = 1000 * largest_displacements(found)
    colours = LinearSegmentedColormap.from_list("heat", HEAT_COLOURS)
    scale = Normalize(0.0, round_up(float(np.quantile(moved, 0.98))))
    axes = view_axes(vertices)
    for plot, degrees in zip(plots, VIEWS, strict=True):
        view = rotate_view(axes, degrees)
        draw_surface(plot, vertices, faces, view, colours(scale(moved))[:, :3])
        seen = vertices @ view.T
        set_frame(plot, seen.min(0)[:2], seen.max(0)[:2])
    bar = figure.colorbar(
        ScalarMappable(scale, colours), ax=plots, orientation="horizontal", extend="max", aspect=40
    )
    bar.set_label("largest displacement over the poses, millimetres", fontsize=9, color=INK)
    bar.ax.tick_params(labelsize=8, colors=INK)


def _draw_joints(plot: Any, found: LearnedCorrectives) -> None:
    joints = found.by_joint
    rows = np.arange(len(joints.names))
    plot.barh(rows - 0.2, 1000 * joints.largest, 0.4, color=COLOURS[0], label="largest")
    plot.barh(rows + 0.2, 1000 * joints.rms, 0.4, color=COLOURS[1], label="root mean square")
    plot.set_yticks(rows, joints.names, fontsize=7)
    plot.invert_yaxis()
    _style(plot, "displacement by the rotation of the joint, mm", "")


def _draw_errors(plot: Any, found: LearnedCorrectives) -> None:
    choice = found.choice
    for label, errors, colour in (
        ("without correctives", choice.errors_without, COLOURS[0]),
        ("with correctives", choice.errors_with, COLOURS[1]),
    ):
        plot.plot(np.arange(len(errors)), 1000 * errors, ".-", color=colour, linewidth=1.2, label=label)
    plot.set_ylim(bottom=0)
    plot.set_title("each mesh, with its fold left out of the fit", fontsize=9, color=INK)
    _style(plot, "mesh", "vertex RMSE, mm")


def _style(plot: Any, x: str, y: str) -> None:
    plot.set_xlabel(x, fontsize=9, color=INK)
    plot.set_ylabel(y, fontsize=9, color=INK)
    plot.tick_params(axis="x", labelsize=8, colors=INK)
    plot.grid(alpha=0.25)
    for side in ("top", "right"):
        plot.spines[side].set_visible(False)
    plot.legend(frameon=False, fontsize=8)
