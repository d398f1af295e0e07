"""A figure of the frames in which each marker is observed."""

from pathlib import Path

import numpy as np

from ...io.system.atomic import atomic_path
from ...observe.markers import MarkerFrames
from ..pictures import new_figure
from ..render import INK

SEEN_COLOUR, GAP_COLOUR = (0.16, 0.24, 0.36), (0.97, 0.93, 0.88)
#: height of a marker's row, inches, and largest number of rows with a label
ROW_HEIGHT, MAX_LABELS = 0.16, 150
#: largest number of columns of the picture, over which frames are grouped
MAX_COLUMNS = 1600


def draw_gaps(path: str | Path, frames: MarkerFrames, title: str = "markers") -> None:
    """Write a PNG: a row for each marker, time to the right, dark where it is observed.

    If several frames share one column, a gap in any of them is drawn, so that no gap is hidden.

    **Raises:** `InputError` if the file cannot be written.
    """
    seen = np.asarray(frames.visible)
    count = seen.shape[1]
    parts = np.linspace(0, len(seen), min(MAX_COLUMNS, len(seen)) + 1).astype(int)[:-1]
    visible = np.logical_and.reduceat(seen, parts, axis=0).T
    rows = min(count, MAX_LABELS)
    canvas, figure = new_figure(11.0, max(ROW_HEIGHT * rows, 1.0) + 1.3)
    plot = figure.add_axes((0.14, 0.7 / figure.get_figheight(), 0.83, 1 - 1.3 / figure.get_figheight()))
    colours = np.where(visible[..., None], np.array(SEEN_COLOUR), np.array(GAP_COLOUR))
    plot.imshow(
        colours,
        aspect="auto",
        interpolation="nearest" if count <= MAX_LABELS else "antialiased",
        extent=(0, len(seen) / frames.rate, count - 0.5, -0.5),
    )
    step = -(-count // MAX_LABELS)
    # a dollar sign would begin a formula
    labels = [label.replace("$", r"\$") for label in frames.labels]
    plot.set_yticks(range(0, count, step), labels[::step], fontsize=6.5, color=INK)
    plot.tick_params(length=0, colors=INK)
    plot.tick_params(axis="x", labelsize=8)
    plot.set_xlabel("seconds", fontsize=9, color=INK)
    for y in np.arange(0.5, count - 1) if count <= MAX_LABELS else ():
        plot.axhline(y, color="white", linewidth=0.4)
    for side in plot.spines.values():
        side.set_visible(False)
    plot.set_title(
        f"{title.replace('$', chr(92) + '$')}: {count} markers, {100 * seen.mean():.2f} % observed",
        fontsize=11,
        color=INK,
    )
    with atomic_path(path) as beside:
        canvas.print_png(beside)
