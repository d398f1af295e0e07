"""Heat maps of the distance from registered meshes to a body (Adaptation, figs. 3.8 and 3.9)."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..body.body import Body, posed_vertices
from ..body.pose import Motion
from ..geometry.sampling import even_indices
from ..io.system.atomic import atomic_path
from ..metrics import scan_to_surface
from ..observe.meshes import MeshSequence
from .render import INK, PAPER, draw_surface, rotate_view, set_frame, view_axes
from .scores import Scores

#: number of meshes in a picture, and angles of the views from the front and the side, degrees
MAX_MESHES, VIEWS = 5, (25.0, 115.0)
MESH_COLOUR = np.array([1.0, 0.86, 0.48])
HEAT_COLOURS = ("#4f7fd1", "#45b3d6", "#8fdcae", "#ffe066", "#ff8a45", "#cf2434")


def error_pictures(
    folder: str | Path,
    body: Body,
    motion: Motion,
    sequence: MeshSequence,
    scores: Scores,
    name: str = "error",
) -> list[Path]:
    """Write `error.png`: some meshes, and below them the posed body from two sides. Returns the files.

    Colours are the distances from the vertices of the mesh to the body's surface. The meshes are the best,
    the worst and evenly spaced ones between, by mean distance.

    **Raises:** `InputError` if a file cannot be written.
    """
    fitted = [number for number, score in enumerate(scores.meshes) if score.fitted]
    if not fitted:
        return []
    ranked = sorted(fitted, key=lambda number: scores.meshes[number].mean)
    shown = [ranked[i] for i in even_indices(len(ranked), MAX_MESHES, nearest=True)]
    meshes = [np.asarray(sequence[number], float) for number in shown]
    posed = [np.asarray(posed_vertices(body, motion[number]), float) for number in shown]
    faces = np.asarray(body.faces)
    heat = [1000 * scan_to_surface(there, here, faces) for there, here in zip(meshes, posed, strict=True)]
    titles = [
        f"{_short_name(scores.meshes[number].name)}\n{1000 * scores.meshes[number].mean:.1f} ± "
        f"{1000 * scores.meshes[number].sd:.1f} mm"
        for number in shown
    ]
    path = Path(folder) / f"{name}.png"
    label = (
        "distance of the meshes to the body"
        if name == "error"
        else name.removeprefix("error-").replace("-", " ")
    )
    with atomic_path(path) as beside:
        _draw(beside, faces, meshes, posed, heat, titles, f"{label}: mean {1000 * scores.mean:.2f} mm, standard deviation "
              f"{1000 * scores.sd:.2f} mm over {len(scores.meshes)} meshes")  # fmt: skip
    return [path]


def _draw(
    path: Path,
    faces: np.ndarray,
    meshes: list[np.ndarray],
    posed: list[np.ndarray],
    heat: list[np.ndarray],
    titles: list[str],
    title: str,
) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    colours = LinearSegmentedColormap.from_list("heat", HEAT_COLOURS)
    scale = Normalize(0.0, round_up(float(np.quantile(np.concatenate(heat), 0.98))))
    axes = view_axes(np.median(meshes, axis=0))
    middles = [0.5 * (mesh.min(0) + mesh.max(0)) for mesh in meshes]
    meshes, posed = (
        [mesh - middle for mesh, middle in zip(some, middles, strict=True)] for some in (meshes, posed)
    )
    rows = [(meshes, VIEWS[0], None), *((posed, degrees, heat) for degrees in VIEWS)]
    boxes = [
        _bounding_box([mesh @ rotate_view(axes, degrees).T for mesh in shapes]) for shapes, degrees, _ in rows
    ]
    width = max(high[0] - low[0] for low, high in boxes)
    height = max(high[1] - low[1] for low, high in boxes)
    wide = float(np.clip(2.6 * width / height, 1.1, 4.0))
    canvas, figure = new_figure(max(wide * len(meshes), 5.5), 2.75 * len(rows) + 1.5)
    plots = figure.subplots(len(rows), len(meshes), squeeze=False)
    for number, (shapes, degrees, values) in enumerate(rows):
        low, high = boxes[number]
        for column, plot in enumerate(plots[number]):
            paint = MESH_COLOUR if values is None else colours(scale(values[column]))[:, :3]
            draw_surface(plot, shapes[column], faces, rotate_view(axes, degrees), paint)
            set_frame(plot, low, high, titles[column] if number == 0 else "")
    total = figure.get_figheight()
    figure.suptitle(title, fontsize=12, color=INK, y=1 - 0.2 / total)
    figure.subplots_adjust(
        left=0.01, right=0.99, top=1 - 0.95 / total, bottom=0.75 / total, wspace=0.02, hspace=0.03
    )
    place = figure.add_axes((0.25, 0.48 / total, 0.5, 0.11 / total))
    bar = figure.colorbar(ScalarMappable(scale, colours), cax=place, orientation="horizontal", extend="max")
    bar.set_label("distance from vertex to surface, millimetres", fontsize=9, color=INK)
    bar.ax.tick_params(labelsize=8, colors=INK, length=2)
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    canvas.print_png(path)


def new_figure(width: float, height: float) -> tuple[Any, Any]:
    """Create a canvas that writes PNG, and its figure, in inches, without a window system."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=150, facecolor=PAPER)
    return FigureCanvasAgg(figure), figure


def _short_name(name: str) -> str:
    """Shorten the name of a mesh to that without its folder, or to that within its file."""
    return name[name.index("[") + 1 : -1] if name.endswith("]") and "[" in name else Path(name).name


def round_up(value: float) -> float:
    """Round up to 1, 2, 3, 5 or 10 times a power of ten; 1 for values that are not positive."""
    if not value > 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(step * power for step in (1, 2, 3, 5, 10) if step * power >= value))


def _bounding_box(shapes: list[np.ndarray]) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    return np.min([mesh.min(0) for mesh in shapes], 0)[:2], np.max([mesh.max(0) for mesh in shapes], 0)[:2]
