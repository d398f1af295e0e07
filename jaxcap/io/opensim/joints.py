"""Joints of OpenSim's models: the frames that they connect, and the axes about and along which they move."""

from collections.abc import Iterator
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ...errors import InputError
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
GROUND = "ground"


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


def read_joints(root: Element, where: str) -> list[Joint]:
    """Read all joints of a model, of OpenSim 4, or of OpenSim 3, where joints are parts of bodies."""
    joints = [_read_joint(element, where) for element in root.iterfind(".//JointSet/objects/*")]
    for body in root.iterfind(".//BodySet/objects/Body"):
        joints += [_read_joint(element, where, body) for element in body.iterfind("Joint/*")]
    return joints


def find_frame(
    path: str, frames: dict[str, tuple[str, Float[np.ndarray, "4 4"]]]
) -> tuple[str, Float[np.ndarray, "4 4"]]:
    """Find the body and the offset of a frame by the last name of its path; a body is its own frame."""
    name = path.strip().rstrip("/").rsplit("/", 1)[-1]
    return frames.get(name, (name, np.eye(4)))


def read_offset_frames(holder: Element, where: str) -> dict[str, tuple[str, Float[np.ndarray, "4 4"]]]:
    """Read the frames that are fixed to bodies: name -> (body, offset)."""
    frames: dict[str, tuple[str, Float[np.ndarray, "4 4"]]] = {}
    for element in holder.iter("PhysicalOffsetFrame"):
        offset = _transform(element, "translation", "orientation", where)
        body, under = find_frame(element.findtext("socket_parent") or "", frames)
        frames[element.get("name", "")] = body, under @ offset
    return frames


def _read_joint(element: Element, where: str, body: Element | None = None) -> Joint:
    name = element.get("name", "")
    where = f"{where}: joint '{name}'"
    if body is not None:
        parent, child = (element.findtext("parent_body") or "").strip(), body.get("name", "")
        in_parent = _transform(element, "location_in_parent", "orientation_in_parent", where)
        in_child = _transform(element, "location", "orientation", where)
    else:
        frames = read_offset_frames(element, where)
        parent, in_parent = find_frame(element.findtext("socket_parent_frame") or "", frames)
        child, in_child = find_frame(element.findtext("socket_child_frame") or "", frames)
    if not parent or not child:
        raise InputError(f"{where} names no bodies; open the model in OpenSim 4 and save it.")
    coordinates = (*element.iterfind("coordinates/Coordinate"), *element.iterfind("CoordinateSet/objects/Coordinate"))  # fmt: skip
    amounts = tuple(_read_amounts(element, coordinates, where))
    return Joint(name, parent, child, in_parent, in_child, coordinates, amounts)


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
            f"{where} is a {element.tag}, which is not supported; expected one of {', '.join((*MOVES, CUSTOM))}."
        )
    moves = MOVES[element.tag]
    if len(coordinates) != len(moves):
        raise InputError(
            f"{where} is a {element.tag} with {len(coordinates)} coordinates; expected {len(moves)}."
        )
    named = [(turns, axis, each.get("name")) for (turns, axis), each in zip(moves, coordinates, strict=True)]
    identity = Piecewise(np.zeros(0), np.zeros(1), np.array([[0.0, 1.0]]))
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


def _transform(element: Element, place: str, turn: str, where: str) -> Float[np.ndarray, "4 4"]:
    """Read a rigid transform: a translation, and angles about the x, y and z axes of the body."""
    matrix = np.eye(4)
    if element.find(place) is not None:
        matrix[:3, 3] = numbers(element, place, where, 3)
    if element.find(turn) is not None:
        matrix[:3, :3] = Rotation.from_euler("XYZ", numbers(element, turn, where, 3)).as_matrix()
    return matrix
