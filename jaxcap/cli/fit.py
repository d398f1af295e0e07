"""`jaxcap fit`: the poses of a body, or the parameters of a body model, in registered meshes, and their errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from jaxtyping import Float, Int

from ..body.body import Body
from ..body.body_model import BodyModel, shape_body, split_coefficients
from ..errors import InputError, user_message
from ..fit.body_models.model_uncertainty import model_uncertainty
from ..fit.body_models.varying_groups import fit_varying_model
from ..fit.fit_meshes import MeshFit, fit_meshes
from ..fit.fit_model import ModelFit, fit_model
from ..io.archives.npz import save_motion
from ..io.body_models.smpl import NUM_EXPRESSION
from ..io.meshes.meshes import read_named_meshes
from ..io.skeletons.amass import write_amass
from ..io.table import write_json
from ..observe.meshes import MeshSequence
from ..report.pictures import error_pictures
from .body_models import is_model_spec, load_model, stated_gender
from .console.console import pluralise, print_table, say, warn
from .console.heartbeat import set_activity
from .console.options import BodySpec, Flag, Unit, arg
from .outputs import check_npz, make_folder
from .scoring import print_scores, score_motion
from .sources import load_body
from .terms import FloorHeight, LimitsFile, LimitWeight, PriorFile, check_floor, read_terms

MeshesSpec = tyro.conf.Positional[Annotated[tuple[str, ...], arg(metavar="MESHES...", help_behavior_hint="")]]
OptionalFolder = Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")]
OptionalRate = Annotated[float | None, arg(metavar="RATE", help_behavior_hint="")]

#: size ratio that no pose causes, but a wrong unit does, except feet for metres
MAX_SIZE_RATIO = 5.0
#: number of meshes in the table of errors
MAX_LISTED = 10
#: root mean square distance that is unusual for meshes of one person, metres
MAX_RMSE = 0.005


@dataclass
class Fit:
    """Fit the poses of a body to registered meshes; write the motion. The meshes have the vertices of the body, in the
    same order.

    The shape coefficients of a body model are fitted with the poses, and all parameters are written in AMASS's format (`poses`,
    `trans`, `betas`), in the coordinates of the meshes.

    The distances from the meshes to the body are printed: vertex to surface, and vertex to vertex."""

    body: BodySpec
    meshes: MeshesSpec
    """Mesh files, a folder, a quoted glob, or an .npz with the arrays `vertices` (F, V, 3), for F meshes of V
    vertices, and `faces`."""
    out: Annotated[Path, arg(aliases=("-o",), metavar="FILE")] = Path("motion.npz")
    """Output file for the motion, .npz."""
    report: OptionalFolder = None
    """Output folder for report.json and pictures of the errors as heat maps."""
    each_person: Flag = False
    """Each mesh is another person, with coefficients of its own. Default: all meshes show one person."""
    expressions: Flag = False
    """All meshes show one person whose expression changes from mesh to mesh."""
    deviations: Flag = False
    """Also write the standard deviations of the coefficients and joints of a body model."""
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
        model = self.model()
        body = load_body(self.body, unit=self.unit)[0] if model is None else model.template
        sequence, names = read_named_meshes(self.meshes, self.unit, self.rate)
        check_mesh_size(body, sequence, self.meshes[0])
        check_floor(self.floor, np.asarray(sequence.vertices))
        terms = read_terms(
            body, limits=self.limits, limit_weight=self.limit_weight, floor=self.floor, prior=self.prior
        )
        try:
            if model is None:
                fit = fit_meshes(body, sequence, terms=terms)
            elif self.expressions:
                fit = fit_varying_model(model, sequence, terms=terms)
            else:
                fit = fit_model(model, sequence, same_person=not self.each_person, terms=terms)
        except ValueError as error:
            raise InputError(f"{self.meshes[0]}: {user_message(error)}") from None
        if not np.asarray(fit.converged).any():
            raise InputError(
                f"{self.meshes[0]}: none of {len(sequence)} meshes could be fitted; check that their vertices have the order of "
                f"those of {self.body}, the unit, and --floor, --limits and --prior."
            )
        if not same_triangles(np.asarray(body.faces), np.asarray(sequence.faces)):
            warn(
                f"{self.meshes[0]}: the triangles differ from those of {self.body}; vertices are matched by their order"
            )
        if model is None or isinstance(fit, MeshFit):
            save_motion(self.out, fit.motion, body.skeleton)
        else:
            body = self.write_parameters(model, fit, sequence)
            if self.each_person or self.expressions:
                print_parameter_errors(fit, names)
                own = "coefficients" if self.each_person else "an expression"
                say(f"{self.out}: {pluralise(fit.motion.num_frames, 'pose')}, each with {own} of its own")
                return
        scores = score_motion(body, fit.motion, np.asarray(fit.converged), sequence, names)
        print_scores({"all": scores}, per_mesh=True)
        say(f"{self.out}: {pluralise(fit.motion.num_frames, 'pose')}")
        if self.report is not None:
            make_folder(self.report)
            write_json(self.report / "report.json", {"body": self.body, **scores.report()})
            error_pictures(self.report, body, fit.motion, sequence, scores)
            say(f"report.json and pictures are in {self.report}")

    def model(self) -> BodyModel | None:
        """Load the body model, if BODY is one. Raises `InputError` for options that it does not have."""
        if self.each_person and self.report is not None:
            raise InputError(
                "--each-person and --report were both given; a report is of one person. Give one of them."
            )
        if self.expressions and (self.each_person or self.deviations or self.report is not None):
            raise InputError(
                "--expressions is for one person, without --each-person, --deviations and --report; leave these out."
            )
        if is_model_spec(self.body):
            # an expression is another one in every mesh
            number = NUM_EXPRESSION if self.each_person or self.expressions else 0
            return load_model(self.body, joints="full", num_expression=number)
        for name, given in (("--deviations", self.deviations), ("--expressions", self.expressions)):
            if given:
                raise InputError(f"{self.body}: {name} is for body models, which have coefficients.")
        if self.each_person:
            raise InputError(f"{self.body}: --each-person is for body models, which have coefficients.")
        return None

    def write_parameters(self, model: BodyModel, fit: ModelFit, sequence: MeshSequence) -> Body:
        """Write the parameters of a model in AMASS's format; return the body of the first mesh."""
        coefficients = np.asarray(fit.coefficients, float)
        groups = split_coefficients(model, coefficients if self.each_person else coefficients[0])
        if self.expressions:
            groups["expression"] = split_coefficients(model, coefficients)["expression"]
        body = shape_body(model, coefficients[0])
        write_amass(
            self.out,
            body.skeleton,
            fit.motion,
            groups,
            stated_gender(self.body) or "neutral",
            up="y",
            with_skeleton=not self.each_person,
            deviations=self.find_deviations(model, fit, sequence) if self.deviations else None,
        )
        known = np.isfinite(np.asarray(fit.rmse))
        typical = float(np.median(np.asarray(fit.rmse)[known])) if known.any() else 0.0
        if typical > MAX_RMSE:
            people = "" if self.each_person else "give --each-person if they show different people; "
            warn(
                f"{self.meshes[0]}: the vertices are {1000 * typical:.0f} mm off (median of the meshes); {people}check that "
                f"the vertices have the order of those of {self.body}, the unit, and that no mesh is mirrored"
            )
        return body

    def find_deviations(
        self, model: BodyModel, fit: ModelFit, sequence: MeshSequence
    ) -> tuple[dict[str, Float[np.ndarray, "..."]], Float[np.ndarray, "F J"]]:
        """Compute the standard deviations of coefficients, by their groups, and of joints."""
        set_activity("computing the deviations")
        found = model_uncertainty(model, sequence, fit, same_person=not self.each_person)
        own = found.coefficients if self.each_person else found.coefficients[0]
        return split_coefficients(model, own), found.joints


def print_parameter_errors(fit: ModelFit, names: Sequence[str]) -> None:
    """Print the errors of meshes that have coefficients of their own, the largest first."""
    rmse = 1000 * np.asarray(fit.rmse, float)
    order = np.argsort(-np.nan_to_num(rmse, nan=np.inf))[:MAX_LISTED]
    rows = [
        [f"{names[k]}{'' if fit.converged[k] else ' (not fitted)'}", f"{rmse[k]:.2f}"] for k in order.tolist()
    ]
    print_table(
        ["mesh, largest errors first", "vertex RMSE, mm"],
        [*rows, ["mean", f"{rmse[np.isfinite(rmse)].mean():.2f}" if np.isfinite(rmse).any() else "-"]],
    )


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
