"""One frame of a tracked sequence: the first one, and each one after it."""

import functools
import logging
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from ..body.pose import Pose
from ..observe.clouds import Cloud
from .ahead import Ahead
from .compare_poses import choose_likeliest, likelier_pose
from .expectation_maximisation.pose_log_density import pose_log_density
from .judge_frame import (
    SearchHistory,
    TrackedFrame,
    choose_better,
    finish_frame,
    judge_frame,
    needs_search,
    reset_velocity,
    track_first_frame,
    track_frame_jit,
)
from .judgement.baseline import initial_baseline
from .judgement.region_samples import RegionSamples, sample_regions
from .search.catch_up import catch_up
from .search.initialise import coarse_tracker, initialise
from .search.search_frame import search_frame
from .track_frame import Tracker, with_clothes

_LOG = logging.getLogger(__name__)
#: search for the pose of a first frame: if the start does not explain the cloud, always, never
FirstSearch = Literal["auto"] | bool
#: standard deviation at which a pose that a search found is tracked, metres
FOUND_SIGMA = 0.03
#: searches for the first pose at most: of a partly seen person, and of one who is seen whole
FIRST_SEARCHES, WHOLE_SEARCHES = 5, 3
#: difference of the log-densities of two poses, for each point, below which they are equally likely
AGREEMENT = 0.01


class Search(NamedTuple):
    """A search that is about to begin; the first one of a process compiles for a minute or more."""

    #: number of the frame
    frame: int
    #: the faults, as in `TrackedFrame.reasons`; empty for a requested search
    reasons: tuple[str, ...]
    #: number of earlier searches
    num_earlier: int


class Follower(NamedTuple):
    """The constants with which a body is followed from frame to frame."""

    tracker: Tracker
    surface: RegionSamples
    #: makes the tracker of searches at its first call
    coarse: Callable[[], Tracker]
    #: vertical of the scene
    up: tuple[float, float, float]
    #: is called before every search
    on_search: Callable[[Search], None] | None

    def begin_search(self, number: int, reasons: tuple[str, ...], before: float) -> Tracker:
        """Begin a search: call `on_search`, and return the tracker of searches."""
        _LOG.info("searching for a better pose of frame %d", number)
        if self.on_search is not None:
            self.on_search(Search(number, reasons, int(before)))
        return self.coarse()


def make_follower(
    tracker: Tracker,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
    on_search: Callable[[Search], None] | None = None,
) -> Follower:
    """Make the constants of a run."""
    coarse = functools.cache(lambda: coarse_tracker(tracker))
    return Follower(tracker, sample_regions(tracker.body, tracker.regions), coarse, up, on_search)


def find_first_frame(
    follower: Follower,
    cloud: Cloud,
    pose: Pose,
    number: int = 0,
    *,
    search: FirstSearch = "auto",
    sigma: float = 0.1,
    candidates: Sequence[Pose] | None = None,
    margin: float = 0.0,
    occluders: Float[Array, "O 4"] | None = None,
) -> TrackedFrame:
    """Track the first frame from a `pose` near it, or search for it, as `track_frames` describes.

    **Arguments:** `occluders` as in `gather_evidence`.
    """
    tracker, surface, frame = follower.tracker, follower.surface, None
    if search is not True:
        frame = track_first_frame(tracker, surface, cloud, pose, sigma, occluders)
    if frame is None or (search == "auto" and frame.verdict != "good"):
        coarse = follower.begin_search(number, () if frame is None else frame.reasons, 0.0)
        frame = search_first_frame(follower, coarse, frame, cloud, occluders)
        frame = eqx.tree_at(lambda f: f.searches, frame, SearchHistory(count=1.0))
    if candidates is not None:
        reached = frame.state, frame.statistics
        state, statistics = choose_likeliest(tracker, *reached, candidates, pose, cloud, margin)
        if state is not frame.state:
            baseline = initial_baseline(surface, len(cloud.views))
            searches = SearchHistory(count=frame.searches.count)
            frame = judge_frame(surface, cloud, state, statistics, baseline, searches, occluders)
            frame = finish_frame(tracker, frame, pose)
    return frame


def search_first_frame(
    follower: Follower,
    coarse: Tracker,
    frame: TrackedFrame | None,
    cloud: Cloud,
    occluders: Float[Array, "O 4"] | None = None,
    most: int = FIRST_SEARCHES,
) -> TrackedFrame:
    """Search for the pose of a first frame, and return the better of what is found and of `frame`.

    One search may end at a wrong pose, to which the next frames would then be compared. Searches from other starts follow, with the
    clothes that the best frame has shown, until the best frame is good, at most `WHOLE_SEARCHES`; if none is, as without a person, the
    first search counts. A partly seen person may look alike from two sides: there the two likeliest poses also have to be equally
    likely, after at `most` so many searches.
    """
    enough = 1 if follower.tracker.pose_prior is None else 2
    densities, first = list[float](), frame
    for attempt in range(min(most, WHOLE_SEARCHES) if enough == 1 else most):
        tracker, few = follower.tracker, coarse
        if frame is not None:
            tracker, few = (with_clothes(each, frame.state.estimate.clothes) for each in (tracker, coarse))
        if attempt:
            _LOG.info("searching from other starts, search %d of at most %d", attempt + 1, most)
        pose, _ = initialise(tracker, cloud, up=follower.up, coarse=few, key=jax.random.key(attempt))
        found = track_first_frame(tracker, follower.surface, cloud, pose, FOUND_SIGMA, occluders)
        if enough > 1:
            densities.append(float(pose_log_density(follower.tracker, found.pose, cloud)))
        frame = found if frame is None else choose_better(tracker, cloud, found, frame)
        first = frame if attempt == 0 else first
        likeliest = sorted(densities)[-enough:]
        agreed = enough == 1 or (len(likeliest) == enough and np.ptp(likeliest) < AGREEMENT)
        if frame.verdict == "good" and agreed:
            break
    assert frame is not None and first is not None
    return frame if enough > 1 or frame.verdict == "good" else first


def follow_frame(
    tracker: Tracker,
    surface: RegionSamples,
    frame: TrackedFrame,
    cloud: Cloud,
    poses: Sequence[Pose] = (),
    margin: float = 0.0,
    judge: bool = True,
    occluders: Float[Array, "O 4"] | None = None,
    ahead: Ahead | None = None,
) -> TrackedFrame:
    """Track and judge the frame after `frame`; `finish_frame` then determines the start of the one after it.

    **Arguments:** `poses`, other candidate poses, and `margin` as in `choose_likeliest`; `occluders` as in
    `gather_evidence`. Without `judge` the frame keeps the verdict of the frame before it, and after a lost frame the last
    trusted pose is not tried.
    """
    before = frame.state.estimate.pose
    if ahead is None:
        state, statistics = track_frame_jit(tracker, frame.state, cloud)
    else:
        state, statistics = ahead.track(frame.state, cloud)
    # a lost frame may have led away from the correct pose
    others = [*([frame.trusted] if frame.lost and judge else []), *poses]
    if others:
        state, statistics = choose_likeliest(tracker, state, statistics, others, before, cloud, margin)
    if frame.lost:
        state = reset_velocity(tracker, state)
    if ahead is not None:
        ahead.begin(state, cloud)
    if not judge:
        return TrackedFrame(
            state.estimate.pose,
            statistics,
            frame.lost,
            frame.judgement,
            frame.others,
            state,
            state.estimate.pose,
            frame.baseline,
            frame.searches,
        )
    return judge_frame(surface, cloud, state, statistics, frame.baseline, frame.searches, occluders)


def advance_frame(
    follower: Follower,
    frame: TrackedFrame,
    cloud: Cloud,
    number: int,
    *,
    candidates: Sequence[Pose] | None = None,
    margin: float = 0.0,
    occluders: Float[Array, "O 4"] | None = None,
    ahead: Ahead | None = None,
) -> TrackedFrame:
    """Track a `cloud` from the `frame` before it: predict, fit and judge; where it is not good, catch up with a fast motion, and
    search.

    **Arguments:** `number` of the frame, which seeds its search; `candidates` and `margin` as in `track_frames`;
    `occluders` as in `gather_evidence`.
    """
    worn = frame.state.estimate.clothes
    tracker, surface = with_clothes(follower.tracker, worn), follower.surface
    before = frame
    others = candidates or ()
    frame = follow_frame(tracker, surface, before, cloud, others, margin, occluders=occluders, ahead=ahead)
    key = jax.random.key(number)
    if needs_search(frame):
        _LOG.info("fitting a few poses that frame %d may have after a fast motion", number)
        coarse = with_clothes(follower.coarse(), worn)
        own = jax.random.fold_in(key, 1)
        frame = catch_up(tracker, surface, coarse, frame, before, cloud, own, occluders)
    if needs_search(frame):
        coarse = with_clothes(follower.begin_search(number, frame.reasons, frame.searches.count), worn)
        found = search_frame(
            tracker,
            surface,
            coarse,
            frame,
            before.baseline,
            before.trusted,
            cloud,
            key,
            follower.up,
            occluders,
        )
        if candidates is not None and found.pose is not frame.pose:
            # the end of a search may be worse than its start
            likelier = likelier_pose(tracker, found.pose, frame.pose, cloud)
            found = found if likelier is found.pose else frame
        frame = found
    return finish_frame(tracker, frame, before.trusted)
