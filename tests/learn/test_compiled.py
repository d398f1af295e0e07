"""Compiled functions are forgotten when they are too many for a process, and compile again."""

import jax
import jax.numpy as jnp
import pytest

from jaxcap.compiled import MANY_MAPS, MAPS, forget_many_compiled

pytestmark = pytest.mark.skipif(
    not MAPS.exists(), reason="needs Linux, which lists what a process has mapped"
)


def test_compiled_functions_are_forgotten_only_when_they_are_many():
    traced = []

    @jax.jit
    def double(x):
        traced.append(1)
        return 2 * x

    assert float(double(jnp.ones(()))) == 2.0
    assert not forget_many_compiled(limit=10**9)
    assert float(double(jnp.ones(()))) == 2.0 and len(traced) == 1
    assert forget_many_compiled(limit=0)
    assert float(double(jnp.ones(()))) == 2.0 and len(traced) == 2
    # well below what Linux allows: a round of learning compiles hundreds of functions
    assert MANY_MAPS < 65_530 // 1.5
