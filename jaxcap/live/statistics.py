"""Frames of a live run, and statistics of their rate and latency."""

import time
from collections import deque
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..tracking.judge_frame import TrackedFrame

#: seconds over which the current rate is measured
RATE_SECONDS = 2.0
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
    #: frames tracked per second of late
    rate: float
    #: median and 99th percentile of the latency, seconds; NaN before the first frame
    latency_median: float
    latency_p99: float
    #: the last failure, a sentence
    last_failure: str
    #: only every second row and column of the images is read, as many frames were dropped
    is_reduced: bool = False
    #: number of frames that were tracked with reduced images
    reduced: int = 0

    def sentence(self) -> str:
        """Format the statistics as one line."""
        failed = f", {self.failed} failed" if self.failed else ""
        latency = (
            f"latency {1000 * self.latency_median:.0f} ms, 99 % within {1000 * self.latency_p99:.0f} ms"
            if self.tracked
            else "no frame yet"
        )
        reduced = "; images are read at half their resolution" if self.is_reduced else ""
        counts = f"{self.tracked} tracked, {self.dropped} dropped{failed}"
        return f"{self.rate:.1f} frames per second, {latency}; {counts}{reduced}"


class StatisticsCounter:
    """Counts of a live run; the caller excludes simultaneous calls."""

    def __init__(self) -> None:
        self.tracked = self.dropped = self.failed = self.reduced = 0
        self.last_failure = ""
        self._latencies: deque[float] = deque(maxlen=MAX_LATENCIES)
        self._times: deque[float] = deque()

    def add(self, latency: float) -> None:
        """Count a tracked frame."""
        self.tracked += 1
        self._latencies.append(latency)
        self._times.append(time.monotonic())

    def latencies(self) -> Float[np.ndarray, "N"]:
        """Return the latencies of the tracked frames, seconds."""
        return np.array(self._latencies)

    def summary(self) -> LiveStatistics:
        """Compute the statistics so far."""
        now = time.monotonic()
        while self._times and now - self._times[0] > RATE_SECONDS:
            self._times.popleft()
        span = now - self._times[0] if len(self._times) > 1 else RATE_SECONDS
        latencies = self.latencies()
        median, late = np.percentile(latencies, [50, 99]) if len(latencies) else (np.nan, np.nan)
        return LiveStatistics(
            self.tracked,
            self.dropped,
            self.failed,
            len(self._times) / max(span, 1e-3),
            float(median),
            float(late),
            self.last_failure,
            reduced=self.reduced,
        )
