"""A template becomes the actor of a sequence of scans, in two passes (Adaptation, 4.1.4 and 4.2.1)."""

import functools
import logging
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..arguments import checked
from ..body.body import Body
from ..body.pose import Motion, Pose, difference, retract, stack_poses
from ..body.skeleton import Skeleton
from ..fit.correspondence.correspond import Pairs, Scan
from ..fit.tracking.likeliest import likelier_pose
from ..fit.tracking.limb_flips import turn_over
from ..fit.tracking.track import track_frames
from .flagged import flag_frames
from .objective import balanced, motion_energy
from .poses.sliding_window import FRAMES, smooth_windows
from .poses.task_pairs import Meetings, pairs_at, poses_at, some_of, told
from .poses.unordered import find_poses
from .rounds import adapt_round
from .rounds import shape_weight as shape_weight
from .rounds import spread_frames as spread_frames
from .shape.scale import fit_size
from .task import AdaptState as AdaptState
from .task import Settings as Settings
from .task import Stage as Stage
from .task import Task as Task
from .task import plan as plan
from .task import tracker_of

_LOG = logging.getLogger(__name__)

#: frames that the actor's size is read from
SIZED = 3
#: share of the weights that balance the pose prior and second differences with the data (eqs. 4.15 and 4.16): as much
#: rolls forearms towards rest until hands lie the wrong way up, and makes motions smoother than people move
BALANCE = 0.1
#: weight of the pose prior while the first poses are found, where it is to be balanced with the data
FIRST_WEIGHT = 1e-6

#: mean log-likelihood by which a pose from before hands were turned over has to be better: they have few of the points
TURNED = 0.05

#: what is reached within a stage, and at its end
Steps = Generator[AdaptState, None, AdaptState]


@checked
def adapt_body(task: Task, state: AdaptState | None = None, every: int = 0) -> Iterator[AdaptState]:
    """Adapt a template to an actor, and yield what is reached after every stage; and where `every` is given, within the
    stages that go through the frames, which are tracking, single poses and smoothing, also after every so many of them.

    The stages (`plan`): the actor's size from the first frames; all frames tracked; proportions, and hands turned over
    that lie the wrong way up; then vertices and joints adapted to some that are spread over the motion, in rounds; all
    tracked and adapted again; every pose by itself; all of them smooth. `state` is one to go on from.

    A frame that is `missing` is lost: its pose lies between those of the frames around it.

    Memory is that of the clouds of the chosen frames, or of one window.
    """
    meetings = Meetings(task)
    stages = plan(task.settings)
    for number, stage in enumerate(stages):
        if state is not None and number < state.done:
            continue
        _LOG.info("adapting, stage %d of %d: %s", number + 1, len(stages), stage)
        if stage.name == "size":
            state = _size(task)
        else:
            assert state is not None
            if stage.name == "adapt":
                state = adapt_round(task, state, meetings, stage)
            else:
                state = yield from _STAGES[stage.name](task, state, stage, every)
        if number + 1 == len(stages):
            state = flag_frames(task, state, final=True)
        yield (state := state._replace(done=number + 1))


def _size(task: Task) -> AdaptState:
    """The first poses, and how large the actor is."""
    # where scans do not follow each other the first one does not lead to others yet
    frames = task.scanned[: 1 if task.settings.unordered else SIZED]
    scans = [task.scan(n) for n in frames]
    found = [_sized(task, scans, frames, task.template, 1.0)]
    if task.start is None:
        # a body of about the right size may find another pose, and finds it more surely
        found.append(_sized(task, scans, frames, found[0].body, found[0].size))
    best = min(found, key=lambda state: state.history[-1][1])
    poses = {frame: best.motion[n] for n, frame in enumerate(frames)}
    return best._replace(motion=_every_frame(task, poses))


def _sized(task: Task, scans: Sequence[Scan], frames: Sequence[int], body: Body, size: float) -> AdaptState:
    """From the template at some size."""
    settings, search = task.settings, task.start is None
    weight = FIRST_WEIGHT if settings.pose is None else settings.pose
    clouds = (task.cloud(n) for n in frames)
    tracked = track_frames(tracker_of(task, body), clouds, task.start, search=search)
    poses = [frame.pose for frame in tracked]
    body, poses, step = fit_size(
        body,
        scans,
        poses,
        task.prior,
        settings.matching,
        weight,
        cameras=task.cameras,
        boxes=task.boxes,
        terms=task.terms,
        already=size,
    )
    motion = stack_poses(poses, task.rate)
    state = AdaptState(0, body, size * step, motion, weight=weight)
    state = told(task.some(frames), state, "size", range(len(frames)))
    if settings.pose is None:
        # first poses are often at rest and later ones are not: a prior that is right is worth one a number
        worth = max(state.terms[0].pose, float(body.skeleton.num_dofs))
        weight = BALANCE * balanced(state.terms[0].data, worth)
    return state._replace(weight=weight)


def _every_frame(task: Task, poses: Mapping[int, Pose]) -> Motion:
    """A pose for every frame: its own, or one between those of the frames around it, as far as it is along."""
    known, every = sorted(poses), []
    for frame in range(task.frames):
        if frame in poses:
            every.append(poses[frame])
            continue
        before = max((n for n in known if n < frame), default=known[0])
        after = min((n for n in known if n > frame), default=known[-1])
        share = (frame - before) / (after - before) if after > before else 0.0
        every.append(_between(task.template.skeleton, poses[before], poses[after], jnp.asarray(share)))
    return stack_poses(every, task.rate)


@eqx.filter_jit
def _between(skeleton: Skeleton, before: Pose, after: Pose, share: Float[Array, ""]) -> Pose:
    """The pose at a share of the way between two."""
    return retract(skeleton, before, share * difference(skeleton, before, after))


def _turn(task: Task, state: AdaptState, stage: Stage, every: int) -> Steps:
    """Hands that lie the wrong way up, which shows once proportions are the actor's; then all frames are tracked again."""
    if task.settings.unordered:
        return (yield from _turn_each(task, state, stage, every))
    if state.within:
        return (yield from _track(task, state, stage, every))
    first, tracker = task.scanned[:SIZED], tracker_of(task, state.body)
    clouds = [task.cloud(n) for n in first]
    # the body has changed since these were tracked, and other frames have been fitted to it
    poses = [
        frame.pose
        for frame in track_frames(tracker, clouds, state.motion[first[0]], search=False, sigma=0.03)
    ]
    turned = turn_over(tracker, clouds, poses)
    if turned[0] is poses[0]:
        return told(task, state, str(stage), some_of(task.scanned))
    return (yield from _track(task, state, stage, every, turned[0]))


def _turn_each(task: Task, state: AdaptState, stage: Stage, every: int) -> Steps:
    """The same where a hand may lie the wrong way up in one scan and not in another."""
    tracker, there = tracker_of(task, state.body), task.scanned
    while state.within < len(there):
        some = there[state.within :][: every or None]
        poses = {n: state.motion[n] for n in there}
        for n in some:
            cloud = task.cloud(n)
            (turned,) = turn_over(tracker, [cloud], [poses[n]])
            poses[n] = likelier_pose(tracker, poses[n], turned, cloud)
        state = state._replace(motion=_every_frame(task, poses), within=state.within + len(some))
        if state.within < len(there):
            yield state
    return told(task, state._replace(within=0), str(stage), some_of(there))


def _track(task: Task, state: AdaptState, stage: Stage, every: int, start: Pose | None = None) -> Steps:
    """All frames, or the first ones, by the tracker, which is fast, and searches for frames that are lost. A frame keeps
    its pose where the tracker finds none that explains it better."""
    if task.settings.unordered:
        return (yield from _find(task, state, stage, every))
    there, passed = task.frames_of(stage), state.within
    if not passed:
        state = state._replace(lost=tuple(task.missing), reasons=(), chosen=())
    before = state.tracked or (state.motion[there[0]] if start is None else start)
    clouds = (task.cloud(n) for n in there[passed:])

    def known(number: int) -> list[Pose]:
        # those of the frame itself and of the one after it, as they were before this stage
        return [own[n] for n in there[number : number + 2]]

    own = state.motion
    worth = TURNED if stage.name == "turn" else 0.0
    frames = track_frames(
        tracker_of(task, state.body),
        clouds,
        before,
        search=False,
        sigma=0.03,
        first=passed,
        known=known,
        worth=worth,
    )
    poses, lost = {n: state.motion[n] for n in there[:passed]}, set(state.lost)
    for done, (n, frame) in enumerate(zip(there[passed:], frames, strict=True), passed + 1):
        poses[n] = frame.pose
        if frame.lost:
            lost.add(n)
        if every and done % every == 0 and done < len(there):
            motion = _every_frame(task, {n: state.motion[n] for n in task.scanned} | poses)
            yield state._replace(motion=motion, lost=tuple(sorted(lost)), within=done, tracked=frame)
    motion = _every_frame(task, poses)
    state = state._replace(motion=motion, lost=tuple(sorted(lost)), within=0, tracked=None)
    # with all frames known what is normal shows; of the first ones the tracker's own judgement counts
    state = flag_frames(task, state) if stage.frames is None else state
    return told(task, state, str(stage), some_of(task.scanned) if stage.frames is None else there[-1:])


def _find(task: Task, state: AdaptState, stage: Stage, every: int) -> Steps:
    """All frames, from those that are most like them."""
    there = task.scanned
    poses = {n: state.motion[n] for n in there}
    for found, number in find_poses(task, state.body, poses, known=state.done > 1, done=state.within):
        poses |= found.poses
        if every and number % every == 0 and number < len(there):
            yield state._replace(motion=_every_frame(task, poses), within=number)
    state = state._replace(motion=_every_frame(task, poses), chosen=(), within=0)
    return told(task, flag_frames(task, state), str(stage), some_of(there))


def _poses(task: Task, state: AdaptState, stage: Stage, every: int) -> Steps:
    """Every pose by itself, with pairs both ways; so many frames at a time, from those on that are done."""
    there = task.scanned
    while state.within < len(there):
        some = there[state.within :][: every or None]
        poses = {n: state.motion[n] for n in there}
        found = poses_at(task, state, (task.scan(n) for n in some), (poses[n] for n in some), steps=5)
        poses |= dict(zip(some, found, strict=True))
        state = state._replace(motion=_every_frame(task, poses), within=state.within + len(some))
        if state.within < len(there):
            yield state
    return told(task, state._replace(within=0), str(stage), some_of(task.scanned))


def _smooth(task: Task, state: AdaptState, stage: Stage, every: int) -> Steps:
    """All poses, smooth in time. Frames without a scan are left out, and lie between the others."""
    settings, body, there = task.settings, state.body, task.scanned
    if not state.within:
        temporal = settings.temporal
        if temporal is None:
            # a pose that is wild would leave all others rough
            rough = motion_energy(body.skeleton, state.motion, without={*state.lost, *task.missing})
            temporal = BALANCE * balanced(state.terms[-1].data, rough)
        state = state._replace(temporal=temporal)

    # every frame is in some windows, and in each as often as it has steps
    scan_at = functools.lru_cache(FRAMES)(lambda number: task.scan(there[number]))

    def pairs_in(number: int, pose: Pose) -> Pairs:
        return pairs_at(task, body, pose, scan_at(number))

    windows = smooth_windows(
        body,
        [state.motion[n] for n in there],
        pairs_in,
        task.prior,
        state.weight,
        state.temporal,
        boxes=task.boxes,
        terms=task.terms,
        times=there,
        begin=state.within,
    )
    for poses, done in windows:
        last = done == len(there)
        if last or (every and done - state.within >= every):
            motion = _every_frame(task, dict(zip(there, poses, strict=True)))
            state = state._replace(motion=motion, within=0 if last else done)
            if not last:
                yield state
    return told(task, state, str(stage), some_of(task.scanned))


_STAGES: dict[str, Callable[[Task, AdaptState, Stage, int], Steps]] = {
    "track": _track,
    "turn": _turn,
    "pose": _poses,
    "smooth": _smooth,
}
