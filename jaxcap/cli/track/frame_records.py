"""Encoding of a tracked frame as a row of numbers, from which a stopped run resumes."""

import zlib
from pathlib import Path
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...body.pose import Pose, rest_pose
from ...body.skeleton import Skeleton
from ...tracking.expectation_maximisation.em_step import FrameStatistics
from ...tracking.judge_frame import TrackedFrame, reasons_of, unseen_of, verdict_of
from ...tracking.judgement.region_samples import sample_regions
from ...tracking.judgement.verdict import UNSEEN, Judgement
from ...tracking.people.person_frame import PersonFrame, frame_template
from ...tracking.track_frame import Tracker

#: a frame of one body, or of several people
Frame = TypeVar("Frame", TrackedFrame, PersonFrame, tuple[PersonFrame, ...])
#: column of a row with the hash of its cloud's name, and number of values before the pose
CLOUD_AT, POSE_AT = 1, 2


def pose_layout(skeleton: Skeleton) -> dict[str, object]:
    """Return the joint names and the offset of poses in a row, for readers that follow a run."""
    return {"joints": list(skeleton.names), "pose at": POSE_AT}


def hash_cloud_name(name: str) -> float:
    """Hash the name of a cloud's file, without its folder, to a number."""
    return float(zlib.crc32(Path(name).name.encode("utf-8", "surrogateescape")))


def pack(frame: Frame, seconds: float, cloud: str = "") -> Float[np.ndarray, "R"]:
    """Encode a frame as one row of numbers, exact in both precisions; `cloud` is its cloud's name."""
    return np.concatenate(
        [
            [seconds, hash_cloud_name(cloud)],
            *(np.ravel(np.asarray(leaf, float)) for leaf in jax.tree.leaves(frame)),
        ]
    )


def unpack(template: Frame, row: Float[np.ndarray, "R"]) -> tuple[Frame, float]:
    """Decode the frame of a row by `pack`, bit for bit, with the shapes and types of a template."""
    leaves, tree = jax.tree.flatten(template)
    numbers, at = [], POSE_AT
    for leaf in leaves:
        size = np.size(leaf)
        values = row[at : at + size].reshape(np.shape(leaf))
        numbers.append(jnp.asarray(values, leaf.dtype) if eqx.is_array(leaf) else type(leaf)(values))
        at += size
    return jax.tree.unflatten(tree, numbers), float(row[0])


class Results(NamedTuple):
    """The results of N frames: the first part of their rows, without the state for the next frame."""

    seconds: Float[np.ndarray, "N"]
    #: stacked over the frames
    poses: Pose
    #: as arrays (N,)
    statistics: FrameStatistics
    #: `verdict` and `reasons` of every `TrackedFrame`
    verdicts: list[tuple[str, tuple[str, ...]]]
    #: `unseen` of every `TrackedFrame`
    unseen: list[tuple[str, ...]]
    #: `others` of every `TrackedFrame`
    others: list[bool]


def unpack_results(template: TrackedFrame, rows: Float[np.ndarray, "N R"]) -> Results:
    """Decode the results in rows by `pack`, or in their first `results_width` columns."""
    poses, statistics, lost, judgements, others = _decode_results(template, rows)
    lost = np.asarray(lost)
    judgements = jax.tree.map(np.asarray, judgements)
    verdicts: list[tuple[str, tuple[str, ...]]] = [("good", ())] * len(rows)
    unseen: list[tuple[str, ...]] = [()] * len(rows)
    # most frames are plainly good: only the others are examined one by one
    plain = (judgements.shares.max((1, 2)) < judgements.doubt) & (judgements.support.min(1) >= UNSEEN)
    for number in np.flatnonzero(lost | ~plain):
        there = jax.tree.map(lambda leaf, row=number: leaf[row, ...], judgements)
        gone = bool(lost[number])
        verdicts[number] = verdict_of(gone, there), reasons_of(gone, there)
        unseen[number] = unseen_of(gone, there)
    statistics, others = jax.tree.map(np.asarray, (statistics, others))
    return Results(rows[:, 0], poses, statistics, verdicts, unseen, others.astype(bool).tolist())


def _decode_results(
    template: TrackedFrame, rows: Float[np.ndarray, "N R"]
) -> tuple[Pose, FrameStatistics, Array, Judgement, Array]:
    leaves, tree = jax.tree.flatten(_results_in(template))
    arrays, at = [], POSE_AT
    for leaf in leaves:
        size = np.size(leaf)
        columns = rows[:, at : at + size].reshape(-1, *np.shape(leaf))
        arrays.append(jnp.asarray(columns, jnp.asarray(leaf).dtype))
        at += size
    return jax.tree.unflatten(tree, arrays)


def results_width(template: TrackedFrame) -> int:
    """Count the values of a row that are results."""
    return POSE_AT + sum(np.size(leaf) for leaf in jax.tree.leaves(_results_in(template)))


def _results_in(frame: TrackedFrame) -> tuple[Pose, FrameStatistics, bool, Judgement, bool]:
    return frame.pose, frame.statistics, frame.lost, frame.judgement, frame.others


def row_width(template: Frame) -> int:
    """Count the values of a row."""
    return len(pack(template, 0.0))


def row_template(tracker: Tracker, like: Pose | None = None, num_cameras: int = 0) -> TrackedFrame:
    """Make a frame with the shapes and types of all frames of a run.

    `like` is a pose of the precision that the run began with, that of the body by default. `num_cameras` is the number of
    known cameras of the clouds. The function
    samples the body's surface, so call it once.
    """
    pose = rest_pose(tracker.body.skeleton) if like is None else like
    return frame_template(tracker, sample_regions(tracker.body, tracker.regions), pose, num_cameras)
