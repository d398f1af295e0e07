"""A template becomes the actor of a sequence of scans, in two passes (Adaptation, 4.1.4 and 4.2.1)."""

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..body.body import Body
from ..body.kinematics import joint_paths
from ..body.pose import Motion, Pose, stack_poses
from ..energy.term import AbstractEnergy
from ..fit.correspond import Matching, Pairs, Scan, make_scan
from ..fit.sequence import track_frames
from ..fit.track import make_tracker
from ..observe import Cloud
from .beside import centres_beside, make_beside
from .equations import TANGENTIAL, stack, unstack
from .modes import joint_modes
from .people import People, person, traits_like
from .pose import fit_pose, mean_square, pairs_of
from .shape import adapt_shape, own_shape_prior
from .shared import Belief, adapt_shared
from .size import fit_size, resized
from .window import FRAMES, smooth_poses, temporal_energy

#: frames that the actor's size is read from
SIZED = 3
#: share of the weight that balances second differences with the data (eq. 4.16): as much makes motions
#: smoother than people move, and costs distance
BALANCE = 0.1
#: squared distances along the surface count by this share while a person is sought: the skin of another slides
SLIDING = 0.005


class Settings(NamedTuple):
    """What adaptation may be told; weights are against the mean squared distance of a pair, metres squared."""

    #: frames that the body is adapted to, spread over the motion
    frames: int = 40
    #: rounds of joints with their skin, or of the traits of people where these are known, before vertices are adapted
    alone: int = 6
    #: rounds of vertices and joints in each pass
    rounds: tuple[int, ...] = (5, 6)
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
    #: what the actor has of the ways in which people differ, beyond the template; none before they are looked for
    traits: tuple[float, ...] = ()


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
    #: how people differ: those of the template's triangles tell more than it alone
    people: People | None = None


def adapt_body(task: Task, state: AdaptState | None = None) -> Iterator[AdaptState]:
    """Adapt a template to an actor, and yield what is reached after every stage.

    The stages (`plan`): the actor's size from the first frames; all frames tracked; proportions, then vertices and
    joints adapted to some that are spread over the motion, in rounds; all tracked and adapted again; every pose
    by itself; all of them smooth. `state` is one to go on from.

    Memory is that of the clouds of the chosen frames, or of one window.
    """
    scans: dict[int, Scan] = {}
    for number, stage in enumerate(plan(task.settings)):
        if state is not None and number < state.done:
            continue
        if stage.name == "size":
            state = _size(task)
        else:
            assert state is not None
            if stage.name == "adapt":
                state = _adapt(task, state, scans, stage)
            else:
                state = {"track": _track, "pose": _pose, "smooth": _smooth}[stage.name](task, state)
        yield (state := state._replace(done=number + 1))


class Stage(NamedTuple):
    """One stage of an adaptation; in passes from 1, of rounds from 1: those of pass 0 are before any vertex is adapted."""

    name: str
    number: int = 0
    round: int = 0

    def __str__(self) -> str:
        if self.name != "adapt":
            return self.name
        return (
            f"pass {self.number}, round {self.round}" if self.number else f"proportions, round {self.round}"
        )


def plan(settings: Settings) -> list[Stage]:
    """The stages, in order."""
    stages = [Stage("size"), Stage("track")]
    stages += [Stage("adapt", 0, step + 1) for step in range(settings.alone)]
    for number, rounds in enumerate(settings.rounds):
        stages += [Stage("track")] if number else []
        stages += [Stage("adapt", number + 1, step + 1) for step in range(rounds)]
    stages += [Stage("track")] if stages[-1].name == "adapt" else []
    stages += [Stage("pose")]
    return stages if settings.temporal == 0.0 else [*stages, Stage("smooth")]


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


def reference(task: Task, state: AdaptState) -> Body:
    """The body whose shape vertices are held to: the person with the actor's traits where these are known, else the
    template at the actor's size."""
    dtype = task.template.vertices.dtype
    if task.people is not None and state.traits:
        return person(task.people, jnp.asarray(state.traits, dtype))
    return resized(task.template, jnp.asarray(state.size, dtype))


def _size(task: Task) -> AdaptState:
    """The first poses, and how large the actor is."""
    count = min(SIZED, task.frames)
    scans = [make_scan(task.cloud(n)) for n in range(count)]
    found = [_sized(task, scans, task.template, 1.0)]
    if task.start is None:
        # a body of about the right size may find another pose, and finds it more surely
        found.append(_sized(task, scans, found[0].body, found[0].size))
    best = min(found, key=lambda state: state.history[-1][1])
    poses = [best.motion[min(n, count - 1)] for n in range(task.frames)]
    return best._replace(motion=stack_poses(poses, task.rate))


def _sized(task: Task, scans: Sequence[Scan], body: Body, size: float) -> AdaptState:
    """From the template at some size."""
    settings, search = task.settings, task.start is None
    clouds = (task.cloud(n) for n in range(len(scans)))
    frames = track_frames(make_tracker(body), clouds, task.start, search=search)
    poses = [frame.pose for frame in frames]
    body, poses, step = fit_size(body, scans, poses, task.prior, settings.matching, settings.pose)
    told = ("size", _distance(body, poses, scans, settings))
    return AdaptState(0, body, size * step, stack_poses(poses, task.rate), history=(told,))


def _track(task: Task, state: AdaptState) -> AdaptState:
    """All frames by the tracker, which is fast, and searches for frames that are lost."""
    clouds = (task.cloud(n) for n in range(task.frames))
    frames = list(track_frames(make_tracker(state.body), clouds, state.motion[0], sigma=0.03))
    lost = tuple(n for n, frame in enumerate(frames) if frame.lost)
    motion = stack_poses([frame.pose for frame in frames], task.rate)
    return _told(task, state._replace(motion=motion, lost=lost, chosen=()), "track")


def _adapt(task: Task, state: AdaptState, held: dict[int, Scan], stage: Stage) -> AdaptState:
    """One round of what all frames share, with the poses of some."""
    settings = task.settings
    if stage.number == 0 and stage.round == 1 and task.people is not None:
        state = _as_person(task.people, state)
    chosen = state.chosen or spread_frames(state, settings.frames)
    poses = [state.motion[n] for n in chosen]
    for gone in set(held) - set(chosen):
        del held[gone]
    scans = [held.setdefault(n, make_scan(task.cloud(n))) for n in chosen]
    if stage.round == 1:
        poses = [
            fit_pose(
                state.body, scan, pose, task.prior, settings.matching, weight=settings.pose, steps=6
            ).pose
            for scan, pose in zip(scans, poses, strict=True)
        ]
    if stage.number == 0:
        body, poses, traits = _proportions(task, state, poses, scans)
        # vertices are adapted to frames that are chosen anew
        chosen_next = () if stage.round == settings.alone else chosen
    else:
        body, poses = _surface(task, state, poses, scans, stage)
        traits, chosen_next = state.traits, chosen
    every = [state.motion[n] for n in range(len(state.motion))]
    for n, pose in zip(chosen, poses, strict=True):
        every[n] = pose
    told = (str(stage), _distance(body, poses, scans, settings))
    return state._replace(
        body=body,
        motion=stack_poses(every, task.rate),
        chosen=chosen_next,
        traits=traits,
        history=(*state.history, told),
    )


def _as_person(people: People, state: AdaptState) -> AdaptState:
    """The same with the person who is most like the body, in its poses."""
    traits = traits_like(people, state.body)
    body = person(people, traits)
    # a root that is elsewhere at rest stays where it is in the world
    shift = state.body.skeleton.centres[0] - body.skeleton.centres[0]
    poses = state.motion.poses
    poses = Pose(poses.translations.at[:, 0].add(shift), poses.rotations, poses.scale)
    return state._replace(body=body, motion=Motion(poses, state.motion.rate), traits=tuple(traits.tolist()))


def _proportions(
    task: Task, state: AdaptState, poses: list[Pose], scans: list[Scan]
) -> tuple[Body, list[Pose], tuple[float, ...]]:
    """Joints and surface together: by the traits of people where these are known, else by joints that take their skin
    with them."""
    settings, body, traits = task.settings, state.body, state.traits
    pairs = _pairs(settings, body, poses, scans)
    if task.people is None:
        modes, mirrored, along = joint_modes(body), task.mirrored, TANGENTIAL
        belief = _joints_beside(task, state)
    else:
        modes, mirrored, along = task.people.modes, (), SLIDING
        standing = task.people.standing + jnp.asarray(traits)
        # what no person explains is the same in all frames, which therefore count as one
        belief = Belief(-standing, jnp.full_like(standing, len(poses) ** -0.5))
    body, moved_poses, amounts = adapt_shared(
        body, stack(poses), pairs, task.prior, modes, belief, mirrored, *_weights(settings, along)
    )
    if task.people is not None:
        traits = tuple((np.array(traits) + np.asarray(amounts, float)).tolist())
    return body, unstack(moved_poses, len(poses)), traits


def _surface(
    task: Task, state: AdaptState, poses: list[Pose], scans: list[Scan], stage: Stage
) -> tuple[Body, list[Pose]]:
    """Joints within their skin, and then the vertices."""
    settings, body = task.settings, state.body
    pairs = _pairs(settings, body, poses, scans)
    modes, belief = joint_modes(body, follow=False), _joints_beside(task, state)
    body, moved_poses, _ = adapt_shared(
        body, stack(poses), pairs, task.prior, modes, belief, task.mirrored, *_weights(settings, TANGENTIAL)
    )
    poses = unstack(moved_poses, len(poses))
    pairs = _pairs(settings, body, poses, scans)
    prior = own_shape_prior(reference(task, state))
    return adapt_shape(body, moved_poses, pairs, prior, shape_weight(settings, stage)), poses


def _joints_beside(task: Task, state: AdaptState) -> Belief:
    """Joints are where the surface around them says."""
    body = state.body
    beside = centres_beside(make_beside(reference(task, state)), np.asarray(body.vertices, float))
    shifts = jnp.asarray(beside - np.asarray(body.skeleton.centres, float), body.vertices.dtype).reshape(-1)
    return Belief(shifts, jnp.full_like(shifts, task.settings.joint))


def _pairs(settings: Settings, body: Body, poses: list[Pose], scans: list[Scan]) -> Pairs:
    """Those of all frames, stacked."""
    return stack([pairs_of(body, p, s, settings.matching) for p, s in zip(poses, scans, strict=True)])


def _weights(settings: Settings, along: float) -> tuple[Float[Array, ""], ...]:
    pose, deviation, share = (jnp.asarray(x, float) for x in (settings.pose, settings.deviation, along))
    return pose, deviation, share


def shape_weight(settings: Settings, stage: Stage) -> float:
    """From the first weight down to the last over the first pass, and from their mean in later ones."""
    first, last = settings.shape
    first = first if stage.number == 1 else np.sqrt(first * last)
    share = (stage.round - 1) / max(settings.rounds[stage.number - 1] - 1, 1)
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
