"""A function of the user on many items, on the workers of a cluster."""

import contextlib
import pickle
import socket
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from ..arguments import checked
from ..errors import InputError
from .cluster import check_version, open_cluster
from .dask_libraries import import_distributed
from .versions import Version, installed_version

if TYPE_CHECKING:
    from distributed import Client


class JobResult(NamedTuple):
    """The result of one job, or the error with which it ended."""

    #: number of the item
    number: int
    #: None if there is an error
    value: Any = None
    error: Exception | None = None


@checked
def map_jobs(
    function: Callable[[Any], Any], items: Iterable[Any], client: "Client | None" = None
) -> Iterator[JobResult]:
    """Map a function over items on the workers of a cluster; yield the results in the order in which the jobs end.

    An error of one job is its result, and the others go on. A job whose worker dies is begun again on another worker, at most
    three times in all. Function, items and values are pickled; a script that calls this needs the usual
    `if __name__ == "__main__":`, as workers import it.

    **Arguments:** `client` is one of `dask.distributed`; by default a cluster of this computer, one worker for each core,
    is started for these items.

    **Raises:** `InputError` if Dask is not installed, if function or items cannot be pickled, if a worker has another version of
    jaxcap, or if the scheduler is lost; results that were yielded stay valid.
    """
    items = list(items)
    opened = open_cluster(jobs=len(items)) if client is None else contextlib.nullcontext(client)
    with opened as connected:
        yield from _results(connected, function, items)


def _results(client: "Client", function: Callable[[Any], Any], items: list) -> Iterator[JobResult]:
    distributed = import_distributed()
    call = partial(_call, function, installed_version())
    _check_picklable(call, items)
    futures = client.map(call, items, pure=False)
    numbers = {future.key: number for number, future in enumerate(futures)}
    waiting = distributed.as_completed(futures, loop=client.loop, with_results=True, raise_errors=False)
    # the scheduler keeps a job's result as long as a future of it is referred to
    del futures
    for future, found in waiting:
        number = numbers[future.key]
        # not by the future's status: a worker that dies after it gave its result makes that "lost"
        if isinstance(found, _Outcome):
            yield JobResult(number, *found)
        elif isinstance(found, tuple):
            yield JobResult(number, error=_failure(distributed, found[1]))
        else:
            raise InputError(
                "The scheduler is lost, and jobs without a result are not done; start the scheduler and the batch again."
            )


class _Outcome(NamedTuple):
    """What a worker returns: the value of the function, or its error."""

    value: Any
    error: Exception | None


def _call(function: Callable[[Any], Any], version: Version, item: Any) -> _Outcome:
    """Apply a function to an item on a worker."""
    try:
        check_version(version, installed_version(), socket.gethostname())
        return _Outcome(function(item), None)
    except Exception as error:
        return _Outcome(None, _picklable(error))


def _picklable(error: Exception) -> Exception:
    """Return an error that can be sent to the client."""
    try:
        pickle.loads(pickle.dumps(error))
        return error
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")


def _check_picklable(call: Callable, items: list) -> None:
    from distributed.protocol import pickle as dask_pickle

    try:
        dask_pickle.dumps((call, items[:1]))
    except Exception as error:
        raise InputError(
            f"The function and its items have to be sent to other processes, and cannot be pickled ({error}); give a function "
            "of a module, and items without open files or locks."
        ) from None


def _failure(distributed: Any, error: Any) -> Exception:
    """Return the error of a job that Dask ended."""
    if isinstance(error, distributed.KilledWorker):
        return InputError(
            f"The process of its worker ended {error.allowed_failures + 1} times while it ran, perhaps for lack of memory; give it "
            "more memory, by fewer workers."
        )
    return error
