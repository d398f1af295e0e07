"""Computation in float64, independent of the precision of the surrounding program."""

from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

Result = TypeVar("Result")


def in_float64(function: Callable[..., Result], *arguments: Any) -> Result:
    """Call a function in float64 and cast its result back to the precision of its arguments. If all of these are arrays of NumPy
    in float64, so are those of the result.

    Information of many frames on shared unknowns is a difference of large numbers, which needs float64. Works
    inside and outside of `jit` and other transformations, with or without `jax_enable_x64`.
    """
    arrays = [leaf for leaf in jax.tree.leaves(arguments) if eqx.is_inexact_array(leaf)]
    host = bool(arrays) and all(isinstance(leaf, np.ndarray) and leaf.dtype == np.float64 for leaf in arrays)
    dtype = jnp.result_type(*arrays) if arrays else jnp.result_type(float)
    small = not jax.config.jax_enable_x64  # pyright: ignore[reportAttributeAccessIssue]
    with jax.enable_x64(True):
        found = function(*jax.tree.map(lambda leaf: _cast(leaf, jnp.float64), arguments))
        if host:
            return jax.tree.map(lambda leaf: np.asarray(leaf) if eqx.is_array(leaf) else leaf, found)
        return jax.tree.map(lambda leaf: _cast(leaf, dtype, small), found)


def _cast(leaf: Any, dtype: Any, small: bool = False) -> Any:
    if eqx.is_inexact_array(leaf):
        # on the host where it can be, as casting in JAX compiles for every shape
        return jnp.asarray(leaf if isinstance(leaf, Tracer) else np.asarray(leaf), dtype)
    if small and eqx.is_array(leaf) and leaf.dtype == jnp.int64:
        return leaf.astype(jnp.int32)
    return leaf
