"""Arrays that are made and stacked on the host, where JAX would compile a function for each shape."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array


def device_array(values, dtype=None) -> Array:
    """Make an array of known numbers; `jnp.asarray` and `jnp.zeros` compile a function for each shape first."""
    # a copy, as the device may share the memory of an array
    return jax.device_put(np.array(values, dtype))


def stack(arrays: Sequence[Array | np.ndarray]) -> Array:
    """Stack arrays along a new first axis, differentiably.

    `jnp.stack` compiles for every number of arrays, and takes minutes for some thousands. So it is called
    only with traced arrays.
    """
    return jnp.stack(arrays) if _traced(arrays) else jax.device_put(np.stack(arrays))


def concatenate(arrays: Sequence[Array | np.ndarray]) -> Array:
    """Concatenate arrays along their first axis, differentiably; as `stack`."""
    return jnp.concatenate(arrays) if _traced(arrays) else jax.device_put(np.concatenate(arrays))


def stack_trees(trees: Sequence):
    """Stack trees of arrays, such as the poses of single frames, leaf by leaf."""
    return jax.tree.map(lambda *leaves: stack(leaves), *trees)


def concatenate_trees(trees: Sequence):
    """Concatenate trees of arrays, such as stacks of poses, leaf by leaf."""
    return jax.tree.map(lambda *leaves: concatenate(leaves), *trees)


def take_rows(stacked, rows: Sequence[int] | slice | np.ndarray):
    """Select rows of a tree of stacked arrays by concrete indices, differentiably.

    Without traced arrays this copies on the host, as indexing in JAX compiles for every shape.
    """
    rows = rows if isinstance(rows, (slice, np.ndarray)) else np.array(rows, int)
    return jax.tree.map(
        lambda leaf: leaf[rows] if _traced([leaf]) else device_array(np.asarray(leaf)[rows]), stacked
    )


def put_rows(stacked, rows: np.ndarray, values):
    """Replace rows of a tree of stacked, known arrays by those of another, on the host as `take_rows`."""

    def put(leaf, new):
        whole = np.array(leaf)
        whole[rows] = new
        return device_array(whole)

    return jax.tree.map(put, stacked, values)


def unstack_trees(stacked, count: int) -> list:
    """Split a tree of stacked arrays into `count` trees."""
    return [jax.tree.map(lambda leaf, i=i: leaf[i], stacked) for i in range(count)]


def _traced(arrays: Sequence[Array | np.ndarray]) -> bool:
    return any(isinstance(array, Tracer) for array in arrays)
