"""`jaxcap fit`: the poses of a body in registered meshes, and their errors."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from jaxtyping import Int

from ..body.body import Body
from ..errors import InputError, user_message
from ..fit.fit_meshes import fit_meshes
from ..io.archives.npz import save_motion
from ..io.meshes.meshes import read_named_meshes
from ..io.table import write_json
from ..observe.meshes import MeshSequence
from ..report.pictures import error_pictures
from .console.console import pluralise, say, warn
from .console.options import BodySpec, Flag, Unit, arg
from .outputs import check_npz, make_folder
from .scoring import print_scores, score_motion
from .sources import load_body
from .terms import FloorHeight, LimitsFile, LimitWeight, PriorFile, read_terms

MeshesSpec = tyro.conf.Positional[Annotated[tuple[str, ...], arg(metavar="MESHES...", help_behavior_hint="")]]
OptionalFolder = Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")]
OptionalRate = Annotated[float | None, arg(metavar="RATE", help_behavior_hint="")]

#: size ratio that no pose causes, but a wrong unit does, except feet for metres
MAX_SIZE_RATIO = 5.0


@dataclass
class Fit:
    """Fit the poses of a body to registered meshes; write the motion. The meshes have the vertices of the body, in the
    same order.

    The distances from the meshes to the body are printed: vertex to surface, and vertex to vertex."""

    body: BodySpec
    meshes: MeshesSpec
    """Mesh files, a folder, a quoted glob, or an .npz with the arrays `vertices` (F, V, 3), for F meshes of V
    vertices, and `faces`."""
    out: Annotated[Path, arg(aliases=("-o",), metavar="FILE")] = Path("motion.npz")
    """Output file for the motion, .npz."""
    report: OptionalFolder = None
    """Output folder for report.json and pictures of the errors as heat maps."""
    limits: LimitsFile = None
    prior: PriorFile = None
    floor: FloorHeight = None
    limit_weight: LimitWeight = 100.0
    unit: Unit = "m"
    """Unit of the meshes, and of BODY if it is a mesh: m, dm, cm, mm, in or ft."""
    rate: OptionalRate = None
    """Meshes per second. Default: the rate stated in the file, else 30."""
    overwrite: Flag = False
    """Replace the motion if it exists."""

    def run(self) -> None:
        check_npz(self.out, self.overwrite)
        check_rate_option(self.rate)
        body, _ = load_body(self.body, unit=self.unit)
        sequence, names = read_named_meshes(self.meshes, self.unit, self.rate)
        check_mesh_size(body, sequence, self.meshes[0])
        terms = read_terms(
            body, limits=self.limits, limit_weight=self.limit_weight, floor=self.floor, prior=self.prior
        )
        try:
            fit = fit_meshes(body, sequence, terms=terms)
        except ValueError as error:
            raise InputError(f"{self.meshes[0]}: {user_message(error)}") from None
        if not same_triangles(np.asarray(body.faces), np.asarray(sequence.faces)):
            warn(
                f"{self.meshes[0]}: the triangles differ from those of {self.body}; vertices are matched by their order"
            )
        save_motion(self.out, fit.motion, body.skeleton)
        scores = score_motion(body, fit.motion, np.asarray(fit.converged), sequence, names)
        print_scores({"all": scores}, per_mesh=True)
        say(f"{self.out}: {pluralise(fit.motion.num_frames, 'pose')}")
        if self.report is not None:
            make_folder(self.report)
            write_json(self.report / "report.json", {"body": self.body, **scores.report()})
            error_pictures(self.report, body, fit.motion, sequence, scores)
            say(f"report.json and pictures are in {self.report}")


def same_triangles(a: Int[np.ndarray, "T 3"], b: Int[np.ndarray, "S 3"]) -> bool:
    """Check if two lists of triangles are equal as sets, in any order of triangles and vertices."""
    rows = [np.unique(np.sort(faces, axis=1), axis=0) for faces in (a, b)]
    return rows[0].shape == rows[1].shape and bool((rows[0] == rows[1]).all())


def check_rate_option(rate: float | None) -> None:
    """Check a rate. Raises `InputError` if it is not positive and finite."""
    if rate is not None and not 0 < rate < np.inf:
        raise InputError(f"--rate is {rate:g}; it must be above 0 meshes per second.")


def check_mesh_size(body: Body, sequence: MeshSequence, where: str) -> None:
    """Check that meshes were read in the right unit. Raises `InputError`."""
    there = float(np.median(np.ptp(np.asarray(sequence.vertices, float), axis=1).max(1)))
    here = float(np.ptp(np.asarray(body.vertices, float), axis=0).max())
    if not here / MAX_SIZE_RATIO < there < here * MAX_SIZE_RATIO:
        raise InputError(
            f"{where}: the meshes are {there:.4g} m long and the body {here:.4g} m; "
            "give the unit of the meshes with --unit."
        )
