"""A map in batches against one over single items."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcap.batched_map import map_batches

#: factorises matrices in batches, one batch at a time
FACTORISE = """
import jax, jax.numpy as jnp, numpy as np
from jaxcap.batched_map import map_batches
jax.config.update("jax_enable_x64", True)
found = np.random.default_rng(0).normal(size=(100, 60, 60))
matrices = jnp.asarray(found @ found.transpose(0, 2, 1) + 60 * np.eye(60))
factors = jax.jit(lambda m: map_batches(jnp.linalg.cholesky, m, 64))
for _ in range(200):
    last = factors(matrices).block_until_ready()
print(float(jnp.abs(last @ last.transpose(0, 2, 1) - matrices).max()) < 1e-9)
"""


@pytest.mark.parametrize("count", [0, 1, 4, 5, 6, 11])
def test_batches_are_the_items_one_by_one(count, rng):
    items = {"a": jnp.asarray(rng.normal(size=(count, 3))), "b": jnp.arange(float(count))}

    def function(item):
        return item["a"] * item["b"], jnp.sum(item["a"])

    alone = jax.lax.map(function, items)
    for size in (None, 1, 5):
        jax.tree.map(np.testing.assert_array_equal, map_batches(function, items, size), alone)


def test_derivatives_do_not_count_the_items_that_fill_a_batch(rng):
    items = jnp.asarray(rng.normal(size=7))
    slopes = jax.grad(lambda x: jnp.sum(map_batches(jnp.sin, x, 3)))(items)
    np.testing.assert_allclose(slopes, np.cos(items), rtol=1e-12)


def test_factorisations_in_batches_do_not_wait_for_each_other():
    """In `jax.lax.map(batch_size=64)` they do on two cores, in most runs."""
    environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    done = subprocess.run(
        [sys.executable, "-c", FACTORISE], env=environment, capture_output=True, text=True, timeout=240
    )
    assert done.stdout.strip() == "True", done.stderr
