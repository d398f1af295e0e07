"""Where `jaxcap adapt` writes: its results, and between its stages one file to go on from, replaced as a whole."""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import numpy as np

from ...adapt.objective import Terms
from ...adapt.task import AdaptState
from ...body.body import Body
from ...errors import InputError, sentence_of
from ...fit.tracking.recover import TrackedFrame
from ...fit.tracking.track_frame import make_tracker
from ...io.archives.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from ...io.archives.npz import get_array
from ...io.registry import MOTION_WRITERS
from ..outputs import check_absent
from ..track.frame_records import pack, row_template, unpack
from ..track.results import make_writable

#: arrays of a checkpoint beside body, motion and history
NEEDS = ("done", "within", "size", "lost", "chosen", "traits", "weight", "terms")


def check_results(out: Path, motion: Path, report: Path | None, resume: bool, overwrite: bool) -> None:
    """That body, motion and report can be written, in folders that are made where they are not there.

    **Raises:** `InputError` for other kinds of files, results in the way, and folders that cannot be written to.
    """
    if out.suffix.lower() != ".npz":
        raise InputError(f"{out}: bodies are written as .npz; give a name that ends in it.")
    if motion.suffix.lower() not in MOTION_WRITERS:
        raise InputError(
            f"{motion}: motions are not written as '{motion.suffix}' files; use {', '.join(MOTION_WRITERS)}."
        )
    if report is not None and report.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{report}: the report is a page; give a name that ends in .html.")
    if resume and overwrite:
        raise InputError("--resume goes on with a run and --overwrite replaces it; give one of them.")
    every = [path for path in (out, motion, report) if path is not None]
    if motion.resolve() == out.resolve():
        raise InputError(f"{out}: body and motion cannot be one file; give --motion another name.")
    check_absent(every, overwrite or resume)
    for path in every:
        make_writable(path.absolute().parent)


def checkpoint_of(state: AdaptState) -> Checkpoint:
    """A state as a file can hold it."""
    arrays = {
        "done": np.array(state.done),
        "within": np.array(state.within),
        "size": np.array(state.size, float),
        "lost": np.array(state.lost, int),
        "reasons": np.array(state.reasons, dtype=str),
        "chosen": np.array(state.chosen, int),
        "traits": np.array(state.traits, float),
        "weight": np.array(state.weight, float),
        "temporal": np.array(state.temporal, float),
        "tracked": np.zeros(0) if state.tracked is None else pack(state.tracked, 0.0),
        "terms": np.array(state.terms, float).reshape(-1, len(Terms._fields)),
    }
    return Checkpoint(state.body, state.motion, state.history, arrays)


def state_of(kept: Checkpoint, path: Path) -> AdaptState:
    """The state of a checkpoint that `checkpoint_of` made, to the last bit; `path`, its file, is for messages.

    **Raises:** `InputError` where an array is another than it has to be.
    """
    arrays, frames = kept.arrays, len(kept.motion)

    def number(name: str) -> float:
        return get_array(arrays, name, path, ()).item() if name in arrays else 0.0

    def whole(name: str) -> tuple[int, ...]:
        values = get_array(arrays, name, path, (None,), "whole")
        if values.size and not 0 <= values.min() <= values.max() < frames:
            raise InputError(f"{path}: '{name}' are other frames than the {frames} there are; overwrite it.")
        return tuple(values.tolist())

    done, within = (get_array(arrays, name, path, (), "whole").item() for name in ("done", "within"))
    reasons = []
    if "reasons" in arrays:
        reasons = get_array(arrays, "reasons", path, (None,), "text").tolist()
    terms = get_array(arrays, "terms", path, (None, len(Terms._fields)))
    return AdaptState(
        done=done,
        body=kept.body,
        size=number("size"),
        motion=kept.motion,
        lost=whole("lost"),
        reasons=tuple(reasons),
        chosen=whole("chosen"),
        history=kept.history,
        traits=tuple(get_array(arrays, "traits", path, (None,)).tolist()),
        weight=number("weight"),
        temporal=number("temporal"),
        within=within,
        tracked=_tracked(kept, path),
        terms=tuple(Terms(*row) for row in terms.tolist()),
    )


def _tracked(kept: Checkpoint, path: Path) -> TrackedFrame | None:
    """The frame that was tracked last, whose numbers may be infinite; None where there is none. Raises `InputError`."""
    row = kept.arrays.get("tracked", np.zeros(0))
    if not row.size:
        return None
    template = row_template(make_tracker(kept.body), kept.motion[0])
    if row.shape != pack(template, 0.0).shape or row.dtype.kind != "f":
        raise InputError(f"{path}: the frame that was tracked last is damaged; overwrite it to begin anew.")
    return unpack(template, row)[0]


def fingerprint_of(body: Body, scans: Sequence[str]) -> dict[str, object]:
    """What tells that inputs are the same: the template, how many scans there are, and of each of them the digest of
    `Looked`."""
    skeleton = body.skeleton
    template = hashlib.sha256(repr((skeleton.names, skeleton.parents, skeleton.kinds)).encode())
    for leaf in jax.tree.leaves(body):
        template.update(np.asarray(leaf).tobytes())
    each = {f"scan of frame {frame}": digest for frame, digest in enumerate(scans)}
    return {"template": template.hexdigest(), "scans": len(scans), **each}


def hash_of(path: Path | None) -> str | None:
    """What tells that a file, where one was given, is the same. Raises `InputError` where it cannot be read."""
    if path is None:
        return None
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path.") from None


def state_to_go_on_from(
    path: Path, header: Mapping[str, object], resume: bool, overwrite: bool
) -> AdaptState | None:
    """The state that `keep_state` left; None to begin anew.

    **Raises:** `InputError` where it was begun with another `header`, or one is in the way.
    """
    if resume:
        # without one the run was stopped before its first stage was kept
        return state_of(load_checkpoint(path, header, NEEDS), path) if path.is_file() else None
    if path.exists() and not overwrite:
        raise InputError(
            f"{path}: an unfinished run is there; give --resume to go on with it or --overwrite to begin anew."
        )
    return None


def keep_state(path: Path, state: AdaptState, header: Mapping[str, object]) -> None:
    """Write what is reached in place of what was reached before.

    **Raises:** `InputError` where it cannot be written: what was kept before is there as it was.
    """
    try:
        save_checkpoint(path, checkpoint_of(state), header)
    except InputError as error:
        # what is kept is of the stage before, or of this one so far
        done = state.done if state.within else state.done - 1
        raise InputError(f"{sentence_of(error)} {kept_words(path, done)}.") from None


def kept_words(path: Path, done: int) -> str:
    """What is left of a run that ends before its time."""
    if not (done and path.is_file()):
        return "0 stages were done"
    return f"{done} {'stage is' if done == 1 else 'stages are'} kept in {path}; --resume goes on"
