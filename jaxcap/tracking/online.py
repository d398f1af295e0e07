"""Tracking of frames that arrive one by one, in which no frame waits for a search."""

import logging
from concurrent.futures import Future, ThreadPoolExecutor

import equinox as eqx
import jax

from ..body.pose import Pose, rest_pose
from ..observe.clouds import Cloud
from ..value_checks import check_at_least, check_direction
from .advance import follow_frame, make_follower, search_first_frame
from .check_cloud import check_cloud
from .compare_poses import track_from
from .expectation_maximisation.pose_log_density import pose_log_density
from .judge_frame import (
    SearchHistory,
    TrackedFrame,
    finish_frame,
    judge_frame,
    needs_search,
    track_first_frame,
)
from .judgement.baseline import initial_baseline
from .search.catch_up import catch_up
from .search.search_frame import search_frame
from .track_frame import Tracker, check_sigma, with_clothes

_LOG = logging.getLogger(__name__)
#: searches for the first pose of a partly seen person at most, while the person moves on
FIRST_SEARCHES = 2


class OnlineTracker:
    """Tracks one cloud at a time, each from the previous one, as `track_frames` does.

    A frame that is not good is fitted from a few hypotheses (`catch_up`), and searched for, in a thread, while the next
    frames are tracked. The next frame after the end of the search takes the found pose as its start if that explains the
    frame better. Call `close` at the end.

    **Arguments:** `start`, a pose near the first frame, rest where not given; `search`, search for frames that are not good;
    `sigma` and `up` as in `track_frames`; `judge_every`, judge only each so-many-th frame. The frames between have the
    verdict of the frame before, so that lost frames take no longer than others.
    """

    def __init__(
        self,
        tracker: Tracker,
        start: Pose | None = None,
        *,
        search: bool = True,
        sigma: float = 0.1,
        up: tuple[float, float, float] = (0.0, 1.0, 0.0),
        judge_every: int = 1,
    ):
        check_at_least("OnlineTracker", 1, judge_every=judge_every)
        check_sigma("OnlineTracker", sigma)
        check_direction("OnlineTracker", up=up)
        self.tracker, self.sigma, self.searches_frames = tracker, sigma, search
        self.start = rest_pose(tracker.body.skeleton) if start is None else start
        #: the newest tracked frame
        self.frame: TrackedFrame | None = None
        #: number of tracked frames
        self.count = 0
        self._follower = make_follower(tracker, up)
        self._thread = ThreadPoolExecutor(1, "pose search")
        # the found frame, and whether more than a few hypotheses were tried
        self._search: Future[tuple[TrackedFrame, bool]] | None = None
        self._is_first_search, self._judge_every = False, judge_every

    @property
    def is_searching(self) -> bool:
        """Whether a search runs at this time."""
        return self._search is not None and not self._search.done()

    def track(self, cloud: Cloud, name: str = "") -> TrackedFrame:
        """Track the next cloud.

        **Raises:** `InputError` for a cloud with fewer points than the pose has parameters, or in another unit.
        """
        check_cloud(self.tracker.body, cloud, name or f"cloud {self.count}")
        if self.frame is None:
            frame = track_first_frame(self.tracker, self._follower.surface, cloud, self.start, self.sigma)
            if self.searches_frames and frame.verdict != "good":
                self._begin(True, cloud, frame, self.start)
        else:
            before = self.frame
            judge = self.count % self._judge_every == 0
            frame = follow_frame(self.tracker, self._follower.surface, before, cloud, judge=judge)
            frame = self._use_search(frame, before, cloud)
            if judge and self.searches_frames and self._search is None and needs_search(frame):
                self._begin(False, cloud, frame, before.trusted, before)
            frame = finish_frame(self.tracker, frame, before.trusted)
        self.frame, self.count = frame, self.count + 1
        return frame

    def warm_up(self, cloud: Cloud) -> None:
        """Compile everything that clouds of this size need, also after a lost frame; searches of later frames compile on their own.

        If the start does not explain the cloud, and searches are wanted, the pose that a search finds in it becomes the start.

        **Raises:** `InputError` as `track` does.
        """
        sample = OnlineTracker(self.tracker, self.start, search=False, sigma=self.sigma, up=self._follower.up)
        if sample.track(cloud).verdict != "good" and self.searches_frames:
            coarse = self._follower.coarse()
            found = search_first_frame(self._follower, coarse, sample.frame, cloud, most=FIRST_SEARCHES)
            self.start = self.start if found.lost else found.pose
        frame = sample.track(cloud)
        lost = eqx.tree_at(lambda f: f.lost, frame, True)
        follow_frame(self.tracker, self._follower.surface, lost, cloud)
        pose_log_density(self.tracker, frame.pose, cloud)
        sample.close()

    def close(self) -> None:
        """End without the result of a search."""
        self._thread.shutdown(wait=False, cancel_futures=True)

    def _begin(
        self,
        is_first: bool,
        cloud: Cloud,
        frame: TrackedFrame,
        trusted: Pose,
        before: TrackedFrame | None = None,
    ) -> None:
        """Begin a search for a frame in the thread."""
        _LOG.info("searching for a better pose of frame %d", self.count)
        number, self._is_first_search = self.count, is_first

        def run() -> tuple[TrackedFrame, bool]:
            worn = None if before is None else before.state.estimate.clothes
            tracker = self.tracker if before is None else with_clothes(self.tracker, worn)
            coarse = self._follower.coarse()
            if before is None:
                return search_first_frame(self._follower, coarse, None, cloud, most=FIRST_SEARCHES), True
            coarse = with_clothes(coarse, worn)
            key, surface = jax.random.key(number), self._follower.surface
            caught = catch_up(tracker, surface, coarse, frame, before, cloud, jax.random.fold_in(key, 1))
            if caught.verdict == "good":
                return caught, False
            found = search_frame(
                tracker,
                surface,
                coarse,
                caught,
                before.baseline,
                trusted,
                cloud,
                key,
                self._follower.up,
            )
            return found, True

        self._search = self._thread.submit(run)

    def _use_search(self, frame: TrackedFrame, before: TrackedFrame, cloud: Cloud) -> TrackedFrame:
        """Take the pose of a search that has ended, if it is likelier in this frame."""
        if self._search is None or not self._search.done():
            return frame
        (found, was_searched), self._search = self._search.result(), None
        worn = before.state.estimate.clothes
        tracker = with_clothes(self.tracker, worn)
        state, statistics, likelihood = track_from(tracker, found.pose, cloud)
        # the steps of a comparison teach no clothes
        state = eqx.tree_at(lambda s: s.estimate.clothes, state, worn, is_leaf=lambda leaf: leaf is None)
        count = frame.searches.count + float(was_searched)
        if likelihood <= float(pose_log_density(tracker, frame.pose, cloud)):
            if not was_searched:
                return frame
            searches = found.searches if not self._is_first_search else frame.searches.extend()
            return eqx.tree_at(lambda f: f.searches, frame, searches)
        # a first search follows a wrong pose, and so does its baseline
        first = self._is_first_search
        baseline = initial_baseline(self._follower.surface, len(cloud.views)) if first else before.baseline
        return judge_frame(
            self._follower.surface,
            cloud,
            state,
            statistics,
            baseline,
            SearchHistory(0.0, before.searches.length, count),
        )
