"""Piecewise polynomials of one variable: lines, polynomials and splines in one form."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...arguments import check_fields


class PiecewisePolynomials(eqx.Module):
    """N functions of one variable, each a polynomial between its knots.

    Piece `p` is `sum_i c_i (x - origin)^i` from knot `p - 1` to knot `p`; the first and the last piece have no outer end.
    Functions with fewer knots than K have ones behind them that no number reaches.
    """

    knots: Float[Array, "*N K"]
    origins: Float[Array, "*N P"]
    #: lowest order first
    coefficients: Float[Array, "*N P C"]

    def __check_init__(self):
        check_fields(self)


def evaluate_polynomials(functions: PiecewisePolynomials, x: Float[Array, "*N"]) -> Float[Array, "*N"]:
    """Evaluate each function at its own `x`."""
    piece = jnp.sum(x[..., None] >= functions.knots, -1)[..., None]
    step = x - jnp.take_along_axis(functions.origins, piece, -1)[..., 0]
    coefficients = jnp.take_along_axis(functions.coefficients, piece[..., None], -2)[..., 0, :]
    value = coefficients[..., -1]
    for order in reversed(range(coefficients.shape[-1] - 1)):
        value = coefficients[..., order] + step * value
    return value
