"""How far the learning of a body has come, in one file that is replaced as a whole after every round."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..body.body import Body
from ..body.pose import Motion
from ..errors import InputError
from .journal import check_same_run
from .npz import body_arrays, body_of, load_kind, motion_arrays, motion_of, save_arrays

KIND = "jaxcap checkpoint"


class Checkpoint(NamedTuple):
    """All that a run needs to go on, to the last bit."""

    body: Body
    #: poses of the training meshes
    motion: Motion
    #: (step, value of the objective) from the start on
    history: tuple[tuple[str, float], ...]
    #: further arrays by name
    arrays: dict[str, np.ndarray]


def save_checkpoint(path: str | Path, checkpoint: Checkpoint, header: Mapping[str, object]) -> None:
    """Write a checkpoint in place of the one before; `header` is what the run was begun with, as JSON
    can say it. Raises `InputError` where it cannot be written."""
    steps = [step for step, _ in checkpoint.history]
    arrays = {
        "header": np.array(json.dumps(header)),
        "history.steps": np.array(steps, dtype=str),
        "history.values": np.array([value for _, value in checkpoint.history], float),
        **{f"body.{name}": values for name, values in body_arrays(checkpoint.body, path).items()},
        **{f"motion.{name}": values for name, values in motion_arrays(checkpoint.motion).items()},
        **{f"more.{name}": values for name, values in checkpoint.arrays.items()},
    }
    save_arrays(path, KIND, arrays)


def load_checkpoint(path: str | Path, header: Mapping[str, object], needs: Sequence[str] = ()) -> Checkpoint:
    """The checkpoint of a run that was begun with the same `header`.

    **Raises:** `InputError` where the file is none, is damaged, lacks one of the further arrays that the
    run `needs`, or was begun with another header: the first difference is told.
    """
    path = Path(path)
    arrays = load_kind(path, KIND)
    grouped: dict[str, dict[str, np.ndarray]] = {"body": {}, "motion": {}, "more": {}, "history": {}}
    for name, values in arrays.items():
        group, _, rest = name.partition(".")
        grouped.setdefault(group, {})[rest] = values
    steps, values = (grouped["history"].get(name, np.zeros(0)) for name in ("steps", "values"))
    lacking = [name for name in needs if name not in grouped["more"]]
    if "header" not in arrays or lacking or steps.shape != values.shape:
        raise InputError(f"{path}: this checkpoint is not whole; overwrite it to begin anew.")
    try:
        there = json.loads(str(arrays["header"]))
    except ValueError:
        raise InputError(f"{path}: this checkpoint is not whole; overwrite it to begin anew.") from None
    check_same_run(path, there, header)
    history = tuple((str(step), float(value)) for step, value in zip(steps, values, strict=True))
    body, motion = body_of(grouped["body"], path), motion_of(grouped["motion"], path)
    return Checkpoint(body, motion, history, grouped["more"])
