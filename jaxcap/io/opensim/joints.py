"""Joints of OpenSim's models: the frames that they connect, and the axes about and along which they move."""

from collections.abc import Iterator
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
from jaxtyping import Float

from ...errors import InputError
from .frames import Frames, read_transform
from .functions import Piecewise, constant, function_in, numbers, read_function, value_at

X, Y, Z = np.eye(3)
#: axes of the coordinates of each kind of joint, in their order, as (rotates, axis): three rotations, then translations
MOVES: dict[str, tuple[tuple[bool, Float[np.ndarray, "3"]], ...]] = {
    "WeldJoint": (),
    "PinJoint": ((True, Z),),
    "SliderJoint": ((False, X),),
    "UniversalJoint": ((True, X), (True, Y)),
    "GimbalJoint": ((True, X), (True, Y), (True, Z)),
    "BallJoint": ((True, X), (True, Y), (True, Z)),
    "PlanarJoint": ((True, Z), (False, X), (False, Y)),
    "FreeJoint": ((True, X), (True, Y), (True, Z), (False, X), (False, Y), (False, Z)),
}
#: the joint that names its own axes
CUSTOM = "CustomJoint"


class Amount(NamedTuple):
    """An amount of rotation or translation, a function of one coordinate."""

    axis: Float[np.ndarray, "3"]
    function: Piecewise
    #: name of the coordinate; None for a constant
    driver: str | None


class Joint(NamedTuple):
    """A joint between two bodies."""

    name: str
    parent: str
    child: str
    #: frames of the joint in the parent and in the child, 4 x 4
    in_parent: Float[np.ndarray, "4 4"]
    in_child: Float[np.ndarray, "4 4"]
    coordinates: tuple[Element, ...]
    #: three rotations, then three translations
    amounts: tuple[Amount, ...]


def read_joints(root: Element, frames: Frames, where: str) -> list[Joint]:
    """Read all joints of a model, of OpenSim 4, or of OpenSim 3, where joints are parts of bodies."""
    holder = root.find("Model/JointSet")
    path = "/jointset" if holder is None else f"/{holder.get('name') or 'jointset'}"
    joints = []
    for element in root.iterfind("Model/JointSet/objects/*"):
        own, at = f"{path}/{element.get('name', '')}", f"joint '{element.get('name', '')}'"
        sockets = [element.findtext(f"socket_{end}_frame") for end in ("parent", "child")]
        if not all(sockets):
            raise InputError(f"{where}: {at} names no bodies; open the model in OpenSim 4 and save it.")
        parent, child = (frames.find(socket or "", own, at) for socket in sockets)
        joints.append(_make_joint(element, parent, child, f"{where}: {at}"))
    for body in root.iterfind("Model/BodySet/objects/Body"):
        for element in body.iterfind("Joint/*"):
            at = f"joint '{element.get('name', '')}'"
            named = frames.find(element.findtext("parent_body") or "", "/", at)[0]
            in_parent = read_transform(
                element, "location_in_parent", "orientation_in_parent", f"{where}: {at}"
            )
            in_child = read_transform(element, "location", "orientation", f"{where}: {at}")
            child = body.get("name", ""), in_child
            joints.append(_make_joint(element, (named, in_parent), child, f"{where}: {at}"))
    return joints


def _make_joint(
    element: Element,
    parent: tuple[str, Float[np.ndarray, "4 4"]],
    child: tuple[str, Float[np.ndarray, "4 4"]],
    where: str,
) -> Joint:
    if (element.findtext("reverse") or "").strip().lower() == "true":
        raise InputError(
            f"{where} is reversed, which is not supported; open the model in OpenSim 4 and save it."
        )
    coordinates = (*element.iterfind("coordinates/Coordinate"), *element.iterfind("CoordinateSet/objects/Coordinate"))  # fmt: skip
    amounts = tuple(_read_amounts(element, coordinates, where))
    return Joint(element.get("name", ""), parent[0], child[0], parent[1], child[1], coordinates, amounts)


def _read_amounts(element: Element, coordinates: tuple[Element, ...], where: str) -> Iterator[Amount]:
    if element.tag == CUSTOM:
        axes = list(element.iterfind("SpatialTransform/TransformAxis"))
        by_name = {axis.get("name", ""): axis for axis in axes}
        for name in (f"{kind}{number}" for kind in ("rotation", "translation") for number in (1, 2, 3)):
            if name not in by_name:
                raise InputError(f"{where}: the SpatialTransform has no '{name}'; export the model again.")
            yield _read_axis(by_name[name], f"{where}, {name}")
        return
    if element.tag not in MOVES:
        raise InputError(
            f"{where} has the type {element.tag}, which is not supported; expected one of {', '.join((*MOVES, CUSTOM))}."
        )
    moves = MOVES[element.tag]
    if len(coordinates) != len(moves):
        raise InputError(
            f"{where} is a {element.tag} with {len(coordinates)} coordinates; expected {len(moves)}."
        )
    named = [(turns, axis, each.get("name")) for (turns, axis), each in zip(moves, coordinates, strict=True)]
    identity = Piecewise(np.zeros(0), np.zeros(1), np.array([[0.0, 1.0]]), is_line=True)
    for turns in (True, False):
        given = [Amount(axis, identity, name) for rotates, axis, name in named if rotates == turns]
        yield from given
        yield from [Amount(X, constant(0.0), None)] * (3 - len(given))


def _read_axis(element: Element, where: str) -> Amount:
    axis = np.array(numbers(element, "axis", where, 3))
    length = float(np.linalg.norm(axis))
    if not length > 0:
        raise InputError(f"{where}: the axis is zero; expected a direction.")
    drivers = (element.findtext("coordinates") or "").split()
    if len(drivers) > 1:
        raise InputError(
            f"{where} depends on {len(drivers)} coordinates, {', '.join(drivers)}; expected one; functions of several "
            "coordinates are not supported."
        )
    stated = function_in(element.find("function"))
    stated = function_in(element) if stated is None else stated
    function = constant(0.0) if stated is None else read_function(stated, where)
    if not drivers:
        # nothing changes it
        return Amount(axis / length, constant(value_at(function, 0.0)), None)
    return Amount(axis / length, function, drivers[0])
