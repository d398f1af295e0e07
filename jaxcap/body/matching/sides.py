"""Find the left and right limbs of a person, and check that names and positions agree."""

from collections.abc import Collection

import numpy as np
from jaxtyping import Float

from .names import Side
from .person_joints import LIMB_PARTS, PersonJoints

#: least forward component of the toes, relative to their lengths, that determines the sides
MIN_TOE_DIRECTION = 0.3


class UnknownSides(ValueError):
    """An error: left and right cannot be determined, or, if `swapped`, names and positions contradict each
    other."""

    def __init__(self, message: str, swapped: bool = False):
        super().__init__(message)
        self.swapped = swapped


def resolve_sides(
    person: PersonJoints,
    positions: Float[np.ndarray, "J 3"],
    up: Float[np.ndarray, "3"],
    known_sides: Collection[str] = (),
) -> PersonJoints:
    """Determine left and right of limbs without sides in their names.

    The joint positions are those of a pose that stands along `up`. Limbs with sides determine the others;
    without any, the toes do, which point forward.

    **Arguments:** `known_sides` are types of limbs whose sides are given by the user: toes do not count against
    these.

    **Raises:** `UnknownSides` if neither determines the sides, the toes contradict the names, or legs and
    arms contradict each other.
    """
    across = _lateral_steps(person, positions, up)
    if len(across) == 2 and across["leg"] @ across["arm"] < 0:
        raise UnknownSides(
            "By the joint names or the table of names, the left leg is on the side of the right arm; left and right "
            "of the legs or of the arms are swapped; correct the table, or give one."
        )
    forward = _toe_direction(person, positions, up)
    named = sum((step for kind, step in across.items() if kind not in known_sides), np.zeros(3))
    if forward is not None and named.any() and np.cross(up, forward) @ named < 0:
        raise UnknownSides(
            "The joint names and the toes disagree on left and right; the names are swapped, or the file is mirrored; "
            "give a table of names.",
            swapped=True,
        )
    if not person.sideless:
        return person
    left = sum(across.values(), np.zeros(3))
    if not left.any():
        if forward is None:
            raise UnknownSides(
                "No joint name states left or right, and no toes determine the front; give a table of names, in which "
                "one joint of a leg or of an arm is enough."
            )
        left = np.cross(up, forward)
    for kind in person.sideless:
        first = "thigh" if kind == "leg" else "upper_arm"
        step = positions[person.parts["left", first]] - positions[person.parts["right", first]]
        if step @ left < 0:
            person = _swap_limb_sides(person, kind)
    return person


def toes_point_backward(
    person: PersonJoints, positions: Float[np.ndarray, "J 3"], axes: Float[np.ndarray, "3 3"] | None
) -> bool:
    """Check whether the toes point backward for a person with `axes` left, up and front."""
    forward = None if axes is None else _toe_direction(person, positions, axes[:, 1])
    return forward is not None and axes is not None and bool(forward @ axes[:, 2] < 0)


def swap_sides(person: PersonJoints) -> PersonJoints:
    """Exchange left and right of a person."""
    return _swap_limb_sides(_swap_limb_sides(person, "leg"), "arm")


def _lateral_steps(person: PersonJoints, positions: np.ndarray, up: np.ndarray) -> dict[str, np.ndarray]:
    """Compute horizontal steps from right to left, for the types of limbs whose sides are known."""
    found = {}
    for kind, part in (("leg", "thigh"), ("arm", "upper_arm")):
        if kind not in person.sideless and ("left", part) in person.parts and ("right", part) in person.parts:
            step = positions[person.parts["left", part]] - positions[person.parts["right", part]]
            found[kind] = step - (step @ up) * up
    return found


def _toe_direction(person: PersonJoints, positions: np.ndarray, up: np.ndarray) -> np.ndarray | None:
    """Compute the horizontal direction of the toes; None without toes or a clear direction."""
    feet = [
        (person.parts.get((side, "foot")), person.parts.get((side, "toes"))) for side in ("left", "right")
    ]
    steps = [
        positions[toes] - positions[foot] for foot, toes in feet if foot is not None and toes is not None
    ]
    if not steps:
        return None
    level = sum(step - (step @ up) * up for step in steps)
    assert isinstance(level, np.ndarray)
    return (
        level
        if np.linalg.norm(level) > MIN_TOE_DIRECTION * sum(np.linalg.norm(step) for step in steps)
        else None
    )


def _swap_limb_sides(person: PersonJoints, kind: str) -> PersonJoints:
    """Exchange left and right of one type of limb."""
    own = {*LIMB_PARTS[kind], *(("palm",) if kind == "arm" else ())}
    other: dict[Side, Side] = {"left": "right", "right": "left"}
    parts = {
        (other[side] if part in own else side, part): joint for (side, part), joint in person.parts.items()
    }
    fingers = person.fingers
    if kind == "arm":
        fingers = {(other[side], finger, n): joint for (side, finger, n), joint in fingers.items()}
    return person._replace(parts=parts, fingers=fingers)
