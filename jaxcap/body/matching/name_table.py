"""Name tables of two skeletons: pairs of joints, and joints without a match.

A table gives single joints and leaves the others to names and trees. A joint in the table is read as if its
name were that of its role in the other skeleton, so it also identifies the limb to which it belongs.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from ..skeleton import Skeleton
from .names import JointName, Side, normalise_name, parse_joint_name
from .person_joints import LIMB_PARTS, PersonJoints

#: a joint without a match by the table is skipped, and belongs to no body part
NO_PART = JointName(None, ("none",), None, True)


class Table(NamedTuple):
    """A name table as indices of joints."""

    #: target -> source
    pairs: dict[int, int]
    #: joints of the source without a match
    none: frozenset[int]

    @property
    def source_joints(self) -> set[int]:
        """Joints of the source that the table contains."""
        return {*self.pairs.values(), *self.none}


def make_table(source: Skeleton, target: Skeleton, names: Mapping[str, str | None]) -> Table:
    """Convert a name table to joint indices.

    **Raises:** `ValueError` for a name that a skeleton does not have, or two joints for one.
    """
    given = {here: there for here, there in names.items() if there is not None}
    for words, own, which in ((names, source.names, "source"), (given.values(), target.names, "target")):
        for name in words:
            if name not in own:
                raise ValueError(f"There is no joint '{name}' in the {which}, which has {', '.join(own)}.")
    pairs: dict[int, int] = {}
    for here, there in given.items():
        joint = target.names.index(there)
        if joint in pairs:
            raise ValueError(
                f"The joints '{source.names[pairs[joint]]}' and '{here}' of the source are both given for '{there}'; give one of them."
            )
        pairs[joint] = source.names.index(here)
    return Table(pairs, frozenset(source.names.index(here) for here in names if here not in given))


def known_target_names(source: Skeleton, target: Skeleton, table: Table) -> dict[int, JointName]:
    """Read target joints with unknown names by the source's names in the table."""
    return {
        there: parse_joint_name(source.names[here])
        for there, here in table.pairs.items()
        if not parse_joint_name(target.names[there]).parts
    }


def known_source_names(target: Skeleton, person: PersonJoints, table: Table) -> dict[int, JointName]:
    """Read the source's joints in the table by their roles in the `person` of the target."""
    roles: dict[int, JointName] = {}
    for part, joints in (("pelvis", (person.pelvis,)), ("spine", person.spine), ("neck", person.neck)):
        roles |= {joint: JointName(None, (part,), None, False) for joint in joints}
    roles[person.head] = JointName(None, ("head",), None, False)
    roles |= {joint: JointName(side, (part,), None, False) for (side, part), joint in person.parts.items()}
    roles |= {
        joint: JointName(side, (finger,), number, False)
        for (side, finger, number), joint in person.fingers.items()
    }
    said = {
        here: roles.get(there) or parse_joint_name(target.names[there]) for there, here in table.pairs.items()
    }
    return said | dict.fromkeys(table.none, NO_PART)


def known_limb_sides(person: PersonJoints, table: Table) -> set[str]:
    """Find the types of limbs whose sides the table gives, by the `person` of the target."""
    return {
        kind
        for kind, names in LIMB_PARTS.items()
        for (_, part), joint in person.parts.items()
        if part in names and joint in table.pairs
    }


def override_roles(source: PersonJoints, target: PersonJoints, table: Table) -> PersonJoints:
    """Replace roles in the source's person by the joints of the table, at the `target`'s roles."""
    given = table.source_joints
    parts = {key: joint for key, joint in source.parts.items() if joint not in given}
    parts |= {key: table.pairs[there] for key, there in target.parts.items() if there in table.pairs}
    fingers = {key: joint for key, joint in source.fingers.items() if joint not in given}
    fingers |= {key: table.pairs[there] for key, there in target.fingers.items() if there in table.pairs}

    def single(here: int, there: int) -> int:
        return table.pairs.get(there, -1 if here in given else here)

    def chain(here: Sequence[int], there: Sequence[int]) -> tuple[int, ...]:
        return tuple(here) or tuple(table.pairs[joint] for joint in there if joint in table.pairs)

    kinds = known_limb_sides(target, table)
    return PersonJoints(
        single(source.pelvis, target.pelvis),
        chain(source.spine, target.spine),
        chain(source.neck, target.neck),
        single(source.head, target.head),
        parts,
        fingers,
        tuple(kind for kind in source.sideless if kind not in kinds),
    )


def initial_pairs(
    source: Skeleton, target: Skeleton, person: PersonJoints | None, pairs: Mapping[int, int], table: Table
) -> dict[int, int]:
    """Choose pairs for an initial table: those of the table, then limbs by equal names, then other pairs
    found.

    Two joints of a limb with the names of the `person` of the target have priority over an incomplete result
    of the tree. If `person` is None, equal names are not used.
    """
    found = {normalise_name(name): joint for joint, name in enumerate(source.names)}
    chosen = dict(table.pairs)
    for limb, whole in [] if person is None else _limb_joints(person):
        called = {
            joint: here
            for joint in limb
            if (here := found.get(normalise_name(target.names[joint]), -1)) >= 0
            and here not in table.source_joints
            and joint not in table.pairs
        }
        if len(called.keys() & set(whole)) >= 2:
            chosen |= called
            # equal names have priority over the result of the tree for this limb
            pairs = {there: here for there, here in pairs.items() if there not in limb}
    taken = {*chosen.values(), *table.none}
    rest = {there: here for there, here in pairs.items() if there not in chosen and here not in taken}
    return chosen | rest


def _limb_joints(person: PersonJoints) -> list[tuple[list[int], tuple[int, ...]]]:
    """List the joints of each limb, with and without clavicle and toes."""
    sides: tuple[Side, Side] = ("left", "right")
    return [
        (
            [person.parts[side, part] for part in names if (side, part) in person.parts],
            person.limb(side, kind),
        )
        for side in sides
        for kind, names in LIMB_PARTS.items()
    ]
