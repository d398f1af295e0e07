"""A robust kernel for marker outliers.

A swapped label causes an error of decimetres, skin of a centimetre, noise of a millimetre. Up to `OUTLIER_BOUND`
squared deviations a residual has full weight, so that clean data lose nothing; beyond, its influence falls
with its cube.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

#: squared residual over variance up to which a 3D residual has full weight: the 99.5 % quantile if normal
OUTLIER_BOUND = 12.8
#: median of the squared length of three standard normal numbers
MEDIAN_SQUARED_LENGTH = 2.366
#: a bound that no residual reaches: least squares
UNBOUNDED = 1e12


def robust_kernel(
    squared: Float[Array, "*shape"], bound: float | Float[Array, ""] = OUTLIER_BOUND
) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
    """Compute the robust cost of squared residuals over their variance, and its slope, the weight.

    The cost is `u` up to the bound `k` and `2 k - k^2 / u` beyond, which is smooth and bounded by `2 k`.
    """
    share = bound / jnp.maximum(squared, bound)
    return jnp.where(squared > bound, bound * (2.0 - share), squared), share**2


def variance_ratio(squared: Float[Array, "M"], seen: Bool[Array, "M"]) -> Float[Array, ""]:
    """Estimate the ratio of the residuals' variance to the expected one, by the median; at least one.

    Nearly half of the residuals may be outliers.
    """
    count = jnp.sum(seen)
    ordered = jnp.sort(jnp.where(seen, squared, jnp.inf))
    low, high = ordered[jnp.maximum((count - 1) // 2, 0)], ordered[jnp.maximum(count // 2, 0) % len(ordered)]
    middle = jnp.where(count > 0, 0.5 * (low + high), 0.0)
    return jnp.maximum(jnp.where(jnp.isfinite(middle), middle, 0.0) / MEDIAN_SQUARED_LENGTH, 1.0)
