"""A strip of frames: a motion before and after a change (Limits, figures 9 and 10)."""

from pathlib import Path

import numpy as np

from ..arguments import checked
from ..body.kinematics import joint_paths
from ..body.pose import Motion
from ..body.skeleton import Skeleton
from ..geometry.sampling import even_indices
from ..io.system.atomic import atomic_path
from .pictures import new_figure
from .render import INK, set_frame, view_axes

#: frames in a strip; colours of bones, and of bones below marked joints
MAX_FRAMES, BONE_COLOUR, MARKED_COLOUR = 8, "#5b6770", "#c81d25"


@checked
def draw_strip(
    path: str | Path,
    skeleton: Skeleton,
    before: Motion,
    after: Motion,
    marked: np.ndarray,
    title: str = "",
) -> None:
    """Write a PNG with frames of a motion in two rows, before and after a change.

    In the upper row the joints in `marked (F, J)` are red. The frames are evenly chosen from those with a
    marked joint.

    **Raises:** `InputError` if the file cannot be written.
    """
    chosen = np.flatnonzero(marked.any(1))
    chosen = chosen if len(chosen) else np.arange(len(before))
    chosen = chosen[even_indices(len(chosen), MAX_FRAMES)]
    rows = [np.asarray(joint_paths(skeleton, motion.poses), float)[chosen] for motion in (before, after)]
    axes = view_axes(rows[0][0])
    canvas, figure = new_figure(1.7 * len(chosen) + 0.3, 5.4)
    plots = figure.subplots(2, len(chosen), squeeze=False)
    for row, joints in enumerate(rows):
        for column, number in enumerate(chosen):
            seen = (joints[column] - rows[0][column].mean(0)) @ axes.T
            plot = plots[row, column]
            for child, parent in enumerate(skeleton.parents):
                if parent < 0:
                    continue
                red = row == 0 and marked[number, parent]
                plot.plot(*seen[[parent, child], :2].T, color=MARKED_COLOUR if red else BONE_COLOUR, lw=2.6 if red else 1.6,
                          solid_capstyle="round")  # fmt: skip
            reach = (rows[0] - rows[0].mean(1, keepdims=True)) @ axes.T
            set_frame(
                plot, reach.min((0, 1))[:2], reach.max((0, 1))[:2], f"frame {number}" if row == 0 else ""
            )
    figure.suptitle(title, fontsize=11, color=INK)
    figure.subplots_adjust(left=0.01, right=0.99, top=0.88, bottom=0.02, wspace=0.02, hspace=0.04)
    with atomic_path(Path(path)) as beside:
        canvas.print_png(beside)
