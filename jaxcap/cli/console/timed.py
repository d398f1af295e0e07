"""How long each of a stream of results took."""

import time
from collections.abc import Iterable, Iterator

import jax


def timed(frames: Iterable) -> Iterator[tuple]:
    """Each result, when it is there, with the seconds since the one before was asked for."""
    start = time.perf_counter()
    for frame in frames:
        jax.block_until_ready(frame)
        yield frame, time.perf_counter() - start
        start = time.perf_counter()
