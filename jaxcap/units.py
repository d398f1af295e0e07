"""Units of length: their sizes and names, and the units in which a length is plausible."""

import math

from .errors import InputError

#: metres in one unit
UNITS: dict[str, float] = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
UNIT_NAMES: dict[str, str] = {
    "m": "metres",
    "dm": "decimetres",
    "cm": "centimetres",
    "mm": "millimetres",
    "in": "inches",
    "ft": "feet",
}
#: bounds of the longest side of a body, and its usual value, metres
BODY_SIZE, USUAL_SIZE = (0.3, 3.0), 1.7


def unit_scale(unit: str | float) -> float:
    """Return the metres in one `unit`: a key of `UNITS`, or that number itself, also as text.

    **Raises:** `InputError` for any other value.
    """
    if unit in UNITS:
        return UNITS[str(unit)]
    try:
        unit = float(unit)
    except (TypeError, ValueError):
        raise InputError(
            f"'{unit}' is not a unit of length; give one of {', '.join(UNITS)}, or the metres in one unit, such as 0.0564."
        ) from None
    if not (math.isfinite(unit) and unit > 0):
        raise InputError(f"{unit} metres is not a unit of length; give a number above zero.")
    return float(unit)


def units_within(length: float, low: float, high: float) -> list[str]:
    """List the units in which a `length` lies between `low` and `high`, metres, in the order of `UNITS`."""
    return [unit for unit, metres in UNITS.items() if low <= length * metres <= high]


def likely_units(length: float, low: float, high: float) -> list[str]:
    """List the units in which a `length` lies between `low` and `high`, metres, the likeliest first.

    In the likeliest unit, the length is nearest to that of a body, `USUAL_SIZE`.
    """
    return sorted(
        units_within(length, low, high), key=lambda unit: abs(math.log(length * UNITS[unit] / USUAL_SIZE))
    )
