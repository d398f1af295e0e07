"""The preparation of workers, and what they record."""

import os
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from jaxcap.batch.cluster import _slurm_settings, check_threads, check_versions, open_cluster
from jaxcap.batch.mapping import _failure
from jaxcap.batch.size import GIB
from jaxcap.cli.console.errors import warnings_as_lines
from jaxcap.cli.console.record import record_output
from jaxcap.errors import InputError

distributed = pytest.importorskip("distributed")
CHECKOUT = Path(__file__).resolve().parents[2]
#: as a worker unpickles the function, before or after JAX is imported
PREPARE = """
import sys
{before}
import jaxcap.cli.batch.prepare as prepare
assert ("jax" in sys.modules) == bool("{before}")
prepare.prepare_worker()
import jax
print(jax.config.jax_compilation_cache_dir, jax.config.jax_persistent_cache_min_compile_time_secs)
"""


@pytest.mark.parametrize("before", ["", "import jax"])
def test_workers_have_the_cache_of_compiled_functions(tmp_path, before):
    env = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    env |= {"PYTHONPATH": str(CHECKOUT), "JAXCAP_CACHE": str(tmp_path / "cache")}
    program = PREPARE.format(before=before)
    done = subprocess.run([sys.executable, "-c", program], env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    folder, seconds = done.stdout.split()
    assert Path(folder).parent == tmp_path / "cache"
    assert float(seconds) == 0.1


def test_each_job_of_a_worker_records_its_warnings():
    """Python itself shows a warning once for each line of the program."""
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        found = []
        for _ in range(2):
            with record_output() as record, warnings_as_lines():
                warnings.warn("the same", stacklevel=1)
            found.append(record.warnings)
    assert found == [["the same"], ["the same"]]


def test_the_sentence_of_a_killed_job_has_the_attempts_of_the_scheduler():
    error = distributed.KilledWorker("job", None, 7)
    assert "ended 8 times while it ran" in str(_failure(distributed, error))


def test_workers_with_several_threads_are_refused():
    check_threads(1, "tcp://there")
    with pytest.raises(InputError, match="tcp://there: this worker has 4 threads"):
        check_threads(4, "tcp://there")
    with (
        distributed.LocalCluster(1, threads_per_worker=2, processes=False, dashboard_address=None) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
        pytest.raises(InputError, match="this worker has 2 threads"),
    ):
        check_versions(client)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, ("--cpus-per-task=1", "--mem=2G", "export NPROC=1")),
        ({"cores": "8", "partition": "cpu"}, ("--cpus-per-task=8", "--mem=2G", "export NPROC=8", "-p cpu")),
        (
            {"cores": "8", "processes": "4"},
            ("--cpus-per-task=8", "--mem=8G", "export NPROC=2", "--nworkers 4"),
        ),
        ({"job_script_prologue": "module load python"}, ("module load python", "export NPROC=1")),
    ],
)
def test_slurm_workers_have_one_thread_no_profiler_and_never_pause(options, words):
    """As the script of the job says, which dask-jobqueue writes."""
    slurm = pytest.importorskip("dask_jobqueue.slurm")
    job = slurm.SLURMJob("tcp://there:1", "worker", **_slurm_settings(options, 2 * GIB))
    script = job.job_script()
    assert "--nthreads 1 " in script
    for name in ("TARGET", "SPILL", "PAUSE"):
        assert f"export DASK_DISTRIBUTED__WORKER__MEMORY__{name}=False\n" in script
    assert "export DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED=False\n" in script
    assert all(word in script for word in words), script


def test_workers_have_the_given_number_of_threads_of_xla():
    with open_cluster(1, threads=3) as client:
        assert list(client.run(os.getenv, "NPROC").values()) == ["3"]


def test_the_environment_of_slurm_workers_is_read_by_dask():
    from dask.config import collect_env

    lines = _slurm_settings({}, GIB)["job_script_prologue"]
    found = collect_env(dict(line.removeprefix("export ").split("=") for line in lines))
    assert found["distributed"]["worker"]["memory"] == {"target": False, "spill": False, "pause": False}
