"""Find the arms and legs of a skeleton: chains of three joints, by names and by the kinematic tree.

Every chain of three joints, each below the one before, gets a score as a leg and as an arm. It depends on the
names, the ratio of the lengths of its two bones, and its total length. A limb has a counterpart on the other
side with bones of the same lengths, so limbs are chosen in pairs, and legs together with arms. Lengths are
measured along the bones, so they do not depend on the pose, and joint names may be unknown.
"""

from itertools import combinations
from typing import NamedTuple

import numpy as np

from ..skeleton import Skeleton
from .names import ARM, LEG, JointName, Side

#: points for a name that states the part, that probably states it, that may state it, and that states another
CERTAIN, LIKELY, POSSIBLE, CONTRADICTED = 3.0, 2.5, 1.5, -4.0
#: points for a helper joint, and for a joint that is skipped
HELPER_SCORE, SKIPPED_SCORE = -3.0, -1.0
#: largest excess of the upper and of the lower bone of a limb over the other without penalty, as logarithms,
#: and the penalty beyond; the lower bone of a person's limb is rarely longer
MAX_UPPER_EXCESS, MAX_LOWER_EXCESS, EXCESS_PENALTY = 0.4, 0.1, 4.0
#: largest penalty for the lengths of a limb's bones, as a share of the points of its names
MAX_LENGTH_PENALTY = 0.5
#: least points by names of a limb without a counterpart, and least score of each limb of a pair without known
#: names
MIN_SINGLE_SCORE, MIN_UNNAMED_SCORE = 5.0, -1.2
#: margin in points over all others that the limbs of a body without names need
MIN_MARGIN = 0.3
#: largest number of joints from the first of a limb to its last
MAX_LIMB_JOINTS = 24
#: largest number of chains of each type, and of pairs of them, that are compared
MAX_CHAINS, MAX_PAIRS = 40, 12


class Limb(NamedTuple):
    """An arm or a leg, as joints of the skeleton."""

    #: thigh, shin and foot; or upper arm, forearm and hand
    joints: tuple[int, int, int]
    #: side by the names
    side: Side | None
    #: points by names, and in total
    name_score: float
    score: float


class Limbs(NamedTuple):
    """The limbs of a skeleton: none, one or two of each type; the order of two limbs without sides has no
    meaning."""

    legs: tuple[Limb, ...]
    arms: tuple[Limb, ...]


def find_limbs(skeleton: Skeleton, names: list[JointName]) -> Limbs:
    """Find legs and arms of a skeleton with the `names` of its joints as `parse_joint_name` reads them."""
    ancestors = _ancestors(skeleton)
    centres = np.asarray(skeleton.centres, float)
    parents = np.array(skeleton.parents)
    steps = np.linalg.norm(centres - centres[np.maximum(parents, 0)], axis=1)
    along = np.zeros(len(steps))
    for joint, parent in enumerate(parents):
        along[joint] = 0.0 if parent < 0 else along[parent] + steps[joint]
    twins = _have_counterparts(skeleton, along)
    chains = {kind: _candidate_chains(ancestors, along, names, twins, kind) for kind in (LEG, ARM)}
    pairs = {kind: _pair_chains(chains[kind], along, ancestors) for kind in (LEG, ARM)}
    scored = [
        (_score_limbs(legs, arms, along, ancestors), Limbs(legs or (), arms or ()))
        for legs in (*pairs[LEG], None)
        for arms in (*pairs[ARM], None)
    ]
    score, best = max(scored, key=lambda item: item[0])
    if score <= 0:
        best = Limbs((), ())
    rivals = [other for points, other in scored if points > max(score - MIN_MARGIN, 0.0)]
    kept = Limbs(*(_keep_if_unambiguous(best[kind], [other[kind] for other in rivals]) for kind in (0, 1)))
    return _add_single_limb(kept, chains, ancestors)


def _keep_if_unambiguous(limbs: tuple[Limb, ...], rivals: list[tuple[Limb, ...]]) -> tuple[Limb, ...]:
    """Keep the limbs, unless no name supports them and other limbs are as likely."""
    if any(limb.name_score > 0 for limb in limbs):
        return limbs
    own = {limb.joints for limb in limbs}
    return () if any({limb.joints for limb in other} != own for other in rivals) else limbs


def lowest_common(skeleton: Skeleton, joints: list[int]) -> int:
    """Find the lowest common ancestor of some joints; -1 if there is none."""
    descent = skeleton.descendants[:, joints].all(axis=1)
    common = np.flatnonzero(descent)
    return int(common[np.argmax(skeleton.depths[common])]) if len(common) else -1


def _ancestors(skeleton: Skeleton) -> list[list[int]]:
    """List the ancestors of each joint, the root first, and the joint itself."""
    found: list[list[int]] = []
    for joint, parent in enumerate(skeleton.parents):
        found.append([*(found[parent] if parent >= 0 else []), joint])
    return found


def _have_counterparts(skeleton: Skeleton, root_distances: np.ndarray) -> np.ndarray:
    """Mark joints for which another joint has the same depth and distance from the root, (J,).

    This holds for joints of limbs, and not for those of the trunk.
    """
    depths = skeleton.depths
    near = np.abs(root_distances[:, None] - root_distances) < 0.1 * np.maximum(
        root_distances[:, None], root_distances
    )
    alike = (depths[:, None] == depths) & near & ~np.eye(len(root_distances), dtype=bool)
    return alike.any(axis=1)


def _name_score(name: JointName, part: str) -> float:
    points = HELPER_SCORE if name.helper else 0.0
    if part in name.parts:
        first = CERTAIN if len(name.parts) == 1 else LIKELY
        return points + (first if name.parts[0] == part else POSSIBLE)
    return points + (CONTRADICTED if name.parts else 0.0)


def _candidate_chains(
    ancestors, root_distances, names: list[JointName], has_counterpart, kind: tuple[str, ...]
) -> list[Limb]:
    """Find candidate chains for limbs, the best first."""
    points = {part: [_name_score(name, part) for name in names] for part in kind}
    found: list[Limb] = []
    reach = np.zeros(len(names))
    for last, above in enumerate(ancestors):
        reach[above] = np.maximum(reach[above], root_distances[last] - root_distances[above])

    def between(above: list[int], first: int, last: int) -> list[int]:
        return above[above.index(first) + 1 : above.index(last)]

    def passed(above: list[int], first: int, last: int, part: str) -> int:
        joints = between(above, first, last)
        return sum(part not in names[joint].parts and not names[joint].helper for joint in joints)

    for last, above in enumerate(ancestors):
        # a joint named as another part cannot end such a limb
        if points[kind[2]][last] <= CONTRADICTED:
            continue
        for first, middle in combinations(above[-MAX_LIMB_JOINTS:-1], 2):
            if points[kind[0]][first] <= CONTRADICTED or points[kind[1]][middle] <= CONTRADICTED:
                continue
            # a joint named as the hip's side is the thigh only if the knee is its child, up to helper joints
            if "hip_side" in names[first].parts and not all(
                names[joint].helper for joint in between(above, first, middle)
            ):
                continue
            upper, lower = (
                root_distances[middle] - root_distances[first],
                root_distances[last] - root_distances[middle],
            )
            if min(upper, lower) < 1e-6 or max(upper, lower) > 5 * min(upper, lower):
                continue
            sides: set[Side] = {
                side for joint in (first, middle, last) if (side := names[joint].side) is not None
            }
            if len(sides) == 2:
                continue
            named = points[kind[0]][first] + points[kind[1]][middle] + points[kind[2]][last]
            if named <= 0 and not has_counterpart[[first, middle, last]].all():
                continue
            # less than half of a limb lies beyond a hand or a foot, unless it carries an object
            beyond = min(max(0.0, reach[last] / (upper + lower) - 0.5), 0.5)
            skipped = passed(above, first, middle, kind[0]) + passed(above, middle, last, kind[1])
            ratio = np.log(upper / lower)
            uneven = EXCESS_PENALTY * max(0.0, ratio - MAX_UPPER_EXCESS, -ratio - MAX_LOWER_EXCESS)
            # if the bone lengths contradict ambiguous names this strongly, another joint is the middle one
            if named > 0 and uneven > MAX_LENGTH_PENALTY * named:
                continue
            score = named + SKIPPED_SCORE * skipped - EXCESS_PENALTY * beyond - uneven
            found.append(Limb((first, middle, last), next(iter(sides), None), named, float(score)))
    if not found:
        return []
    longest = max(root_distances[limb.joints[2]] - root_distances[limb.joints[0]] for limb in found)
    sized = [
        limb._replace(
            score=limb.score
            + np.log((root_distances[limb.joints[2]] - root_distances[limb.joints[0]]) / longest)
        )
        for limb in found
    ]
    return sorted(sized, key=lambda limb: -limb.score)[:MAX_CHAINS]


def _pair_chains(chains: list[Limb], root_distances, ancestors) -> list[tuple[Limb, Limb]]:
    """Pair chains that are each other's counterpart, the best first, left before right if the names give
    sides."""
    found = []
    for a, b in combinations(chains, 2):
        if a.joints[0] in ancestors[b.joints[2]] or b.joints[0] in ancestors[a.joints[2]]:
            continue
        if ancestors[a.joints[0]][0] != ancestors[b.joints[0]][0] or (
            a.side == b.side and a.side is not None
        ):
            continue
        score = a.score + b.score + (1.0 if a.side and b.side else -1.0 if a.side or b.side else 0.0)
        for first, last in ((0, 1), (1, 2)):
            lengths = [
                root_distances[limb.joints[last]] - root_distances[limb.joints[first]] for limb in (a, b)
            ]
            score -= EXCESS_PENALTY * abs(np.log(lengths[0] / lengths[1]))
        if min(a.name_score, b.name_score) <= 0.0 and min(a.score, b.score) < MIN_UNNAMED_SCORE:
            continue
        found.append((float(score), (b, a) if a.side == "right" or b.side == "left" else (a, b)))
    return [pair for _, pair in sorted(found, key=lambda item: -item[0])][:MAX_PAIRS]


def _score_limbs(legs, arms, root_distances, ancestors) -> float:
    """Score a pair of legs and a pair of arms of one body; either may be missing."""
    if legs is None or arms is None:
        only = legs or arms
        # one pair alone needs names, as two similar chains may be anything
        return (
            0.0
            if only is None or min(limb.name_score for limb in only) < MIN_SINGLE_SCORE
            else sum(limb.score for limb in only)
        )
    for leg in legs:
        for arm in arms:
            if leg.joints[0] in ancestors[arm.joints[2]] or arm.joints[0] in ancestors[leg.joints[2]]:
                return 0.0
    lengths = [
        sum(root_distances[limb.joints[2]] - root_distances[limb.joints[0]] for limb in pair)
        for pair in (legs, arms)
    ]
    # legs are longer than arms
    short = max(0.0, float(np.log(lengths[1] / lengths[0])) + 0.1)
    return 10.0 + sum(limb.score for limb in (*legs, *arms)) - EXCESS_PENALTY * short


def _add_single_limb(limbs: Limbs, chains, ancestors) -> Limbs:
    """Add a leg or an arm that has no counterpart, if its names are certain."""
    taken = [limb for pair in limbs for limb in pair]
    found = list(limbs)
    for place, kind in enumerate((LEG, ARM)):
        if found[place]:
            continue
        for chain in chains[kind]:
            free = all(
                chain.joints[0] not in ancestors[t.joints[2]]
                and t.joints[0] not in ancestors[chain.joints[2]]
                for t in taken
            )
            if free and chain.name_score >= MIN_SINGLE_SCORE and chain.side:
                found[place] = (chain,)
                taken.append(chain)
                break
    return Limbs(found[0], found[1])
