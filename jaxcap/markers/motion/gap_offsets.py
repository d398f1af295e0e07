"""Offsets of markers from their bones in gaps, with the statistics of gaps that are made in visible pieces."""

from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...body.kinematics import forward_kinematics
from ...body.pose import Motion, Pose
from ...geometry.sampling import even_indices
from ...observe.markers import MarkerFrames
from ..calibration.residuals import rest_positions
from ..segments.gaps import find_runs
from ..subject import Subject
from .gap_model import (
    NINETY,
    Gap,
    GapModel,
    MadeGaps,
    bridge,
    estimate_gap,
    learn_gap_model,
    standardised_errors,
    worst_axis,
)
from .inverse_kinematics import solve_markers

#: number of rounds of made gaps, and share of the frames of a marker in them in each round
NUM_ROUNDS, MADE_SHARE = 4, 0.06
#: longest made gap, as a share of the take
MAX_MADE = 0.1
#: number of frames in which gaps are made at most
MAX_FRAMES = 3000
#: number of gaps that the quantile of all markers' errors counts as
PRIOR_GAPS = 8.0


class FilledOffsets(NamedTuple):
    """Offsets of markers in the rest frames of their bones, and the poses that these belong to."""

    offsets: Float[np.ndarray, "F M 3"]
    #: metres, along the least certain axis; of gaps only
    deviations: Float[np.ndarray, "F M"]
    poses: Pose


def fill_offsets(
    subject: Subject,
    motion: Motion,
    positions: Float[Array, "F M 3"],
    trusted: Bool[np.ndarray, "F M"],
    gap: Bool[np.ndarray, "F M"],
) -> FilledOffsets:
    """Estimate the offsets of markers in gaps.

    The frames next to a gap are solved without its marker, as the frames in it: so the offsets at both ends
    belong to the same kind of pose. `trusted` are the observed positions, `gap` those to be estimated.
    """
    offsets = np.tile(np.asarray(subject.offsets, float), (len(gap), 1, 1))
    deviations = np.zeros(gap.shape)
    deviations[:] = np.asarray(subject.deviations, float)
    filling = gap & trusted.any(0)
    if not filling.any():
        return FilledOffsets(offsets, deviations, motion.poses)
    gaps = find_gaps(filling, trusted)
    poses, local = _offsets_without(subject, motion.rate, positions, trusted, gaps)
    made = _make_gaps(subject, motion.rate, positions, trusted, gaps)
    models, scales = _learn_models(subject, np.flatnonzero(filling.any(0)), made, motion.rate)
    for one in gaps:
        model = models[one.marker]
        found, variance = estimate_gap(model, one, local, trusted)
        offsets[one.begin : one.end, one.marker] = found
        axis = worst_axis(model.residual)
        spread = scales[one.marker] * np.sqrt(variance * (axis @ model.residual @ axis))
        deviations[one.begin : one.end, one.marker] = spread
    return FilledOffsets(offsets, deviations, poses)


def find_gaps(gap: Bool[np.ndarray, "F M"], trusted: Bool[np.ndarray, "F M"]) -> list[Gap]:
    """Find the gaps of all markers, with the observed frames next to them."""
    found, count = [], len(gap)
    for marker in range(gap.shape[1]):
        for begin, end in find_runs(gap[:, marker]):
            before = begin - 1 if begin > 0 and trusted[begin - 1, marker] else -1
            after = end if end < count and trusted[end, marker] else -1
            found.append(Gap(marker, begin, end, before, after))
    return found


def rest_frame_positions(
    subject: Subject, motion: Motion, positions: Float[Array, "F M 3"]
) -> Float[Array, "F M 3"]:
    """Transform marker positions of a motion to the rest frames of their bones, metres."""
    return _to_rest_frames(subject, motion.poses, positions)


def _offsets_without(
    subject: Subject, rate: float, positions, trusted: Bool[np.ndarray, "F M"], gaps: list[Gap]
) -> tuple[Pose, Float[np.ndarray, "F M 3"]]:
    """Solve the poses without the markers of gaps in and next to these, and compute the offsets of all markers."""
    used = trusted.copy()
    for one in gaps:
        used[max(one.begin - 1, 0) : one.end + 1, one.marker] = False
    solved = solve_markers(subject, MarkerFrames(positions, used, subject.labels, rate))
    return solved.motion.poses, np.asarray(_to_rest_frames(subject, solved.motion.poses, positions), float)


def _make_gaps(
    subject: Subject, rate: float, positions, trusted: Bool[np.ndarray, "F M"], gaps: list[Gap]
) -> list[MadeGaps]:
    """Make gaps as long as the real ones in visible pieces of the same markers, in addition to the real ones."""
    rng = np.random.default_rng(0)
    first = max(0, (len(trusted) - MAX_FRAMES) // 2)
    part = slice(first, first + MAX_FRAMES)
    positions, trusted = positions[part], trusted[part]
    count = len(trusted)
    longest = max(2, round(MAX_MADE * count))
    lengths = np.array([min(one.end - one.begin, longest) for one in gaps])
    made = []
    for _ in range(NUM_ROUNDS):
        holes: list[Gap] = []
        for marker in sorted({one.marker for one in gaps}):
            free, target = trusted[:, marker].copy(), MADE_SHARE * trusted[:, marker].sum()
            for _ in range(200):
                length = int(rng.choice(lengths))
                runs = [run for run in find_runs(free) if run[1] - run[0] >= length + 4]
                if target <= 0 or not runs:
                    break
                sizes = np.array([end - begin for begin, end in runs], float)
                begin, end = runs[rng.choice(len(runs), p=sizes / sizes.sum())]
                start = int(rng.integers(begin + 2, end - length - 1))
                holes.append(Gap(marker, start, start + length, start - 1, start + length))
                free[start - 2 : start + length + 2] = False
                target -= length
        if not holes:
            break
        _, local = _offsets_without(
            subject, rate, positions, trusted, [*find_gaps(~trusted & trusted.any(0), trusted), *holes]
        )
        seen = trusted.copy()
        for one in holes:
            seen[one.begin : one.end, one.marker] = False
        made.append(MadeGaps(holes, local, seen))
    return made


def _learn_models(
    subject: Subject, markers: Int[np.ndarray, "K"], made: list[MadeGaps], rate: float
) -> tuple[dict[int, GapModel], dict[int, float]]:
    """Learn the model of each marker, and the factor of its deviations with which nine of ten errors are in the interval."""
    bones, used = np.asarray(subject.bones), np.asarray(subject.weights) > 0
    pooled = _pooled_covariance(subject, made, rate)
    models, errors = {}, {}
    for marker in markers.tolist():
        others = np.flatnonzero((bones == bones[marker]) & used & (np.arange(len(bones)) != marker))
        model = learn_gap_model(marker, others, made, pooled, rate)
        if np.isnan(model.mean[:3]).any():
            model = model._replace(neighbours=others[:0], mean=np.asarray(subject.offsets[marker], float))
        models[marker], errors[marker] = model, standardised_errors(model)
    whole = np.concatenate([*errors.values(), np.zeros(0)])
    common = _interval_factor(whole) if len(whole) else 1.0
    scales = {}
    for marker, own in errors.items():
        count = sum(gap.marker == marker for one in made for gap in one.gaps)
        share = count / (count + PRIOR_GAPS)
        scales[marker] = common ** (1 - share) * (_interval_factor(own) if len(own) else common) ** share
    return models, scales


def _interval_factor(errors: Float[np.ndarray, "E"]) -> float:
    """Compute the factor of the deviation with which the normal interval has nine of ten errors."""
    return max(float(np.quantile(np.abs(errors), 0.9)) / NINETY, 1e-3)


def _pooled_covariance(subject: Subject, made: list[MadeGaps], rate: float) -> Float[np.ndarray, "3 3"]:
    """Compute the mean variance of errors of a bridge of unit variance over all made gaps."""
    squares = []
    for one in made:
        for gap in (one.gaps[i] for i in even_indices(len(one.gaps), 200)):
            left, right, variance = bridge(gap, 0.2 * rate)
            at = one.offsets[:, gap.marker]
            ends = left[:, None] * at[gap.before] + right[:, None] * at[gap.after]
            rest = (1 - left - right)[:, None] * np.asarray(subject.offsets[gap.marker], float)
            off = at[gap.begin : gap.end] - ends - rest
            squares.append(np.mean(off**2 / variance[:, None]))
    middle = float(np.median(squares)) if squares else float(np.median(subject.deviations)) ** 2
    return middle * np.eye(3)


@eqx.filter_jit
def _to_rest_frames(subject: Subject, poses: Pose, positions: Float[Array, "F M 3"]) -> Float[Array, "F M 3"]:
    def of_frame(frame):
        pose, observed = frame
        return rest_positions(subject, pose, forward_kinematics(subject.skeleton, pose), observed)

    return jax.lax.map(of_frame, (poses, positions))
