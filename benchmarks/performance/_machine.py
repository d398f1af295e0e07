"""Limits of the machine: memory bandwidth and floating-point operations per second."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from benchmarks.report import median_seconds

#: megabytes that are copied, beyond every cache; rows of the matrices that are multiplied
COPIED, ROWS = 256, 2048


class Machine(NamedTuple):
    """The limits of the device, measured."""

    #: read and written, bytes a second
    bandwidth: float
    #: of products of float32 matrices, operations a second
    flops: float


@jax.jit
def _copy(x):
    return x + 1.0


@jax.jit
def _multiply(a, b):
    return a @ b


def measure_machine(repeats: int = 5) -> Machine:
    """Measure the memory bandwidth and the speed of products of matrices, in float32."""
    x = jnp.zeros(COPIED * 2**20 // 4, jnp.float32)
    a = jnp.ones((ROWS, ROWS), jnp.float32)
    copied, _ = median_seconds(_copy, x, repeats=repeats)
    multiplied, _ = median_seconds(_multiply, a, a, repeats=repeats)
    return Machine(2 * x.nbytes / copied, 2 * ROWS**3 / multiplied)
