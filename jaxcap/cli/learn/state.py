"""The state of learning as a checkpoint, and back."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np

from ...errors import InputError
from ...io.archives.checkpoint import Checkpoint, load_checkpoint
from ...io.archives.npz import get_array
from ...learn.learn_body import LearnState
from ...learn.skeleton.given_centres import GivenCentres

#: names of the arrays of a checkpoint
STATE_ARRAYS = (
    "pairs",
    "damping",
    "round",
    "curve",
    "given_centres",
    "given_normals",
    "given_fixed",
    "symmetry_cost",
)


def make_checkpoint(state: LearnState) -> Checkpoint:
    """Convert a state to a checkpoint."""
    arrays = {
        "pairs": np.asarray(state.left_right_pairs, int),
        "damping": np.array(float(state.damping)),
        "round": np.array(state.round),
        "curve": np.asarray(state.curve, float),
        "symmetry_cost": np.array(float(state.symmetry_cost)),
        **given_arrays(state.given),
    }
    return Checkpoint(state.body, state.motion, tuple(state.history), arrays)


def restore_state(checkpoint: Checkpoint, path: Path) -> LearnState:
    """Restore the state of a checkpoint by `make_checkpoint`, bit for bit; `path`, its file, is for messages.

    **Raises:** `InputError` if an array is invalid.
    """
    pairs = get_array(checkpoint.arrays, "pairs", path, (None, 2), "whole")
    if pairs.size and not 0 <= pairs.min() <= pairs.max() < checkpoint.body.skeleton.num_joints:
        raise InputError(
            f"{path}: the array 'pairs' contains joints that do not exist; give --overwrite to begin anew."
        )
    return LearnState(
        body=checkpoint.body,
        motion=checkpoint.motion,
        left_right_pairs=pairs,
        damping=get_array(checkpoint.arrays, "damping", path, ()).item(),
        history=checkpoint.history,
        round=get_array(checkpoint.arrays, "round", path, (), "whole").item(),
        curve=get_array(checkpoint.arrays, "curve", path, (None,)),
        given=restore_given(checkpoint, path),
        symmetry_cost=get_array(checkpoint.arrays, "symmetry_cost", path, ()).item(),
    )


def load_state(path: Path, header: dict[str, object], resume: bool, overwrite: bool) -> LearnState | None:
    """Load the state of the checkpoint `path` to resume from; None to start again.

    **Raises:** `InputError` if the checkpoint of another run exists, or that of this run without `resume` and `overwrite`.
    """
    check_unfinished(path, resume, overwrite)
    # without a file the run was probably stopped before the end of its first round
    if not resume or not path.is_file():
        return None
    return restore_state(load_checkpoint(path, header, STATE_ARRAYS), path)


def stop_message(done: int, path: Path) -> str:
    """Make the message of a run that is stopped after `done` rounds, with the checkpoint `path`."""
    # a checkpoint that exists before the first round is of a run that this one replaces
    return (
        f"stopped; round {done} is saved in {path}; --resume continues"
        if done
        else "stopped; no round is complete"
    )


def check_unfinished(path: Path, resume: bool, overwrite: bool) -> None:
    """Check that a run may begin where the checkpoint `path` of another one may exist. Raises `InputError`."""
    if path.exists() and not resume and not overwrite:
        raise InputError(
            f"{path}: an unfinished run exists; give --resume to continue it or --overwrite to begin anew."
        )


def given_arrays(given: GivenCentres | None) -> dict[str, np.ndarray]:
    """Convert given joint centres to arrays without rows if there are none."""
    none = np.zeros((0, 3))
    centres, normals = (none, None) if given is None else (given.centres, given.normals)
    return {
        "given_centres": np.asarray(centres),
        "given_normals": none if normals is None else np.asarray(normals),
        "given_fixed": np.array(int(given is not None and given.is_fixed)),
    }


def restore_given(checkpoint: Checkpoint, path: Path) -> GivenCentres | None:
    """Restore given joint centres from `given_arrays`."""
    centres, normals = (
        get_array(checkpoint.arrays, name, path, (None, 3)) for name in ("given_centres", "given_normals")
    )
    if not len(centres):
        return None
    fixed = bool(get_array(checkpoint.arrays, "given_fixed", path, (), "whole").item())
    dtype = checkpoint.body.vertices.dtype
    count = checkpoint.body.skeleton.num_joints
    if len(centres) != count or len(normals) not in (0, count):
        raise InputError(
            f"{path}: the given joints are not those of the body; give --overwrite to begin anew."
        )
    planes = jnp.asarray(normals, dtype) if len(normals) else None
    return GivenCentres(jnp.asarray(centres, dtype), fixed, planes)
