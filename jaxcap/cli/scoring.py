"""Tables of mesh scores, and the hashes of scored meshes."""

import hashlib

import numpy as np
from jaxtyping import Bool

from ..body.body import Body
from ..body.pose import Motion
from ..observe.meshes import MeshSequence
from ..report.scores import MeshScore, Scores, score_meshes
from .console.console import print_table, progress, warn
from .console.record import give_figures

#: maximum number of meshes with a row each
MAX_ROWS = 12


def score_motion(
    body: Body,
    motion: Motion,
    fitted: Bool[np.ndarray, "F"],
    sequence: MeshSequence,
    names: tuple[str, ...],
    label: str = "scoring",
) -> Scores:
    """Score a motion on meshes with a progress bar; warn of meshes that were not fitted."""
    if not fitted.all():
        missed = [names[frame] for frame in np.flatnonzero(~fitted)]
        listed = ", ".join(missed[:5]) + (f" and {len(missed) - 5} more" if len(missed) > 5 else "")
        warn(
            f"{len(missed)} of {len(names)} meshes could not be fitted, and are excluded from the means: {listed}"
        )

    def each(scores):
        return progress(scores, len(sequence), label=label)

    return score_meshes(body, motion, sequence, names, fitted, each)


def print_scores(groups: dict[str, Scores], per_mesh: bool = False) -> None:
    """Print a table of totals, and of single meshes if `per_mesh`: mean and standard deviation of the distance
    from vertex to surface, and the vertex RMSE, millimetres."""
    rows = []
    for label, scores in groups.items():
        if per_mesh:
            rated = list(scores.meshes)
            if len(rated) > MAX_ROWS:
                # NaN marks meshes that were not fitted; they are last
                rated = sorted(rated, key=lambda score: -np.nan_to_num(score.mean, nan=np.inf))[:MAX_ROWS]
            rows += [_row(f"{score.name}{'' if score.fitted else ' (not fitted)'}", score) for score in rated]
            if len(rated) < len(scores.meshes):
                rows.append([f"... {len(scores.meshes) - MAX_ROWS} meshes with smaller errors", "", "", ""])
        rows.append(_row(f"{label}, {len(scores.meshes)} meshes", scores))
        name = label.replace(" ", "_")
        give_figures({f"{name}_{each}": getattr(scores, each) for each in ("mean", "sd", "rmse")})
    print_table(["vertex to surface, mm", "mean", "sd", "vertex RMSE"], rows)


def mesh_hashes(sequence: MeshSequence) -> dict[str, object]:
    """Compute the hash of meshes, to detect changes."""
    digest = hashlib.sha256(np.ascontiguousarray(sequence.vertices).tobytes())
    digest.update(np.ascontiguousarray(sequence.faces, np.int64).tobytes())
    return {"meshes": digest.hexdigest(), "precision": str(sequence.vertices.dtype)}


def _row(label: str, score: MeshScore | Scores) -> list[str]:
    return [label, *(f"{1000 * value:.2f}" for value in (score.mean, score.sd, score.rmse))]
