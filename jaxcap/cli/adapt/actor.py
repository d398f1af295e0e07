"""The file of an adapted body: the body, its priors, and the run that made it."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ...adapt.task import AdaptState
from ...errors import InputError
from ...io.archives.checkpoint import Checkpoint
from ...io.archives.journal import check_same_header, hash_file
from ...io.archives.npz import add_limits_prefix, body_arrays, body_of, get_array, load_format, save_arrays
from ...io.skeletons.body_motion import read_body_motion
from ...io.text import parse_json
from .state import REQUIRED_ARRAYS, make_checkpoint, restore_state

#: prefix of the names of a run's arrays
RUN = "run."


def save_actor(
    path: Path,
    state: AdaptState,
    extra_arrays: Mapping[str, np.ndarray],
    header: Mapping[str, object],
    motion: Path,
) -> None:
    """Write a body that `load_body` reads, with the arrays `extra_arrays` it as in `save_body`, and with the values
    of its run that a report needs in addition to the body and its existing file `motion`.

    **Raises:** `InputError` if it cannot be written.
    """
    kept = make_checkpoint(state)
    run = {
        "header": np.array(json.dumps(header)),
        "motion": np.array(hash_file(motion)),
        "steps": np.array([step for step, _ in kept.history], dtype=str),
        "distances": np.array([distance for _, distance in kept.history], float),
        **kept.arrays,
    }
    named = {f"{RUN}{name}": values for name, values in run.items()}
    save_arrays(
        path, "jaxcap body", {**body_arrays(state.body, path), **add_limits_prefix(extra_arrays), **named}
    )


def load_finished_run(path: Path, motion: Path, header: Mapping[str, object]) -> AdaptState:
    """Load the last state of the run that wrote a body by `save_actor`, and its motion.

    **Raises:** `InputError` if it was another run than that of `header`, or the motion is not the one it
    wrote.
    """
    arrays = load_format(path, "jaxcap body")
    run = {name.removeprefix(RUN): values for name, values in arrays.items() if name.startswith(RUN)}
    if not {"header", "motion", "steps", "distances", *REQUIRED_ARRAYS} <= run.keys():
        raise InputError(
            f"{path}: this file does not record the run that made the body; repeat the adaptation with --overwrite."
        )
    check_same_header(path, parse_json(str(run["header"]), f"{path}: its header"), header)
    if hash_file(motion) != str(run["motion"]):
        raise InputError(
            f"{motion}: this is not the motion that was written with {path}; give that motion with --motion, or repeat "
            "the adaptation with --overwrite."
        )
    body = body_of(arrays, path)
    steps = get_array(run, "steps", path, (None,), "text").tolist()
    distances = get_array(run, "distances", path, (len(steps),)).tolist()
    history = tuple(zip(steps, distances, strict=True))
    return restore_state(Checkpoint(body, read_body_motion(body, motion), history, run), path)
