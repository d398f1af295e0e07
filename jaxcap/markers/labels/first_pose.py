"""The first pose from unlabelled points: hypotheses of several frames, each verified by inverse kinematics."""

from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...body.pose import Pose
from ...geometry import rotation
from ..motion.initial_pose import estimate_separate_poses
from ..motion.inverse_kinematics import INITIAL_SEARCH, MIN_MARKERS, solve_each_frame
from ..motion.solve_frame import SearchCriteria
from ..subject import Subject, marker_positions
from .grow_pose import grow_hypotheses
from .match_points import match_points, matched_targets

#: number of frames that are tried, and of hypotheses solved in each
MAX_FRAMES, NUM_SOLVED = 10, 8
#: tolerances of distances on a bone that are tried in turn, metres
TOLERANCES = (0.015, 0.03)
#: gates of the rounds of assignment and inverse kinematics, metres
GATES = (0.2, 0.12, 0.08, 0.05, 0.05)
#: seconds around a frame in which distances on one bone are constant, and number of frames compared there
WINDOW, WINDOW_FRAMES = 0.15, 5
#: a pose is accepted if it explains this share of the points or of the markers, whichever are fewer; the search ends
#: at once if a frame has the second share
MIN_EXPLAINED, WELL_EXPLAINED = 0.65, 0.9
#: penalty of a joint that is half a turn from rest, in the score: decides between mirror images of two markers on a bone
TURN_PENALTY = 0.01
#: search of a hypothesis that is near already
NEAR_SEARCH = SearchCriteria(max_iterations=12)


class PointPose(NamedTuple):
    """A pose found in one frame, and the column of each marker, -1 where it has none."""

    frame: int
    pose: Pose
    columns: Int[np.ndarray, "M"]
    #: share of the points or of the markers, whichever are fewer, that the pose explains
    explained: float
    #: sum over matched markers of one minus the squared distance in gates, divided by the same number, less the turn penalty
    score: float


def find_first_pose(
    subject: Subject,
    positions: Float[np.ndarray, "F N 3"],
    seen: Bool[np.ndarray, "F N"],
    candidates: Int[np.ndarray, "C"],
    rate: float,
    given: Int[np.ndarray, "N"],
) -> PointPose | None:
    """Find the pose of one of the candidate frames; None if no frame has any hypothesis.

    Frames with the most points are tried first. `given (N,)` is the marker of each labelled column, or -1: a hypothesis
    from given labels is tried together with those from distances.
    """
    counts = seen[candidates].sum(1)
    best: PointPose | None = None
    for tolerance in TOLERANCES:
        for frame in _spread_frames(candidates, counts):
            found = _solve_hypotheses(subject, positions, seen, int(frame), rate, given, tolerance)
            if found is not None and (best is None or found.score > best.score):
                best = found
            if best is not None and best.explained >= WELL_EXPLAINED and best.score > 0.5:
                return best
        if best is not None and best.explained >= MIN_EXPLAINED:
            return best
    return best


def _spread_frames(candidates: Int[np.ndarray, "C"], counts: Int[np.ndarray, "C"]) -> list[int]:
    """Choose the frame with the most points in each of several parts of the take, the fullest first."""
    parts = np.array_split(np.arange(len(candidates)), min(MAX_FRAMES, len(candidates)))
    chosen = [part[counts[part].argmax()] for part in parts]
    return [int(candidates[i]) for i in sorted(chosen, key=lambda i: -counts[i]) if counts[i] >= MIN_MARKERS]


def _solve_hypotheses(
    subject: Subject, positions, seen, frame: int, rate: float, given: Int[np.ndarray, "N"], tolerance: float
) -> PointPose | None:
    columns = np.flatnonzero(seen[frame])
    points = positions[frame, columns]
    hypotheses = grow_hypotheses(
        subject, points, _steady_pairs(positions, seen, frame, columns, rate), tolerance
    )
    if (labels := _from_labels(given[columns], subject.num_markers)) is not None:
        hypotheses.insert(0, labels)
    hypotheses = [one for one in hypotheses if (one >= 0).sum() >= MIN_MARKERS][:NUM_SOLVED]
    if not hypotheses:
        return None
    matched = np.stack([*hypotheses, *[hypotheses[-1]] * (NUM_SOLVED - len(hypotheses))])
    targets, shown = matched_targets(subject, points, matched)
    poses = estimate_separate_poses(subject, targets, shown)
    poses, predicted = _solve_poses(subject, poses, targets, shown, INITIAL_SEARCH)
    used = np.asarray(subject.weights) > 0
    for gate in GATES:
        gates = np.where(used, gate, 1e-6)[:, None]
        matched = np.stack([match_points(np.asarray(one, float), points, gates) for one in predicted])
        poses, predicted = _solve_poses(
            subject, poses, *matched_targets(subject, points, matched), NEAR_SEARCH
        )
    away = np.linalg.norm(np.asarray(predicted, float) - points[matched], axis=2)
    gain = np.where(matched >= 0, np.maximum(1 - (away / GATES[-1]) ** 2, 0), 0.0)
    possible = min(len(points), int(used.sum()))
    angles = np.linalg.norm(np.asarray(rotation.log(poses.rotations), float), axis=2)
    scores = gain.sum(1) / possible - TURN_PENALTY * ((angles / np.pi) ** 2).sum(1)
    k = int(scores.argmax())
    good = gain[k] > 0
    return PointPose(
        frame,
        jax.tree.map(lambda leaf: leaf[k], poses),
        np.where(good, columns[matched[k]], -1),
        float(good.sum() / possible),
        float(scores[k]),
    )


def _from_labels(given: Int[np.ndarray, "P"], count: int) -> Int[np.ndarray, "M"] | None:
    """Make the hypothesis of the given labels, if there are enough of them."""
    known = np.flatnonzero(given >= 0)
    if len(known) < MIN_MARKERS:
        return None
    labels = np.full(count, -1)
    labels[given[known]] = known
    return labels


def _steady_pairs(positions, seen, frame: int, columns, rate: float) -> Bool[np.ndarray, "P P"]:
    """Find the pairs of points with a constant distance in the frames around, as far as both are visible."""
    reach = max(1, round(WINDOW * rate))
    frames = np.unique(np.linspace(frame - reach, frame + reach, WINDOW_FRAMES).round().astype(int))
    steady = np.ones((len(columns), len(columns)), bool)
    now = np.linalg.norm(positions[frame, columns][:, None] - positions[frame, columns], axis=2)
    for other in frames[(frames >= 0) & (frames < len(positions))]:
        at, shown = positions[other, columns], seen[other, columns]
        change = np.abs(np.linalg.norm(at[:, None] - at, axis=2) - now)
        steady &= (change < TOLERANCES[-1] / 2) | ~(shown[:, None] & shown)
    return steady


def _solve_poses(
    subject: Subject, starts: Pose, targets: Float[Array, "K M 3"], shown, search: SearchCriteria
) -> tuple[Pose, Float[Array, "K M 3"]]:
    """Solve poses, and compute their markers."""
    poses = solve_each_frame(subject, starts, targets, shown, search).pose
    return poses, _markers_of_poses(subject, poses)


@eqx.filter_jit
def _markers_of_poses(subject: Subject, poses: Pose) -> Float[Array, "K M 3"]:
    return jax.lax.map(lambda pose: marker_positions(subject, pose), poses)
