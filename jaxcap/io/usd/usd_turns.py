"""Checks of the quaternions of USD prims: OpenUSD reads a zero quaternion as the identity."""

# pxr fills its modules as it is imported and has no stubs
# pyright: reportAttributeAccessIssue=false

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from ...errors import InputError
from ..archives.npz import MIN_QUATERNION_NORM
from ..text import shortened

if TYPE_CHECKING:
    from pxr import Usd

_QUATERNION_TYPES = ("quath", "quatf", "quatd")


def check_quaternions(path: Path, prim: "Usd.Prim") -> None:
    """Check that no quaternion of a prim or its ancestors is zero, at any time sample.

    **Raises:** `InputError` with the prim, its attribute, the time and the joint.
    """
    while prim and not prim.IsPseudoRoot():
        for attribute in prim.GetAttributes():
            if str(attribute.GetTypeName()).removesuffix("[]") in _QUATERNION_TYPES:
                _check(path, prim, attribute)
        prim = prim.GetParent()


def _check(path: Path, prim: "Usd.Prim", attribute: Any) -> None:
    for time in attribute.GetTimeSamples() or (None,):
        turns = _numbers(attribute.Get() if time is None else attribute.Get(time))
        # numbers that are not finite are reported for the transforms that are computed from them
        with np.errstate(over="ignore"):
            short = np.linalg.norm(turns, axis=1) <= MIN_QUATERNION_NORM
        if short.any():
            row = int(short.argmax())
            when = "" if time is None else f" at time {time:g}"
            raise InputError(
                f"{path}: '{shortened(str(attribute.GetPath()))}' has a zero quaternion{when}"
                f"{_describe_row(prim, row, len(turns))}; write a unit quaternion."
            )


def _numbers(value: Any) -> Float[np.ndarray, "N 4"]:
    """Convert one quaternion or several to rows of numbers."""
    if value is None:
        return np.zeros((0, 4))
    if hasattr(value, "GetReal"):
        return np.array([[*value.GetImaginary(), value.GetReal()]], float)
    return np.array(value, float).reshape(-1, 4)


def _describe_row(prim: "Usd.Prim", row: int, count: int) -> str:
    """Describe the joint of a prim's quaternion, or its row if there are several."""
    joints = prim.GetAttribute("joints").Get() or ()
    if len(joints) == count:
        return f", of joint '{shortened(str(joints[row]))}'"
    return f", in row {row}" if count > 1 else ""
