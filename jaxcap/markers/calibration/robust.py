"""How much a marker counts that is further off than its deviation explains.

A swapped label is decimetres off, skin a centimetre, noise a millimetre. Up to `BOUND` deviations a
residual counts in full, so that of clean data nothing is lost; beyond, its pull falls with its cube.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

#: squared residual over variance up to which three numbers count in full: 99.5 % of what is normal
BOUND = 12.8
#: median of the squared length of three standard normal numbers
MEDIAN = 2.366
#: a bound that nothing reaches: least squares
UNBOUNDED = 1e12


def kernel(
    squared: Float[Array, "*shape"], bound: float | Float[Array, ""] = BOUND
) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
    """The cost of squared residuals over their variance, and its slope, the weight: `u` up to the bound
    `k`, `2 k - k^2 / u` beyond, which is smooth and bounded by `2 k`."""
    share = bound / jnp.maximum(squared, bound)
    return jnp.where(squared > bound, bound * (2.0 - share), squared), share**2


def spread(squared: Float[Array, "M"], seen: Bool[Array, "M"]) -> Float[Array, ""]:
    """The variance of residuals over what is expected of them, by the median, so that nearly half of
    them may be anything; at least one."""
    count = jnp.sum(seen)
    ordered = jnp.sort(jnp.where(seen, squared, jnp.inf))
    low, high = ordered[jnp.maximum((count - 1) // 2, 0)], ordered[jnp.maximum(count // 2, 0) % len(ordered)]
    middle = jnp.where(count > 0, 0.5 * (low + high), 0.0)
    return jnp.maximum(jnp.where(jnp.isfinite(middle), middle, 0.0) / MEDIAN, 1.0)
