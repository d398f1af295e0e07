"""Work in other threads: a map over independent items on all cores."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

import jax

Item = TypeVar("Item")
Result = TypeVar("Result")


def with_own_settings(function: Callable[..., Result]) -> Callable[..., Result]:
    """Give a function that runs in another thread the settings of this one, such as those of `with jax.enable_x64(True)`."""
    names = "jax_enable_x64", "jax_default_device", "jax_default_matmul_precision"
    x64, device, precision = (getattr(jax.config, name) for name in names)

    def run(*arguments) -> Result:
        with jax.enable_x64(x64), jax.default_device(device), jax.default_matmul_precision(precision):
            return function(*arguments)

    return run


def parallel_map(
    function: Callable[[Item], Result], items: Iterable[Item], *, is_compiled: bool = False
) -> Iterator[Result]:
    """Map a function over items in as many threads as there are cores; results are in the order of the
    items.

    Items are taken in the caller's thread, and not before a core is free for them. The first is completed
    before all others, so that its compilation is shared, unless it `is_compiled` already.
    """
    function, remaining = with_own_settings(function), iter(items)
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
