"""The report of a learned body: figures as JSON, and pictures of errors, weights and curves."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...arguments import checked
from ...body.body import Body
from ...body.pose import Motion
from ...io.system.atomic import atomic_path
from ...io.table import write_json
from ...learn.anatomy.joint_evidence import JointEvidence
from ...learn.correctives.learn_correctives import LearnedCorrectives
from ...learn.learn_body import COARSE_PREFIX
from ...learn.skeleton.given_centres import GivenCentres
from ...learn.symmetry.surface_symmetry import SurfaceSymmetry
from ...observe.meshes import MeshSequence
from ..pictures import error_pictures, new_figure
from ..render import INK
from ..scores import Scores
from ..weights import skeleton_picture, weight_pictures
from .correctives import corrective_picture, corrective_report

#: colours of the steps of a round, in their order
STEP_COLOURS = ("#2a5fd0", "#e8743b", "#2e9e4f", "#8f4fb0", "#b3202c", "#17a398", "#c9a227", "#555555")


@checked
def report_learning(
    folder: str | Path,
    body: Body,
    groups: Mapping[str, tuple[Motion, MeshSequence, Scores]],
    history: Sequence[tuple[str, float]],
    curve: Float[np.ndarray, "N"] | None,
    settings: Mapping[str, object],
    evidence: JointEvidence | None = None,
    given: GivenCentres | None = None,
    correctives: LearnedCorrectives | None = None,
    symmetry: tuple[SurfaceSymmetry | None, str] = (None, ""),
) -> list[Path]:
    """Write `report.json` and pictures into an existing folder; return the pictures.

    **Arguments:** `groups` of meshes by name, such as training and held out; `history` the objective after
    every step; `curve` the root mean square error of 1, 2, ... rigid parts, metres, if parts were computed; `evidence` of the
    meshes for the joints, and their `given` positions, for `skeleton.png`; `correctives` of the body, for `correctives.png`;
    the `symmetry` of the surface with its sentence.

    **Raises:** `InputError` if a file cannot be written.
    """
    folder = Path(folder)
    pictures = [
        path
        for label, (motion, sequence, scores) in groups.items()
        for path in error_pictures(folder, body, motion, sequence, scores, f"error-{label.replace(' ', '-')}")
    ]
    pictures += weight_pictures(folder, body)
    if evidence is not None:
        pictures.append(skeleton_picture(folder / "skeleton.png", body, given))
    if correctives is not None:
        pictures.append(corrective_picture(folder / "correctives.png", correctives))
    if len(history):
        pictures.append(_plot_history(folder / "history.png", history))
    known = None if curve is None or not len(curve) else np.asarray(curve, float)
    if known is not None:
        pictures.append(_plot_curve(folder / "parts.png", known, body.skeleton.num_joints))
    write_json(
        folder / "report.json",
        {
            "settings": dict(settings),
            "vertices": int(body.vertices.shape[0]),
            "joints": {
                "names": list(body.skeleton.names),
                "parents": list(body.skeleton.parents),
                "kinds": list(body.skeleton.kinds),
                "centres": np.asarray(body.skeleton.centres, float).tolist(),
            },
            "evidence": None if evidence is None else _evidence_rows(evidence, given is not None),
            "symmetry": _symmetry_report(*symmetry),
            "correctives": None if correctives is None else corrective_report(correctives),
            "history": [{"step": step, "Q": float(value)} for step, value in history],
            "parts_rms": None if known is None else known.tolist(),
            "scores": {label: scores.report() for label, (_, _, scores) in groups.items()},
            "pictures": [path.name for path in pictures],
        },
    )
    return pictures


def _symmetry_report(found: SurfaceSymmetry | None, sentence: str) -> dict[str, object] | None:
    """List the measures of the symmetry, lengths in metres, or the reason why none was found; None without a search."""
    if not sentence:
        return None
    return {"sentence": sentence, **({} if found is None else found.quality._asdict())}


def _evidence_rows(evidence: JointEvidence, was_given: bool) -> list[dict[str, object]]:
    """List the joints with the lengths of their bones, rotations, and the source of their positions."""
    return [
        {
            "joint": name,
            "pair": evidence.names[evidence.partners[row]] if evidence.partners[row] >= 0 else None,
            "length": float(evidence.lengths[row]),
            "rotation_degrees": float(evidence.rotations[row]),
            "shift": float(evidence.shifts[row]) if was_given else None,
            "from": "meshes" if evidence.determined[row] or not was_given else "anatomy",
        }
        for row, name in enumerate(evidence.names)
    ]


def _plot_history(path: Path, history: Sequence[tuple[str, float]]) -> Path:
    """Plot the objective after every step, one colour per type of step; hollow for a vertex subset."""
    from matplotlib.ticker import NullFormatter

    canvas, figure = new_figure(7.5, 3.8)
    plot = figure.subplots()
    kinds = [step.removeprefix(COARSE_PREFIX) for step, _ in history]
    hollow = np.array([step.startswith(COARSE_PREFIX) for step, _ in history])
    values = np.array([value for _, value in history])
    # the objective on other vertices is not comparable
    begins = [i for i, name in enumerate(step for step, _ in history) if name.endswith("start")]
    for begin, end in zip([0, *begins], [*begins, len(values)], strict=True):
        plot.plot(np.arange(begin, end), values[begin:end], color="#9aa5b1", linewidth=1.2, zorder=1)
    for number, name in enumerate(dict.fromkeys(kinds)):
        colour, own = STEP_COLOURS[number % len(STEP_COLOURS)], np.array([kind == name for kind in kinds])
        plot.scatter([], [], s=22, color=colour, label=name)
        for some, face in ((hollow, "white"), (~hollow, colour)):
            at = np.flatnonzero(own & some)
            plot.scatter(at, values[at], s=22, facecolors=face, edgecolors=colour, zorder=2)
    if hollow.any():
        plot.scatter([], [], s=22, facecolors="white", edgecolors=INK, label="on a subset of the vertices")
    if (values > 0).all():
        plot.set_yscale("log")
        plot.yaxis.set_major_formatter("{x:g}")
        few = values.max() < 30 * values.min()
        plot.yaxis.set_minor_formatter("{x:g}" if few else NullFormatter())
    plot.tick_params(which="minor", labelsize=8, colors=INK)
    plot.xaxis.get_major_locator().set_params(integer=True)
    _style_axes(plot, "step", "objective Q, m²")
    plot.legend(frameon=False, fontsize=8)
    return _save_figure(path, canvas, figure)


def _plot_curve(path: Path, curve: Float[np.ndarray, "N"], joints: int) -> Path:
    """Plot the error of rigid parts over their number, and mark the selected number."""
    canvas, figure = new_figure(6.5, 3.8)
    plot = figure.subplots()
    parts = np.arange(1, len(curve) + 1)
    plot.plot(parts, 1000 * curve, color=STEP_COLOURS[0], linewidth=1.6)
    if joints <= len(curve):
        plot.scatter([joints], [1000 * curve[joints - 1]], s=45, color=STEP_COLOURS[1], zorder=3)
        plot.annotate(
            f"{joints} parts",
            (joints, 1000 * curve[joints - 1]),
            (8, 8),
            textcoords="offset points",
            fontsize=9,
        )
    plot.set_ylim(bottom=0)
    _style_axes(plot, "rigid parts", "root mean square error, mm")
    return _save_figure(path, canvas, figure)


def _style_axes(plot: Any, x: str, y: str) -> None:
    plot.set_xlabel(x, fontsize=9, color=INK)
    plot.set_ylabel(y, fontsize=9, color=INK)
    plot.tick_params(labelsize=8, colors=INK)
    plot.grid(alpha=0.25)
    for side in ("top", "right"):
        plot.spines[side].set_visible(False)


def _save_figure(path: Path, canvas: Any, figure: Any) -> Path:
    figure.tight_layout()
    with atomic_path(path) as beside:
        canvas.print_png(beside)
    return path
