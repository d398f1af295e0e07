"""Run every test in float64 with shapes checked at run time.

`JAXCAP_TEST_FLOAT32=1` leaves JAX at its default precision, for the tests marked `float32`. Tests run in several
processes, which share one cache of compiled functions."""

import gc
import os
import shutil
import subprocess
import sys
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("MPLBACKEND", "Agg")
# the cores are the workers'
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# compiled once for all processes, those of the command line's tests among them, single operations too
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", f"{Path(__file__).resolve().parents[1]}/.pytest_cache/jax")
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")

import hypothesis
import jax
import numpy as np
import pytest
from jaxtyping import install_import_hook

jax.config.update("jax_enable_x64", os.environ.get("JAXCAP_TEST_FLOAT32", "0") in ("", "0"))

# from here on every annotation of the package is checked; it must not be imported before
install_import_hook("jaxcap", "beartype.beartype")

# the first example of a test compiles, so no deadline, and no test is too slow; the same examples on
# every machine
hypothesis.settings.register_profile(
    "jaxcap",
    deadline=None,
    derandomize=True,
    max_examples=25,
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
)
hypothesis.settings.load_profile("jaxcap")

CHECKOUT = Path(__file__).resolve().parents[1]
CACHE = CHECKOUT / ".pytest_cache" / "jax"
SHARED = Path(os.environ.get("JAXCAP_SHARED") or CHECKOUT.parent / "shared")


#: what a worker needs at most, and the size from which the cache is begun anew, in bytes
WORKER_MEMORY, CACHE_SIZE = 4 << 30, 2 << 30
#: XLA flags that nearly halve the compile time, and a program that fails if XLA does not know them; with one thread, LAPACK
#: calls cannot wait for each other
FAST_COMPILING = "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0 --xla_cpu_multi_thread_eigen=false"
START_XLA = "import jax; jax.devices()"
#: pieces of memory that a process may map, and those from which compiled functions are forgotten
MAPS = Path("/proc/self/maps")
MANY_MAPS = 30_000
#: the memory of a process, in pages, and the bytes from which compiled functions are forgotten
PAGES, MUCH_MEMORY = Path("/proc/self/statm"), 3 << 30


def pytest_xdist_auto_num_workers() -> int:
    """Use all cores that the process may use, as long as memory is enough."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError):
        return cores
    return max(1, min(cores, memory // WORKER_MEMORY))


def pytest_configure(config):
    """Have XLA compile without optimising; most tests call what they compile a few times only."""
    if (
        "XLA_FLAGS" in os.environ
        or hasattr(config, "workerinput")
        or config.getoption("markexpr") != "not slow"
    ):
        return
    wanted = {**os.environ, "XLA_FLAGS": FAST_COMPILING}
    # a version of XLA that has no such flags dies of them
    if not subprocess.run([sys.executable, "-c", START_XLA], env=wanted, capture_output=True).returncode:
        os.environ["XLA_FLAGS"] = FAST_COMPILING


def pytest_sessionstart(session):
    """Keep the cache of compiled functions from growing without end."""
    if hasattr(session.config, "workerinput") or not CACHE.is_dir():
        return
    if sum(file.stat().st_size for file in CACHE.rglob("*") if file.is_file()) > CACHE_SIZE:
        shutil.rmtree(CACHE, ignore_errors=True)


def pytest_collection_finish(session):
    """Leave what was imported out of garbage collection, which tracing sets off very often."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)


def pytest_collection_modifyitems(items):
    if (SHARED / "data").is_dir():
        return
    for item in items:
        if "shared" in item.keywords:
            item.add_marker(pytest.mark.skip(reason="needs the shared captures"))


@pytest.fixture(autouse=True, scope="module")
def _forget_compiled():
    """Forget compiled functions before they are too many: each is mapped into memory in several pieces, and a process
    may map 65,530. They also take memory, gigabytes after some hundred tests."""
    yield
    if (
        not MAPS.exists()
        or MAPS.read_bytes().count(b"\n") > MANY_MAPS
        or int(PAGES.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") > MUCH_MEMORY
    ):
        jax.clear_caches()


@pytest.fixture(autouse=True)
def _forget_slow(request):
    """A slow test alone compiles as many functions as a whole module of others."""
    yield
    if "slow" in request.keywords:
        jax.clear_caches()


@pytest.fixture(scope="session")
def checkout() -> Path:
    """The root of the source tree."""
    return CHECKOUT


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of the shared captures; a test that asks for it also carries `@pytest.mark.shared`."""
    if not (SHARED / "data").is_dir():
        pytest.skip("needs the shared captures")
    return SHARED


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers, the same in every run and for every test."""
    return np.random.default_rng(20_240_229)
