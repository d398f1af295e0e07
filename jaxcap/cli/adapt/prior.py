"""The priors of `jaxcap adapt`, and their copy in the actor's file."""

from pathlib import Path
from typing import Literal

import numpy as np

from ...body.body import Body
from ...energy.priors.pair_likelihood import LikelihoodPrior, MahalanobisPrior
from ...io.archives.npz import load_body_limits
from ...io.archives.prior import Priors, has_prior, load_priors, prior_arrays
from ..body_models import is_own_file
from ..console.console import say

PriorForm = Literal["nearest", "mean"]
#: energies of the values of --prior-form
PRIOR_FORMS = {"nearest": MahalanobisPrior, "mean": LikelihoodPrior}
#: option value that disables a template's own prior
NONE = "none"


def prior_file(body: str, requested: Path | None) -> Path | None:
    """Select the file of the priors: the requested one, or the template's if it has priors; None if there are
    none, or `NONE` is requested. Raises `InputError` if the template's file cannot be read."""
    if requested is not None:
        return None if str(requested) == NONE else requested
    return Path(body) if is_own_file(body) and has_prior(body) else None


def read_priors(path: Path | None, body: Body, *, from_template: bool, reduced: bool) -> Priors | None:
    """Load the priors of a file, if any; print a line if they are the template's `from_template`. For a `reduced`
    template its own shape prior is omitted, as its vertices differ.

    **Raises:** `InputError` as `load_priors` does.
    """
    if path is None:
        return None
    priors = load_priors(path, body, shape=not (from_template and reduced))
    if from_template:
        parts = [f"{len(priors.prior.pairs)} pairs of joints"]
        parts += [] if priors.boxes is None else [f"ranges of {len(priors.boxes.joints)} joints"]
        parts += [] if priors.shape is None else [f"the shape of {len(priors.shape.vectors)} meshes"]
        parts += ["no shape prior, because of --vertices"] if reduced else []
        say(f"{path}: the prior in this file is used ({', '.join(parts)}); --prior {NONE} disables it")
    return priors


def carried_arrays(body: str, priors: Priors | None) -> dict[str, np.ndarray]:
    """Collect the additional arrays of the actor's file, as `save_body` takes them: the pose prior and the
    ranges in use, as the actor's joints and their rest frames are the template's, and other limits in the
    template's file.

    A shape prior is not copied: it constrains vertices to the template's shape, which the actor does not
    have.
    """
    others = load_body_limits(body) if is_own_file(body) else {}
    kept = {name: a for name, a in others.items() if not name.startswith(("prior.", "boxes.", "shape."))}
    return kept if priors is None else kept | prior_arrays(priors.prior, priors.boxes)
