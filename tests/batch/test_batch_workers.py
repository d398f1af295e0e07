"""The preparation of workers, and what they record."""

import os
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from jaxcap.cli.console.errors import warnings_as_lines
from jaxcap.cli.console.record import record_output

pytest.importorskip("distributed")
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
