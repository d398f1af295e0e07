"""Every test runs in float64 with shapes checked at run time; `JAXCAP_TEST_FLOAT32=1` leaves
JAX at its default precision, for the tests marked `float32`."""

import os
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("MPLBACKEND", "Agg")

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
SHARED = Path(os.environ.get("JAXCAP_SHARED") or CHECKOUT.parent / "shared")


def pytest_collection_modifyitems(items):
    if (SHARED / "data").is_dir():
        return
    for item in items:
        if "shared" in item.keywords:
            item.add_marker(pytest.mark.skip(reason="needs the shared captures"))


@pytest.fixture(autouse=True, scope="module")
def _forget_compiled():
    """Compiled functions stay mapped into memory, and a process may map only so many pieces."""
    yield
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
