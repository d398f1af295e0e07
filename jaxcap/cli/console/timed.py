"""The computing time of each element of an iterator."""

import time
from collections.abc import Iterable, Iterator

import jax


def timed(frames: Iterable) -> Iterator[tuple]:
    """Yield each result, once computed, with the seconds since it was requested."""
    start = time.perf_counter()
    for frame in frames:
        jax.block_until_ready(frame)
        yield frame, time.perf_counter() - start
        start = time.perf_counter()
