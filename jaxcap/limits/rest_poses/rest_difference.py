"""Differences between the rest poses of two skeletons, on both sides of a joint.

The rotation of a joint from rest is that of its distal segment relative to the proximal one, and has another meaning if
either of the two is rotated at rest. A skeleton shows how a segment is rotated by the directions to the joints on it, and by
the axes of these joints if they are hinges. A segment with a single joint that is no hinge shows no rotation about its bone.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...body.skeleton import Skeleton

#: largest angle between the bones of two skeletons with the same rest pose, radians: people differ by less
MAX_REST_ANGLE = float(np.radians(20.0))
#: largest angle between directions at rest of skeletons whose rotations mean the same, radians
EQUAL_REST = float(np.radians(2.0))
#: shorter bones, as a share of the skeleton's size, have no reliable direction
MIN_LENGTH = 0.01


class RestDifference(NamedTuple):
    """A direction that differs between two rest poses."""

    #: radians
    angle: float
    #: as in "the bone from 'LeftUpLeg' to 'LeftLeg'"
    direction: str


def rest_difference(one: Skeleton, other: Skeleton, joint: str | None = None) -> RestDifference:
    """Find the direction that differs most between the rest poses of two skeletons with some common joint names.

    The directions are those of bones between joints that both have, and of the axes of hinges that both have, of either
    sign. With a `joint`, they are those of the two segments that the joint connects. The angle is zero where nothing is shared.
    """
    indices = range(one.num_joints) if joint is None else _joints_of_segments(one, one.index(joint))
    found = [each for index in indices for each in _differences(one, other, index)]
    return max(found, default=RestDifference(0.0, ""), key=lambda each: each.angle)


def has_equal_rest(one: Skeleton, other: Skeleton, joint: str) -> bool:
    """Test if rotations of a joint that two skeletons have mean the same: their whole rest poses agree to two degrees."""
    return has_same_segments(one, other, joint) and rest_difference(one, other).angle <= EQUAL_REST


def has_same_segments(one: Skeleton, other: Skeleton, joint: str) -> bool:
    """Test if two skeletons with a joint share the names by which its two segments are compared.

    These are the joint's parent, and one of the joints below it where both have some.
    """
    above, below = zip(*((_parent_name(s, joint), _child_names(s, joint)) for s in (one, other)), strict=True)
    is_above = above[0] is None or above[0] in other.names
    return is_above and (not below[0] or not below[1] or bool(below[0] & set(other.names)))


def _parent_name(skeleton: Skeleton, joint: str) -> str | None:
    parent = skeleton.parents[skeleton.index(joint)]
    return skeleton.names[parent] if parent >= 0 else None


def _child_names(skeleton: Skeleton, joint: str) -> set[str]:
    index = skeleton.index(joint)
    return {name for name, parent in zip(skeleton.names, skeleton.parents, strict=True) if parent == index}


def _joints_of_segments(skeleton: Skeleton, joint: int) -> list[int]:
    """List the joints that lie on the proximal and on the distal segment of a joint."""
    parents = skeleton.parents
    proximal = [each for each, parent in enumerate(parents) if parent == parents[joint] and parent >= 0]
    return [*proximal, *(each for each, parent in enumerate(parents) if parent == joint)]


def _differences(one: Skeleton, other: Skeleton, index: int) -> Iterator[RestDifference]:
    """Compare the bone that ends in a joint, and the axes of the joint."""
    name, parent = one.names[index], one.parents[index]
    if name not in other.names:
        return
    there = other.index(name)
    if parent >= 0 and one.names[parent] in other.names:
        above = one.names[parent]
        bones = _bone(one, parent, index), _bone(other, other.index(above), there)
        yield RestDifference(bone_angle(*bones), f"the bone from '{above}' to '{name}'")
    kind = one.kinds[index]
    if kind == other.kinds[there] and kind in ("revolute", "universal"):
        axes = zip(*(np.asarray(s.axes[j], float) for s, j in ((one, index), (other, there))), strict=True)
        for first, second in list(axes)[: 1 if kind == "revolute" else 2]:
            angle = bone_angle(first, second)
            yield RestDifference(min(angle, np.pi - angle), f"the axis of '{name}'")


def _bone(skeleton: Skeleton, begin: int, end: int) -> Float[np.ndarray, "3"]:
    """Compute the vector between two joints at rest; zero where it is too short to have a direction."""
    centres = np.asarray(skeleton.centres, float)
    bone = centres[end] - centres[begin]
    return bone if np.linalg.norm(bone) > MIN_LENGTH * np.ptp(centres, 0).max() else np.zeros(3)


def bone_angle(one: Float[np.ndarray, "3"], other: Float[np.ndarray, "3"]) -> float:
    """Compute the angle between two directions, radians; zero where one of them is not known."""
    if not (one.any() and other.any()):
        return 0.0
    return float(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other))
