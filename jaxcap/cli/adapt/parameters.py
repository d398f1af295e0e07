"""The parameters of the body model of an adapted person."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...adapt.task import AdaptState, AdaptTask
from ...body.body_model import BodyModel
from ...edit.conversion.convert_motion import ConvertedMotion, convert_motion
from ...errors import InputError
from ...tracking.track_frame import make_tracker
from ..body_models import is_model_spec, load_model_of, write_parameters
from ..console.console import progress, say, warn
from ..track.deviations import Deviations, find_deviations

#: number of frames that a warning lists
MAX_NAMED = 10


def write_actor_parameters(
    path: Path, spec: str, vertices: int | None, state: AdaptState, task: AdaptTask | None = None
) -> None:
    """Write the parameters of the body model that come nearest to an adapted person, and print the distance that remains.

    **Arguments:** `spec` names the model, reduced to about `vertices` vertices if given; `task`, also write standard deviations of
    coefficients and joints, which its clouds determine.
    """
    model = load_model_of(spec, vertices)
    assert model is not None
    found = convert_motion(
        state.motion,
        state.body,
        model,
        progress=lambda every: progress(every, len(every), label="parameters", noun="blocks of frames"),
    )
    known = None if task is None else _deviations(model, task, state, found)
    write_parameters(path, spec, found.body, found.motion, vertices, known)
    say(f"{path}: the parameters of {model.family or 'the model'}; {describe_residual(found)}")
    lost = np.flatnonzero(found.error.failed).tolist()
    if lost:
        more = f" and {len(lost) - MAX_NAMED} more" if len(lost) > MAX_NAMED else ""
        frames = ", ".join(map(str, lost[:MAX_NAMED]))
        warn(f"{path}: the model does not reach the adapted body in frame {frames}{more}, counted from 0")


def describe_residual(found: ConvertedMotion) -> str:
    """Describe the distance between an adapted body and the body of the model nearest to it, in millimetres."""
    worst = found.error.worst_part
    return (
        f"free vertices leave {1000 * found.error.mean.mean():.2f} mm from the adapted surface to that of the model (mean), "
        f"{1000 * found.error.quantile.mean():.2f} mm for 95 % of the vertices, most at {found.body.skeleton.names[worst]}"
    )


def check_parameters(path: Path | None, spec: str, deviations: bool) -> None:
    """Check that parameters and their deviations are those of a body model. Raises `InputError`."""
    if deviations and path is None:
        raise InputError("--deviations is for parameters; give their file with --parameters.")
    if path is None:
        return
    if not is_model_spec(spec):
        raise InputError(
            f"--parameters is for body models; give one as BODY, such as smplx.npz or human:betas=20, in place of {spec}."
        )
    if path.suffix.lower() != ".npz":
        raise InputError(f"{path}: parameters are written as .npz; give a name that ends in .npz.")


def _deviations(model: BodyModel, task: AdaptTask, state: AdaptState, found: ConvertedMotion) -> Deviations:
    good = [frame for frame in task.scanned if frame not in state.lost]
    some: Sequence[int] = [frame for frame in state.chosen if frame in good] or good
    return find_deviations(make_tracker(found.body), model, task.cloud, found.motion.poses, good, some)
