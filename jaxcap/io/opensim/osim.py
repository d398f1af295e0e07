"""Models of OpenSim (`.osim`): bodies, joints with their coordinates, and markers."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ...arguments import checked
from ...body.coordinates.coordinate_model import CoordinateModel
from ...body.coordinates.piecewise_polynomial import evaluate_polynomials
from ...body.skeleton import Skeleton, make_skeleton
from ...errors import InputError
from ...markers.subject import Subject, make_subject
from ..system.reader_errors import reader_of
from .coordinates import read_model_coordinates
from .document import parse_document
from .frames import GROUND, Frames
from .functions import numbers, pack_functions
from .joints import Joint, read_joints

#: names of the unit of lengths
METRES = ("m", "meter", "meters", "metre", "metres")


class OsimModel(NamedTuple):
    """The parts of an OpenSim model that say how its markers move."""

    model: CoordinateModel
    #: the skeleton with the markers of the file; None if it has none
    markers: Subject | None


@checked
@reader_of("an OpenSim model")
def read_osim(path: str | Path) -> OsimModel:
    """Read bodies, joints, coordinates and markers of an OpenSim model, of version 3 or 4; muscles and meshes are left out.

    A joint of the skeleton has the name of the body that it moves. It is at rest where all coordinates have their default values,
    in the axes of the ground, metres.

    **Raises:** `InputError` if the file is no OpenSim model, or has joints, functions or constraints that are not supported.
    """
    root = parse_document(Path(path))
    if root.find("Model") is None:
        raise InputError(f"{path}: the file has no <Model>; give an OpenSim model.")
    where = str(path)
    unit = (root.findtext("Model/length_units") or "m").strip().lower()
    if unit not in METRES:
        raise InputError(
            f"{path}: the lengths of the model are in {unit}; expected meters; scale the model in OpenSim."
        )
    frames = Frames(root, where)
    joints = _sort_joints(read_joints(root, frames, where), where)
    read = read_model_coordinates(root, joints, where)
    names = [coordinate.name for coordinate in read.coordinates]
    drivers = tuple(tuple(_driver(amount.driver, names, where) for amount in joint.amounts) for joint in joints)  # fmt: skip
    amounts = pack_functions(
        [amount.function for joint in joints for amount in joint.amounts], (len(joints), 6)
    )
    driving = jnp.asarray(read.defaults[np.maximum(np.array(drivers), 0)])
    at_rest = np.asarray(evaluate_polynomials(amounts, driving), float)
    in_parents, in_world = _rest_frames(joints, at_rest)
    axes = np.array(
        [
            [frame[:3, :3] @ amount.axis for amount in joint.amounts]
            for joint, frame in zip(joints, in_parents, strict=True)
        ]
    )
    skeleton = _rest_skeleton(joints, axes, at_rest, in_world)
    model = CoordinateModel(
        skeleton=skeleton,
        axes=jnp.asarray(axes),
        amounts=amounts,
        followers=read.followers,
        defaults=jnp.asarray(read.defaults),
        low=jnp.asarray(read.low),
        high=jnp.asarray(read.high),
        coordinates=read.coordinates,
        drivers=drivers,
    )
    return OsimModel(model, _read_markers(root, frames, model, in_world, where))


def _sort_joints(joints: list[Joint], where: str) -> list[Joint]:
    """Sort joints so that parents come first, and check that they form a tree."""
    known, order, left = {GROUND}, [], list(joints)
    twice = [joint.child for joint in joints if sum(other.child == joint.child for other in joints) > 1]
    if twice:
        raise InputError(
            f"{where}: body '{twice[0]}' is moved by several joints; expected one joint for each body."
        )
    while left:
        ready = [joint for joint in left if joint.parent in known]
        if not ready:
            raise InputError(
                f"{where}: joint '{left[0].name}' has the parent '{left[0].parent}', which no chain of joints connects with the "
                "ground; export the model again."
            )
        order += ready
        known |= {joint.child for joint in ready}
        left = [joint for joint in left if joint.child not in known]
    if not order:
        raise InputError(f"{where}: the model has no joints; give a model with bodies that move.")
    return order


def _driver(name: str | None, names: Sequence[str], where: str) -> int:
    if name is None:
        return -1
    if name not in names:
        raise InputError(f"{where}: a joint depends on the coordinate '{name}', which does not exist.")
    return names.index(name)


def _rest_frames(
    joints: list[Joint], amounts: Float[np.ndarray, "J 6"]
) -> tuple[list[Float[np.ndarray, "4 4"]], dict[str, Float[np.ndarray, "4 4"]]]:
    """Compute the frame of each joint in its parent, in the world at rest, and the frames of the bodies."""
    in_world = {GROUND: np.eye(4)}
    frames = []
    for joint, own in zip(joints, amounts, strict=True):
        frame = in_world[joint.parent] @ joint.in_parent
        moved = np.eye(4)
        for amount, angle in zip(joint.amounts[:3], own[:3], strict=True):
            moved[:3, :3] = moved[:3, :3] @ Rotation.from_rotvec(angle * amount.axis).as_matrix()
        moved[:3, 3] = sum(length * amount.axis for amount, length in zip(joint.amounts[3:], own[3:], strict=True))  # fmt: skip
        frames.append(frame)
        in_world[joint.child] = frame @ moved @ _inverse(joint.in_child)
    return frames, in_world


def _rest_skeleton(
    joints: list[Joint],
    axes: Float[np.ndarray, "J 6 3"],
    at_rest: Float[np.ndarray, "J 6"],
    in_world: dict[str, Float[np.ndarray, "4 4"]],
) -> Skeleton:
    """Make the skeleton at rest, with the centre of each joint at its frame in the body that it moves."""
    kinds, first_axes = zip(
        *(_kind(joint, row, at) for joint, row, at in zip(joints, axes, at_rest, strict=True)), strict=True
    )
    bodies = [joint.child for joint in joints]
    return make_skeleton(
        bodies,
        [bodies.index(joint.parent) if joint.parent in bodies else -1 for joint in joints],
        kinds,
        np.array([(in_world[joint.child] @ joint.in_child)[:3, 3] for joint in joints]),
        axes=np.stack([first_axes, np.roll(first_axes, 1, 1)], 1),
    )


def _inverse(frame: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Invert a rigid transform."""
    turn = frame[:3, :3].T
    return np.block([[turn, -turn @ frame[:3, 3:]], [np.zeros((1, 3)), np.ones((1, 1))]])


def _kind(
    joint: Joint, axes: Float[np.ndarray, "6 3"], at_rest: Float[np.ndarray, "6"]
) -> tuple[str, Float[np.ndarray, "3"]]:
    """Find the kind of joint with the fewest degrees of freedom that makes all poses, and its first axis."""
    moving = [amount.driver is not None and bool(amount.function.coefficients[:, 1:].any()) for amount in joint.amounts]  # fmt: skip
    if any(moving[3:]):
        return "free" if any(moving[:3]) else "translate", np.array([1.0, 0, 0])
    turning = np.flatnonzero(moving[:3])
    if len(turning) != 1:
        return "ball" if len(turning) else "fixed", np.array([1.0, 0, 0])
    # constant rotations before the turning axis turn it
    axis = axes[turning[0]]
    for number in reversed(range(turning[0])):
        axis = Rotation.from_rotvec(at_rest[number] * axes[number]).apply(axis)
    return "revolute", axis


def _read_markers(
    root: Element,
    frames: Frames,
    model: CoordinateModel,
    in_world: dict[str, Float[np.ndarray, "4 4"]],
    where: str,
) -> Subject | None:
    labels, bones, offsets = [], [], []
    for element in root.iterfind(".//MarkerSet/objects/Marker"):
        label = element.get("name", "")
        at = f"{where}: marker '{label}'"
        path = element.findtext("socket_parent_frame") or element.findtext("body") or ""
        body, offset = frames.find(path, f"/markerset/{label}", f"marker '{label}'")
        if body == GROUND:
            # it does not move
            continue
        if body not in model.skeleton.names:
            raise InputError(f"{at} is on '{path.strip()}', which is no body of the model.")
        place = np.append(numbers(element, "location", at, 3), 1.0)
        labels.append(label)
        bones.append(model.skeleton.index(body))
        offsets.append((in_world[body] @ offset @ place)[:3])
    return make_subject(model.skeleton, bones, np.array(offsets), labels) if labels else None
