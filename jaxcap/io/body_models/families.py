"""The families of SMPL's body models: their joints, and their groups of coefficients."""

import re
from typing import NamedTuple

from ..skeletons.parameters.joints import SMPL_PARENTS

_TRUNK = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle", "spine3",
    "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist",
)  # fmt: skip
_FINGERS = tuple(
    f"{finger}{number}" for finger in ("index", "middle", "pinky", "ring", "thumb") for number in (1, 2, 3)
)
_HANDS = tuple(f"{side}_{finger}" for side in ("left", "right") for finger in _FINGERS)
_FACE = ("jaw", "left_eye_smplhf", "right_eye_smplhf")


class Family(NamedTuple):
    """A family of body models."""

    name: str
    #: names of the joints, as the package `smplx` has them
    joints: tuple[str, ...]
    #: joints of hands and face, which a scan of a whole body does not show
    small_joints: tuple[str, ...]
    #: words in names of files that belong to this family
    words: tuple[str, ...]


#: by the number of joints
FAMILIES: dict[int, Family] = {
    24: Family("SMPL", (*_TRUNK, "left_hand", "right_hand"), ("left_hand", "right_hand"), ("smpl",)),
    52: Family("SMPL-H", (*_TRUNK, *_HANDS), _HANDS, ("smplh",)),
    55: Family("SMPL-X", (*_TRUNK, *_FACE, *_HANDS), (*_FACE, *_HANDS), ("smplx",)),
    16: Family("MANO", ("wrist", *_FINGERS), (), ("mano",)),
    5: Family("FLAME", ("root", "neck", "jaw", "left_eye", "right_eye"), (), ("flame",)),
}
#: parents of the joints, by their number
PARENTS: dict[int, tuple[int, ...]] = {
    **{count: SMPL_PARENTS[count] for count in (24, 52, 55)},
    16: (-1, *(0 if number == 0 else 3 * finger + number for finger in range(5) for number in range(3))),
    5: (-1, 0, 1, 1, 1),
}
#: the family whose displacements depend on quaternions, with the joints of SMPL
STAR = "STAR"
#: number of shape directions of a model with 100 directions of expressions behind them, and of older models with fewer
FIRST_EXPRESSION = {"SMPL-X": (300, 10), "FLAME": (300, 300)}


def family_in_name(name: str) -> str | None:
    """Find the family that a word in the name of a file states; None if none does."""
    joined = re.sub(r"smpl[-+_ ]([hx])(?![a-z])", r"smpl\1", name.lower())
    words = set(re.split(r"[^a-z]+", joined))
    families = [(STAR, ("star",)), *((family.name, family.words) for family in FAMILIES.values())]
    return next((stated for stated, of_family in families if words & set(of_family)), None)


def split_directions(family: str, count: int) -> dict[str, tuple[int, int]]:
    """Split the shape directions of a file into groups: name -> (first direction, number of directions).

    SMPL-X and FLAME have 300 directions of shapes and 100 of expressions; older files of SMPL-X have 10 of each.
    """
    first, older = FIRST_EXPRESSION.get(family, (count, count))
    split = first if count > first else older
    if count <= split:
        return {"betas": (0, count)}
    return {"betas": (0, split), "expression": (split, count - split)}
