"""Independent pieces of work on all cores at once."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def parallel_map(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Call a function on each item, in as many threads as there are cores; results come in the order of the items.

    Items are drawn in the caller's thread and no sooner than a core is free for them. The first is done before all others, so that what it
    compiles is compiled once.
    """
    drawn = iter(items)
    for first in drawn:
        yield function(first)
        break
    cores = os.cpu_count() or 1
    with ThreadPoolExecutor(cores) as threads:
        begun: deque[Future[Result]] = deque()
        for item in drawn:
            begun.append(threads.submit(function, item))
            if len(begun) >= cores:
                yield begun.popleft().result()
        while begun:
            yield begun.popleft().result()
