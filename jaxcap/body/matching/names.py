"""Read side and body part from the name of a joint, in the naming schemes of other programs.

The words are those of CMU's ASF and BVH files, Biovision, MotionBuilder, Motive, Vicon, Xsens, Kinect,
Mixamo, Unity, VRM, Unreal, Rigify, MakeHuman, 3ds Max Biped, Source, Daz, Poser, SMPL and Bandai Namco. A
word may denote two parts: in one scheme "shoulder" is the clavicle, in another the upper arm. The tree then
decides (`limbs`).
"""

import re
from itertools import dropwhile
from typing import Literal, NamedTuple

Side = Literal["left", "right"]

LEG, ARM = ("thigh", "shin", "foot"), ("upper_arm", "forearm", "hand")
FINGERS = ("thumb", "index", "middle", "ring", "little", "finger")


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


#: body part -> its words, in lower case without separators; parts in the order of their likelihood for a word
_PART_WORDS: dict[tuple[str, ...], str] = {
    ("thigh",): "thigh thighbend upleg upperleg legupper upthigh femur hipbend buttockthigh",
    ("shin", "thigh"): "leg",
    ("shin",): "shin shinbend calf lowerleg leglower lowleg loleg knee tibia shank crus",
    ("foot", "toes"): "foot feet",
    ("foot",): "ankle talus",
    ("toes",): "toe toes toebase toesbase ball balltoe metatarsal metatarsals forefoot",
    ("clavicle", "upper_arm"): "shoulder",
    ("clavicle",): "clavicle clav collar collarbone scapula shoulderblade sternoclavicular",
    ("upper_arm", "forearm"): "arm",
    ("upper_arm",): "upperarm uarm uparm armupper upperarmbend humerus shldr shldrbend bicep glenohumeral",
    ("forearm",): "forearm forearmbend lowerarm armlower lowarm loarm foarm farm elbow radius ulna",
    ("hand",): "wrist carpus",
    ("hand", "palm"): "hand",
    ("palm",): "palm fingerbase",
    ("hip_side", "thigh"): "hipjoint",
    ("hip_side",): "buttock",
    ("pelvis",): "hips pelvis root cog spinebase hipcenter hipcentre lowerbody",
    (
        "spine",
    ): "spine chest back abdomen torso thorax waist stomach belly ribs ribcage lowerback upperback upperchest lowerchest "
    "abdomenlower abdomenupper chestlower chestupper spinelower spinemiddle spineupper spinemid spinenavel spinechest spineshoulder "
    "lumbar thoracic upperbody sternum",
    ("neck",): "neck lowerneck upperneck necklower neckupper neckbase cervical shouldercenter shouldercentre",
    ("head",): "head skull cranium",
    ("thumb",): "thumb handthumb fingerthumb thumbfinger",
    ("index",): "index handindex indexfinger findex fingerindex",
    ("middle",): "middle mid handmiddle middlefinger fmiddle handmid fingermiddle",
    ("ring",): "ring handring ringfinger fring fingerring",
    ("little",): "little pinky pinkie handpinky handlittle littlefinger pinkyfinger fpinky fingerpinky",
    ("finger",): "finger fingers handfinger",
}
PARTS_OF_WORD: dict[str, tuple[str, ...]] = {
    word: parts for parts, words in _PART_WORDS.items() for word in words.split()
}

#: "hip" is the pelvis, unless it has a side: then it is the joint of the thigh
HIP = "hip"
#: words without information on the part
_FILLER_WORDS = _words(
    "mixamorig bip biped valvebiped valve cc def org mch jnt jt joint joints bone bones bn j b c m f g x sk skel skeleton character rig "
    "avg ctrl anim mesh armature reference actor base"
)
#: joints for the skin or an animator, which are not joints of a person
_HELPER_WORDS = _words(
    "twist roll ik fk pole end nub tip helper share corrective adj adjust bulge weapon prop attach socket volume aux muscle target dummy "
    "fix jiggle breast pec skirt hair cloth cape tail eye jaw face toeik null site locator"
)
_LEFT, _RIGHT = frozenset(["l", "left", "lft"]), frozenset(["r", "right", "rgt"])
_SIDE_AFFIXES: dict[str, Side] = {"left": "left", "right": "right", "l": "left", "r": "right"}
_TOKENS = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+")
#: vertebrae, as named by Xsens
_VERTEBRA = re.compile(r"(l[1-5]|t\d{1,2}|c[1-7])$")
#: order of a finger's bones
_BONE_NUMBERS = {"metacarpal": 0, "proximal": 1, "intermediate": 2, "distal": 3}


class JointName(NamedTuple):
    """The information in the name of a joint."""

    side: Side | None
    #: possible parts of the body, the most likely first; empty for an unknown word
    parts: tuple[str, ...]
    #: last number in the name; None without one
    number: int | None
    #: a joint for skinning or control, such as a twist joint
    helper: bool


def normalise_name(name: str) -> str:
    """Remove a namespace, such as `mixamorig:` or `Character1|`, and convert to lower case without
    separators."""
    name = re.sub(
        r"^(mixamorig|bip|valvebiped[._]bip)\d*[ _:]?", "", _without_namespace(name), flags=re.IGNORECASE
    )
    return re.sub(r"[^0-9a-z]", "", name.lower())


def parse_joint_name(name: str) -> JointName:
    """Read side, part and number from the name of a joint."""
    pieces = [piece.lower() for piece in _TOKENS.findall(_without_namespace(name))]
    words = [piece for piece in pieces if not piece.isdigit()]
    numbers = [int(piece) for piece in pieces if piece.isdigit()]
    number = numbers[-1] if numbers else None
    if _VERTEBRA.match("".join(pieces)):
        return JointName(None, ("neck" if pieces[0] == "c" else "spine",), None, False)
    sides: set[Side] = set()
    kept, helper = [], False
    for word in words:
        if word in _LEFT or word in _RIGHT:
            sides.add("left" if word in _LEFT else "right")
        elif word in _HELPER_WORDS or (word.endswith("twist") and word != "twist"):
            helper = True
            kept += [word.removesuffix("twist")] if word.endswith("twist") and word != "twist" else []
        elif word in _BONE_NUMBERS:
            number = _BONE_NUMBERS[word] if number is None else number
        else:
            kept.append(word)
    side = next(iter(sides)) if len(sides) == 1 else None
    bare = "".join(word for word in kept if word not in _FILLER_WORDS)
    # words before the part are a prefix; one after it, as in HipJoint or FingerBase, may belong to it
    parts = _parts_of_stem("".join(kept), side) or _parts_of_stem(
        "".join(dropwhile(_FILLER_WORDS.__contains__, kept)), side
    )
    parts = parts or _parts_of_stem(bare, side)
    if not parts and not sides:
        side, parts, helper = _split_affixes(bare, helper)
    return JointName(side, parts, number, helper)


def _without_namespace(name: str) -> str:
    return re.split(r"[:|]", name)[-1] or name


def _parts_of_stem(stem: str, side: Side | None) -> tuple[str, ...]:
    if stem == HIP:
        return ("thigh",) if side else ("pelvis",)
    return PARTS_OF_WORD.get(stem, ())


def _split_affixes(stem: str, helper: bool) -> tuple[Side | None, tuple[str, ...], bool]:
    """Split a name in one case, such as `lfemur`, `rthumb`, `leftupleg` or `hipright`."""
    for ending in ("", "twist", "roll", "end", "nub"):
        if ending and not stem.endswith(ending):
            continue
        whole = stem.removesuffix(ending)
        if ending and _parts_of_stem(whole, None):
            return None, _parts_of_stem(whole, None), True
        for word, side in _SIDE_AFFIXES.items():
            for rest, found in (
                (whole[len(word) :], whole.startswith(word)),
                (whole[: -len(word)], whole.endswith(word)),
            ):
                if found and _parts_of_stem(rest, side):
                    return side, _parts_of_stem(rest, side), helper or bool(ending)
    return None, (), helper
