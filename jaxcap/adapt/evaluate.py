"""Evaluation of an adaptation (Adaptation, 4.2.1, tables 4.2 and 4.3).

The same scans are compared with the template, with a body adapted to one scan, and with one adapted to many.
"""

from collections.abc import Iterator, Sequence
from itertools import islice
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import KDTree

from ..body.body import Body, pose_body, scale_body
from ..body.pose import Motion, Pose, stack_poses
from ..geometry import rotation
from ..geometry.laplacian import vertex_adjacency
from ..metrics import Summary, scan_to_surface
from .adapt_body import adapt_body
from .task import AdaptSettings, AdaptState, AdaptTask, plan_stages

#: width of a bin of distances, the resolution of percentiles, and the distance of the last bin, metres
BIN_WIDTH, MAX_DISTANCE = 1e-5, 1.0
#: number of frames with reported joint angles over time (fig. 4.16)
NUM_ANGLE_FRAMES = 500

_log = jax.jit(rotation.log)


class DistanceHistogram(NamedTuple):
    """A histogram of distances, of a size that does not depend on the number of scans."""

    counts: Int[np.ndarray, "B"]
    #: sum, metres, and sum of squares
    total: float
    sum_of_squares: float


class Variant(NamedTuple):
    """The distances of a body from the scans."""

    name: str
    body: Body
    #: from points of the scans to the surface, and from vertices to the nearest point
    scan_to_body: DistanceHistogram
    body_to_scan: DistanceHistogram
    #: mean distance of the points nearest to a vertex or its neighbours, metres; NaN without such points
    heat: Float[np.ndarray, "V"]
    #: median distance of the points of every measured frame, metres
    frame_medians: Float[np.ndarray, "E"]
    #: frames that no pose explains
    lost: tuple[int, ...]


class AngleHistory(NamedTuple):
    """Joint angles over time, before and after smoothing; radians."""

    seconds: Float[np.ndarray, "F"]
    #: rotation of each joint from rest about its main axis
    before: Float[np.ndarray, "F J"]
    #: None if the motion was not smoothed
    after: Float[np.ndarray, "F J"] | None
    #: root mean square of second differences (eq. 4.10)
    roughness_before: Float[np.ndarray, "J"]
    roughness_after: Float[np.ndarray, "J"] | None


class Evaluation(NamedTuple):
    """The variants, from the template to the final result, in the measured frames."""

    measured_frames: tuple[int, ...]
    variants: tuple[Variant, ...] = ()
    #: None for unordered scans
    angles: AngleHistory | None = None


def variant_names(settings: AdaptSettings) -> list[str]:
    """List the names of the variants of `compare_stages`."""
    names = ["not adapted", "first frame", "many frames"]
    return [*names, "smooth"] if settings.smooth else names


def compare_stages(task: AdaptTask, state: AdaptState, *, step: int = 1) -> Iterator[Evaluation]:
    """Measure a finished adaptation, and yield the results after every variant.

    `not adapted` is the template at the actor's size, `first frame` the template adapted to one scan, `many
    frames` the adapted body with every pose fitted by itself, `smooth` the final motion. All frames are
    tracked; every `step`-th one is measured. One scan at a time is in memory, in addition to those of the
    stages.

    **Raises:** `ValueError` if the adaptation is not finished, or `step` is below 1.
    """
    if state.done < len(plan_stages(task.settings)):
        raise ValueError(
            f"{state.done} of {len(plan_stages(task.settings))} stages are finished; finish the adaptation first."
        )
    if step < 1:
        raise ValueError(f"The step is {step}; expected at least 1.")
    stages = Evaluation(tuple(n for n in range(0, task.num_frames, step) if n not in task.missing))

    # tracked before `first frame` too, which adapts to the first frame that is not lost
    size = jnp.asarray(state.size, task.template.vertices.dtype)
    # start with one pose, as an adaptation does: the final poses would help these variants
    begun = _select_frames(state.motion, task.scanned[:1] * task.num_frames)
    template = AdaptState(
        1, scale_body(task.template, size), state.size, begun, pose_weight=state.pose_weight
    )
    tracked = _adapt_until_poses(task, template, 0)
    poses = _fit_poses_independently(task, tracked, stages.measured_frames)
    yield (stages := _append_variant(stages, task, tracked, poses))
    first = _adapt_until_poses(task, tracked, 1)
    poses = _fit_poses_independently(task, first, stages.measured_frames)
    yield (stages := _append_variant(stages, task, first, poses))

    smooth = task.settings.smooth
    frames = tuple(sorted({*range(min(task.num_frames, NUM_ANGLE_FRAMES)), *stages.measured_frames}))
    alone = _fit_poses_independently(task, state, frames) if smooth else _select_frames(state.motion, frames)
    if not task.settings.unordered:
        stages = stages._replace(angles=_angle_history(alone, state.motion if smooth else None))
    poses = _select_frames(alone, [frames.index(frame) for frame in stages.measured_frames])
    yield (stages := _append_variant(stages, task, state, poses))
    if smooth:
        yield _append_variant(stages, task, state, _select_frames(state.motion, stages.measured_frames))


def empty_histogram() -> DistanceHistogram:
    """Make an empty histogram of distances."""
    return DistanceHistogram(np.zeros(round(MAX_DISTANCE / BIN_WIDTH), int), 0.0, 0.0)


def add_distances(histogram: DistanceHistogram, values: Float[np.ndarray, "N"]) -> DistanceHistogram:
    """Add distances, metres, to a histogram; values that are not finite are ignored."""
    values = values[np.isfinite(values)]
    last = len(histogram.counts) - 1
    bins = np.minimum(values / BIN_WIDTH, last).astype(int)
    counts = histogram.counts + np.bincount(bins, minlength=last + 1)
    return DistanceHistogram(
        counts, histogram.total + float(values.sum()), histogram.sum_of_squares + float(np.sum(values**2))
    )


def quantile(distances: DistanceHistogram, share: float) -> float:
    """Compute the quantile of distances at a share, metres, to the width of a bin; NaN without distances."""
    return _weighted_quantile(_bin_centres(distances), distances.counts, share)


def share_below(distances: DistanceHistogram, limits: Float[np.ndarray, "L"]) -> Float[np.ndarray, "L"]:
    """Compute the share of distances below each limit, metres."""
    passed = np.concatenate([[0], np.cumsum(distances.counts)])
    return np.interp(limits / BIN_WIDTH, np.arange(len(passed)), passed / max(passed[-1], 1))


def summarise(distances: DistanceHistogram) -> Summary:
    """Compute location and spread, metres; median, MAD and quartiles (eq. 4.18) to the width of a bin."""
    count = int(distances.counts.sum())
    mean, median = distances.total / max(count, 1), quantile(distances, 0.5)
    off = np.abs(_bin_centres(distances) - median)
    order = np.argsort(off, kind="stable")
    return Summary(
        mean=mean if count else float("nan"),
        sd=float(np.sqrt(max(distances.sum_of_squares / count - mean**2, 0.0))) if count else float("nan"),
        median=median,
        mad=_weighted_quantile(off[order], distances.counts[order], 0.5),
        iqr=quantile(distances, 0.75) - quantile(distances, 0.25),
        count=count,
    )


def _bin_centres(distances: DistanceHistogram) -> Float[np.ndarray, "B"]:
    return (np.arange(len(distances.counts)) + 0.5) * BIN_WIDTH


def _weighted_quantile(values: Float[np.ndarray, "B"], counts: Int[np.ndarray, "B"], share: float) -> float:
    """Compute a quantile of ascending values with counts."""
    passed = np.cumsum(counts)
    return float(values[np.searchsorted(passed, share * passed[-1])]) if passed[-1] else float("nan")


def _adapt_until_poses(task: AdaptTask, state: AdaptState, num_adapted_frames: int) -> AdaptState:
    """Adapt a body to the first `num_adapted_frames` frames (none or one), and track it in all frames."""
    own = task.settings
    settings = own._replace(
        num_frames=num_adapted_frames,
        every=0,
        proportion_rounds=own.proportion_rounds * num_adapted_frames,
        rounds=own.rounds[:num_adapted_frames],
        temporal_weight=0.0,
    )
    left = len(plan_stages(settings)) - 1 - state.done
    for reached in islice(adapt_body(task._replace(settings=settings), state), left):
        state = reached
    return state


def _fit_poses_independently(task: AdaptTask, state: AdaptState, frames: Sequence[int]) -> Motion:
    """Fit the poses of some frames by the stage `pose`, from those of a state."""
    settings = task.settings._replace(every=0, proportion_rounds=0, rounds=(), temporal_weight=0.0)
    some = task.subset(frames)._replace(settings=settings)
    begun = state._replace(done=len(plan_stages(settings)) - 1, motion=_select_frames(state.motion, frames))
    (found,) = adapt_body(some, begun)
    return found.motion


def _select_frames(motion: Motion, frames: Sequence[int]) -> Motion:
    return stack_poses([motion[frame] for frame in frames], motion.rate)


def _append_variant(stages: Evaluation, task: AdaptTask, state: AdaptState, motion: Motion) -> Evaluation:
    """Measure the distances of a body in the measured frames, and append them as a variant."""
    body, faces = state.body, np.asarray(state.body.faces)
    to_body, to_scan = empty_histogram(), empty_histogram()
    sums = np.zeros((len(body.vertices), 2))
    medians = []
    for number, frame in enumerate(stages.measured_frames):
        scan = task.scan(frame)
        vertices = _vertices(body, motion[number])
        distances = scan_to_surface(scan.points, vertices, faces)
        to_body, to_scan = (
            add_distances(to_body, distances),
            add_distances(to_scan, scan.tree.query(vertices)[0]),
        )
        np.add.at(
            sums, KDTree(vertices).query(scan.points)[1], np.stack([distances, np.ones_like(distances)], 1)
        )
        medians.append(np.median(distances))
    sums += vertex_adjacency(faces, len(body.vertices)) @ sums
    heat = np.where(sums[:, 1] > 0, sums[:, 0] / np.maximum(sums[:, 1], 1.0), np.nan)
    name = variant_names(task.settings)[len(stages.variants)]
    variant = Variant(name, body, to_body, to_scan, heat, np.array(medians), state.lost)
    return stages._replace(variants=(*stages.variants, variant))


def _vertices(body: Body, pose: Pose) -> Float[np.ndarray, "V 3"]:
    return np.asarray(pose_body(body, pose).vertices, float)


def _angle_history(alone: Motion, smooth: Motion | None) -> AngleHistory:
    """Compute the joint angles of consecutive frames."""
    frames = min(len(alone if smooth is None else smooth), NUM_ANGLE_FRAMES)
    turns = [motion.poses.rotations[:frames] for motion in (alone, smooth) if motion is not None]
    vectors = [np.asarray(_log(turn), float) for turn in turns]
    axes = main_axes(vectors[-1])
    angles = [np.einsum("fja,ja->fj", vector, axes) for vector in vectors]
    shakes = [np.asarray(_roughness(turn), float) for turn in turns]
    after = (None, None) if smooth is None else (angles[1], shakes[1])
    return AngleHistory(np.arange(frames) / alone.rate, angles[0], after[0], shakes[0], after[1])


def main_axes(vectors: Float[np.ndarray, "F J 3"]) -> Float[np.ndarray, "J 3"]:
    """Compute the main axis of each joint's rotation vectors; its largest component is positive."""
    off = vectors - vectors.mean(0)
    axes = np.linalg.eigh(np.einsum("fja,fjb->jab", off, off))[1][..., -1]
    largest = np.take_along_axis(axes, np.abs(axes).argmax(1)[:, None], 1)
    return axes * np.where(largest < 0, -1.0, 1.0)


@jax.jit
def _roughness(rotations: Float[Array, "F J 4"]) -> Float[Array, "J"]:
    """Compute the RMS difference of rotations from the mean of both neighbours (eq. 4.10), radians."""
    back = rotation.conjugate(rotations[1:-1])
    before, after = (rotation.log(rotation.multiply(back, turn)) for turn in (rotations[:-2], rotations[2:]))
    return jnp.sqrt(jnp.sum((before + after) ** 2, (0, 2)) / max(len(back), 1)) / 2
