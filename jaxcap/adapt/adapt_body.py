"""Adaptation of a template to the actor in scans, in two passes (Adaptation, 4.1.4 and 4.2.1)."""

import logging
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..arguments import checked
from ..body.body import Body, scale_body
from ..body.pose import Motion, Pose, stack_poses
from ..body.retraction import difference, retract
from ..body.skeleton import Skeleton
from ..compiled import forget_many_compiled
from ..fit.correspondence.nearest_assignment import IndexedScan
from ..tracking.compare_poses import likelier_pose
from ..tracking.limb_flips import flip_limb_ends
from ..tracking.search.initialise import search_size
from ..tracking.track import track_frames
from .adapt_round import adapt_round
from .compare_people import compare_people
from .history import append_history
from .objective import balancing_weight, motion_energy
from .poses.finger_slips import correct_finger_slips
from .poses.fit_frame import fit_task_poses
from .poses.flag_frames import flag_frames
from .poses.pair_cache import make_pair_cache
from .poses.select_frames import select_evenly
from .poses.sliding_window import smooth_windows
from .poses.unordered import find_poses
from .shape.actor_size import fit_size
from .task import AdaptState, AdaptTask, Stage, make_task_tracker, plan_stages

_LOG = logging.getLogger(__name__)

#: number of frames from which the actor's size is estimated
NUM_SIZE_FRAMES = 3
#: steps of each frame's own pose at the end: of poses that were tracked, and of those that were adapted with the body
TRACKED_STEPS, ADAPTED_STEPS = 5, 2
#: share of the weights that balance the pose prior and second differences with the data (eqs. 4.15 and 4.16):
#: the full weights roll forearms towards rest until hands are flipped, and oversmooth motions
BALANCE_SHARE = 0.1
#: weight of the pose prior while the first poses are found, if it is balanced with the data afterwards
INITIAL_PRIOR_WEIGHT = 1e-6

#: mean log-likelihood by which a pose from before the flip of hands must be better, as hands have few of the
#: points
MIN_FLIP_GAIN = 0.05

#: yields the states within a stage, and returns the one at its end
Steps = Generator[AdaptState, None, AdaptState]


@checked
def adapt_body(task: AdaptTask, state: AdaptState | None = None, every: int = 0) -> Iterator[AdaptState]:
    """Adapt a template to an actor, and yield the state after every stage.

    The stages (`plan_stages`) are: estimate the actor's size in the first frames; track all frames; estimate
    proportions and correct flipped hands; adapt vertices and joints, in rounds, to some frames that are
    spread over the motion; track and adapt again; fit every pose by itself; smooth all poses.

    After the last stage, `lost` lists frames that the body does not explain, and `others` scans that seem to show other people
    (`compare_people`).

    A frame that is `missing` is lost: its pose is interpolated between those of the frames around it.

    Memory is that of the clouds of the chosen frames, or of one window.

    **Arguments:** `state`, one to resume from; `every`, if above zero, also yields a state after so many
    frames within the stages that process single frames (tracking, single poses and smoothing).
    """
    pair_cache = make_pair_cache(task)
    stages = plan_stages(task.settings)
    for number, stage in enumerate(stages):
        if state is not None and number < state.done:
            continue
        forget_many_compiled()
        _LOG.info("adapting, stage %d of %d: %s", number + 1, len(stages), stage)
        if stage.name == "size":
            state = _estimate_size(task)
        else:
            assert state is not None
            if stage.name == "adapt":
                state = adapt_round(task, state, pair_cache, stage)
            else:
                state = yield from _STAGES[stage.name](task, state, stage, every)
        if number + 1 == len(stages):
            state = flag_frames(task, state, final=True)
        yield (state := state._replace(done=number + 1))
    if state is not None and not state.others and (others := compare_people(task, state)):
        yield state._replace(others=others)


def _estimate_size(task: AdaptTask) -> AdaptState:
    """Estimate the first poses and the actor's size."""
    # the first of unordered scans does not lead to the next one
    frames = task.scanned[: 1 if task.settings.unordered else NUM_SIZE_FRAMES]
    scans = [task.scan(n) for n in frames]
    verdict, first = _estimate_size_from(task, scans, frames, task.template, 1.0)
    found = [first]
    if task.start is None:
        # a body of about the right size may find a better pose, and more reliably
        found.append(_estimate_size_from(task, scans, frames, first.body, first.size)[1])
        # the size that fits a wrong pose is wrong, too
        size = (
            1.0
            if verdict == "good"
            else search_size(make_task_tracker(task, task.template), task.cloud(frames[0]))
        )
        if size != 1:
            body = scale_body(task.template, jnp.asarray(size, task.template.vertices.dtype))
            found.append(_estimate_size_from(task, scans, frames, body, size)[1])
    best = min(found, key=lambda state: state.history[-1][1])
    poses = {frame: best.motion[n] for n, frame in enumerate(frames)}
    return best._replace(motion=_interpolate_missing(task, poses))


def _estimate_size_from(
    task: AdaptTask, scans: Sequence[IndexedScan], frames: Sequence[int], body: Body, size: float
) -> tuple[str, AdaptState]:
    """Estimate poses and size from a body that is the template scaled by `size`.

    Return also the verdict on the first frame before the size was fitted.
    """
    settings, search = task.settings, task.start is None
    weight = INITIAL_PRIOR_WEIGHT if settings.pose_weight is None else settings.pose_weight
    clouds = (task.cloud(n) for n in frames)
    tracked = list(track_frames(make_task_tracker(task, body), clouds, task.start, search=search))
    poses = [frame.pose for frame in tracked]
    body, poses, step = fit_size(
        body,
        scans,
        poses,
        task.pose_terms(weight),
        settings.matching,
        cameras=task.cameras,
        initial_size=size,
    )
    motion = stack_poses(poses, task.rate)
    state = AdaptState(0, body, size * step, motion, pose_weight=weight)
    state = append_history(task.subset(frames), state, "size", range(len(frames)))
    if settings.pose_weight is None:
        # first poses are often at rest, later ones are not: a correct prior has an energy of one per degree
        # of freedom
        worth = max(state.terms[0].pose, float(body.skeleton.num_dofs))
        weight = BALANCE_SHARE * balancing_weight(state.terms[0].data, worth)
    return tracked[0].verdict, state._replace(pose_weight=weight)


def _interpolate_missing(task: AdaptTask, poses: Mapping[int, Pose]) -> Motion:
    """Fill in the poses of all frames by linear interpolation between the known ones."""
    known, every = sorted(poses), []
    for frame in range(task.num_frames):
        if frame in poses:
            every.append(poses[frame])
            continue
        before = max((n for n in known if n < frame), default=known[0])
        after = min((n for n in known if n > frame), default=known[-1])
        share = (frame - before) / (after - before) if after > before else 0.0
        every.append(_interpolate(task.template.skeleton, poses[before], poses[after], jnp.asarray(share)))
    return stack_poses(every, task.rate)


@eqx.filter_jit
def _interpolate(skeleton: Skeleton, before: Pose, after: Pose, share: Float[Array, ""]) -> Pose:
    """Interpolate between two poses; `share` is from 0 to 1."""
    return retract(skeleton, before, share * difference(skeleton, before, after))


def _correct_hands(task: AdaptTask, state: AdaptState, stage: Stage, every: int) -> Steps:
    """Correct flipped hands, and then hands whose fingers lie on their neighbours, which show with the actor's proportions."""
    correct = _correct_flips_unordered if task.settings.unordered else _correct_flips
    found = yield from correct(task, state, stage, every)
    corrected = _correct_slips(task, found)
    if corrected is found:
        return found
    # the body was not adapted in these poses, and frames may have been lost by their hands
    corrected = flag_frames(task, corrected._replace(chosen=(), history=state.history, terms=state.terms))
    return append_history(task, corrected, str(stage), select_evenly(task.scanned))


def _correct_slips(task: AdaptTask, state: AdaptState) -> AdaptState:
    """Correct hands whose fingers lie on their neighbours in some scans; the same state if there are none."""
    _LOG.info("comparing hands with those in other scans")
    changed = correct_finger_slips(task, state)
    if not changed:
        return state
    poses = {n: state.motion[n] for n in task.scanned}
    return state._replace(motion=_interpolate_missing(task, poses | changed))


def _correct_flips(task: AdaptTask, state: AdaptState, stage: Stage, every: int) -> Steps:
    """Correct flipped hands in all frames together, and track all frames again."""
    if state.within:
        return (yield from _track(task, state, stage, every))
    first, tracker = task.scanned[:NUM_SIZE_FRAMES], make_task_tracker(task, state.body)
    clouds = [task.cloud(n) for n in first]
    # these were tracked with an earlier body
    poses = [
        frame.pose
        for frame in track_frames(tracker, clouds, state.motion[first[0]], search=False, sigma=0.03)
    ]
    turned = flip_limb_ends(tracker, clouds, poses)
    if turned[0] is poses[0]:
        return append_history(task, state, str(stage), select_evenly(task.scanned))
    return (yield from _track(task, state, stage, every, turned[0]))


def _correct_flips_unordered(task: AdaptTask, state: AdaptState, stage: Stage, every: int) -> Steps:
    """Correct flipped hands in each of unordered scans by itself."""
    tracker, there = make_task_tracker(task, state.body), task.scanned
    while state.within < len(there):
        some = there[state.within :][: every or None]
        poses = {n: state.motion[n] for n in there}
        for n in some:
            cloud = task.cloud(n)
            (turned,) = flip_limb_ends(tracker, [cloud], [poses[n]])
            before, poses[n] = poses[n], likelier_pose(tracker, poses[n], turned, cloud)
            if poses[n] is not before:
                # the body was not adapted in this pose
                state = state._replace(chosen=())
        state = state._replace(motion=_interpolate_missing(task, poses), within=state.within + len(some))
        if state.within < len(there):
            yield state
    return append_history(task, state._replace(within=0), str(stage), select_evenly(there))


def _track(task: AdaptTask, state: AdaptState, stage: Stage, every: int, start: Pose | None = None) -> Steps:
    """Track all frames, or the first ones, and search for lost poses.

    A frame keeps its pose if the tracker finds none that explains it better. If the body was adapted to all frames and explains
    them, no frame is tracked, unless a `start` is given.
    """
    there, passed = task.frames_of(stage), state.within
    if start is None and not passed and _is_adapted_to(task, state, there):
        judged = flag_frames(task, state)
        if _is_adapted_to(task, judged, there):
            return append_history(task, judged, str(stage), select_evenly(there))
    if task.settings.unordered:
        return (yield from _find_unordered(task, state, stage, every))
    if not passed:
        state = state._replace(lost=tuple(task.missing), reasons=(), chosen=())
    before = state.tracked or (state.motion[there[0]] if start is None else start)
    clouds = (task.cloud(n) for n in there[passed:])

    def known(number: int) -> list[Pose]:
        # candidates: the poses of this frame and the next one from before this stage
        return [own[n] for n in there[number : min(number + 2, num_known)]]

    # the other poses are interpolated before the first stage of tracking
    own, num_known = state.motion, len(there) if state.done > 1 else NUM_SIZE_FRAMES
    worth = MIN_FLIP_GAIN if stage.name == "turn" else 0.0
    frames = track_frames(
        make_task_tracker(task, state.body),
        clouds,
        before,
        search=False,
        sigma=0.03,
        first=passed,
        candidates=known,
        margin=worth,
    )
    poses, lost = {n: state.motion[n] for n in there[:passed]}, set(state.lost)
    for done, (n, frame) in enumerate(zip(there[passed:], frames, strict=True), passed + 1):
        poses[n] = frame.pose
        if frame.lost:
            lost.add(n)
        if every and done % every == 0 and done < len(there):
            motion = _interpolate_missing(task, {n: state.motion[n] for n in task.scanned} | poses)
            yield state._replace(motion=motion, lost=tuple(sorted(lost)), within=done, tracked=frame)
    motion = _interpolate_missing(task, poses)
    state = state._replace(motion=motion, lost=tuple(sorted(lost)), within=0, tracked=None)
    # the baseline needs all frames; for the first ones keep the tracker's own judgement
    state = flag_frames(task, state) if stage.frames is None else state
    return append_history(
        task, state, str(stage), select_evenly(task.scanned) if stage.frames is None else there[-1:]
    )


def _is_adapted_to(task: AdaptTask, state: AdaptState, frames: Sequence[int]) -> bool:
    """Test if the body and the poses of some frames were adapted to their scans together, and none of these is lost."""
    return set(frames) <= set(state.chosen) and set(state.lost) <= set(task.missing)


def _find_unordered(task: AdaptTask, state: AdaptState, stage: Stage, every: int) -> Steps:
    """Find the poses of unordered scans, each from the most similar ones."""
    there = task.scanned
    poses = {n: state.motion[n] for n in there}
    for found, number in find_poses(task, state.body, poses, is_known=state.done > 1, num_done=state.within):
        poses |= found.poses
        if every and number % every == 0 and number < len(there):
            yield state._replace(motion=_interpolate_missing(task, poses), within=number)
    state = state._replace(motion=_interpolate_missing(task, poses), chosen=(), within=0)
    return append_history(task, flag_frames(task, state), str(stage), select_evenly(there))


def _fit_poses(task: AdaptTask, state: AdaptState, stage: Stage, every: int) -> Steps:
    """Fit every pose by itself with pairs in both directions, `every` frames at a time."""
    there = task.scanned
    while state.within < len(there):
        some = there[state.within :][: every or None]
        poses = {n: state.motion[n] for n in there}
        steps = ADAPTED_STEPS if set(some) <= set(state.chosen) else TRACKED_STEPS
        scans, starts = (task.scan(n) for n in some), (poses[n] for n in some)
        found = fit_task_poses(task, state, scans, starts, steps=steps)
        poses |= {n: fit.pose for n, fit in zip(some, found, strict=True)}
        state = state._replace(motion=_interpolate_missing(task, poses), within=state.within + len(some))
        if state.within < len(there):
            yield state
    state = _correct_slips(task, state._replace(within=0))
    return append_history(task, state, str(stage), select_evenly(task.scanned))


def _smooth(task: AdaptTask, state: AdaptState, stage: Stage, every: int) -> Steps:
    """Smooth all poses in time; those of frames without a scan are interpolated."""
    settings, body, there = task.settings, state.body, task.scanned
    if not state.within:
        temporal_weight = settings.temporal_weight
        if temporal_weight is None:
            # a wrong pose has a large energy, so its weight would smooth too little
            rough = motion_energy(body.skeleton, state.motion, excluded={*state.lost, *task.missing})
            temporal_weight = BALANCE_SHARE * balancing_weight(state.terms[-1].data, rough)
        state = state._replace(temporal_weight=temporal_weight)

    windows = smooth_windows(
        body,
        [state.motion[n] for n in there],
        make_pair_cache(task, there),
        task.pose_terms(state.pose_weight),
        state.temporal_weight,
        times=there,
        resume_frame=state.within,
    )
    for poses, done in windows:
        last = done == len(there)
        if last or (every and done - state.within >= every):
            motion = _interpolate_missing(task, dict(zip(there, poses, strict=True)))
            state = state._replace(motion=motion, within=0 if last else done)
            if not last:
                yield state
    return append_history(task, state, str(stage), select_evenly(task.scanned))


_STAGES: dict[str, Callable[[AdaptTask, AdaptState, Stage, int], Steps]] = {
    "track": _track,
    "turn": _correct_hands,
    "pose": _fit_poses,
    "smooth": _smooth,
}
