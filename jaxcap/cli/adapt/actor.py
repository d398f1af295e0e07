"""The file of an adapted body: the body, its priors, and the run that made it."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ...adapt.task import AdaptState
from ...errors import InputError
from ...io.archives.checkpoint import Checkpoint
from ...io.archives.journal import check_same_run
from ...io.archives.npz import beside_body, body_arrays, body_of, get_array, load_kind, save_arrays
from ...io.skeletons.body_motion import read_motion_of
from ...io.text import parse_json
from .state import NEEDS, checkpoint_of, hash_of, state_of

#: prefix of the names of a run's arrays
RUN = "run."


def save_actor(
    path: Path,
    state: AdaptState,
    beside: Mapping[str, np.ndarray],
    header: Mapping[str, object],
    motion: Path,
) -> None:
    """Write a body that `load_body` reads, with the arrays `beside` it as in `save_body`, and with the values
    of its run that a report needs in addition to the body and its existing file `motion`.

    **Raises:** `InputError` if it cannot be written.
    """
    kept = checkpoint_of(state)
    run = {
        "header": np.array(json.dumps(header)),
        "motion": np.array(hash_of(motion)),
        "steps": np.array([step for step, _ in kept.history], dtype=str),
        "distances": np.array([distance for _, distance in kept.history], float),
        **kept.arrays,
    }
    named = {f"{RUN}{name}": values for name, values in run.items()}
    save_arrays(path, "jaxcap body", {**body_arrays(state.body, path), **beside_body(beside), **named})


def finished_run(path: Path, motion: Path, header: Mapping[str, object]) -> AdaptState:
    """Load the last state of the run that wrote a body by `save_actor`, and its motion.

    **Raises:** `InputError` if it was another run than that of `header`, or the motion is not the one it
    wrote.
    """
    arrays = load_kind(path, "jaxcap body")
    run = {name.removeprefix(RUN): values for name, values in arrays.items() if name.startswith(RUN)}
    if not {"header", "motion", "steps", "distances", *NEEDS} <= run.keys():
        raise InputError(
            f"{path}: this file does not record the run that made the body; repeat the adaptation with --overwrite."
        )
    check_same_run(path, parse_json(str(run["header"]), f"{path}: its header"), header)
    if hash_of(motion) != str(run["motion"]):
        raise InputError(
            f"{motion}: this is not the motion that was written with {path}; give that motion with --motion, or repeat "
            "the adaptation with --overwrite."
        )
    body = body_of(arrays, path)
    steps = get_array(run, "steps", path, (None,), "text").tolist()
    distances = get_array(run, "distances", path, (len(steps),)).tolist()
    history = tuple(zip(steps, distances, strict=True))
    return state_of(Checkpoint(body, read_motion_of(body, motion), history, run), path)
