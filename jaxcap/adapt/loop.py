"""A template becomes the actor of a sequence of scans, in two passes (Adaptation, 4.1.4 and 4.2.1)."""

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ..body.body import Body
from ..body.kinematics import joint_paths
from ..body.pose import Motion, Pose, stack_poses
from ..energy.term import AbstractEnergy
from ..fit.correspond import Matching, Scan, make_scan
from ..fit.sequence import track_frames
from ..fit.track import make_tracker
from ..observe import Cloud
from .equations import Follow, make_follow, stack, unstack
from .joints import Beside, Trust, adapt_joints, centres_beside, make_beside
from .pose import fit_pose, mean_square, pairs_of
from .shape import ShapePrior, adapt_shape, own_shape_prior
from .size import fit_size, resized
from .window import FRAMES, smooth_poses, temporal_energy

#: frames that the actor's size is read from
SIZED = 3
#: share of the weight that balances second differences with the data (eq. 4.16): as much makes motions
#: smoother than people move, and costs distance
BALANCE = 0.1
#: rounds in which joints alone are adapted, before vertices are
JOINTS_ALONE = 3


class Settings(NamedTuple):
    """What adaptation may be told; weights are against the mean squared distance of a pair, metres squared."""

    #: frames that the body is adapted to, spread over the motion
    frames: int = 40
    #: rounds of joints and vertices in each pass
    rounds: tuple[int, ...] = (8, 6)
    #: weight of the Laplacian term in the first and the last round
    shape: tuple[float, float] = (100.0, 3.0)
    #: weight of the pose prior
    pose: float = 1e-6
    #: weight of second differences; None is by their balance with the data (eq. 4.16), 0 leaves them out
    temporal: float | None = None
    #: standard deviation of a joint from where the surface around it says, metres
    joint: float = 0.005
    #: the same of a pair's distance
    deviation: float = 0.003
    matching: Matching = Matching()


class AdaptState(NamedTuple):
    """What has been reached: enough to go on from, to the last bit."""

    #: stages that are done
    done: int
    body: Body
    #: the actor's size against the template's
    size: float
    #: poses of all frames
    motion: Motion
    #: frames that no pose explained when they were tracked last
    lost: tuple[int, ...] = ()
    #: frames that the body is being adapted to
    chosen: tuple[int, ...] = ()
    #: what each stage was, and the root mean square of a pair after it, millimetres
    history: tuple[tuple[str, float], ...] = ()


class Task(NamedTuple):
    """What stays the same through all stages."""

    template: Body
    #: the cloud of a frame
    cloud: Callable[[int], Cloud]
    frames: int
    rate: float
    #: a pose near that of the first frame; None is searched for
    start: Pose | None
    prior: AbstractEnergy
    #: pairs of joints, left and right, whose bones stay equally long
    mirrored: tuple[tuple[int, int], ...]
    settings: Settings


def adapt_body(task: Task, state: AdaptState | None = None) -> Iterator[AdaptState]:
    """Adapt a template to an actor, and yield what is reached after every stage.

    The stages (`plan`): the actor's size from the first frames; all frames tracked; joints and vertices
    adapted to some that are spread over the motion, in rounds; all tracked and adapted again; every pose by
    itself; all of them smooth. `state` is one to go on from.

    Memory is that of the clouds of the chosen frames, or of one window.
    """
    held: _Held | None = None
    for number, (name, *which) in enumerate(plan(task.settings)):
        if state is not None and number < state.done:
            continue
        if name == "size":
            state = _size(task)
        else:
            assert state is not None
            if name == "adapt":
                if held is None:
                    held = _held(task, state.size)
                state = _adapt(task, state, held, *which)
            else:
                state = {"track": _track, "pose": _pose, "smooth": _smooth}[name](task, state)
        yield (state := state._replace(done=number + 1))


def plan(settings: Settings) -> list[tuple]:
    """The stages by name; of adaptation with its pass and round."""
    stages: list[tuple] = [("size",)]
    for number, rounds in enumerate(settings.rounds):
        stages += [("track",), *(("adapt", number, step) for step in range(rounds))]
    stages += [("track",), ("pose",)]
    return stages if settings.temporal == 0.0 else [*stages, ("smooth",)]


def spread_frames(state: AdaptState, count: int) -> tuple[int, ...]:
    """Frames with poses as unlike each other as can be, each the furthest from those before; none that is lost."""
    there = [n for n in range(len(state.motion)) if n not in state.lost] or [0]
    joints = np.asarray(joint_paths(state.body.skeleton, state.motion.poses), float)[there]
    joints = (joints - joints[:, :1]).reshape(len(there), -1)
    chosen = [0]
    apart = np.linalg.norm(joints - joints[0], axis=1)
    while len(chosen) < min(count, len(there)):
        chosen.append(int(np.argmax(apart)))
        apart = np.minimum(apart, np.linalg.norm(joints - joints[chosen[-1]], axis=1))
    return tuple(sorted(there[n] for n in chosen))


class _Held(NamedTuple):
    """What the template says of shape, at the actor's size; and scans that are adapted to."""

    shape: ShapePrior
    beside: Beside
    follow: Follow
    scans: dict[int, Scan]


def _held(task: Task, size: float) -> _Held:
    template = resized(task.template, jnp.asarray(size, task.template.vertices.dtype))
    return _Held(own_shape_prior(template), make_beside(template), make_follow(template), {})


def _size(task: Task) -> AdaptState:
    """The first poses, and how large the actor is."""
    count, settings = min(SIZED, task.frames), task.settings
    tracker = make_tracker(task.template)
    frames = track_frames(
        tracker, (task.cloud(n) for n in range(count)), task.start, search=task.start is None
    )
    scans = [make_scan(task.cloud(n)) for n in range(count)]
    body, poses, size = fit_size(
        task.template, scans, [frame.pose for frame in frames], task.prior, settings.matching, settings.pose
    )
    motion = stack_poses([poses[min(n, count - 1)] for n in range(task.frames)], task.rate)
    return AdaptState(0, body, size, motion, history=(("size", _distance(body, poses, scans, settings)),))


def _track(task: Task, state: AdaptState) -> AdaptState:
    """All frames by the tracker, which is fast, and searches for frames that are lost."""
    clouds = (task.cloud(n) for n in range(task.frames))
    frames = list(track_frames(make_tracker(state.body), clouds, state.motion[0], sigma=0.03))
    lost = tuple(n for n, frame in enumerate(frames) if frame.lost)
    motion = stack_poses([frame.pose for frame in frames], task.rate)
    return _told(task, state._replace(motion=motion, lost=lost, chosen=()), "track")


def _adapt(task: Task, state: AdaptState, held: _Held, number: int, step: int) -> AdaptState:
    """One round of joints with poses, and vertices."""
    settings, body = task.settings, state.body
    chosen = state.chosen or spread_frames(state, settings.frames)
    poses = [state.motion[n] for n in chosen]
    for gone in set(held.scans) - set(chosen):
        del held.scans[gone]
    scans = [held.scans.setdefault(n, make_scan(task.cloud(n))) for n in chosen]
    if step == 0:
        poses = [
            fit_pose(body, scan, pose, task.prior, settings.matching, weight=settings.pose, steps=6).pose
            for scan, pose in zip(scans, poses, strict=True)
        ]
    trust = Trust(*(jnp.asarray(x, float) for x in (settings.pose, settings.joint, settings.deviation)))
    expected = jnp.asarray(centres_beside(held.beside, np.asarray(body.vertices, float)), float)
    pairs = stack([pairs_of(body, p, s, settings.matching) for p, s in zip(poses, scans, strict=True)])
    body, moved = adapt_joints(
        body, stack(poses), pairs, task.prior, held.follow, task.mirrored, expected, trust
    )
    poses = unstack(moved, len(chosen))
    if number > 0 or step >= JOINTS_ALONE:
        pairs = stack([pairs_of(body, p, s, settings.matching) for p, s in zip(poses, scans, strict=True)])
        body = adapt_shape(body, stack(poses), pairs, held.shape, shape_weight(settings, number, step))
    every = [state.motion[n] for n in range(len(state.motion))]
    for n, pose in zip(chosen, poses, strict=True):
        every[n] = pose
    told = (f"pass {number + 1}, round {step + 1}", _distance(body, poses, scans, settings))
    motion = stack_poses(every, task.rate)
    return state._replace(body=body, motion=motion, chosen=chosen, history=(*state.history, told))


def shape_weight(settings: Settings, number: int, step: int) -> float:
    """From the first weight down to the last over the first pass, and from their mean in later ones."""
    first, last = settings.shape
    begin, rounds = (JOINTS_ALONE, settings.rounds[0]) if number == 0 else (0, settings.rounds[number])
    first = first if number == 0 else np.sqrt(first * last)
    share = (step - begin) / max(rounds - begin - 1, 1)
    return float(first ** (1 - share) * last**share)


def _pose(task: Task, state: AdaptState) -> AdaptState:
    """Every pose by itself, with pairs both ways."""
    settings = task.settings
    poses = [
        fit_pose(
            state.body,
            make_scan(task.cloud(n)),
            state.motion[n],
            task.prior,
            settings.matching,
            weight=settings.pose,
            steps=5,
        ).pose
        for n in range(task.frames)
    ]
    return _told(task, state._replace(motion=stack_poses(poses, task.rate)), "pose")


def _smooth(task: Task, state: AdaptState) -> AdaptState:
    """All poses, smooth in time."""
    settings, body = task.settings, state.body
    poses = [state.motion[n] for n in range(task.frames)]
    temporal = settings.temporal
    if temporal is None:
        rough = float(temporal_energy(body.skeleton, stack(poses)))
        temporal = BALANCE * (state.history[-1][1] / 1000) ** 2 / max(rough, 1e-12)

    # every frame is in some windows, and in each as often as it has steps
    scan_at = functools.lru_cache(FRAMES)(lambda frame: make_scan(task.cloud(frame)))

    def pairs_at(frame: int, pose: Pose):
        return pairs_of(body, pose, scan_at(frame), settings.matching)

    smooth = smooth_poses(body, poses, pairs_at, task.prior, settings.pose, temporal)
    return _told(task, state._replace(motion=stack_poses(smooth, task.rate)), "smooth")


def _told(task: Task, state: AdaptState, name: str) -> AdaptState:
    """With the distance of a few frames in the history."""
    frames = np.unique(np.linspace(0, task.frames - 1, min(task.frames, 8)).astype(int)).tolist()
    scans, poses = [make_scan(task.cloud(n)) for n in frames], [state.motion[n] for n in frames]
    told = (name, _distance(state.body, poses, scans, task.settings))
    return state._replace(history=(*state.history, told))


def _distance(body: Body, poses: Sequence[Pose], scans: Sequence[Scan], settings: Settings) -> float:
    """Root mean squared weighed distance of a pair, millimetres."""
    told = [
        mean_square(body, pose, pairs_of(body, pose, scan, settings.matching))
        for pose, scan in zip(poses, scans, strict=True)
    ]
    return 1000 * float(np.sqrt(np.mean(told)))
