"""Pair the joints of two persons, and choose the source bones that the bones of the target follow."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..skeleton import Skeleton
from .name_table import Table
from .names import Side, normalise_name
from .person_joints import PersonJoints

SIDES: tuple[Side, Side] = ("left", "right")
#: a joint nearer than this share of the length to the end of an upper arm or thigh belongs to the next joint
MIN_END_DISTANCE = 0.05

#: joint of the target -> (a, b, share) of the source
Followed = dict[int, tuple[int, int, float]]


def pair_joints(source: PersonJoints, target: PersonJoints, table: Table) -> tuple[dict[int, int], Followed]:
    """Pair corresponding joints from target to source, and choose the source joints that each target joint
    follows.

    **Arguments:** `source` has the joints of the `table` at the roles that they have in the target.
    """
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
    given = table.source_joints
    pairs = {there: here for there, here in pairs.items() if here not in given and there not in table.pairs}
    pairs |= table.pairs
    followed = {there: (here, here, 0.0) for there, here in pairs.items()}
    taken = {*pairs.values(), *table.none}
    for there, (a, b, share) in _follow_trunk(source, target, table).items():
        if there in table.pairs:
            continue
        followed[there] = (a, b, share)
        if share == 0.0 and a not in taken:
            pairs[there] = a
            taken.add(a)
    return pairs, followed


def _follow_trunk(source: PersonJoints, target: PersonJoints, table: Table) -> Followed:
    """Choose the joints that the spine and the neck of the target follow."""
    if source.pelvis < 0 or target.pelvis < 0:
        return {}
    spine = _align_chains([source.pelvis, *source.spine], target.spine, table)
    chest = source.spine[-1] if source.spine else source.pelvis
    if source.neck or source.head < 0 or target.head < 0:
        return spine | _align_chains([chest, *source.neck], target.neck, table)
    steps = len(target.neck) + 1
    return spine | {there: (chest, source.head, (k + 1) / steps) for k, there in enumerate(target.neck)}


def _align_chains(source: Sequence[int], target: Sequence[int], table: Table) -> Followed:
    """Map joints of a target chain to positions along a source chain.

    The first source joint is above the target's chain. The last joints correspond, and so do those of the
    table.
    """
    count, found = len(source) - 1, {}
    if not count:
        return found
    known = {0: 0, len(target): count} | {
        place: source.index(table.pairs[joint])
        for place, joint in enumerate(target, 1)
        if table.pairs.get(joint) in source
    }
    places = sorted(known)
    # joints that the table pairs otherwise or excludes cannot be followed here
    closed = [joint in table.source_joints for joint in source]
    for place, joint in enumerate(target, 1):
        along = float(np.interp(place, places, [known[each] for each in places]))
        low = int(np.floor(along + 1e-9))
        share = max(along - low, 0.0)
        if share >= 1e-9:
            found[joint] = (source[low], source[low + 1], share)
            continue
        above = max((k for k in range(low) if not closed[k]), default=0)
        below = min((k for k in range(low + 1, count + 1) if not closed[k]), default=above)
        if not closed[low] or below == above:
            found[joint] = (source[low], source[low], 0.0)
        else:
            found[joint] = (source[above], source[below], (low - above) / (below - above))
    return found


def pair_equal_names(
    source: Skeleton, target: Skeleton, pairs: dict[int, int], followed: Followed, table: Table
) -> None:
    """Pair remaining joints of equal names, if their matched ancestors and descendants agree in both
    skeletons."""
    plain = {}
    for joint, name in enumerate(source.names):
        plain.setdefault(normalise_name(name), []).append(joint)
    taken = {*pairs.values(), *table.none}
    called = [normalise_name(name) for name in target.names]
    for joint, name in enumerate(called):
        here = plain.get(name, [])
        if joint in followed or len(here) != 1 or here[0] in taken or called.count(name) > 1:
            continue
        above = target.parents[joint]
        while above >= 0 and above not in pairs:
            above = target.parents[above]
        if above >= 0 and not source.descendants[pairs[above], here[0]]:
            continue
        if any(not source.descendants[here[0], own] for own in _matched_descendants(target, joint, pairs)):
            continue
        pairs[joint] = here[0]
        followed[joint] = (here[0], here[0], 0.0)
        taken.add(here[0])


def _matched_descendants(target: Skeleton, joint: int, pairs: Mapping[int, int]) -> list[int]:
    """List the source joints that match a descendant of a target joint."""
    return [here for there, here in pairs.items() if there != joint and target.descendants[joint, there]]


def follow_twist_joints(
    source: Skeleton, target: PersonJoints, pairs: Mapping[int, int], followed: Followed
) -> None:
    """Make upper arms and thighs follow the far ends of the source's bones if these have twist joints.

    Elbows and knees then bend as much as the source's.
    """
    centres = np.asarray(source.centres, float)
    for side in SIDES:
        for kind in ("leg", "arm"):
            limb = target.limb(side, kind)
            if not limb or limb[0] not in pairs or limb[1] not in pairs:
                continue
            first, joint = pairs[limb[0]], source.parents[pairs[limb[1]]]
            end = centres[pairs[limb[1]]]
            while joint >= 0 and joint != first:
                if np.linalg.norm(end - centres[joint]) > MIN_END_DISTANCE * np.linalg.norm(
                    end - centres[first]
                ):
                    if source.descendants[first, joint]:
                        followed[limb[0]] = (joint, joint, 0.0)
                    break
                joint = source.parents[joint]
