"""Match the joints of two skeletons."""

from collections.abc import Iterable, Mapping

import numpy as np

from ...body.pose import Motion
from ...body.skeleton import Skeleton
from .matches import JointMatches, UnmatchedJoints
from .names import ARM, LEG, Side, plain_name
from .person import LIMBS, Person, find_person
from .reference import find_reference

#: so many joints match at least
LEAST = 3
SIDES: tuple[Side, Side] = ("left", "right")
#: joints without a match that a refusal lists
SAID = 12
#: a joint that is nearer to the end of an upper arm or thigh, as a share of its length, is not on the bone but of the next joint
ON_BONE = 0.05


def match_joints(
    source: Skeleton,
    target: Skeleton,
    names: Mapping[str, str | None] | None = None,
    *,
    motion: Motion | None = None,
) -> JointMatches:
    """Match the joints of two skeletons, by the names of many programs and by their trees.

    Arms and legs are chains of three joints whose bones are about equally long, with a twin on the other side; names decide where they are known, and
    lengths where they are not. Spine and neck are matched from the hips to the head; where their numbers of joints differ, joints share rotations.
    Whatever is left matches where it is called alike and hangs on joints that match.

    **Arguments:** `names` leads from joints of the source to those of the target, or to None; where it is given nothing else matches. `motion` of
    the source is for files whose rest pose is not that of a person.

    **Raises:** `UnmatchedJoints`, a `ValueError`, where both arms or both legs have no match, or fewer than three joints match; `ValueError` for a
    name that a skeleton does not have, or two joints for one, or where neither rest nor motion shows how the person stands.
    """
    persons = find_person(source), find_person(target)
    if names is not None:
        pairs = _named(source, target, names)
        there = find_reference(target, persons[1], None, "target")
        here = find_reference(source, _carried(there.person, pairs), motion, "source")
        followed = {joint: (match, match, 0.0) for joint, match in pairs.items()}
    else:
        stands = (
            find_reference(source, persons[0], motion, "source"),
            find_reference(target, persons[1], None, "target"),
        )
        here, there = stands
        pairs, followed = _matched(here.person, there.person)
        _called_alike(source, target, pairs, followed)
    _to_the_end_of_bones(source, there.person, pairs, followed)
    found = JointMatches(source, target, pairs, followed, (here, there), ())
    if len(pairs) < LEAST:
        raise UnmatchedJoints(
            f"{len(pairs)} joints of the source ({', '.join(source.names)}) match one of the target "
            f"({', '.join(target.names)}); say which do with a table of names from source to target.",
            found.names,
        )
    return found._replace(warnings=tuple(_check_limbs(found, names is not None)))


def _named(source: Skeleton, target: Skeleton, names: Mapping[str, str | None]) -> dict[int, int]:
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
    return pairs


def _carried(person: Person, pairs: Mapping[int, int]) -> Person:
    """The person of the target in the source, by the joints that match."""

    def own(joint: int) -> int:
        return pairs.get(joint, -1)

    def chain(joints: Iterable[int]) -> tuple[int, ...]:
        return tuple(own(joint) for joint in joints if own(joint) >= 0)

    limbs = {key: own(joint) for key, joint in person.parts.items()}
    parts = {}
    for kind, names in (("leg", LEG), ("arm", ARM)):
        for side in SIDES:
            if all(limbs.get((side, part), -1) >= 0 for part in names):
                kept = (*LIMBS[kind], "palm")
                parts |= {
                    (side, part): limbs[side, part] for part in kept if limbs.get((side, part), -1) >= 0
                }
    return Person(
        own(person.pelvis), chain(person.spine), chain(person.neck), own(person.head), parts, {}, ()
    )


def _matched(source: Person, target: Person) -> tuple[dict[int, int], dict[int, tuple[int, int, float]]]:
    pairs = {there: source.parts[key] for key, there in target.parts.items() if key in source.parts}
    if source.pelvis >= 0 and target.pelvis >= 0:
        pairs[target.pelvis] = source.pelvis
    if source.head >= 0 and target.head >= 0:
        pairs[target.head] = source.head
    for (side, finger, number), there in target.fingers.items():
        alike = [finger, *({"finger": ["middle", "index"], "thumb": []}.get(finger, ["finger"]))]
        here = [
            source.fingers[side, name, number] for name in alike if (side, name, number) in source.fingers
        ]
        if here:
            pairs[there] = here[0]
    followed = {there: (here, here, 0.0) for there, here in pairs.items()}
    if source.pelvis >= 0 and target.pelvis >= 0:
        spine = _shared([source.pelvis, *source.spine], target.spine)
        chest = source.spine[-1] if source.spine else source.pelvis
        if source.neck or source.head < 0 or target.head < 0:
            neck = _shared([chest, *source.neck], target.neck)
        else:
            steps = len(target.neck) + 1
            neck = {there: (chest, source.head, (k + 1) / steps) for k, there in enumerate(target.neck)}
        for there, (a, b, share) in {**spine, **neck}.items():
            followed[there] = (a, b, share)
            if share == 0.0:
                pairs[there] = a
    return pairs, followed


def _shared(source: list[int], target: tuple[int, ...]) -> dict[int, tuple[int, int, float]]:
    """Joints of a chain of the target as places along one of the source, whose first joint is above the target's chain; the last are the same."""
    count, found = len(source) - 1, {}
    for place, joint in enumerate(target if count else ()):
        along = (place + 1) * count / len(target)
        low = int(np.floor(along + 1e-9))
        share = max(along - low, 0.0)
        found[joint] = (
            (source[low], source[low], 0.0) if share < 1e-9 else (source[low], source[low + 1], share)
        )
    return found


def _called_alike(source: Skeleton, target: Skeleton, pairs: dict[int, int], followed) -> None:
    """Match what is left and called alike, where what it hangs on matches."""
    plain = {}
    for joint, name in enumerate(source.names):
        plain.setdefault(plain_name(name), []).append(joint)
    taken = set(pairs.values())
    called = [plain_name(name) for name in target.names]
    for joint, name in enumerate(called):
        here = plain.get(name, [])
        if joint in followed or len(here) != 1 or here[0] in taken or called.count(name) > 1:
            continue
        above = target.parents[joint]
        while above >= 0 and above not in pairs:
            above = target.parents[above]
        if above >= 0 and not source.descent[pairs[above], here[0]]:
            continue
        pairs[joint] = here[0]
        followed[joint] = (here[0], here[0], 0.0)
        taken.add(here[0])


def _to_the_end_of_bones(source: Skeleton, target: Person, pairs: Mapping[int, int], followed) -> None:
    """Let upper arms and thighs turn as the far ends of the source's bones do, where twist joints lie along them: then elbows and knees bend as much
    as the source's."""
    centres = np.asarray(source.centres, float)
    for side in SIDES:
        for kind in ("leg", "arm"):
            limb = target.limb(side, kind)
            if not limb or limb[0] not in pairs or limb[1] not in pairs:
                continue
            first, joint = pairs[limb[0]], source.parents[pairs[limb[1]]]
            end = centres[pairs[limb[1]]]
            while joint >= 0 and joint != first:
                if np.linalg.norm(end - centres[joint]) > ON_BONE * np.linalg.norm(end - centres[first]):
                    if source.descent[first, joint]:
                        followed[limb[0]] = (joint, joint, 0.0)
                    break
                joint = source.parents[joint]


def _check_limbs(matches: JointMatches, by_table: bool) -> list[str]:
    """Warnings of limbs without a match.

    **Raises:** `UnmatchedJoints` where no arm or no leg has one, unless a table says so.
    """
    here, there = (stand.person for stand in matches.stands)
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
        elif sides or (own and len(matches.unmatched_target) >= LEAST):
            whose, other = ("target", "source") if sides else ("source", "target")
            sentence = f"no {kind} of the {whose} has a match in the {other}"
            if not by_table:
                left = list(matches.unmatched_source)[:SAID]
                raise UnmatchedJoints(
                    f"N{sentence[1:]}, neither by names nor by the tree; joints of the source without a match: "
                    f"{', '.join(left) or 'none'}; say which joints match by a table of names.",
                    matches.names,
                )
            said.append(f"{sentence} by the table of names")
        elif own:
            said.append(f"the {kind}s of the source are left out, as the target has none")
    return said
