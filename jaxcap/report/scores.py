"""Fit errors of a body against registered meshes, in the form of the thesis (Adaptation, section 3.3.1)."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from ..arguments import checked
from ..body.body import Body, posed_vertices
from ..body.pose import Motion
from ..metrics import scan_to_surface
from ..observe.meshes import MeshSequence


class MeshScore(NamedTuple):
    """Distances of one mesh from the posed body, metres."""

    name: str
    #: from the vertices of the mesh to the surface of the body
    mean: float
    #: standard deviation of the population
    sd: float
    #: largest distance
    worst: float
    #: root mean square distance of the vertices from the body's corresponding ones
    rmse: float
    #: true if a pose was fitted to it
    fitted: bool


class Scores(NamedTuple):
    """The scores of all meshes, and of all their vertices together; meshes without a fit are in no mean."""

    meshes: tuple[MeshScore, ...]
    mean: float
    sd: float
    rmse: float

    def report(self) -> dict:
        """Convert the scores to a dictionary for JSON."""
        total = {"mean": self.mean, "sd": self.sd, "vertex_rmse": self.rmse, "meshes": len(self.meshes)}
        rows = [
            {
                "mesh": s.name,
                "mean": s.mean,
                "sd": s.sd,
                "worst": s.worst,
                "vertex_rmse": s.rmse,
                "fitted": s.fitted,
            }
            for s in self.meshes
        ]
        return {"unit": "m", "vertex_to_surface": total, "per_mesh": rows}


@checked
def score_meshes(
    body: Body,
    motion: Motion,
    sequence: MeshSequence,
    names: tuple[str, ...],
    fitted: np.ndarray | None = None,
    progress: Callable[[Iterator[MeshScore]], Iterator[MeshScore]] = iter,
) -> Scores:
    """Compute the `Scores` of a body posed as in `motion` against the meshes.

    **Arguments:** `names` of the meshes; `fitted (F,)` marks those with a valid pose, all if not given;
    `progress` may pass the scores through a progress bar.
    """
    fitted = np.ones(len(sequence), bool) if fitted is None else np.asarray(fitted)
    faces = np.asarray(body.faces)

    def score(frame: int) -> MeshScore:
        place, posed = (
            np.asarray(sequence[frame], float),
            np.asarray(posed_vertices(body, motion[frame]), float),
        )
        if not (np.isfinite(place).all() and np.isfinite(posed).all()):
            return MeshScore(names[frame], np.nan, np.nan, np.nan, np.nan, False)
        distances = scan_to_surface(place, posed, faces)
        rmse = float(np.sqrt(np.mean(np.sum((place - posed) ** 2, 1))))
        mean, sd, worst = float(distances.mean()), float(distances.std()), float(distances.max())
        return MeshScore(names[frame], mean, sd, worst, rmse, bool(fitted[frame]))

    return total_scores(tuple(progress(score(frame) for frame in range(len(sequence)))))


@checked
def total_scores(meshes: tuple[MeshScore, ...]) -> Scores:
    """Average over all vertices of all meshes, which have equal numbers of vertices."""
    counted = [score for score in meshes if score.fitted]
    if not counted:
        return Scores(meshes, np.nan, np.nan, np.nan)
    means, spreads, rmses = (np.array([getattr(s, name) for s in counted]) for name in ("mean", "sd", "rmse"))
    mean = means.mean()
    # the law of total variance
    sd = np.sqrt(np.mean(spreads**2) + np.mean((means - mean) ** 2))
    return Scores(meshes, float(mean), float(sd), float(np.sqrt(np.mean(rmses**2))))
