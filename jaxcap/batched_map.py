"""A map over batches of equal size."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp


def map_batches(function: Callable[[Any], Any], items: Any, batch_size: int | None = None) -> Any:
    """Map a function over the first axis of a tree of arrays, in batches of at most `batch_size` items; None: one by one.

    `jax.lax.map(batch_size=)` computes the items that fill no batch in a second copy of the function after the loop. That compiles the
    function twice. If it has factorisations, both may run at the same time, and on a computer with two cores each then waits
    forever for a thread of the other: LAPACK calls of jaxlib wait within XLA's threads for further tasks on the same threads.
    Here the batches are of nearly equal sizes, and the last item is repeated to fill them.
    """
    count = len(jax.tree.leaves(items)[0])
    if not count or batch_size is None:
        return jax.lax.map(function, items)
    batches = -(-count // batch_size)
    size = -(-count // batches)

    def divide(leaf):
        filled = jnp.concatenate([leaf, jnp.repeat(leaf[-1:], batches * size - count, axis=0)])
        return filled.reshape(batches, size, *leaf.shape[1:])

    found = jax.lax.map(jax.vmap(function), jax.tree.map(divide, items))
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:])[:count], found)
