"""Coordinates of OpenSim's models: their ranges, default values and locks, and those that follow others."""

from collections.abc import Sequence
from xml.etree.ElementTree import Element

import jax.numpy as jnp
import numpy as np

from ...body.coordinates.coordinate_model import Coordinate
from ...body.coordinates.piecewise_polynomial import PiecewisePolynomials, evaluate_polynomials
from ...errors import InputError
from .functions import (
    Piecewise,
    constant,
    function_in,
    has_unit_slope,
    numbers,
    pack_functions,
    read_function,
)
from .joints import Joint

#: constraint that makes a coordinate a function of another one
COUPLER = "CoordinateCouplerConstraint"


def read_model_coordinates(
    root: Element, joints: Sequence[Joint], where: str
) -> tuple[tuple[Coordinate, ...], PiecewisePolynomials]:
    """Read the coordinates of all joints, and the functions of those that follow others.

    The default value of a coordinate that follows another one is that of its function.

    **Raises:** `InputError` if names repeat, or a constraint is not supported.
    """
    elements = [element for joint in joints for element in joint.coordinates]
    names = [element.get("name", "") for element in elements]
    if len(set(names)) < len(names):
        raise InputError(f"{where}: two coordinates have the same name; give each its own.")
    couplers = _read_couplers(root, names, where)
    leaders = [leader for leader, _ in couplers] or [-1]
    followers = pack_functions([function for _, function in couplers] or [constant(0.0)], (len(leaders),))
    stated = [_read_coordinate(element, where) for element in elements]
    defaults = np.array([coordinate.default for coordinate in stated] or [0.0])
    followed = np.asarray(evaluate_polynomials(followers, jnp.asarray(defaults[leaders])), float)
    turning = {
        amount.driver for joint in joints for amount in joint.amounts[:3] if has_unit_slope(amount.function)
    }
    coordinates = (
        coordinate._replace(
            is_angle=coordinate.name in turning,
            default=coordinate.default if leader < 0 else float(value),
            leader=leader,
            is_periodic=number not in leaders and _is_periodic(coordinate.name, joints),
        )
        for number, (coordinate, leader, value) in enumerate(zip(stated, leaders, followed, strict=False))
    )
    return tuple(coordinates), followers


def _read_coordinate(element: Element, where: str) -> Coordinate:
    name = element.get("name", "")
    where = f"{where}: coordinate '{name}'"
    low, high = (
        numbers(element, "range", where, 2) if element.find("range") is not None else (-np.inf, np.inf)
    )
    default = (
        numbers(element, "default_value", where, 1)[0] if element.find("default_value") is not None else 0.0
    )
    return Coordinate(
        name,
        True,
        default,
        low,
        high,
        is_clamped=_is_true(element, "clamped"),
        is_locked=_is_true(element, "locked"),
    )


def _is_periodic(name: str, joints: Sequence[Joint]) -> bool:
    """Test that a coordinate only turns joints, so that a whole turn more is the same pose."""
    return all(
        number < 3 and has_unit_slope(amount.function)
        for joint in joints
        for number, amount in enumerate(joint.amounts)
        if amount.driver == name
    )


def _is_true(element: Element, name: str) -> bool:
    return (element.findtext(name) or "").strip().lower() == "true"


def _read_couplers(root: Element, names: list[str], where: str) -> list[tuple[int, Piecewise]]:
    """Read for each coordinate the one that determines it, and the function; other constraints are refused."""
    couplers = [(-1, constant(0.0))] * len(names)
    for element in root.iterfind(".//ConstraintSet/objects/*"):
        if _is_true(element, "isDisabled") or (element.findtext("isEnforced") or "true").strip() == "false":
            continue
        at = f"{where}: constraint '{element.get('name', '')}'"
        leaders = (element.findtext("independent_coordinate_names") or "").split()
        stated = function_in(element.find("coupled_coordinates_function"))
        if element.tag != COUPLER or len(leaders) != 1 or stated is None:
            raise InputError(
                f"{at} is a {element.tag} of {len(leaders)} coordinates, which is not supported; expected a {COUPLER} of one "
                "coordinate; disable it in OpenSim if it does not matter."
            )
        follower = (element.findtext("dependent_coordinate_name") or "").strip()
        unknown = [name for name in (leaders[0], follower) if name not in names]
        if unknown:
            raise InputError(f"{at} names the coordinate '{unknown[0]}', which does not exist.")
        function = read_function(stated, at)
        scale = (
            numbers(element, "scale_factor", at, 1)[0] if element.find("scale_factor") is not None else 1.0
        )
        couplers[names.index(follower)] = (
            names.index(leaders[0]),
            function._replace(coefficients=scale * function.coefficients),
        )
    chained = [names[k] for k, (leader, _) in enumerate(couplers) if leader >= 0 and couplers[leader][0] >= 0]
    if chained:
        raise InputError(
            f"{where}: the coordinate '{chained[0]}' follows one that follows another; this is not supported."
        )
    return couplers
