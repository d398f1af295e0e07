"""Landmarks of markers without labels: the human is fitted to the points of a frame in which the person stands."""

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from ...arguments import checked
from ...body.pose import Pose, stack_poses
from ...errors import InputError
from ...geometry.sampling import even_indices
from ...observe.markers import MarkerFrames
from ..marker_sets.landmarks import landmarks
from ..marker_sets.recognise import MarkerSet
from ..motion.initial_pose import estimate_initial_poses
from ..motion.inverse_kinematics import INITIAL_SEARCH
from ..motion.solve_frame import SearchCriteria, solve_frame
from ..segments.rigid_motion import distance_ranges
from ..subject import Subject, marker_positions
from .all_landmarks import all_landmarks, height_of, landmark_costs, landmark_subject, mirrored_landmarks
from .standing_hypotheses import StandingHypothesis, find_standing, hypothesis_pose

#: least number of points of a person
MIN_POINTS = 12
#: number of parts of a take with a candidate frame each, and of frames that are solved
NUM_PARTS, NUM_FRAMES = 4, 2
#: number of hypotheses that are solved, and that are near each other in facing at most, radians
NUM_SOLVED, MIN_TURN = 6, np.radians(40.0)
#: standard deviations of the pose in the rounds of assignment and inverse kinematics, metres
POSE_DEVIATIONS = (0.08, 0.06, 0.04, 0.03, 0.025, 0.02)
#: number of assignments by several frames
NUM_REFINEMENTS = 4
#: largest squared distance in one frame, in deviations
MAX_SQUARE = 25.0
#: squared deviations that a point without a landmark costs
NO_LANDMARK_COST = 16.0
#: range of the distances on a bone that is one standard deviation, metres
RANGE_DEVIATION = 0.03
#: cost of a landmark whose mirror image no marker has
ONE_SIDED_COST = 4.0
#: least difference of costs between two bones, so that the marker is known to be on the better one; and of the take to its
#: mirror image and to any other facing
MIN_BONE_MARGIN, MIN_FACING_MARGIN = 4.0, 25.0
#: largest mean cost of the markers, and share of the markers without a landmark, of a person
MAX_MEAN_COST, MAX_UNKNOWN_SHARE = 5.0, 0.3
#: standard deviation of a marker from a landmark that geometry gave it, metres: at least that of a nearby landmark, and less
#: than that of a marker somewhere on a segment
GEOMETRY_DEVIATION = 0.02
ROUND_SEARCH = SearchCriteria(max_iterations=12)


class GeometryRecognition(NamedTuple):
    """Landmarks by geometry, and how sure they are."""

    #: of the take's markers; None where it is not decided
    marker_set: MarkerSet
    #: the frame that was used
    frame: int
    #: cost of the best hypothesis, in squared standard deviations, and how much more the best one with another facing costs
    cost: float
    margin: float
    #: messages to the user, in sentences
    messages: tuple[str, ...]


@checked
def recognise_by_geometry(
    frames: MarkerFrames, *, up: Literal["x", "y", "z"] | None = None
) -> GeometryRecognition:
    """Find the landmarks of a person's markers by their positions, whatever the labels are.

    In the frame in which the person is most upright, a standing human is aligned to the points from all sides. In turns, each
    point gets a landmark of its own (linear assignment), and the poses are solved. Landmarks that many marker sets have cost
    less, and bones on which a marker keeps its distances in the whole take. A marker between two bones stays unknown.

    **Arguments:** `frames` of one person without props; `up`, the vertical axis, by default that of the largest extent.

    **Raises:** `InputError` with too few points in every frame, if no person explains them, and if left and right, or front and
    back, are not decided.
    """
    axis = "xyz".index(up) if up is not None else vertical_axis(frames)
    points = TakePoints(
        np.roll(np.asarray(frames.positions, float), 1 - axis, axis=2),
        np.asarray(frames.visible),
        distance_ranges(frames),
    )
    most = int(points.seen.sum(1).max())
    if most < MIN_POINTS:
        raise InputError(
            f"{most} points are visible at once; at least {MIN_POINTS} are needed to recognise a person by geometry. Give labels of "
            "landmarks."
        )
    options = [
        # the vertical may point down: half a turn about x
        refine(one, points.turned(upwards), upwards)
        for upwards in (True, False)
        for one in shortlist(points.turned(upwards))
    ]
    best = min(options, key=lambda one: one.cost)
    _check(best, facing_margin(options, best), frames)
    return _collect(frames, best, facing_margin(options, best))


def vertical_axis(frames: MarkerFrames) -> int:
    """Find the axis along which the markers of one frame extend most, as of a standing person."""
    seen = np.asarray(frames.visible)
    places = np.asarray(frames.positions, float)
    sides = np.where(seen[..., None], places, -np.inf).max(1) - np.where(seen[..., None], places, np.inf).min(1)  # fmt: skip
    sides = sides[seen.sum(1) > 1]
    return int(np.argmax(np.median(sides, axis=0))) if len(sides) else 1


class TakePoints(NamedTuple):
    """Points of a take with y up or down, and the ranges of their distances."""

    positions: Float[np.ndarray, "F P 3"]
    seen: Bool[np.ndarray, "F P"]
    ranges: Float[np.ndarray, "P P"]

    def turned(self, upwards: bool) -> "TakePoints":
        """Rotate the points upside down, unless the vertical points up."""
        return self if upwards else self._replace(positions=self.positions * [1.0, -1.0, -1.0])


class LandmarkOption(NamedTuple):
    """A hypothesis: the landmark of each marker of the take, -1 without one; its costs, and their margins to other bones."""

    #: frame from which it was found
    frame: int
    facing: float
    upwards: bool
    #: of the person, metres
    height: float
    landmarks: Int[np.ndarray, "P"]
    costs: Float[np.ndarray, "P"]
    margins: Float[np.ndarray, "P"]
    #: sum of the costs of all markers that are visible in the frames that were used
    cost: float


def upright_frames(points: TakePoints) -> Int[np.ndarray, "N"]:
    """Choose the frame with the largest vertical extent in each part of the take, among those with nearly all points."""
    seen, height = points.seen, points.positions[..., 1]
    counts = seen.sum(1)
    extent = np.where(seen, height, -np.inf).max(1) - np.where(seen, height, np.inf).min(1)
    extent = np.where(counts >= 0.9 * counts.max(), extent, -np.inf)
    parts = np.array_split(np.arange(len(seen)), min(NUM_PARTS, len(seen)))
    chosen = np.array([part[np.argmax(extent[part])] for part in parts])
    return chosen[np.isfinite(extent[chosen])]


def facing_margin(options: list[LandmarkOption], best: LandmarkOption) -> float:
    """Compute how much more the best option costs that faces elsewhere by more than a right angle, or is upside down."""
    others = [
        one.cost for one in options if np.cos(one.facing - best.facing) < 0.0 or one.upwards != best.upwards
    ]
    return min(others, default=np.inf) - best.cost


def shortlist(points: TakePoints) -> list[LandmarkOption]:
    """Solve the best hypotheses of the most promising frames, and keep the best one and its best opposite."""
    mean = landmark_subject(round(height_of(0.0), 2))
    aligned = []
    for frame in upright_frames(points):
        columns = np.flatnonzero(points.seen[frame])
        found = find_standing(points.positions[frame, columns], mean)
        aligned.append((found[0].cost, int(frame), found))
    options = [
        option
        for _, frame, found in sorted(aligned, key=lambda one: one[0])[:NUM_FRAMES]
        for option in _solve_options(points, frame, found)
    ]
    best = min(options, key=lambda one: one.cost / (one.costs > 0).sum())
    # a point more or less does not decide
    opposite = [one for one in options if one.frame == best.frame and np.cos(one.facing - best.facing) < 0.0]
    return [best, *sorted(opposite, key=lambda one: one.cost)[:1]]


def _solve_options(points: TakePoints, frame: int, found: list[StandingHypothesis]) -> list[LandmarkOption]:
    """Solve the best hypotheses of a standing person with different facings in one frame."""
    columns = np.flatnonzero(points.seen[frame])
    here = points.positions[frame, columns]
    scale = float(np.median([one.scale for one in found[:3]]))
    height = round(height_of(0.0) * scale, 2)
    subject = landmark_subject(height)
    chosen = _different(find_standing(here, subject))
    poses = stack_poses([hypothesis_pose(subject, one) for one in chosen]).poses
    predicted = np.asarray(_predict(subject, poses), float)
    costs = landmark_costs()
    for number, deviation in enumerate(POSE_DEVIATIONS):
        assigned = [assign(point_costs(here, one, subject, deviation) + costs) for one in predicted]
        targets, shown = _targets(np.stack(assigned), np.stack([here] * len(chosen)), subject)
        search = INITIAL_SEARCH if number == 0 else ROUND_SEARCH
        poses, positions = _solve_each(subject, poses, targets, shown, search)
        predicted = np.asarray(positions, float)
    ranges = points.ranges[np.ix_(columns, columns)]
    options = []
    for one, hypothesis in zip(predicted, chosen, strict=True):
        cost = point_costs(here, one, subject, POSE_DEVIATIONS[-1]) + costs
        landmark, own, margins = judge(cost, ranges, np.asarray(subject.bones))
        whole = np.full(points.seen.shape[1], -1), np.zeros(points.seen.shape[1]), np.zeros(points.seen.shape[1])  # fmt: skip
        for every, some in zip(whole, (landmark, own, margins), strict=True):
            every[columns] = some
        options.append(LandmarkOption(frame, hypothesis.facing, True, height, *whole, float(own.sum())))
    return options


def refine(option: LandmarkOption, points: TakePoints, upwards: bool) -> LandmarkOption:
    """Assign landmarks by several frames of the take: in turns, the poses of all are solved, and all costs are averaged."""
    subject, costs = landmark_subject(option.height), landmark_costs()
    counts = points.seen.sum(1)
    full = np.flatnonzero(counts >= 0.8 * counts.max())
    chosen = full[even_indices(len(full), NUM_SOLVED - 1, nearest=True)]
    chosen = np.concatenate([[option.frame] * (NUM_SOLVED - len(chosen)), chosen]).astype(int)
    here, seen = points.positions[chosen], points.seen[chosen]
    used = np.asarray(np.any(seen, axis=0))
    landmark, own, margins = option.landmarks, option.costs, option.margins
    for _ in range(NUM_REFINEMENTS):
        each = np.where(seen, landmark, -1)
        targets, shown = _targets(each, here, subject)
        poses = estimate_initial_poses(subject, targets, shown)
        _, positions = _solve_each(subject, poses, targets, shown, INITIAL_SEARCH)
        total = np.zeros((len(landmark), subject.num_markers))
        for one, at, visible in zip(np.asarray(positions, float), here, seen, strict=True):
            total += np.where(visible[:, None], point_costs(at, one, subject, POSE_DEVIATIONS[-1]), 0.0)
        cost = total[used] / seen[:, used].sum(0)[:, None] + costs
        found = judge(cost, points.ranges[np.ix_(used, used)], np.asarray(subject.bones))
        before = landmark
        landmark, own, margins = np.full(len(used), -1), np.zeros(len(used)), np.zeros(len(used))
        landmark[used], own[used], margins[used] = found
        if np.array_equal(before, landmark):
            break
    return option._replace(
        upwards=upwards, landmarks=landmark, costs=own, margins=margins, cost=float(own.sum())
    )


def _different(hypotheses: list[StandingHypothesis]) -> list[StandingHypothesis]:
    """Choose the best hypotheses with facings apart from each other, padded to a constant number."""
    chosen: list[StandingHypothesis] = []
    for one in hypotheses:
        if all(np.cos(one.facing - other.facing) < np.cos(MIN_TURN) for other in chosen):
            chosen.append(one)
    chosen = chosen[:NUM_SOLVED]
    return chosen + [chosen[-1]] * (NUM_SOLVED - len(chosen))


def point_costs(
    points: Float[np.ndarray, "P 3"],
    predicted: Float[np.ndarray, "L 3"],
    subject: Subject,
    pose_deviation: float,
) -> Float[np.ndarray, "P L"]:
    """Compute the squared deviation of each point from each landmark, with the logarithm of the variance."""
    variances = np.asarray(subject.deviations, float) ** 2 + pose_deviation**2
    squares = np.minimum(cdist(points, predicted) ** 2 / variances, MAX_SQUARE)
    return squares + np.log(variances / variances.min())


def assign(cost: Float[np.ndarray, "P L"]) -> Int[np.ndarray, "P"]:
    """Assign landmarks to points with the least sum of costs, at most one to each; -1 where none is near."""
    none = np.full((len(cost), len(cost)), NO_LANDMARK_COST)
    rows, found = linear_sum_assignment(np.concatenate([cost, none], axis=1))
    landmark = np.full(len(cost), -1)
    landmark[rows] = np.where(found < cost.shape[1], found, -1)
    return landmark


def judge(
    cost: Float[np.ndarray, "P L"], ranges: Float[np.ndarray, "P P"], bones: Int[np.ndarray, "L"]
) -> tuple[Int[np.ndarray, "P"], Float[np.ndarray, "P"], Float[np.ndarray, "P"]]:
    """Assign, then again with the ranges of distances on each bone; return also the costs, and their margins to other bones."""
    first = assign(cost)
    used = np.isin(np.arange(cost.shape[1]), first)
    # laboratories place most markers on both sides
    one_sided = ONE_SIDED_COST * ~used[mirrored_landmarks()]
    cost = cost + _range_costs(first, bones, ranges)
    landmark = assign(cost + one_sided)
    known = landmark >= 0
    own = np.where(known, cost[np.arange(len(cost)), np.maximum(landmark, 0)], NO_LANDMARK_COST)
    other = bones[None] != bones[np.maximum(landmark, 0)][:, None]
    return landmark, own, np.where(known, np.where(other, cost, np.inf).min(1) - own, 0.0)


def _targets(
    landmark: Int[np.ndarray, "K P"], points: Float[np.ndarray, "K P 3"], subject: Subject
) -> tuple[Array, Array]:
    targets = np.zeros((len(landmark), subject.num_markers, 3))
    shown = np.zeros(targets.shape[:2], bool)
    for k, one in enumerate(landmark):
        some = one >= 0
        targets[k, one[some]], shown[k, one[some]] = points[k, some], True
    return jnp.asarray(targets, subject.offsets.dtype), jnp.asarray(shown)


def _range_costs(
    landmark: Int[np.ndarray, "P"], bones: Int[np.ndarray, "L"], ranges: Float[np.ndarray, "P P"]
) -> Float[np.ndarray, "P L"]:
    """Compute what it costs to be on each landmark's bone, by how much the distances from the markers on it change."""
    owner = np.where(landmark >= 0, bones[np.maximum(landmark, 0)], -1)
    result = np.zeros((len(landmark), len(bones)))
    for bone in np.unique(owner[owner >= 0]):
        mine = np.flatnonzero(owner == bone)
        for point in range(len(landmark)):
            others = mine[mine != point]
            known = ranges[point, others][np.isfinite(ranges[point, others])]
            if len(known):
                result[point, bones == bone] = min(float(np.median(known) / RANGE_DEVIATION) ** 2, 9.0)
    return result


def _check(best: LandmarkOption, margin: float, frames: MarkerFrames) -> None:
    """Check that a person explains the points, and that the facing is decided. Raises `InputError`."""
    used = best.costs > 0
    unknown = float(np.mean(best.landmarks[used] < 0))
    if best.costs[used].mean() > MAX_MEAN_COST or unknown > MAX_UNKNOWN_SHARE:
        raise InputError(
            f"No standing person explains the {int(used.sum())} points of frame {best.frame}: {100 * unknown:.0f} % of them are at no "
            f"landmark, and the others are {np.sqrt(best.costs[used].mean()):.1f} standard deviations off. Give a take in which the person "
            "stands upright, without props, or labels of landmarks."
        )
    if margin < MIN_FACING_MARGIN:
        raise InputError(
            f"It is not decided which way the person faces, and so which markers are on the left: in frame {best.frame} another facing "
            f"explains the points nearly as well ({margin:.0f} squared deviations worse, at least {MIN_FACING_MARGIN:.0f} are needed). Add "
            "markers on the feet and the pelvis, or give labels of landmarks."
        )


def _collect(frames: MarkerFrames, best: LandmarkOption, margin: float) -> GeometryRecognition:
    """Collect the landmarks of all markers of the take; those between two bones are unknown."""
    every, table = all_landmarks(), landmarks()
    names: list[str | None] = [None] * len(frames.labels)
    for column, (landmark, between) in enumerate(zip(best.landmarks, best.margins, strict=True)):
        if landmark >= 0 and between >= MIN_BONE_MARGIN:
            names[column] = every.names[landmark]
    known = [None if name is None else table[name] for name in names]
    count = len(names)
    unknown = [label for label, name in zip(frames.labels, names, strict=True) if name is None]
    messages = [
        f"{count - len(unknown)} of {count} markers got landmarks by their geometry in frame {best.frame}; check the names of the bones in "
        "the table or the pictures."
    ]
    if unknown:
        messages.append(
            f"{len(unknown)} markers are at no landmark, or between two bones: {', '.join(unknown[:10])}."
        )
    used = set(best.landmarks[best.landmarks >= 0].tolist())
    mirror = mirrored_landmarks()
    lonely = sorted(every.labels[one] for one in used if mirror[one] not in used)
    if lonely:
        messages.append(
            f"{len(lonely)} landmarks have a marker on one side only ({', '.join(lonely[:8])}); markers of these limbs may be at wrong landmarks."
        )
    found = MarkerSet(
        frames.labels,
        tuple(names),
        tuple(None if mark is None else mark.bone for mark in known),
        # the landmark next to it may be meant
        np.array([np.nan if mark is None else max(mark.deviation, GEOMETRY_DEVIATION) for mark in known]),
        np.array([np.nan if mark is None else every.heights[0] for mark in known]),
        np.zeros(count, bool),
        tuple(None if mark is None else "geometry" for mark in known),
        None,
    )
    return GeometryRecognition(found, best.frame, best.cost, margin, tuple(messages))


@eqx.filter_jit
def _predict(subject: Subject, poses: Pose) -> Float[Array, "K L 3"]:
    return jax.lax.map(lambda pose: marker_positions(subject, pose), poses)


@eqx.filter_jit
def _solve_each(
    subject: Subject, starts: Pose, positions: Float[Array, "K L 3"], seen, search: SearchCriteria
) -> tuple[Pose, Float[Array, "K L 3"]]:
    def of_frame(frame):
        pose = solve_frame(subject, frame[0], frame[1], frame[2], search).pose
        return pose, marker_positions(subject, pose)

    return jax.lax.map(of_frame, (starts, positions, seen))
