"""The output files of `jaxcap adapt`: its results, and a checkpoint after each stage, replaced atomically."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import numpy as np

from ...adapt.objective import Terms
from ...adapt.task import AdaptState, AdaptTask, OtherPerson, Stage
from ...body.body import Body
from ...errors import InputError, user_message
from ...io.archives.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from ...io.archives.npz import get_array
from ...io.registry import MOTION_WRITERS
from ...io.text import parse_json
from ...tracking.judge_frame import TrackedFrame
from ...tracking.track_frame import make_tracker
from ..outputs import check_absent
from ..track.frame_records import pack, row_template, unpack
from ..track.results import make_writable

#: required arrays of a checkpoint besides body, motion and history
REQUIRED_ARRAYS = ("done", "within", "size", "lost", "chosen", "traits", "weight", "terms")


def check_results(every: Sequence[Path], report: Path | None, resume: bool, overwrite: bool) -> None:
    """Check that the output files of a run can be written, the body, its motion and others, and make missing folders.

    **Raises:** `InputError` for other file types, existing results, one name for two, and folders without write access.
    """
    out, motion = every[:2]
    if out.suffix.lower() != ".npz":
        raise InputError(f"{out}: bodies are written as .npz; give a name that ends in .npz.")
    if motion.suffix.lower() not in MOTION_WRITERS:
        raise InputError(
            f"{motion}: motions are not written as '{motion.suffix}' files; use {', '.join(MOTION_WRITERS)}."
        )
    if report is not None and report.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{report}: the report is an HTML file; give a name that ends in .html.")
    if resume and overwrite:
        raise InputError("--resume continues a run and --overwrite replaces it; give one of them.")
    if motion.resolve() == out.resolve():
        raise InputError(f"{out}: body and motion cannot be one file; give --motion another name.")
    places = [path.resolve() for path in every]
    if len(set(places)) < len(places):
        raise InputError(f"{every[-1]}: two results cannot be one file; give each a name of its own.")
    check_absent(every, overwrite or resume)
    for path in every:
        make_writable(path.absolute().parent)


def make_checkpoint(state: AdaptState) -> Checkpoint:
    """Convert a state to a checkpoint."""
    # the names of the file format, which differ from those of some fields
    arrays = {
        "done": np.array(state.done),
        "within": np.array(state.within),
        "size": np.array(state.size, float),
        "lost": np.array(state.lost, int),
        "reasons": np.array(state.reasons, dtype=str),
        "others": np.array(json.dumps(state.others)),
        "chosen": np.array(state.chosen, int),
        "traits": np.array(state.coefficients, float),
        "weight": np.array(state.pose_weight, float),
        "temporal": np.array(state.temporal_weight, float),
        "tracked": np.zeros(0) if state.tracked is None else pack(state.tracked, 0.0),
        "terms": np.array(state.terms, float).reshape(-1, len(Terms._fields)),
    }
    return Checkpoint(state.body, state.motion, state.history, arrays)


def restore_state(checkpoint: Checkpoint, path: Path) -> AdaptState:
    """Restore the state of a checkpoint by `make_checkpoint`, bit for bit; `path`, its file, is for messages.

    **Raises:** `InputError` if an array is invalid.
    """
    arrays, frames = checkpoint.arrays, len(checkpoint.motion)

    def number(name: str) -> float:
        return get_array(arrays, name, path, ()).item() if name in arrays else 0.0

    def whole(name: str) -> tuple[int, ...]:
        values = get_array(arrays, name, path, (None,), "whole")
        if values.size and not 0 <= values.min() <= values.max() < frames:
            raise InputError(
                f"{path}: the array '{name}' has frames that are not among the {frames} of the motion; give --overwrite to begin anew."
            )
        return tuple(values.tolist())

    done, within = (get_array(arrays, name, path, (), "whole").item() for name in ("done", "within"))
    reasons = []
    if "reasons" in arrays:
        reasons = get_array(arrays, "reasons", path, (None,), "text").tolist()
    terms = get_array(arrays, "terms", path, (None, len(Terms._fields)))
    return AdaptState(
        done=done,
        body=checkpoint.body,
        size=number("size"),
        motion=checkpoint.motion,
        lost=whole("lost"),
        reasons=tuple(reasons),
        others=_restore_others(arrays, frames, path),
        chosen=whole("chosen"),
        history=checkpoint.history,
        coefficients=tuple(get_array(arrays, "traits", path, (None,)).tolist()),
        pose_weight=number("weight"),
        temporal_weight=number("temporal"),
        within=within,
        tracked=_restore_tracked(checkpoint, path),
        terms=tuple(Terms(*row) for row in terms.tolist()),
    )


def _restore_others(arrays: Mapping[str, np.ndarray], frames: int, path: Path) -> tuple[OtherPerson, ...]:
    """Restore the scans of other people; none in files of earlier versions. Raises `InputError`."""
    if "others" not in arrays:
        return ()
    try:
        found = tuple(
            OtherPerson(
                tuple(int(frame) for frame in own),
                tuple((str(name), float(shift)) for name, shift in parts),
                int(compared),
            )
            for own, parts, compared in parse_json(str(arrays["others"]), path)
        )
    except (TypeError, ValueError, OverflowError):
        found = None
    if found is None or not all(0 <= frame < frames for other in found for frame in other.frames):
        raise InputError(f"{path}: the scans of other people are damaged; give --overwrite to begin anew.")
    return found


def _restore_tracked(checkpoint: Checkpoint, path: Path) -> TrackedFrame | None:
    """Restore the last tracked frame, which may have infinite values; None if there is none. Raises
    `InputError`."""
    row = checkpoint.arrays.get("tracked", np.zeros(0))
    if not row.size:
        return None
    template = row_template(make_tracker(checkpoint.body), checkpoint.motion[0])
    if row.shape != pack(template, 0.0).shape or row.dtype.kind != "f":
        raise InputError(f"{path}: the last tracked frame is damaged; give --overwrite to begin anew.")
    return unpack(template, row)[0]


def fingerprint_of(body: Body, scans: Sequence[str]) -> dict[str, object]:
    """Compute the fingerprint of the inputs: the template, the number of scans, and for each the digest of
    `InputSummary`."""
    skeleton = body.skeleton
    template = hashlib.sha256(repr((skeleton.names, skeleton.parents, skeleton.kinds)).encode())
    for leaf in jax.tree.leaves(body):
        template.update(np.asarray(leaf).tobytes())
    each = {f"scan of frame {frame}": digest for frame, digest in enumerate(scans)}
    return {"template": template.hexdigest(), "scans": len(scans), **each}


def load_resumed_state(
    path: Path, header: Mapping[str, object], resume: bool, overwrite: bool
) -> AdaptState | None:
    """Load the state that `keep_state` wrote; None to start again.

    **Raises:** `InputError` if it is of another `header`, or a checkpoint exists and neither option is given.
    """
    if resume:
        # without a file the run was stopped before its first checkpoint
        return restore_state(load_checkpoint(path, header, REQUIRED_ARRAYS), path) if path.is_file() else None
    if path.exists() and not overwrite:
        raise InputError(
            f"{path}: an unfinished run exists; give --resume to continue it or --overwrite to begin anew."
        )
    return None


def keep_state(path: Path, state: AdaptState, header: Mapping[str, object]) -> None:
    """Write the state in place of the previous checkpoint.

    **Raises:** `InputError` if it cannot be written; the previous checkpoint is kept.
    """
    try:
        save_checkpoint(path, make_checkpoint(state), header)
    except InputError as error:
        # the kept checkpoint is of the stage before, or of an earlier frame of this one
        done = state.done if state.within else state.done - 1
        raise InputError(f"{user_message(error)} {checkpoint_sentence(path, done)}.") from None


def checkpoint_sentence(path: Path, done: int) -> str:
    """Format the state of an interrupted run for the user."""
    if not (done and path.is_file()):
        return "no stage is complete"
    return f"{done} {'stage is' if done == 1 else 'stages are'} saved in {path}; --resume continues"


def format_progress(task: AdaptTask, state: AdaptState, stages: Sequence[Stage]) -> str:
    """Format the progress of a state for the user."""
    if state.within:
        stage = stages[state.done]
        return f"{stage}: {state.within} of {len(task.frames_of(stage))} frames"
    return f"{stages[state.done - 1]}: {state.history[-1][1]:.2f} mm from scan to body"
