"""Frames of a live run, and statistics of their rate and latency."""

import math
import time
from collections import deque
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..tracking.judge_frame import TrackedFrame

#: seconds over which the current rate is measured, at most and at least
RATE_SECONDS, MIN_RATE_SECONDS = 2.0, 1.0
#: least number of frames for a 99th percentile
MIN_FRAMES = 100
#: number of latencies that are kept: an hour at 30 frames per second
MAX_LATENCIES = 108_000


class LiveFrame(NamedTuple):
    """A tracked frame of a live run."""

    #: number of the frame among all that arrived, from 0
    number: int
    name: str
    #: the time of the frame on the clock of its source, seconds
    seconds: float
    #: seconds from its arrival to its pose
    latency: float
    #: seconds of computation
    computed: float
    tracked: TrackedFrame


class LiveStatistics(NamedTuple):
    """Counts and latencies of a live run so far."""

    #: number of frames that were tracked; that were dropped as a newer one arrived; without a person or unreadable
    tracked: int
    dropped: int
    failed: int
    #: frames tracked per second of late; NaN before a second of tracking
    rate: float
    #: median and 99th percentile of the latency of frames that arrived after `LiveTracker.warm_up`, seconds; NaN before the first
    latency_median: float
    latency_p99: float
    #: the last failure, a sentence
    last_failure: str
    #: only every second row and column of the images is read, as many frames were dropped
    is_reduced: bool = False
    #: number of frames that were tracked with reduced images
    reduced: int = 0
    #: number of the dropped frames that arrived before the end of `LiveTracker.warm_up`
    dropped_before_ready: int = 0

    def sentence(self) -> str:
        """Format what is known of the statistics as one line."""
        measured = []
        if not math.isnan(self.rate):
            measured.append(f"{self.rate:.1f} frames per second")
        if not math.isnan(self.latency_median):
            measured.append(f"latency {1000 * self.latency_median:.0f} ms")
            if self.tracked >= MIN_FRAMES:
                measured.append(f"99 % within {1000 * self.latency_p99:.0f} ms")
        early = f" ({self.dropped_before_ready} during compilation)" if self.dropped_before_ready else ""
        failed = f", {self.failed} failed" if self.failed else ""
        counts = f"{self.tracked} tracked, {self.dropped} dropped{early}{failed}"
        reduced = "images are read at half their resolution" if self.is_reduced else ""
        return "; ".join(part for part in (", ".join(measured), counts, reduced) if part)


class StatisticsCounter:
    """Counts of a live run; the caller excludes simultaneous calls."""

    def __init__(self) -> None:
        self.tracked = self.dropped = self.failed = self.reduced = self.early = 0
        self.last_failure = ""
        self._latencies: deque[float] = deque(maxlen=MAX_LATENCIES)
        #: times of the tracked frames of late, and of the last frame that was tracked, dropped or failed
        self._times: deque[float] = deque()
        self._last = 0.0

    def begin(self) -> None:
        """Count all frames so far as early, without their latencies."""
        self.early = self.dropped
        self._latencies.clear()

    def add(
        self, latency: float | None, dropped: bool = False, failure: str = "", early: bool = False
    ) -> None:
        """Count a frame: tracked with this latency, dropped, or failed; `early` if it arrived before the tracker was ready."""
        self._last = time.monotonic()
        if latency is not None:
            self.tracked += 1
            self._times.append(self._last)
            if not early:
                self._latencies.append(latency)
        self.dropped += dropped
        self.early += dropped and early
        if failure:
            self.failed += 1
            self.last_failure = failure
        while len(self._times) > 2 and self._last - self._times[0] > RATE_SECONDS:
            self._times.popleft()

    def latencies(self) -> Float[np.ndarray, "N"]:
        """Return the latencies of the tracked frames, seconds."""
        return np.array(self._latencies)

    def summary(self) -> LiveStatistics:
        """Compute the statistics so far."""
        # up to the last frame, as nothing is known of the time after it
        span = self._last - self._times[0] if self._times else 0.0
        rate = (len(self._times) - 1) / span if span >= MIN_RATE_SECONDS and len(self._times) > 1 else np.nan
        latencies = self.latencies()
        median, late = np.percentile(latencies, [50, 99]) if len(latencies) else (np.nan, np.nan)
        return LiveStatistics(
            self.tracked,
            self.dropped,
            self.failed,
            rate,
            float(median),
            float(late),
            self.last_failure,
            reduced=self.reduced,
            dropped_before_ready=self.early,
        )
