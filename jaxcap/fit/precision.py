"""Conversion of all arrays of a problem to the same precision."""

from typing import Any

import equinox as eqx
import jax


def with_precision(tree: Any, dtype: Any) -> Any:
    """Convert the real arrays of a tree to one precision, because data may have another one than the body."""
    return jax.tree.map(lambda leaf: leaf.astype(dtype) if eqx.is_inexact_array(leaf) else leaf, tree)
