"""Hold what a table of names says of two skeletons: pairs of joints, and joints that have none.

A table says single joints and leaves the others to names and trees: a joint that it names is read as if the file had called it what it is in the
other skeleton, so that it also shows the limb that it belongs to.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from ...body.skeleton import Skeleton
from .names import JointName, Side, plain_name, read_name
from .person import LIMBS, Person

#: a joint that is said to have no match is passed over, and is no part of anybody
NOBODY = JointName(None, ("none",), None, True)


class Table(NamedTuple):
    """Hold a table of names by the indices of joints."""

    #: target -> source
    pairs: dict[int, int]
    #: joints of the source that have no match
    none: frozenset[int]

    @property
    def given(self) -> set[int]:
        """Joints of the source that the table says anything of."""
        return {*self.pairs.values(), *self.none}


def make_table(source: Skeleton, target: Skeleton, names: Mapping[str, str | None]) -> Table:
    """Find the joints that a table of names is of.

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


def told_of_target(source: Skeleton, target: Skeleton, table: Table) -> dict[int, JointName]:
    """Read joints of the target whose own names say nothing by the source's names in the table."""
    return {
        there: read_name(source.names[here])
        for there, here in table.pairs.items()
        if not read_name(target.names[there]).parts
    }


def told_of_source(target: Skeleton, person: Person, table: Table) -> dict[int, JointName]:
    """Read the source's joints of the table as what they are in the `person` of the target."""
    roles: dict[int, JointName] = {}
    for part, joints in (("pelvis", (person.pelvis,)), ("spine", person.spine), ("neck", person.neck)):
        roles |= {joint: JointName(None, (part,), None, False) for joint in joints}
    roles[person.head] = JointName(None, ("head",), None, False)
    roles |= {joint: JointName(side, (part,), None, False) for (side, part), joint in person.parts.items()}
    roles |= {
        joint: JointName(side, (finger,), number, False)
        for (side, finger, number), joint in person.fingers.items()
    }
    said = {here: roles.get(there) or read_name(target.names[there]) for there, here in table.pairs.items()}
    return said | dict.fromkeys(table.none, NOBODY)


def told_kinds(person: Person, table: Table) -> set[str]:
    """Kinds of limbs of whose sides the table says something, by the `person` of the target."""
    return {
        kind
        for kind, names in LIMBS.items()
        for (_, part), joint in person.parts.items()
        if part in names and joint in table.pairs
    }


def overruled(own: Person, target: Person, table: Table) -> Person:
    """Put the joints of the table into the person that names and tree show in the source, in the places of the `target`'s."""
    given = table.given
    parts = {key: joint for key, joint in own.parts.items() if joint not in given}
    parts |= {key: table.pairs[there] for key, there in target.parts.items() if there in table.pairs}
    fingers = {key: joint for key, joint in own.fingers.items() if joint not in given}
    fingers |= {key: table.pairs[there] for key, there in target.fingers.items() if there in table.pairs}

    def single(here: int, there: int) -> int:
        return table.pairs.get(there, -1 if here in given else here)

    def chain(here: Sequence[int], there: Sequence[int]) -> tuple[int, ...]:
        return tuple(here) or tuple(table.pairs[joint] for joint in there if joint in table.pairs)

    kinds = told_kinds(target, table)
    return Person(
        single(own.pelvis, target.pelvis),
        chain(own.spine, target.spine),
        chain(own.neck, target.neck),
        single(own.head, target.head),
        parts,
        fingers,
        tuple(kind for kind in own.sideless if kind not in kinds),
    )


def table_to_start(
    source: Skeleton, target: Skeleton, person: Person | None, pairs: Mapping[int, int], table: Table
) -> dict[int, int]:
    """Choose pairs of joints for a table that somebody fills in: what the table says, then limbs by equal names, then what else was found.

    Two joints of a limb that are called as in the `person` of the target say more than a reading of the tree that could not be finished. None for
    it leaves equal names out.
    """
    found = {plain_name(name): joint for joint, name in enumerate(source.names)}
    chosen = dict(table.pairs)
    for limb, whole in [] if person is None else _limbs(person):
        called = {
            joint: here
            for joint in limb
            if (here := found.get(plain_name(target.names[joint]), -1)) >= 0
            and here not in table.given
            and joint not in table.pairs
        }
        if len(called.keys() & set(whole)) >= 2:
            chosen |= called
            # what the tree says of this limb does not count beside that
            pairs = {there: here for there, here in pairs.items() if there not in limb}
    taken = {*chosen.values(), *table.none}
    rest = {there: here for there, here in pairs.items() if there not in chosen and here not in taken}
    return chosen | rest


def _limbs(person: Person) -> list[tuple[list[int], tuple[int, ...]]]:
    """The joints of each limb, with clavicle and toes and without."""
    sides: tuple[Side, Side] = ("left", "right")
    return [
        (
            [person.parts[side, part] for part in names if (side, part) in person.parts],
            person.limb(side, kind),
        )
        for side in sides
        for kind, names in LIMBS.items()
    ]
