"""Functions of one coordinate in OpenSim's files, as piecewise polynomials."""

from collections.abc import Sequence
from typing import NamedTuple
from xml.etree.ElementTree import Element

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.interpolate import PPoly, make_interp_spline

from ...body.coordinates.piecewise_polynomial import PiecewisePolynomials, evaluate_polynomials
from ...errors import InputError
from ..text import parse_floats

#: knot behind the last one of a function, finite in single precision
LAST_KNOT = float(np.finfo(np.float32).max)
#: names of OpenSim's functions that are read
READ = (
    "Constant",
    "LinearFunction",
    "PolynomialFunction",
    "PiecewiseLinearFunction",
    "SimmSpline",
    "NaturalCubicSpline",
    "MultiplierFunction",
)


class Piecewise(NamedTuple):
    """One piecewise polynomial: K knots, and K + 1 pieces with their origins."""

    knots: Float[np.ndarray, "K"]
    origins: Float[np.ndarray, "P"]
    #: lowest order first
    coefficients: Float[np.ndarray, "P C"]
    #: true for a `LinearFunction`
    is_line: bool = False


def constant(value: float) -> Piecewise:
    """Make a constant function."""
    return Piecewise(np.zeros(0), np.zeros(1), np.array([[value]]))


def has_unit_slope(function: Piecewise) -> bool:
    """Test if a function is a `LinearFunction` with the slope 1 or -1: only such coordinates are angles in OpenSim."""
    return function.is_line and bool(abs(function.coefficients[0, 1]) == 1.0)


def read_function(element: Element, where: str) -> Piecewise:
    """Read a function. Raises `InputError` for one of another kind; `where` begins the message."""
    kind = element.tag
    if kind == "Constant":
        return constant(numbers(element, "value", where, 1)[0])
    if kind == "LinearFunction":
        slope, offset = numbers(element, "coefficients", where, 2)
        return _polynomial([offset, slope])._replace(is_line=True)
    if kind == "PolynomialFunction":
        return _polynomial(list(reversed(numbers(element, "coefficients", where))))
    if kind == "MultiplierFunction":
        inner = function_in(element.find("function"))
        if inner is None:
            raise InputError(f"{where}: a MultiplierFunction has no function; export the model again.")
        scale = numbers(element, "scale", where, 1)[0] if element.find("scale") is not None else 1.0
        function = read_function(inner, where)
        return function._replace(coefficients=scale * function.coefficients, is_line=False)
    if kind in ("PiecewiseLinearFunction", "SimmSpline", "NaturalCubicSpline"):
        return _spline(element, where)
    raise InputError(
        f"{where}: the function {kind} of a coordinate is not supported; expected one of {', '.join(READ)}."
    )


def function_in(holder: Element | None) -> Element | None:
    """Find the function in an element that holds one; None if there is none."""
    return None if holder is None else next((child for child in holder if child.tag[0].isupper()), None)


def pack_functions(functions: Sequence[Piecewise], shape: tuple[int, ...]) -> PiecewisePolynomials:
    """Pack functions into arrays of the given leading shape, padded with knots beyond all numbers."""
    most = max(1, *(len(function.knots) for function in functions))
    width = max(function.coefficients.shape[1] for function in functions)
    knots = np.full((len(functions), most), LAST_KNOT)
    origins = np.zeros((len(functions), most + 1))
    coefficients = np.zeros((len(functions), most + 1, width))
    for number, function in enumerate(functions):
        knots[number, : len(function.knots)] = function.knots
        origins[number, : len(function.origins)] = function.origins
        pieces, terms = function.coefficients.shape
        coefficients[number, :pieces, :terms] = function.coefficients
    return PiecewisePolynomials(
        jnp.asarray(knots.reshape(*shape, most)),
        jnp.asarray(origins.reshape(*shape, most + 1)),
        jnp.asarray(coefficients.reshape(*shape, most + 1, width)),
    )


def value_at(function: Piecewise, x: float) -> float:
    """Evaluate a function."""
    return float(evaluate_polynomials(pack_functions([function], ()), jnp.asarray(x)))


def numbers(element: Element, name: str, where: str, count: int | None = None) -> list[float]:
    """Read the numbers in a child element. Raises `InputError` if it is missing or has another count."""
    words = (element.findtext(name) or "").split()
    found = parse_floats(words, where, f"<{name}>")
    if not found or count not in (None, len(found)):
        raise InputError(
            f"{where}: <{name}> has {len(found)} numbers; expected {count or 'some'}; export the model again."
        )
    return found


def _polynomial(lowest_first: list[float]) -> Piecewise:
    return Piecewise(np.zeros(0), np.zeros(1), np.array([lowest_first]))


def _spline(element: Element, where: str) -> Piecewise:
    """Read a spline through points; beyond its ends it goes on with the slope there.

    The third derivatives at the ends are those of cubics through the first and the last four points (Forsythe et al. 1977).
    """
    x, y = (np.array(numbers(element, name, where)) for name in "xy")
    if len(x) != len(y) or not (np.diff(x) > 0).all():
        raise InputError(
            f"{where}: a spline has {len(x)} and {len(y)} coordinates of points; expected as many x as y, with x ascending."
        )
    if len(x) == 1:
        return constant(y[0])
    if element.tag == "PiecewiseLinearFunction" or len(x) == 2:
        inner = np.column_stack([y[:-1], np.diff(y) / np.diff(x)])
        inner = np.pad(inner, ((0, 0), (0, 2)))
    else:
        ends = [0.0, 0.0] if len(x) == 3 else [_third_derivative(x[at], y[at]) for at in _ENDS]
        spline = make_interp_spline(x, y, k=3, bc_type=([(3, ends[0])], [(3, ends[1])]))
        pieces = PPoly.from_spline(spline)
        inner = pieces.c[::-1, np.searchsorted(pieces.x, x[:-1], "right") - 1].T
    step = x[-1] - x[-2]
    last = inner[-1] @ np.array([[1, 0], [step, 1], [step**2, 2 * step], [step**3, 3 * step**2]])
    first = [inner[0, 0], inner[0, 1], 0.0, 0.0]
    return Piecewise(
        x,
        np.concatenate([x[:1], x]),
        np.concatenate([[first], inner, [[*last, 0.0, 0.0]]]),
    )


#: the four points at each end of a spline
_ENDS = (slice(0, 4), slice(-4, None))


def _third_derivative(x: Float[np.ndarray, "4"], y: Float[np.ndarray, "4"]) -> float:
    """Compute the third derivative of the cubic through four points: six times their divided difference."""
    for order in range(1, 4):
        y = np.diff(y) / (x[order:] - x[:-order])
    return 6.0 * float(y[0])
