"""Clusters of Dask: one of this computer, one with a running scheduler, or jobs of SLURM."""

import contextlib
import importlib.util
import logging
import threading
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from ..arguments import checked
from ..errors import InputError
from .dask_libraries import import_distributed, import_optional
from .size import GIB, Computer, count_workers, this_computer
from .versions import Version, installed_version

if TYPE_CHECKING:
    from distributed import Client

_LOG = logging.getLogger(__name__)
#: memory of a worker by default, bytes
WORKER_MEMORY = 2 * GIB
#: how often a job is begun whose worker dies, and seconds until a scheduler has to answer
ATTEMPTS, ANSWER_SECONDS = 3, 10.0
#: share of a GPU's memory that all workers together take, as JAX does in one process
GPU_SHARE = 0.75
#: settings of the scheduler: a job whose worker died is begun again so often that it was begun `ATTEMPTS` times; a worker has
#: one job, so that its death counts for no other one; a worker that starts slowly is not given up
SCHEDULER = {
    "distributed.scheduler.allowed-failures": ATTEMPTS - 1,
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.deploy.lost-worker-timeout": "600s",
}
#: settings of a worker: there are no results to spill, and a paused worker whose memory is in use by JAX would never go on; what
#: Dask's profiler collects grows by a tenth of a megabyte a second
WORKER = {
    "distributed.worker.profile.enabled": False,
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
}
#: seconds between two looks for workers that are gone
WATCH_SECONDS = 2.0
#: address of the dashboard, which is there if bokeh is installed
DASHBOARD = "127.0.0.1:8787"


@checked
@contextlib.contextmanager
def open_cluster(
    workers: int | None = None,
    *,
    scheduler: str | None = None,
    slurm: Mapping[str, str] | None = None,
    memory: int | float = WORKER_MEMORY,
    jobs: int | None = None,
    processes: bool = True,
    threads: int | None = None,
) -> "Iterator[Client]":
    """Open a client of a cluster for the duration of a block, and close what was started for it.

    **Arguments:** without `scheduler` and `slurm`, a cluster of this computer, whose scheduler listens on this computer only.
    It has `workers` processes of one thread each; by default one for each core, as far as `memory`, bytes for each worker,
    suffices, and at most `jobs`. `scheduler` is the address of a running scheduler, such as `tcp://10.0.0.1:8786`. `slurm`
    are options of `dask_jobqueue.SLURMCluster`; `partition` and `time` are other names of its `queue` and `walltime`; `workers` is
    then the number of SLURM jobs. With `processes=False` the workers are threads of this process, for tests. `threads` of XLA that a
    process of this computer has, by default its share of the cores: sums depend on their number, by rounding errors.

    **Raises:** `InputError` if Dask is not installed, no scheduler answers, or a worker has another version of jaxcap.
    """
    if scheduler is not None and slurm is not None:
        raise InputError("A scheduler and SLURM were both given; give one of them.")
    if scheduler is not None:
        opened = _connect(scheduler)
    elif slurm is not None:
        opened = _slurm_cluster(slurm, workers, memory)
    else:
        computer = this_computer()
        count = count_workers(computer, memory, computer.cores if jobs is None else jobs, workers)
        opened = _local_cluster(count, computer, processes, threads)
    with opened as client:
        check_versions(client)
        yield client


@contextlib.contextmanager
def _local_cluster(
    workers: int, computer: Computer, processes: bool, threads: int | None
) -> "Iterator[Client]":
    distributed = import_distributed()
    from dask import config

    threads = max(1, computer.cores // workers) if threads is None else threads
    settings = {
        **SCHEDULER,
        **WORKER,
        # the threads of XLA: by default all workers together have as many as there are cores; and its share of a GPU's memory
        "distributed.nanny.pre-spawn-environ.NPROC": str(threads),
        "distributed.nanny.pre-spawn-environ.XLA_PYTHON_CLIENT_MEM_FRACTION": f"{GPU_SHARE / workers:.3f}",
    }
    has_dashboard = importlib.util.find_spec("bokeh") is not None
    with config.set(settings), _quiet_logs(), contextlib.ExitStack() as stack:
        cluster = stack.enter_context(
            distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=processes,
                host="127.0.0.1" if processes else None,
                memory_limit=computer.memory / workers if processes else None,
                dashboard_address=DASHBOARD if has_dashboard else "127.0.0.1:0",
                silence_logs=logging.CRITICAL,
            )
        )
        stack.enter_context(_workers_kept(cluster))
        client = stack.enter_context(distributed.Client(cluster, set_as_default=False))
        if has_dashboard:
            _LOG.info("the dashboard is at %s", client.dashboard_link)
        yield client


@contextlib.contextmanager
def _workers_kept(cluster: Any) -> Iterator[None]:
    """Replace the workers that Dask gives up because their process died while it was started again."""
    stop, count = threading.Event(), len(cluster.workers)

    def replace() -> None:
        gone = [
            name for name, worker in cluster.workers.items() if worker.status.name in ("closed", "failed")
        ]
        for name in gone:
            del cluster.workers[name]
        if gone:
            cluster.scale(count)

    def watch() -> None:
        while not stop.wait(WATCH_SECONDS):
            cluster.loop.add_callback(replace)

    thread = threading.Thread(target=watch, daemon=True, name="workers")
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


@contextlib.contextmanager
def _connect(address: str) -> "Iterator[Client]":
    distributed = import_distributed()
    with _quiet_logs():
        try:
            client = distributed.Client(address, timeout=ANSWER_SECONDS, set_as_default=False)
        except (OSError, ValueError) as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise InputError(
                f"{address}: no scheduler answers at this address ({reason}); start one with `dask scheduler`, or run the "
                "batch on this computer alone."
            ) from None
        with client:
            if not client.scheduler_info()["workers"]:
                _LOG.info("waiting for the first worker of %s", address)
                client.wait_for_workers(1)
            yield client


@contextlib.contextmanager
def _slurm_cluster(
    options: Mapping[str, str], workers: int | None, memory: int | float
) -> "Iterator[Client]":
    distributed = import_distributed()
    jobqueue = import_optional("dask_jobqueue", "Jobs of SLURM are started by dask-jobqueue")
    from dask import config

    with config.set(SCHEDULER), _quiet_logs():
        try:
            cluster = jobqueue.SLURMCluster(**_slurm_settings(options, memory))
        except (TypeError, ValueError) as error:
            reason = str(error).partition(".")[0]
            raise InputError(
                f"SLURM jobs cannot be made with {', '.join(options)} ({reason}); give options of dask_jobqueue.SLURMCluster."
            ) from None
        with cluster, distributed.Client(cluster, set_as_default=False) as client:
            cluster.scale(jobs=workers or 1)
            _LOG.info("waiting for the first job of SLURM")
            client.wait_for_workers(1)
            yield client


def _slurm_settings(options: Mapping[str, Any], memory: int | float) -> dict[str, Any]:
    """Return the arguments of `SLURMCluster`: workers of one thread, with the settings of `WORKER`. Raises `ValueError`.

    The cores of a SLURM job, by default one for each of its processes, are divided among the processes for the threads of XLA.
    """
    from dask import config

    names = {"partition": "queue", "time": "walltime"}
    given = {names.get(name, name): value for name, value in options.items()}
    processes = int(given.get("processes", 1))
    cores = max(int(given.get("job_cpu", given.get("cores", processes))), processes)
    # the process that a job starts reads its configuration from the environment
    variables: dict[str, Any] = {
        f"DASK_{name.replace('.', '__').upper()}": value for name, value in WORKER.items()
    }
    variables["NPROC"] = cores // processes
    # the computing centre's own commands, such as those that load modules, stay
    found = f"jobqueue.{given.get('config_name', 'slurm')}.job-script-prologue"
    prologue = given.get("job_script_prologue") or config.get(found, None) or []
    return {
        "memory": f"{processes * memory / GIB:g}GiB",
        **given,
        "cores": processes,
        "processes": processes,
        "job_cpu": cores,
        "job_script_prologue": [
            *([prologue] if isinstance(prologue, str) else prologue),
            *(f"export {name}={value}" for name, value in variables.items()),
        ],
    }


def check_versions(client: "Client") -> None:
    """Check that the present workers have this version of jaxcap, and one thread. Raises `InputError`."""
    counts: Any = client.nthreads()
    for address, threads in counts.items():
        check_threads(threads, address)
    own = installed_version()
    answers: Any = client.run(installed_version, on_error="return")
    for address, found in answers.items():
        if isinstance(found, ImportError):
            raise InputError(
                f"{address}: this worker has no jaxcap ({found}); install version {own.number} where the worker runs."
            )
        if isinstance(found, Exception):
            raise InputError(f"{address}: this worker does not answer ({found}); restart it.")
        check_version(own, found, address)


def check_threads(threads: int, where: str) -> None:
    """Check that a worker runs one job at a time. Raises `InputError`."""
    if threads != 1:
        raise InputError(
            f"{where}: this worker has {threads} threads, and the jobs of a batch need a process each; start it with "
            "--nthreads 1, and with --nworkers for several processes."
        )


def check_version(own: Version, found: Version, where: str) -> None:
    """Check that two versions are equal. Raises `InputError`."""
    if found != own:
        raise InputError(
            f"{where}: this worker has version {found} of jaxcap, and the batch was started with {own}; install the same "
            "version in both places."
        )


@contextlib.contextmanager
def _quiet_logs() -> Iterator[None]:
    """Hide the log of Dask about workers that come and go; jobs report their errors themselves."""
    # Dask sets levels of its own for some of them
    names = [name for name in logging.root.manager.loggerDict if name.partition(".")[0] == "distributed"]
    levels = {logging.getLogger(name): logging.getLogger(name).level for name in ("distributed", *names)}
    for log in levels:
        log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for log, level in levels.items():
            log.setLevel(level)
