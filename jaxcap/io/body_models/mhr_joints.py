"""The joints of MHR (Ferguson et al. 2025), which its files have without names."""


def _twists(bone: str, first: int) -> list[tuple[str, str]]:
    return [(f"{bone}_twist{number}_proc", bone) for number in range(first, 5)]


def _leg(side: str) -> list[tuple[str, str]]:
    chain = ("root", *(f"{side}_{part}" for part in ("upleg", "lowleg", "foot", "talocrural", "subtalar")))
    chain = (*chain, f"{side}_transversetarsal", f"{side}_ball")
    return [
        *zip(chain[1:], chain, strict=False),
        *_twists(f"{side}_lowleg", 1),
        *_twists(f"{side}_upleg", 0),
    ]


def _finger(side: str, name: str, first: int) -> list[tuple[str, str]]:
    parts = (*(f"{side}_{name}{number}" for number in range(first, 4)), f"{side}_{name}_null")
    return list(zip(parts, (f"{side}_wrist", *parts), strict=False))


def _arm(side: str) -> list[tuple[str, str]]:
    chain = (
        "c_spine3",
        *(f"{side}_{part}" for part in ("clavicle", "uparm", "lowarm", "wrist_twist", "wrist")),
    )
    return [
        *zip(chain[1:], chain, strict=False),
        *(each for name, first in FINGERS for each in _finger(side, name, first)),
        *_twists(f"{side}_lowarm", 1),
        *_twists(f"{side}_uparm", 0),
    ]


#: fingers with the number of their first joint
FINGERS = (("pinky", 0), ("ring", 1), ("middle", 1), ("index", 1), ("thumb", 0))
#: the joints in their order, with their parents
JOINTS: tuple[tuple[str, str], ...] = (
    ("body_world", ""), ("root", "body_world"), *_leg("l"), *_leg("r"),
    ("c_spine0", "root"), ("c_spine1", "c_spine0"), ("c_spine2", "c_spine1"), ("c_spine3", "c_spine2"),
    *_arm("r"), *_arm("l"),
    ("c_neck", "c_spine3"), ("c_neck_twist1_proc", "c_neck"), ("c_neck_twist0_proc", "c_neck"), ("c_head", "c_neck"),
    ("c_jaw", "c_head"), ("c_teeth", "c_jaw"), ("c_jaw_null", "c_jaw"), ("c_tongue0", "c_jaw"),
    *((f"c_tongue{number}", f"c_tongue{number - 1}") for number in range(1, 5)),
    ("r_eye", "c_head"), ("r_eye_null", "r_eye"), ("l_eye", "c_head"), ("l_eye_null", "l_eye"), ("c_head_null", "c_head"),
)  # fmt: skip
#: parts of names of joints that scans of a whole body do not show: fingers, face, and twists of limbs and feet
SMALL_PARTS = (
    "_proc", "_null", "jaw", "teeth", "tongue", "eye", "subtalar", "transversetarsal", *(name for name, _ in FINGERS),
)  # fmt: skip


def names_of(parents: tuple[int, ...]) -> tuple[str, ...]:
    """Return the names of the joints of MHR, or numbered ones if the tree is another one."""
    names = [name for name, _ in JOINTS]
    if parents == tuple(names.index(above) if above else -1 for _, above in JOINTS):
        return tuple(names)
    return tuple(f"joint{number}" for number in range(len(parents)))
