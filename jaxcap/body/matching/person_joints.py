"""Identify the joints of a person: limbs, trunk, neck, head, hands and feet, for any naming scheme."""

from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...geometry.axes import nearest_axis
from ..skeleton import Skeleton
from .limbs import Limb, Limbs, find_limbs, lowest_common
from .names import ARM, FINGERS, LEG, JointName, Side, parse_joint_name

#: parts of one limb, from the trunk on
LIMB_PARTS = {"leg": (*LEG, "toes"), "arm": ("clavicle", *ARM)}


class PersonJoints(NamedTuple):
    """The joints of a skeleton by their roles in a person; -1 or empty if there is none."""

    pelvis: int
    #: from the pelvis to the neck, and from there to the head, without both
    spine: tuple[int, ...]
    neck: tuple[int, ...]
    head: int
    #: (side, part) -> joint; parts as in `LIMB_PARTS`, and "palm"; left and right are provisional for limbs
    #: in `sideless`
    parts: dict[tuple[Side, str], int]
    #: (side, finger, number of the bone) -> joint
    fingers: dict[tuple[Side, str, int], int]
    #: types of limbs without a side in any name
    sideless: tuple[str, ...]

    def limb(self, side: Side, kind: str) -> tuple[int, ...]:
        """Return thigh, shin and foot of a "leg", or upper arm, forearm and hand of an "arm"; empty if a
        joint is missing."""
        names = LEG if kind == "leg" else ARM
        return (
            tuple(self.parts[side, part] for part in names)
            if all((side, part) in self.parts for part in names)
            else ()
        )


def identify_joints(skeleton: Skeleton, known_names: Mapping[int, JointName] | None = None) -> PersonJoints:
    """Find a person in a skeleton, by joint names and the kinematic tree, independently of the pose.

    **Arguments:** `known_names` replaces the information in the names of some joints.
    """
    known_names = known_names or {}
    names = [known_names.get(joint) or parse_joint_name(name) for joint, name in enumerate(skeleton.names)]
    limbs = find_limbs(skeleton, names)
    parts: dict[tuple[Side, str], int] = {}
    for kind, found in (("leg", limbs.legs), ("arm", limbs.arms)):
        for side, limb in zip(_limb_sides(found), found, strict=True):
            for part, joint in zip(LEG if kind == "leg" else ARM, limb.joints, strict=True):
                parts[side, part] = joint
    pelvis, spine, neck, head = _find_trunk(skeleton, names, limbs)
    trunk = {pelvis, head, *spine, *neck}
    fingers: dict[tuple[Side, str, int], int] = {}
    for side in ("left", "right"):
        _find_toes(skeleton, names, parts, side)
        _find_clavicle(skeleton, names, parts, side, trunk)
        _find_fingers(skeleton, names, parts, fingers, side)
    sideless = tuple(
        kind
        for kind, found in (("leg", limbs.legs), ("arm", limbs.arms))
        if found and not any(limb.side for limb in found)
    )
    return PersonJoints(pelvis, spine, neck, head, parts, fingers, sideless)


def has_named_limbs(skeleton: Skeleton) -> bool:
    """Test if a skeleton has two arms and two legs of a person whose joints have known names with sides."""
    person = identify_joints(skeleton)
    if person.sideless:
        return False
    for side in ("left", "right"):
        for kind, parts in (("leg", LEG), ("arm", ARM)):
            limb = person.limb(side, kind)
            called = [parse_joint_name(skeleton.names[joint]) for joint in limb]
            if not limb or any(part not in name.parts for part, name in zip(parts, called, strict=True)):
                return False
    return True


def trunk_direction(
    person: PersonJoints, positions: Float[np.ndarray, "... J 3"]
) -> Float[np.ndarray, "... 3"] | None:
    """Compute the direction from the hips to the shoulders or the head; None if the person has neither."""
    thighs = [joint for (_, part), joint in person.parts.items() if part == "thigh"]
    upper = [joint for (_, part), joint in person.parts.items() if part == "upper_arm"]
    low = thighs or ([person.pelvis] if person.pelvis >= 0 else [])
    high = upper or ([person.head] if person.head >= 0 else [])
    if not low or not high:
        return None
    along = positions[..., high, :].mean(-2) - positions[..., low, :].mean(-2)
    return along / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-12)


def far_end(skeleton: Skeleton, person: PersonJoints, side: Side, kind: str, last: int) -> int | None:
    """Find the joint at the far end of a hand or a foot: toes, palm, a finger, or else its only child; None
    if there is none.

    **Arguments:** `last` is the hand, for the type "arm", or the foot, for the type "leg".
    """
    named = person.parts.get((side, "toes" if kind == "leg" else "palm"))
    if named is not None:
        return named
    if kind == "arm":
        for finger in ("middle", "finger", "index", "ring"):
            own = [
                (number, joint)
                for (s, f, number), joint in person.fingers.items()
                if (s, f) == (side, finger)
            ]
            if own:
                return min(own)[1]
    below = [child for child, parent in enumerate(skeleton.parents) if parent == last]
    return below[0] if len(below) == 1 else None


def _limb_sides(limbs: tuple[Limb, ...]) -> tuple[Side, ...]:
    """List the sides of one or two limbs, left first if no name gives them."""
    if len(limbs) == 1:
        return (limbs[0].side or "left",)
    return ("left", "right") if limbs else ()


def _find_trunk(
    skeleton: Skeleton, names: list[JointName], limbs: Limbs
) -> tuple[int, tuple[int, ...], tuple[int, ...], int]:
    """Find pelvis, spine, neck and head."""
    thighs = [limb.joints[0] for limb in limbs.legs]
    arms = [limb.joints[0] for limb in limbs.arms]
    if not thighs and not arms:
        return -1, (), (), -1
    parents, descent = skeleton.parents, skeleton.descendants
    top = (
        lowest_common(skeleton, [parents[arm] for arm in arms])
        if arms and min(parents[a] for a in arms) >= 0
        else -1
    )
    if thighs:
        pelvis = lowest_common(skeleton, [max(parents[thigh], 0) for thigh in thighs])
        # for a single leg, the joint of the hip's side may be above the thigh
        while pelvis >= 0 and names[pelvis].parts[:1] == ("hip_side",) and parents[pelvis] >= 0:
            pelvis = parents[pelvis]
    else:
        path = _joint_path(skeleton, -1, top)
        called = [joint for joint in path if "pelvis" in names[joint].parts]
        pelvis = called[-1] if called else (path[0] if path else -1)
    taken = np.asarray(descent[[limb.joints[0] for limb in (*limbs.legs, *limbs.arms)]].any(axis=0))
    head = _find_head(skeleton, names, top, taken)
    end = head if head >= 0 else top
    if head >= 0 and "neck" in names[head].parts:
        # the trunk ends at the neck
        head = -1
    if end < 0:
        return pelvis, (), (), head
    start = lowest_common(skeleton, [pelvis, end])
    chain = [joint for joint in _joint_path(skeleton, start, end) if joint not in (pelvis, head)]
    under = set(_joint_path(skeleton, -1, top)) if top >= 0 else set()
    called = head >= 0 and "head" in names[head].parts
    is_neck = [
        "neck" in names[joint].parts
        or (bool(under) and joint not in under and not (called and "spine" in names[joint].parts))
        for joint in chain
    ]
    # all joints from the first neck joint on belong to the neck
    first = is_neck.index(True) if True in is_neck else len(chain)
    return pelvis, tuple(chain[:first]), tuple(chain[first:]), head


def _joint_path(skeleton: Skeleton, start: int, end: int) -> list[int]:
    """List the joints below `start`, without it, down to `end`."""
    found = []
    while end >= 0 and end != start:
        found.append(end)
        end = skeleton.parents[end]
    return found[::-1]


def _find_head(skeleton: Skeleton, names: list[JointName], top: int, taken: np.ndarray) -> int:
    depths = skeleton.depths
    named = [
        j
        for j, name in enumerate(names)
        if name.parts[:1] == ("head",) and not name.helper and not taken[j] and not name.side
    ]
    if named:
        return min(named, key=lambda joint: depths[joint])
    if top < 0:
        return -1
    # end of the chain that continues from the shoulders between the arms
    joint, last = top, -1
    while True:
        below = [
            child
            for child, parent in enumerate(skeleton.parents)
            if parent == joint
            and not taken[child]
            and not skeleton.descendants[child, taken].any()
            and set(names[child].parts) <= {"spine", "neck"}
            and not names[child].helper
        ]
        if len(below) != 1:
            return last
        joint = last = below[0]


def _find_toes(skeleton: Skeleton, names: list[JointName], parts, side: Side) -> None:
    foot = parts.get((side, "foot"))
    if foot is None:
        return
    below = _descendants(skeleton, foot)
    named = [joint for joint in below if "toes" in names[joint].parts and not names[joint].helper]
    nameless = [joint for joint in below if not names[joint].parts and not names[joint].helper]
    if named or (len(nameless) == 1 == len(below)):
        parts[side, "toes"] = min(named or nameless, key=lambda joint: skeleton.depths[joint])


def _find_clavicle(skeleton: Skeleton, names: list[JointName], parts, side: Side, trunk: set[int]) -> None:
    upper = parts.get((side, "upper_arm"))
    if upper is None:
        return
    above, joint = [], skeleton.parents[upper]
    while joint >= 0 and joint not in trunk:
        above.append(joint)
        joint = skeleton.parents[joint]
    if joint < 0:
        return
    called = [joint for joint in above if "clavicle" in names[joint].parts and not names[joint].helper]
    unknown = [joint for joint in above if not names[joint].helper]
    if called or unknown:
        parts[side, "clavicle"] = (called or unknown)[-1] if called else unknown[0]


def _find_fingers(skeleton: Skeleton, names: list[JointName], parts, fingers, side: Side) -> None:
    hand = parts.get((side, "hand"))
    if hand is None:
        return
    seen: dict[str, list[int]] = {}
    for joint in _descendants(skeleton, hand):
        name = names[joint]
        if name.helper or not name.parts:
            continue
        if name.parts[0] in ("palm", "hand"):
            parts.setdefault((side, "palm"), joint)
        elif name.parts[0] in FINGERS:
            seen.setdefault(name.parts[0], []).append(joint)
    for finger, joints in seen.items():
        joints = sorted(joints, key=lambda joint: skeleton.depths[joint])
        if not all(skeleton.descendants[above, below] for above, below in pairwise(joints)):
            # several fingers share one name, so they cannot be distinguished
            continue
        for place, joint in enumerate(joints):
            number = names[joint].number
            fingers.setdefault((side, finger, place + 1 if number is None else number), joint)


def _descendants(skeleton: Skeleton, joint: int) -> list[int]:
    return [below for below in np.flatnonzero(skeleton.descendants[joint]).tolist() if below != joint]


def snap_to_axis(direction: Float[np.ndarray, "3"], max_angle: float) -> Float[np.ndarray, "3"]:
    """Find the coordinate axis within some radians of a direction; the direction itself if there is none."""
    axis = nearest_axis(direction)
    return axis if axis @ direction > np.cos(max_angle) else direction
