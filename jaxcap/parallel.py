"""Parallel map over independent items on all cores."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def parallel_map(
    function: Callable[[Item], Result], items: Iterable[Item], *, is_compiled: bool = False
) -> Iterator[Result]:
    """Map a function over items in as many threads as there are cores; results are in the order of the
    items.

    Items are taken in the caller's thread, and not before a core is free for them. The first is completed
    before all others, so that its compilation is shared, unless it `is_compiled` already.
    """
    remaining = iter(items)
    for first in () if is_compiled else remaining:
        yield function(first)
        break
    cores = os.cpu_count() or 1
    with ThreadPoolExecutor(cores) as threads:
        begun: deque[Future[Result]] = deque()
        for item in remaining:
            begun.append(threads.submit(function, item))
            if len(begun) >= cores:
                yield begun.popleft().result()
        while begun:
            yield begun.popleft().result()
