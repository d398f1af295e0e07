"""Which joints of two skeletons are the same one, by their names."""

from collections.abc import Mapping, Sequence

from ..body.symmetry import twin_joints

#: ASF bone -> the name that CMU's BVH files and the embedded human have for its joint
ASF_TO_BVH: dict[str, str] = {
    "root": "Hips",
    "lowerback": "LowerBack",
    "upperback": "Spine",
    "thorax": "Spine1",
    "lowerneck": "Neck",
    "upperneck": "Neck1",
    "head": "Head",
    **{
        f"{short}{bone}": name.format(long=long, letter=letter)
        for short, long, letter in (("l", "Left", "L"), ("r", "Right", "R"))
        for bone, name in {
            "hipjoint": "{letter}HipJoint",
            "femur": "{long}UpLeg",
            "tibia": "{long}Leg",
            "foot": "{long}Foot",
            "toes": "{long}ToeBase",
            "clavicle": "{long}Shoulder",
            "humerus": "{long}Arm",
            "radius": "{long}ForeArm",
            "wrist": "{long}Hand",
            "hand": "{long}FingerBase",
            "fingers": "{long}HandFinger1",
            "thumb": "{letter}Thumb",
        }.items()
    },
}

#: other names of the same joints
ALIASES: dict[str, str] = {
    **ASF_TO_BVH,
    "LeftHandIndex1": "LeftHandFinger1",
    "RightHandIndex1": "RightHandFinger1",
    "LFingers": "LeftHandFinger1",
    "RFingers": "RightHandFinger1",
}

#: thigh, shin and foot of each leg
LEGS = (("LeftUpLeg", "LeftLeg", "LeftFoot"), ("RightUpLeg", "RightLeg", "RightFoot"))

#: bones that join a limb to the trunk: they lie differently in different skeletons without
#: any difference of pose
GIRDLES = frozenset(["LHipJoint", "RHipJoint", "LeftShoulder", "RightShoulder"])


def match_names(
    source: Sequence[str], target: Sequence[str], names: Mapping[str, str] | None = None
) -> dict[int, int]:
    """{target joint: source joint}.

    **Arguments:** `names` leads from source to target names; where it is not given, names
    match that are equal, by themselves or by `ALIASES`, with any `prefix:` left out.

    **Raises:** `ValueError` for a name that is in neither skeleton, or when fewer than three
    joints match.
    """
    if names is None:
        known = {plain_name(name): joint for joint, name in enumerate(source)}
        matches = {
            joint: known[plain_name(name)] for joint, name in enumerate(target) if plain_name(name) in known
        }
    else:
        for words, given, which in ((names.keys(), source, "source"), (names.values(), target, "target")):
            for name in words:
                if name not in given:
                    raise ValueError(
                        f"There is no joint '{name}' in the {which}, which has {', '.join(given)}."
                    )
        matches = {target.index(there): source.index(here) for here, there in names.items()}
    if len(matches) < 3:
        raise ValueError(
            f"{len(matches)} joints of the source ({', '.join(source)}) match one of the target "
            f"({', '.join(target)}); say which do with a table of names from source to target."
        )
    return matches


def sided(names: Sequence[str]) -> list[bool]:
    """Whether each joint has a twin on the other side of the body, by the names."""
    twins = {joint for pair in twin_joints(names) for joint in pair}
    return [joint in twins for joint in range(len(names))]


def plain_name(name: str) -> str:
    """The name that CMU's BVH files have for a joint, without any `prefix:`."""
    name = name.rsplit(":", 1)[-1]
    return ALIASES.get(name, name)
