"""Validation of numeric values of arguments of public functions, outside of inner loops.

Traced arrays pass, as their values are not known.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from .errors import InputError
from .units import BODY_SIZE, UNIT_NAMES, UNITS, units_within

#: largest width of a body or scene, metres
MAX_EXTENT = 50.0


def concrete_values(value: Any) -> np.ndarray | None:
    """Return the numbers of a value, or None where it is traced or has none."""
    if value is None or isinstance(value, Tracer):
        return None
    try:
        numbers = np.asarray(value)
        return numbers.astype(float) if numbers.dtype.kind in "biuf" else None
    except (TypeError, ValueError):
        return None


def check_values(where: str, condition: Callable[[np.ndarray], Any], expected: str, **given: Any) -> None:
    """Check that all numbers of some arguments, by their names, satisfy a condition; NaN never does.

    **Raises:** `InputError` with the argument, the first number that fails, and the expected values.
    """
    for name, value in given.items():
        numbers = concrete_values(value)
        if numbers is None:
            continue
        wrong = ~np.broadcast_to(condition(numbers), numbers.shape)
        if wrong.any():
            verb = "has" if numbers.ndim else "is"
            raise InputError(f"{where}: `{name}` {verb} {numbers[wrong][0]:g}; expected {expected}.")


def check_positive(where: str, unit: str = "", **given: Any) -> None:
    """Check that numbers are finite and above zero, with a `unit` for the message. Raises `InputError`."""
    check_values(
        where, lambda x: (x > 0) & (x < np.inf), f"a finite number above 0{_unit_suffix(unit)}", **given
    )


def check_at_least(where: str, minimum: float | int, **given: Any) -> None:
    """Check that numbers are finite and at least `minimum`. Raises `InputError`."""
    check_values(
        where, lambda x: (x >= minimum) & (x < np.inf), f"a finite number of at least {minimum:g}", **given
    )


def check_within(where: str, low: float | int, high: float | int, unit: str = "", **given: Any) -> None:
    """Check that numbers are from `low` to `high`. Raises `InputError`."""
    check_values(
        where,
        lambda x: (x >= low) & (x <= high),
        f"a number from {low:g} to {high:g}{_unit_suffix(unit)}",
        **given,
    )


def check_deviations(where: str, **given: Any) -> None:
    """Check that standard deviations are above zero; an infinite one leaves its parameter free. Raises
    `InputError`."""
    expected = "a standard deviation above 0, infinite for a free parameter"
    check_values(where, lambda x: x > 0, expected, **given)


def check_direction(where: str, **given: Any) -> None:
    """Check that vectors have a direction: three finite numbers, not all zero. Raises `InputError`."""
    for name, value in given.items():
        numbers = concrete_values(value)
        if numbers is None:
            continue
        length = np.linalg.norm(numbers) if numbers.shape == (3,) else 0.0
        if not 0 < length < np.inf:
            raise InputError(
                f"{where}: `{name}` is {numbers.tolist()}; expected a direction: three finite numbers, not "
                "all 0."
            )


def check_faces(where: str, faces: Any, num_vertices: int) -> None:
    """Check that triangles have only existing vertices. Raises `InputError`."""
    if not isinstance(faces, Tracer):
        corners = np.asarray(faces)
        wrong = (corners < 0) | (corners >= num_vertices)
        if wrong.any():
            raise InputError(
                f"{where}: `faces` has vertex {corners[wrong][0]}, but there are {num_vertices} vertices; "
                f"expected indices from 0 to {num_vertices - 1}."
            )


def as_number(value: Any) -> Float[Array, ""]:
    """Convert a number, also an integer, to a floating-point array; an array keeps its precision."""
    return jnp.asarray(value, jnp.result_type(value, float))


def _unit_suffix(unit: str) -> str:
    return f" {unit}" if unit else ""


def check_rate(where: str, rate: Any) -> None:
    """Check that a rate is a positive number of frames per second. Raises `InputError`."""
    if isinstance(rate, (int, float)) and not 0 < rate < float("inf"):
        raise InputError(f"{where}: `rate` is {rate}; expected a number of frames per second above 0.")


def check_metres(where: str, name: str, points: np.ndarray) -> None:
    """Check that points of one body or scene are in metres: at most 50 m wide, without the outer 5 % at
    each end.

    **Raises:** `InputError` with the likely unit, or with two where the width fits both.
    """
    if len(points) == 0:
        return
    extent = float(np.ptp(np.quantile(points, [0.05, 0.95], axis=0), axis=0).max())
    if extent > MAX_EXTENT:
        likely = {UNIT_NAMES[unit]: f"{UNITS[unit]:g}" for unit in units_within(extent, *BODY_SIZE)}
        unit = (
            f"it looks like {' or '.join(likely)}: multiply by {' or '.join(likely.values())}, or give the "
            "unit when reading the file"
            if likely
            else "check the unit"
        )
        raise InputError(
            f"{where}: `{name}` is {extent:.4g} wide; expected metres, at most {MAX_EXTENT:g}; {unit}."
        )
