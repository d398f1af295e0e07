"""Frames that have arrived at a source, and recorded frames that arrive again at their own rate."""

import threading
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

from ...observe.clouds import Scan
from ..depth.sequence import DepthFrame
from ..lazy_frames import LazyFrames

#: seconds between two looks at a stop event, so that Ctrl-C is not delayed
STOP_SECONDS = 0.1


class Arrival(NamedTuple):
    """A frame that has arrived and is read when it is used; a dropped frame is never read."""

    name: str
    #: the time of the frame, seconds, on the clock of its source
    seconds: float
    #: the time of its arrival, `time.monotonic()`
    arrived: float
    read: Callable[[], DepthFrame | Scan]


def replay(
    frames: LazyFrames[DepthFrame] | LazyFrames[Scan], rate: float, stop: threading.Event
) -> Iterator[Arrival]:
    """Yield recorded frames, each at its own time, until the end or until `stop`.

    A frame arrives at its time also if the consumer takes longer, so that a slow consumer sees frames that are late.
    """
    begin = time.monotonic()
    for number, name in enumerate(frames.names):
        due = begin + number / rate
        while (rest := due - time.monotonic()) > 0:
            if stop.wait(min(rest, STOP_SECONDS)):
                return
        if stop.is_set():
            return
        yield Arrival(name, number / rate, due, lambda number=number: frames[number])
