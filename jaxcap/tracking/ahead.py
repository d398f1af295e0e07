"""The next frame of a recorded sequence, tracked while the last one is judged."""

from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

from ..observe.clouds import Cloud
from ..parallel import with_own_settings
from .expectation_maximisation.em_step import FrameStatistics
from .judge_frame import track_frame_jit
from .track_frame import Tracker, TrackState


class _Begun(NamedTuple):
    """A frame whose tracking has begun, from a state that may not be the final one of the frame before."""

    state: TrackState
    cloud: Cloud
    result: Future[tuple[TrackState, FrameStatistics]]


class Ahead:
    """Track the next frame in a thread, and use the result only if the frame before it ends with the same state."""

    def __init__(self, tracker: Tracker):
        self._tracker = tracker
        #: the cloud after the current one, if it is known
        self.following: Cloud | None = None
        self._begun: _Begun | None = None
        self._thread = ThreadPoolExecutor(1, "next frame")

    def track(self, state: TrackState, cloud: Cloud) -> tuple[TrackState, FrameStatistics]:
        """Track a frame as `track_frame` does; at once if it was begun with the same arguments."""
        begun, self._begun = self._begun, None
        if begun is not None and begun.state is state and begun.cloud is cloud:
            return begun.result.result()
        return track_frame_jit(self._tracker, state, cloud)

    def begin(self, state: TrackState, cloud: Cloud) -> None:
        """Begin the frame after `cloud`, if it is known and needs no other compiled function."""
        following = self.following
        if following is None or following.missing or following.points.shape != cloud.points.shape:
            return
        if len(following.views) != len(cloud.views):
            return
        result = self._thread.submit(with_own_settings(track_frame_jit), self._tracker, state, following)
        self._begun = _Begun(state, following, result)

    def with_next(self, clouds: Iterable[Cloud]) -> Iterator[Cloud]:
        """Yield clouds, each while the one after it is known; an error in the latter is raised at its turn."""
        iterator = iter(clouds)
        current, error = _next(iterator)
        try:
            while current is not None:
                self.following, error = _next(iterator)
                yield current
                current = self.following
        finally:
            self._thread.shutdown(wait=False, cancel_futures=True)
        if error is not None:
            raise error


def _next(clouds: Iterator[Cloud]) -> tuple[Cloud | None, Exception | None]:
    try:
        return next(clouds, None), None
    except Exception as error:
        return None, error
