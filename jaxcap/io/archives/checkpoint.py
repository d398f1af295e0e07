"""The progress of the learning of a body, in one file that is replaced atomically after every round."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...body.body import Body
from ...body.pose import Motion
from ...errors import InputError
from ..system.reader_errors import reader_of
from ..text import parse_json
from .journal import check_same_header
from .npz import body_arrays, body_of, get_array, load_format, motion_arrays, motion_of, save_arrays

FORMAT = "jaxcap checkpoint"


class Checkpoint(NamedTuple):
    """The complete state from which a run continues, to the last bit."""

    body: Body
    #: poses of the training meshes
    motion: Motion
    #: (step, value of the objective) from the start on
    history: tuple[tuple[str, float], ...]
    #: further arrays by name
    arrays: dict[str, np.ndarray]


def save_checkpoint(path: str | Path, checkpoint: Checkpoint, header: Mapping[str, object]) -> None:
    """Write a checkpoint and replace the previous one; `header` holds the settings of the run, as JSON data.

    **Raises:** `InputError` if it cannot be written.
    """
    steps = [step for step, _ in checkpoint.history]
    arrays = {
        "header": np.array(json.dumps(header)),
        "history.steps": np.array(steps, dtype=str),
        "history.values": np.array([value for _, value in checkpoint.history], float),
        **{f"body.{name}": values for name, values in body_arrays(checkpoint.body, path).items()},
        **{f"motion.{name}": values for name, values in motion_arrays(checkpoint.motion).items()},
        **{f"more.{name}": values for name, values in checkpoint.arrays.items()},
    }
    save_arrays(path, FORMAT, arrays)


@reader_of("a checkpoint")
def load_checkpoint(
    path: str | Path, header: Mapping[str, object], required: Sequence[str] = ()
) -> Checkpoint:
    """Read the checkpoint of a run that was started with the same `header`.

    **Raises:** `InputError` if the file is no checkpoint, is damaged, lacks one of the further arrays that
    the run `required`, or has another header; the message gives the first difference.
    """
    path = Path(path)
    arrays = load_format(path, FORMAT)
    kept, past = _group(arrays, "more."), _group(arrays, "history.")
    if "header" not in arrays or any(name not in kept for name in required):
        raise InputError(f"{path}: this checkpoint is incomplete; overwrite it to start again.")
    there = parse_json(str(arrays["header"]), f"{path}: its header")
    if not isinstance(there, dict):
        raise InputError(f"{path}: this checkpoint is incomplete; overwrite it to start again.")
    check_same_header(path, there, header)
    steps = get_array(past, "steps", path, (None,), "text").tolist()
    values = get_array(past, "values", path, (len(steps),)).tolist()
    body, motion = body_of(_group(arrays, "body."), path), motion_of(_group(arrays, "motion."), path)
    return Checkpoint(body, motion, tuple(zip(steps, values, strict=True)), kept)


@reader_of("a checkpoint")
def load_progress(path: str | Path) -> tuple[Body, Motion]:
    """Read the body and the poses of any unfinished run.

    **Raises:** `InputError` if the file is no checkpoint or is damaged.
    """
    arrays = load_format(path, FORMAT, select=lambda name: name.startswith(("body.", "motion.")))
    return body_of(_group(arrays, "body."), path), motion_of(_group(arrays, "motion."), path)


def _group(arrays: Mapping[str, np.ndarray], start: str) -> dict[str, np.ndarray]:
    return {name.removeprefix(start): values for name, values in arrays.items() if name.startswith(start)}
