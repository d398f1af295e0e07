"""The number of workers of a computer: by its cores, its memory, and the memory that a job needs."""

from typing import NamedTuple

from ..errors import InputError

#: bytes of a gibibyte
GIB = 1 << 30
#: share of the memory that workers may use
MEMORY_SHARE = 0.8


class Computer(NamedTuple):
    """The resources of a computer that this process may use."""

    cores: int
    #: bytes
    memory: int


def this_computer() -> Computer:
    """Measure the cores and the memory of this computer, within the limits of a container. Raises `InputError` without Dask."""
    from .dask_libraries import import_distributed

    distributed = import_distributed()
    from dask.system import CPU_COUNT

    return Computer(CPU_COUNT, int(distributed.system.MEMORY_LIMIT))


def count_workers(computer: Computer, job_memory: int | float, jobs: int, wanted: int | None = None) -> int:
    """Choose the number of workers: one for each core, as far as the memory suffices, and not more than there are jobs.

    `job_memory` is the memory of one worker in bytes; `wanted` overrides cores and memory.

    **Raises:** `InputError` if `wanted` is below 1.
    """
    if wanted is not None:
        if wanted < 1:
            raise InputError(f"The number of workers is {wanted}; it must be at least 1.")
        return min(wanted, max(jobs, 1))
    fitting = int(MEMORY_SHARE * computer.memory / job_memory)
    return max(1, min(computer.cores, fitting, jobs))
