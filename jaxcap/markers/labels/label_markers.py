"""Labels for unlabelled markers, by a calibrated subject."""

import logging
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ...arguments import checked
from ...body.pose import Motion, Pose, stack_poses, take_poses
from ...observe.markers import MarkerFrames
from ..motion.gap_filling import predicted_positions
from ..motion.gap_offsets import rest_frame_positions
from ..motion.inverse_kinematics import MIN_MARKERS, solve_from_poses
from ..segments.gaps import find_runs
from ..subject import Subject, shift_markers
from .describe_labels import TrackLabel, describe_labels, describe_misfit, refuse_subject
from .first_pose import MIN_EXPLAINED, find_first_pose
from .follow_points import PointSequence, follow_points
from .half_turns import undo_half_turns
from .rival_tracks import decide_rivals
from .tracks import cut_tracks, tracks_by_frame
from .vote import LabelledTrack, vote_on_tracks

_LOG = logging.getLogger(__name__)

#: number of votes, each by the motion of the labels before it
NUM_VOTES = 2
#: number of searches for a pose where the labels of frames are lost, and least length of such frames, seconds
MAX_SEARCHES, MIN_LOST = 12, 0.2
#: gate of a marker in a vote: this multiple of its median distance, within these bounds, metres
GATE_RATIO, MIN_GATE, MAX_GATE = 5.0, 0.025, 0.05
#: gate in the first vote, metres
FIRST_GATE = 0.06
#: a pose with a larger median residual does not fit, metres
MAX_MEDIAN = 0.05
#: frames in which a marker has to be visible for its mean position on its bone to be estimated
MIN_FRAMES = 50


class Labelling(NamedTuple):
    """Labelled markers, and the label of each track."""

    #: the subject's markers in its order; without the points that are no markers
    frames: MarkerFrames
    #: the motion of these markers
    motion: Motion
    tracks: tuple[TrackLabel, ...]
    #: frames without a pose that explains their points; their labels are those of the tracks around
    doubtful: Bool[np.ndarray, "F"]
    #: messages to the user, in sentences
    messages: tuple[str, ...]


@checked
def label_markers(subject: Subject, frames: MarkerFrames, *, ignore_labels: bool = False) -> Labelling:
    """Label the markers of frames by a calibrated subject.

    A pose is found from distances between the points of one frame. From there the points of each frame
    are assigned to the markers of the predicted pose, forwards and backwards. Each track, which is a piece of a
    trajectory without gaps or jumps, then gets one label by all of its frames. Points that are no markers
    get none, and neither do two tracks between which the poses do not decide.

    **Arguments:** `frames` with any labels. Labels of the subject are kept, unless the poses contradict them;
    with `ignore_labels` all are ignored.

    **Raises:** `ValueError` if the subject has no bone with three markers, or if it does not explain the
    points in any frame that is tried.
    """
    if reason := refuse_subject(subject):
        raise ValueError(reason)
    positions, seen = np.asarray(frames.positions, float), np.asarray(frames.visible)
    seen = seen & np.isfinite(positions).all(2)
    positions = np.where(seen[..., None], positions, 0.0)
    if not (seen.sum(1) >= MIN_MARKERS).any():
        raise ValueError(f"No frame has {MIN_MARKERS} visible points; there is nothing to label.")
    place = {} if ignore_labels else {label: index for index, label in enumerate(subject.labels)}
    given = np.array([place.get(label, -1) for label in frames.labels])
    tracks = cut_tracks(positions, seen, frames.rate)
    numbers = tracks_by_frame(tracks, seen.shape)
    points = PointSequence(positions, numbers, given, frames.rate)
    columns, poses, known = _label_frames(subject, points, frames)
    labelled: list[LabelledTrack] = []
    for number in range(NUM_VOTES):
        _LOG.info("solving the motion of the labelled markers")
        motion, weights, known = _solve_labelled(subject, poses, positions, columns, known, frames.rate)
        subject = _shift_to_means(subject, motion, weights, positions, columns)
        motion = undo_half_turns(subject, motion)
        predicted = np.asarray(predicted_positions(subject, motion), float)
        # first wide ones: a bone that was turned back by half a turn is not solved yet
        gates = np.full(subject.num_markers, FIRST_GATE)
        if number > 0:
            gates = _vote_gates(predicted, positions, columns)
        gates = np.where(np.asarray(subject.weights) > 0, gates, 1e-6)
        labelled = vote_on_tracks(tracks, positions, predicted, known, gates, given)
        columns, poses = _columns_of(labelled, len(positions), subject.num_markers), motion.poses
    labelled = decide_rivals(subject, labelled, positions, predicted, columns, gates)
    columns = _columns_of(labelled, len(positions), subject.num_markers)
    motion, _, known = _solve_labelled(subject, poses, positions, columns, known, frames.rate)
    found = _collect(subject, positions, columns, frames.rate, np.asarray(frames.positions).dtype)
    named = tuple(
        TrackLabel(
            frames.labels[one.track.column],
            one.track.begin,
            one.track.end,
            None if one.marker < 0 else subject.labels[one.marker],
        )
        for one in labelled
    )
    messages = describe_labels(
        subject, named, seen, ~known, [label for label in frames.labels if label in place]
    )
    return Labelling(found, motion, named, ~known, messages)


def _label_frames(
    subject: Subject, points: PointSequence, frames: MarkerFrames
) -> tuple[Int[np.ndarray, "F M"], Pose, Bool[np.ndarray, "F"]]:
    """Label frame by frame from found poses, and search again in long runs without labels.

    Returns the columns, the poses, and the frames where these are known; others have the pose of the nearest one.
    """
    seen, count = points.tracks >= 0, len(points.positions)
    columns = np.full((count, subject.num_markers), -1)
    poses: dict[int, Pose] = {}
    known, searched = np.zeros(count, bool), seen.sum(1) < MIN_MARKERS
    for number in range(MAX_SEARCHES):
        runs = find_runs(~known & ~searched)
        begin, end = max(runs, key=lambda run: run[1] - run[0], default=(0, 0))
        if end == begin or (number > 0 and end - begin < MIN_LOST * points.rate):
            break
        _LOG.info("searching for a pose in frames %d to %d", begin, end - 1)
        start = find_first_pose(
            subject, points.positions, seen, np.arange(begin, end), points.rate, points.given
        )
        if start is None or start.explained < MIN_EXPLAINED:
            if number == 0:
                raise ValueError(describe_misfit(subject, frames, seen, start))
            searched[begin:end] = True
            continue
        for way in (range(start.frame, end), range(start.frame - 1, begin - 1, -1)):
            for frame, (some, pose) in follow_points(subject, points, start, way).items():
                columns[frame], poses[frame], known[frame] = some, pose, True
        searched[start.frame] = not known[start.frame]
    labelled = np.flatnonzero(known)
    # the nearest frame with a pose
    ends = np.concatenate([[-np.inf], (labelled[1:] + labelled[:-1]) / 2])
    nearest = labelled[np.searchsorted(ends, np.arange(count), side="right") - 1]
    stacked = stack_poses([poses[frame] for frame in labelled.tolist()]).poses
    return columns, take_poses(stacked, np.searchsorted(labelled, nearest)), known


def _solve_labelled(
    subject: Subject, poses: Pose, positions, columns, known: Bool[np.ndarray, "F"], rate: float
) -> tuple[Motion, Float[np.ndarray, "F M"], Bool[np.ndarray, "F"]]:
    """Solve the poses of labelled markers from poses near them; also return robust weights and the frames with a pose."""
    found = _collect(subject, positions, columns, rate)
    at = jnp.asarray(found.positions, subject.offsets.dtype)
    solved = solve_from_poses(subject, poses, at, jnp.asarray(found.visible))
    lengths = np.where(columns >= 0, np.asarray(solved.residuals, float), np.nan)
    fits = np.zeros(len(columns), bool)
    some = (columns >= 0).sum(1) >= MIN_MARKERS
    fits[some] = np.nanmedian(lengths[some], axis=1) < MAX_MEDIAN
    return Motion(solved.pose, rate), np.asarray(solved.weights), known & fits


def _collect(
    subject: Subject, positions, columns: Int[np.ndarray, "F M"], rate: float, dtype: np.dtype | type = float
) -> MarkerFrames:
    """Collect the labelled points as the subject's markers."""
    shown = columns >= 0
    at = np.take_along_axis(positions, np.maximum(columns, 0)[..., None], 1)
    return MarkerFrames(np.where(shown[..., None], at, 0.0).astype(dtype), shown, subject.labels, rate)


def _columns_of(labelled: list[LabelledTrack], count: int, markers: int) -> Int[np.ndarray, "F M"]:
    columns = np.full((count, markers), -1)
    for (column, begin, end), marker in labelled:
        if marker >= 0:
            columns[begin:end, marker] = column
    return columns


def _shift_to_means(subject: Subject, motion: Motion, weights, positions, columns) -> Subject:
    """Shift each marker to its median position on its bone in these frames: markers are placed anew on other days."""
    found = _collect(subject, positions, columns, motion.rate)
    local = np.asarray(rest_frame_positions(subject, motion, jnp.asarray(found.positions)), float)
    trusted = (weights > 0.5) & np.asarray(found.visible)
    shifts = np.zeros((subject.num_markers, 3))
    for marker in np.flatnonzero(trusted.sum(0) >= MIN_FRAMES):
        shifts[marker] = np.median(local[trusted[:, marker], marker], axis=0) - subject.offsets[marker]
    return shift_markers(subject, jnp.asarray(shifts, subject.offsets.dtype))


def _vote_gates(predicted, positions, columns) -> Float[np.ndarray, "M"]:
    """Compute the gates of markers by their usual distances from the predicted positions."""
    at = np.take_along_axis(positions, np.maximum(columns, 0)[..., None], 1)
    away = np.where(columns >= 0, np.linalg.norm(at - predicted, axis=2), np.nan)
    some = (columns >= 0).any(0)
    middle = np.full(len(some), MAX_GATE)
    middle[some] = np.nanmedian(away[:, some], axis=0)
    return np.clip(GATE_RATIO * middle, MIN_GATE, MAX_GATE)
