"""Tracking of frames as they arrive, in two threads."""

import math
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..arguments import checked
from ..body.body import Body, posed_vertices
from ..body.pose import Pose
from ..depth.background import Background
from ..depth.floor import find_floor_of_person
from ..depth.stream.cloud_stream import NUM_POINTS, CloudStream
from ..energy.check_energies import UserTerms
from ..energy.data.floor import make_measured_floor
from ..errors import InputError, user_message
from ..geometry.camera import Camera
from ..observe import Scan, thin_cloud
from ..observe.clouds import Cloud, as_cloud
from ..observe.planes import Plane
from ..tracking.judge_frame import TrackedFrame
from ..tracking.online import OnlineTracker
from ..tracking.track_frame import Tracker, make_tracker
from .load import Load
from .mailbox import Mailbox
from .statistics import LiveFrame, LiveStatistics, StatisticsCounter

#: verdicts are given every so many frames, as a judgement takes a quarter of the time of a frame
JUDGE_EVERY = 2
#: steps of expectation maximisation, and vertices tested for free space, of a live tracker of depth images
ITERATIONS, NUM_TESTED = 3, 500
#: while the body is lost, the person is searched for in the whole image every so many frames
SEARCH_EVERY = 15
#: while many frames are dropped, every so-many-th row and column of the images is read
REDUCED_STEP = 2
#: a frame: depth images of all cameras in metres, a cloud, or a scan as read from a file
Observation = Sequence[np.ndarray] | Cloud | Scan


class _Incoming(NamedTuple):
    number: int
    name: str
    seconds: float
    arrived: float
    read: Callable[[], Observation]


class _Ready(NamedTuple):
    """A frame as a cloud."""

    incoming: _Incoming
    cloud: Cloud
    #: seconds of computation of the cloud
    computed: float


@checked
def make_live_tracker(
    body: Body,
    terms: UserTerms = (),
    *,
    partial: bool = True,
    iterations: int | None = None,
    clothes: bool = False,
) -> Tracker:
    """Make a `Tracker` that is fast enough for live depth images, with the arguments of `make_tracker`.

    It takes 3 steps of expectation maximisation where `make_tracker(partial=True)` takes 6, and tests fewer vertices for free
    space. Frames that follow each other closely need no more, and no further ones follow in a fast motion, so that the time of a frame
    is bounded.
    """
    steps = ITERATIONS if iterations is None else iterations
    return make_tracker(
        body,
        terms=terms,
        iterations=steps,
        max_iterations=steps,
        partial=partial,
        num_tested=NUM_TESTED,
        clothes=clothes,
    )


class LiveTracker:
    """Track frames as they arrive: the newest frame is tracked, and frames that a newer one overtakes are dropped.

    While frames are dropped often, only every second row and column of the images is read (`Load`).

    `push` returns at once. One thread makes the cloud of a frame while another tracks the previous frame. A search for a lost
    body runs next to them (`OnlineTracker`). Use it in a `with` statement, or call `close`.

    **Arguments:** `tracker` as of `make_live_tracker`; `cameras` of the depth images, which
    do not move; `backgrounds` of the cameras, of `estimate_background`; `num_points`, the largest number of points of a frame; `on_frame`, a function that is called with each tracked
    frame, in the thread that tracks; `start`, `search`, `sigma`, `up` and `judge_every` as in `OnlineTracker`. With a `start`, the
    first images are searched near it. `find_floor`: `warm_up` looks for the floor below the person in its depth images, before the
    first frame is tracked, and feet stay above it.

    **Raises:** `InputError` for `find_floor` without cameras.
    """

    @checked
    def __init__(
        self,
        tracker: Tracker,
        cameras: Sequence[Camera] = (),
        *,
        backgrounds: Sequence[Background | None] | None = None,
        num_points: int = NUM_POINTS,
        on_frame: Callable[[LiveFrame], None] | None = None,
        start: Pose | None = None,
        search: bool = True,
        sigma: float | int = 0.1,
        up: tuple[float, float, float] = (0.0, 1.0, 0.0),
        judge_every: int = JUDGE_EVERY,
        find_floor: bool = False,
    ):
        if find_floor and not cameras:
            raise InputError(
                "LiveTracker: `find_floor` is for depth images, but there are no cameras; give `cameras`."
            )
        self._make_online = partial(
            OnlineTracker, start=start, search=search, sigma=float(sigma), up=up, judge_every=judge_every
        )
        self._online, self._finds_floor, self._up = self._make_online(tracker), find_floor, up
        #: the floor that `warm_up` has found
        self.floor: Plane | None = None
        self._cameras = list(cameras)
        steps = (1, REDUCED_STEP) if self._cameras else ()
        # of whole images, and of reduced ones
        self._streams = [
            CloudStream(self._cameras, num_points, pixel_step=step, backgrounds=backgrounds) for step in steps
        ]
        self._load = Load()
        self.num_points, self.on_frame = num_points, on_frame
        #: the newest tracked frame
        self.newest: LiveFrame | None = None
        self._counts, self._lock, self._pushed = StatisticsCounter(), threading.Lock(), 0
        #: held while a frame is tracked
        self._tracking = threading.Lock()
        self._idle = threading.Condition(self._lock)
        self._open = 0
        #: where the next image is expected to show the person
        self._surface: Float[np.ndarray, "N 3"] | None = None
        if start is not None and self._cameras:
            self._surface = np.asarray(posed_vertices(tracker.body, start), float)
        self._num_lost = 0
        self._failure: BaseException | None = None
        #: the end of the last warm-up, `time.monotonic()`
        self._ready_since = -math.inf
        self._incoming, self._ready = Mailbox[_Incoming](), Mailbox[_Ready]()
        self._threads = [
            threading.Thread(
                target=self._guard, args=(work,), daemon=True, name=f"live {work.__name__.strip('_')}"
            )
            for work in (self._make_clouds, self._track)
        ]
        for thread in self._threads:
            thread.start()

    def push(
        self,
        frame: Observation | Callable[[], Observation],
        seconds: float | int | None = None,
        *,
        name: str = "",
        arrived: float | None = None,
    ) -> None:
        """Give the tracker a frame, or a function that reads it, and return at once.

        **Arguments:** `frame`, the depth images of all cameras (metres, zero where nothing was measured), a cloud, or a scan; a
        function is called only if the frame is not dropped; `seconds`, the time of the frame on the clock of its source; `name`
        for messages; `arrived`, the time of its arrival by `time.monotonic()`, now by default.

        **Raises:** the error that has ended a thread, if one has.
        """
        if self._failure is not None:
            raise self._failure
        now = time.monotonic() if arrived is None else arrived
        read = frame if callable(frame) else lambda: frame
        with self._lock:
            number, self._pushed, self._open = self._pushed, self._pushed + 1, self._open + 1
        there = _Incoming(
            number, name or f"frame {number}", now if seconds is None else float(seconds), now, read
        )
        if (overtaken := self._incoming.replace(there)) is not None:
            self._finish(overtaken, dropped=True)

    def warm_up(self, frame: Observation, name: str = "the first frame") -> float:
        """Compile everything that a frame of this size needs, and return the seconds that this takes; searches of later frames compile on
        their own.

        The frame itself is not counted. If the body at rest, or the `start`, does not explain it, its pose is searched for, and
        the next frame starts from the pose that is found. Frames that arrive before the end are counted as
        `dropped_before_ready` if they are dropped, and their latencies are left out. `name` is for messages.

        **Raises:** `InputError` for a frame that cannot be tracked.
        """
        begin = time.perf_counter()
        cloud = self._cloud(frame, name)
        for stream in self._streams:
            stream.warm_up()
        if not isinstance(frame, (Cloud, Scan)):
            # floor and walls are looked for in the first image of each stream
            self._streams[1].make(list(frame), name=name)
            if self._finds_floor and self.floor is None:
                self._use_floor(find_floor_of_person(self._cameras, list(frame), cloud, self._up))
        self._online.warm_up(cloud)
        np.asarray(posed_vertices(self._online.tracker.body, self._online.start))
        with self._lock:
            self._ready_since = time.monotonic()
            self._counts.begin()
            # frames that were dropped until now are no load
            self._load = Load()
        return time.perf_counter() - begin

    def _use_floor(self, floor: Plane | None) -> None:
        """Track with a floor, unless a frame was tracked without it."""
        with self._tracking:
            if floor is None or self._online.frame is not None:
                return
            self.floor, tracker = floor, self._online.tracker
            self._online.close()
            terms = (*tracker.terms, make_measured_floor(tracker.body, floor))
            self._online = self._make_online(eqx.tree_at(lambda t: t.terms, tracker, terms))

    @property
    def statistics(self) -> LiveStatistics:
        """Counts, rate and latency so far."""
        with self._lock:
            return self._counts.summary()._replace(is_reduced=self._is_reduced)

    @property
    def _is_reduced(self) -> bool:
        return bool(self._streams) and self._load.is_high

    @property
    def latencies(self) -> Float[np.ndarray, "N"]:
        """Latencies of the tracked frames, seconds."""
        with self._lock:
            return self._counts.latencies()

    @property
    def is_searching(self) -> bool:
        """Whether the body is searched for."""
        return self._online.is_searching

    def wait(self, timeout: float | int | None = None) -> bool:
        """Wait until all frames that were pushed are tracked or dropped; false after `timeout` seconds.

        **Raises:** the error that has ended a thread, if one has.
        """
        with self._idle:
            done = self._idle.wait_for(lambda: not self._open or self._failure is not None, timeout)
        if self._failure is not None:
            raise self._failure
        return done

    def close(self) -> None:
        """Stop after the frame that is being tracked."""
        self._incoming.close()
        self._ready.close()
        for thread in self._threads:
            thread.join()
        self._online.close()

    def __enter__(self) -> "LiveTracker":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _guard(self, work: Callable[[], None]) -> None:
        """Run the work of a thread, and keep the error that ends it for the caller."""
        try:
            work()
        except BaseException as error:
            with self._idle:
                self._failure = error
                self._idle.notify_all()
            self._incoming.close()
            self._ready.close()

    def _make_clouds(self) -> None:
        while (incoming := self._incoming.take()) is not None:
            begin = time.perf_counter()
            try:
                cloud = self._cloud(incoming.read(), incoming.name)
            except InputError as error:
                self._finish(incoming, failure=user_message(error))
                continue
            if not self._ready.put(_Ready(incoming, cloud, time.perf_counter() - begin)):
                return

    def _cloud(self, frame: Observation, name: str) -> Cloud:
        if isinstance(frame, (Cloud, Scan)):
            cloud = as_cloud(frame)
            few = int(np.count_nonzero(np.asarray(cloud.weights))) <= self.num_points
            return cloud if few else thin_cloud(cloud, self.num_points)
        if not self._streams:
            raise InputError(f"{name}: these are depth images, but no camera is known; give `cameras`.")
        stream = self._streams[1 if self._is_reduced else 0]
        return stream.make(list(frame), self._surface, name)

    def _track(self) -> None:
        while (ready := self._ready.take()) is not None:
            begin, incoming = time.perf_counter(), ready.incoming
            try:
                with self._tracking:
                    tracked = self._online.track(ready.cloud, incoming.name)
            except InputError as error:
                self._finish(incoming, failure=user_message(error))
                continue
            done = time.monotonic()
            computed = ready.computed + time.perf_counter() - begin
            frame = LiveFrame(
                incoming.number,
                incoming.name,
                float(incoming.seconds),
                done - incoming.arrived,
                computed,
                tracked,
            )
            self._surface = self._followed_surface(tracked, ready.cloud)
            self.newest = frame
            if self.on_frame is not None:
                self.on_frame(frame)
            self._finish(incoming, latency=frame.latency)

    def _followed_surface(self, tracked: TrackedFrame, cloud: Cloud) -> Float[np.ndarray, "N 3"] | None:
        """Return the surface near which the next image shows the person; None if the whole image is to be searched.

        It is that of the body, or, where the body is lost, the person's points in this frame: a search of the whole image
        takes as long as several frames, so it is repeated only now and then.
        """
        if not tracked.lost:
            self._num_lost = 0
            return np.asarray(posed_vertices(self._online.tracker.body, tracked.pose), float)
        self._num_lost += 1
        points = np.asarray(cloud.points, float)[np.asarray(cloud.weights) > 0]
        return None if self._num_lost % SEARCH_EVERY == 0 else points

    def _finish(
        self, frame: _Incoming, latency: float | None = None, dropped: bool = False, failure: str = ""
    ) -> None:
        """Count a frame that is done."""
        with self._idle:
            early = frame.arrived < self._ready_since
            self._counts.add(latency, dropped, failure, early)
            if latency is not None:
                self._counts.reduced += self._is_reduced
            if not early:
                self._load.count(dropped)
            self._open -= 1
            self._idle.notify_all()
