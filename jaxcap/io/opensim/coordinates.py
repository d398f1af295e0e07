"""Coordinates of OpenSim's models: their ranges, default values and locks, and those that follow others."""

from collections.abc import Sequence
from typing import NamedTuple
from xml.etree.ElementTree import Element

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...body.coordinates.coordinate_model import Coordinate
from ...body.coordinates.piecewise_polynomial import PiecewisePolynomials, evaluate_polynomials
from ...errors import InputError
from ..text import MAX_NUMBER
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

#: largest distance of a default value from its range, by rounding
RANGE_TOLERANCE = 1e-6
#: constraint that makes a coordinate a function of another one
COUPLER = "CoordinateCouplerConstraint"


class ModelCoordinates(NamedTuple):
    """The coordinates of a model, their values at rest and ranges, and the functions of those that follow others."""

    coordinates: tuple[Coordinate, ...]
    defaults: Float[np.ndarray, "Q"]
    low: Float[np.ndarray, "Q"]
    high: Float[np.ndarray, "Q"]
    followers: PiecewisePolynomials


class _Stated(NamedTuple):
    """A coordinate as its element states it."""

    coordinate: Coordinate
    default: float
    low: float
    high: float


def read_model_coordinates(root: Element, joints: Sequence[Joint], where: str) -> ModelCoordinates:
    """Read the coordinates of all joints, and the functions of those that follow others.

    The default value of a coordinate that follows another one is that of its function. A coordinate that is prescribed as a
    constant is locked there.

    **Raises:** `InputError` if there is none, names repeat, a default value is outside of its range, or a constraint or a
    prescribed function is not supported.
    """
    elements = [element for joint in joints for element in joint.coordinates]
    names = [element.get("name", "") for element in elements]
    if not names:
        raise InputError(f"{where}: the model has no coordinates, so that nothing moves; give another model.")
    if len(set(names)) < len(names):
        raise InputError(f"{where}: two coordinates have the same name; give each its own.")
    couplers = _read_couplers(root, names, where)
    leaders = [leader for leader, _ in couplers]
    followers = pack_functions([function for _, function in couplers], (len(names),))
    stated = [_read_coordinate(element, where) for element in elements]
    defaults = np.array([one.default for one in stated])
    followed = np.asarray(evaluate_polynomials(followers, jnp.asarray(defaults[leaders])), float)
    turning = {
        amount.driver for joint in joints for amount in joint.amounts[:3] if has_unit_slope(amount.function)
    }
    coordinates = tuple(
        one.coordinate._replace(
            is_angle=name in turning,
            leader=leader,
            is_periodic=number not in leaders and _is_periodic(name, joints),
        )
        for number, (name, one, leader) in enumerate(zip(names, stated, leaders, strict=True))
    )
    low, high = (np.array([getattr(one, end) for one in stated]) for end in ("low", "high"))
    defaults = np.where(np.array(leaders) < 0, defaults, followed)
    return ModelCoordinates(coordinates, defaults, low, high, followers)


def _read_coordinate(element: Element, where: str) -> _Stated:
    name = element.get("name", "")
    where = f"{where}: coordinate '{name}'"
    low, high = (
        numbers(element, "range", where, 2)
        if element.find("range") is not None
        else (-MAX_NUMBER, MAX_NUMBER)
    )
    default = (
        numbers(element, "default_value", where, 1)[0] if element.find("default_value") is not None else 0.0
    )
    is_locked, is_clamped = _is_true(element, "locked"), _is_true(element, "clamped")
    if _is_true(element, "prescribed"):
        function = function_in(element.find("prescribed_function"))
        if function is None or function.tag != "Constant":
            raise InputError(
                f"{where} is prescribed as a function of time, which is not supported; switch `prescribed` off, or lock it."
            )
        default, is_locked = numbers(function, "value", where, 1)[0], True
    if is_clamped and not low - RANGE_TOLERANCE <= default <= high + RANGE_TOLERANCE:
        raise InputError(
            f"{where} has the default value {default:g} outside of its range, {low:g} to {high:g}; correct one of them."
        )
    return _Stated(Coordinate(name, True, is_clamped, is_locked), default, low, high)


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
