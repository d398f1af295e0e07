"""Evaluation of an adaptation (Adaptation, 4.2.1, tables 4.2 and 4.3).

The same scans are compared with the template, with a body adapted to one scan, and with one adapted to many.
"""

from collections.abc import Iterator, Sequence
from itertools import islice
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import KDTree

from ..body.body import Body, pose_body
from ..body.pose import Motion, Pose, stack_poses
from ..geometry import rotation
from ..geometry.laplacian import vertex_adjacency
from ..metrics import Summary, scan_to_surface
from .adapt_body import AdaptSettings, AdaptState, AdaptTask, adapt_body, plan
from .shape.scale import resized

#: width of a bin of distances, the resolution of percentiles, and the distance of the last bin, metres
BIN, FURTHEST = 1e-5, 1.0
#: number of frames with reported joint angles over time (fig. 4.16)
CURVED = 500

_posed, _log = eqx.filter_jit(pose_body), jax.jit(rotation.log)


class Distances(NamedTuple):
    """A histogram of distances, of a size that does not depend on the number of scans."""

    counts: Int[np.ndarray, "B"]
    #: sum, metres, and sum of squares
    total: float
    squares: float


class Variant(NamedTuple):
    """The distances of a body from the scans."""

    name: str
    body: Body
    #: from points of the scans to the surface, and from vertices to the nearest point
    to_body: Distances
    to_scan: Distances
    #: mean distance of the points nearest to a vertex or its neighbours, metres; NaN without such points
    heat: Float[np.ndarray, "V"]
    #: median distance of the points of every measured frame, metres
    by_frame: Float[np.ndarray, "E"]
    #: frames that no pose explains
    lost: tuple[int, ...]


class Angles(NamedTuple):
    """Joint angles over time, before and after smoothing; radians."""

    seconds: Float[np.ndarray, "F"]
    #: rotation of each joint from rest about its main axis
    before: Float[np.ndarray, "F J"]
    #: None if the motion was not smoothed
    after: Float[np.ndarray, "F J"] | None
    #: root mean square of second differences (eq. 4.10)
    shake_before: Float[np.ndarray, "J"]
    shake_after: Float[np.ndarray, "J"] | None


class Stages(NamedTuple):
    """The variants, from the template to the final result, in the measured frames."""

    measured: tuple[int, ...]
    variants: tuple[Variant, ...] = ()
    #: None for unordered scans
    angles: Angles | None = None


def variant_names(settings: AdaptSettings) -> list[str]:
    """List the names of the variants of `compare_stages`."""
    names = ["not adapted", "first frame", "many frames"]
    return [*names, "smooth"] if settings.smooth else names


def compare_stages(task: AdaptTask, state: AdaptState, *, step: int = 1) -> Iterator[Stages]:
    """Measure a finished adaptation, and yield the results after every variant.

    `not adapted` is the template at the actor's size, `first frame` the template adapted to one scan, `many
    frames` the adapted body with every pose fitted by itself, `smooth` the final motion. All frames are
    tracked; every `step`-th one is measured. One scan at a time is in memory, in addition to those of the
    stages.

    **Raises:** `ValueError` if the adaptation is not finished, or `step` is below 1.
    """
    if state.done < len(plan(task.settings)):
        raise ValueError(
            f"{state.done} of {len(plan(task.settings))} stages are finished; finish the adaptation first."
        )
    if step < 1:
        raise ValueError(f"The step is {step}; expected at least 1.")
    stages = Stages(tuple(n for n in range(0, task.frames, step) if n not in task.missing))

    # tracked before `first frame` too, which adapts to the first frame that is not lost
    size = jnp.asarray(state.size, task.template.vertices.dtype)
    # start with one pose, as an adaptation does: the final poses would help these variants
    begun = _taken(state.motion, task.scanned[:1] * task.frames)
    template = AdaptState(1, resized(task.template, size), state.size, begun, weight=state.weight)
    tracked = _until_poses(task, template, 0)
    poses = _each_by_itself(task, tracked, stages.measured)
    yield (stages := _measured(stages, task, tracked, poses))
    first = _until_poses(task, tracked, 1)
    poses = _each_by_itself(task, first, stages.measured)
    yield (stages := _measured(stages, task, first, poses))

    smooth = task.settings.smooth
    frames = tuple(sorted({*range(min(task.frames, CURVED)), *stages.measured}))
    alone = _each_by_itself(task, state, frames) if smooth else _taken(state.motion, frames)
    if not task.settings.unordered:
        stages = stages._replace(angles=_angles(alone, state.motion if smooth else None))
    poses = _taken(alone, [frames.index(frame) for frame in stages.measured])
    yield (stages := _measured(stages, task, state, poses))
    if smooth:
        yield _measured(stages, task, state, _taken(state.motion, stages.measured))


def no_distances() -> Distances:
    """Make an empty histogram of distances."""
    return Distances(np.zeros(round(FURTHEST / BIN), int), 0.0, 0.0)


def with_distances(known: Distances, more: Float[np.ndarray, "N"]) -> Distances:
    """Add distances, metres, to a histogram; values that are not finite are ignored."""
    more = more[np.isfinite(more)]
    last = len(known.counts) - 1
    bins = np.minimum(more / BIN, last).astype(int)
    counts = known.counts + np.bincount(bins, minlength=last + 1)
    return Distances(counts, known.total + float(more.sum()), known.squares + float(np.sum(more**2)))


def quantile(distances: Distances, share: float) -> float:
    """Compute the quantile of distances at a share, metres, to the width of a bin; NaN without distances."""
    return _weighed_quantile(_middles(distances), distances.counts, share)


def share_below(distances: Distances, limits: Float[np.ndarray, "L"]) -> Float[np.ndarray, "L"]:
    """Compute the share of distances below each limit, metres."""
    passed = np.concatenate([[0], np.cumsum(distances.counts)])
    return np.interp(limits / BIN, np.arange(len(passed)), passed / max(passed[-1], 1))


def summary_of(distances: Distances) -> Summary:
    """Compute location and spread, metres; median, MAD and quartiles (eq. 4.18) to the width of a bin."""
    count = int(distances.counts.sum())
    mean, median = distances.total / max(count, 1), quantile(distances, 0.5)
    off = np.abs(_middles(distances) - median)
    order = np.argsort(off, kind="stable")
    return Summary(
        mean=mean if count else float("nan"),
        sd=float(np.sqrt(max(distances.squares / count - mean**2, 0.0))) if count else float("nan"),
        median=median,
        mad=_weighed_quantile(off[order], distances.counts[order], 0.5),
        iqr=quantile(distances, 0.75) - quantile(distances, 0.25),
        count=count,
    )


def _middles(distances: Distances) -> Float[np.ndarray, "B"]:
    return (np.arange(len(distances.counts)) + 0.5) * BIN


def _weighed_quantile(values: Float[np.ndarray, "B"], counts: Int[np.ndarray, "B"], share: float) -> float:
    """Compute a quantile of ascending values with counts."""
    passed = np.cumsum(counts)
    return float(values[np.searchsorted(passed, share * passed[-1])]) if passed[-1] else float("nan")


def _until_poses(task: AdaptTask, state: AdaptState, adapted: int) -> AdaptState:
    """Adapt a body to the first `adapted` frames (none or one), and track it in all frames."""
    own = task.settings
    settings = own._replace(
        frames=adapted, every=0, alone=own.alone * adapted, rounds=own.rounds[:adapted], temporal=0.0
    )
    left = len(plan(settings)) - 1 - state.done
    for reached in islice(adapt_body(task._replace(settings=settings), state), left):
        state = reached
    return state


def _each_by_itself(task: AdaptTask, state: AdaptState, frames: Sequence[int]) -> Motion:
    """Fit the poses of some frames by the stage `pose`, from those of a state."""
    settings = task.settings._replace(every=0, alone=0, rounds=(), temporal=0.0)
    some = task.some(frames)._replace(settings=settings)
    begun = state._replace(done=len(plan(settings)) - 1, motion=_taken(state.motion, frames))
    (found,) = adapt_body(some, begun)
    return found.motion


def _taken(motion: Motion, frames: Sequence[int]) -> Motion:
    return stack_poses([motion[frame] for frame in frames], motion.rate)


def _measured(stages: Stages, task: AdaptTask, state: AdaptState, motion: Motion) -> Stages:
    """Measure the distances of a body in the measured frames, and append them as a variant."""
    body, faces = state.body, np.asarray(state.body.faces)
    to_body, to_scan = no_distances(), no_distances()
    sums = np.zeros((len(body.vertices), 2))
    medians = []
    for number, frame in enumerate(stages.measured):
        scan = task.scan(frame)
        vertices = _vertices(body, motion[number])
        apart = scan_to_surface(scan.points, vertices, faces)
        to_body, to_scan = (
            with_distances(to_body, apart),
            with_distances(to_scan, scan.tree.query(vertices)[0]),
        )
        np.add.at(sums, KDTree(vertices).query(scan.points)[1], np.stack([apart, np.ones_like(apart)], 1))
        medians.append(np.median(apart))
    sums += vertex_adjacency(faces, len(body.vertices)) @ sums
    heat = np.where(sums[:, 1] > 0, sums[:, 0] / np.maximum(sums[:, 1], 1.0), np.nan)
    name = variant_names(task.settings)[len(stages.variants)]
    variant = Variant(name, body, to_body, to_scan, heat, np.array(medians), state.lost)
    return stages._replace(variants=(*stages.variants, variant))


def _vertices(body: Body, pose: Pose) -> Float[np.ndarray, "V 3"]:
    return np.asarray(_posed(body, pose).vertices, float)


def _angles(alone: Motion, smooth: Motion | None) -> Angles:
    """Compute the joint angles of consecutive frames."""
    frames = min(len(alone if smooth is None else smooth), CURVED)
    turns = [motion.poses.rotations[:frames] for motion in (alone, smooth) if motion is not None]
    vectors = [np.asarray(_log(turn), float) for turn in turns]
    axes = main_axes(vectors[-1])
    angles = [np.einsum("fja,ja->fj", vector, axes) for vector in vectors]
    shakes = [np.asarray(_shake(turn), float) for turn in turns]
    after = (None, None) if smooth is None else (angles[1], shakes[1])
    return Angles(np.arange(frames) / alone.rate, angles[0], after[0], shakes[0], after[1])


def main_axes(vectors: Float[np.ndarray, "F J 3"]) -> Float[np.ndarray, "J 3"]:
    """Compute the main axis of each joint's rotation vectors; its largest component is positive."""
    off = vectors - vectors.mean(0)
    axes = np.linalg.eigh(np.einsum("fja,fjb->jab", off, off))[1][..., -1]
    largest = np.take_along_axis(axes, np.abs(axes).argmax(1)[:, None], 1)
    return axes * np.where(largest < 0, -1.0, 1.0)


@jax.jit
def _shake(turns: Float[Array, "F J 4"]) -> Float[Array, "J"]:
    """Compute the RMS difference of rotations from the mean of both neighbours (eq. 4.10), radians."""
    back = rotation.conjugate(turns[1:-1])
    before, after = (rotation.log(rotation.multiply(back, turn)) for turn in (turns[:-2], turns[2:]))
    return jnp.sqrt(jnp.sum((before + after) ** 2, (0, 2)) / max(len(back), 1)) / 2
