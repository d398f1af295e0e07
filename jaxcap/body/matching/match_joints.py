"""Match the joints of two skeletons."""

from collections.abc import Mapping
from itertools import pairwise

from ...arguments import checked
from ...errors import user_message
from ..pose import Motion
from ..skeleton import Skeleton
from .joint_matches import JointMatches, UnmatchedJoints, initial_name_table
from .name_table import (
    Table,
    initial_pairs,
    known_limb_sides,
    known_source_names,
    known_target_names,
    make_table,
    override_roles,
)
from .names import Side
from .pairing import SIDES, follow_twist_joints, pair_equal_names, pair_joints
from .person_joints import PersonJoints, identify_joints
from .sides import UnknownSides, swap_sides, toes_point_backward
from .upright_pose import find_upright_pose

#: least number of matched joints
MIN_MATCHES = 3
#: number of unmatched joints that an error lists
MAX_LISTED = 12


@checked
def match_joints(
    source: Skeleton,
    target: Skeleton,
    names: Mapping[str, str | None] | None = None,
    *,
    motion: Motion | None = None,
) -> JointMatches:
    """Match the joints of two skeletons, by the names of many programs and by their kinematic trees.

    Arms and legs are chains of three joints whose bones are about equally long, with a counterpart on the
    other side. Known names have priority over lengths. Spine and neck are matched from the hips to the head;
    if their numbers of joints differ, joints share rotations. Remaining joints match if their names are equal
    and their ancestors match.

    **Arguments:** `names` maps joints of the source to those of the target, or to None for a joint that has
    no match. It overrides names and trees for these joints, and also identifies the limbs to which they
    belong. `motion` of the source is for files whose rest pose is not that of a person.

    **Raises:** `UnmatchedJoints`, a `ValueError`, if both arms or both legs have no match, fewer than three
    joints match, or left and right cannot be determined. `ValueError` for a name that a skeleton does not
    have, two joints for one, a limb of the table whose joints are not a chain, or if the person stands
    neither at rest nor in the motion.
    """
    table = make_table(source, target, names or {})
    there = identify_joints(target, known_target_names(source, target, table))
    here = _find_source_person(source, target, there, table)
    try:
        stood = find_upright_pose(target, there, None, "target", known_limb_sides(there, table))
        there = stood.person
        here = _find_source_person(source, target, there, table)
        stands = find_upright_pose(source, here, motion, "source", known_limb_sides(there, table)), stood
    except UnknownSides as error:
        persons = _resolve_contradiction(here, error), there
        raise _make_error(
            user_message(error), (source, target), persons, table, use_equal_names=not error.swapped
        ) from None
    here = stands[0].person
    pairs, followed = pair_joints(here, there, table)
    pair_equal_names(source, target, pairs, followed, table)
    follow_twist_joints(source, there, pairs, followed)
    found = JointMatches(source, target, pairs, followed, stands, ())
    if len(pairs) < MIN_MATCHES:
        sentence = (
            f"{len(pairs)} joints of the source ({', '.join(source.names)}) match a joint of the target "
            f"({', '.join(target.names)}), expected at least {MIN_MATCHES}; give a table of names from source to target."
        )
        raise _make_error(sentence, (source, target), (here, there), table, pairs)
    _check_chains(found, table)
    return found._replace(warnings=(*_check_facing(found, table), *_check_limbs(found, table)))


def _find_source_person(
    source: Skeleton, target: Skeleton, target_person: PersonJoints, table: Table
) -> PersonJoints:
    """Find the person of the source by names, tree and table."""
    return override_roles(
        identify_joints(source, known_source_names(target, target_person, table)), target_person, table
    )


def _resolve_contradiction(person: PersonJoints, error: UnknownSides) -> PersonJoints:
    """Exchange the sides of a person if they are swapped; remove the limbs if the sides are unknown."""
    return swap_sides(person) if error.swapped else person._replace(parts={}, fingers={})


def _make_error(
    sentence: str,
    skeletons: tuple[Skeleton, Skeleton],
    persons: tuple[PersonJoints, PersonJoints],
    table: Table,
    pairs: Mapping[int, int] | None = None,
    *,
    use_equal_names: bool = True,
) -> UnmatchedJoints:
    """Make an error that includes an initial table."""
    found = pair_joints(*persons, table)[0] if pairs is None else pairs
    chosen = initial_pairs(*skeletons, persons[1] if use_equal_names else None, found, table)
    return UnmatchedJoints(sentence, *initial_name_table(*skeletons, chosen, table.none))


def _check_chains(matches: JointMatches, table: Table) -> None:
    """Check that the joints of limbs in a table are chains. Raises `ValueError`."""
    person, names = matches.references[1].person, matches.source.names
    for side in SIDES:
        for kind in ("leg", "arm"):
            limb = person.limb(side, kind)
            own = [matches.pairs[joint] for joint in limb if joint in matches.pairs]
            if not set(limb) & set(table.pairs):
                continue
            for above, below in pairwise(own):
                if not matches.source.descendants[above, below]:
                    raise ValueError(
                        f"By the table of names, {', '.join(names[joint] for joint in own)} are the {side} {kind}, but "
                        f"{names[below]} is not a descendant of {names[above]}; correct the table."
                    )


def _check_facing(matches: JointMatches, table: Table) -> list[str]:
    """Warn if the sides of a table contradict the direction of the toes."""
    looks = [
        toes_point_backward(upright.person, upright.positions, upright.axes) for upright in matches.references
    ]
    if not table.pairs or looks[0] == looks[1]:
        return []
    return [
        "the table of names and the toes disagree on left and right, so left and right of the motion are exchanged "
        "unless the file is mirrored"
    ]


def _check_limbs(matches: JointMatches, table: Table) -> list[str]:
    """Warn of limbs without a match.

    **Raises:** `UnmatchedJoints` if no arm or no leg has one, unless a table is given and no source joint
    that could belong to one remains.
    """
    here, there = (upright.person for upright in matches.references)
    said = []
    for kind in ("arm", "leg"):
        own: list[Side] = [side for side in SIDES if here.limb(side, kind)]
        sides: list[Side] = [side for side in SIDES if there.limb(side, kind)]
        matched = [side for side in sides if set(there.limb(side, kind)) <= set(matches.pairs)]
        if matched:
            said += [
                f"the {side} {kind} of the target has no match in the source and stays at rest"
                for side in sides
                if side not in matched
            ]
            said += [
                f"the {side} {kind} of the source is left out, as the target has none"
                for side in own
                if side not in sides
            ]
        elif sides or (own and len(matches.unmatched_target) >= MIN_MATCHES):
            whose, other = ("target", "source") if sides else ("source", "target")
            sentence = f"no {kind} of the {whose} has a match in the {other}"
            left = list(matches.unmatched_source)
            if left or not table.source_joints:
                raise _make_error(
                    f"N{sentence[1:]}, neither by names nor by the tree{' nor by the table' if table.source_joints else ''}; "
                    f"joints of the source without a match: {', '.join(left[:MAX_LISTED]) or 'none'}; give the matching joints "
                    "in a table of names.",
                    (matches.source, matches.target),
                    (here, there),
                    table,
                    matches.pairs,
                )
            said.append(f"{sentence} by the table of names")
        elif own:
            said.append(f"the {kind}s of the source are left out, as the target has none")
    return said
