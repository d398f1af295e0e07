"""What `jaxcap adapt` knows of the actor beforehand, and what of it the actor's file says on."""

from pathlib import Path

import numpy as np

from ...body.body import Body
from ...io.archives.npz import load_limits
from ...io.archives.prior import Priors, carries_prior, load_priors, prior_arrays
from ..console.console import say

#: what leaves a template's own prior out, in place of a file
NONE = "none"


def prior_file(body: str, asked: Path | None) -> Path | None:
    """The file whose priors count: the one asked for, or the template's where they are in it; None where there are none,
    or `NONE` is asked for. Raises `InputError` where the template's file cannot be read."""
    if asked is not None:
        return None if str(asked) == NONE else asked
    return Path(body) if _is_npz(body) and carries_prior(body) else None


def read_priors(path: Path | None, body: Body, *, own: bool, reduced: bool) -> Priors | None:
    """The priors of a file, if any; a line tells of the template's `own`, which were not asked for. Of a template that is
    `reduced` the shape in its own file is left out, as its vertices are others.

    **Raises:** `InputError` as `load_priors` does.
    """
    if path is None:
        return None
    priors = load_priors(path, body, shape=not (own and reduced))
    if own:
        parts = [f"{len(priors.prior.pairs)} pairs of joints"]
        parts += [] if priors.boxes is None else [f"ranges of {len(priors.boxes.joints)} joints"]
        parts += [] if priors.shape is None else [f"the shape of {len(priors.shape.vectors)} meshes"]
        parts += ["not the shape, with --vertices"] if reduced else []
        say(f"{path}: the prior in it counts ({', '.join(parts)}); --prior {NONE} leaves it out")
    return priors


def carried(body: str, priors: Priors | None) -> dict[str, np.ndarray]:
    """What the actor's file says beside its body, as `save_body` takes it: the prior and the ranges that counted, as the
    actor's joints and their frames at rest are the template's, and other limits that are in the template's file.

    A shape prior is not carried over: it holds vertices to the template's shape, which the actor does not have."""
    others = load_limits(body) if _is_npz(body) else {}
    kept = {name: a for name, a in others.items() if not name.startswith(("prior.", "boxes.", "shape."))}
    return kept if priors is None else kept | prior_arrays(priors.prior, priors.boxes)


def _is_npz(body: str) -> bool:
    return Path(body).suffix.lower() == ".npz"
