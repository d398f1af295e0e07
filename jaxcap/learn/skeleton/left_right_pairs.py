"""Detection of left-right joint pairs from the tree, its bone lengths and its part areas alone."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...body.skeleton import Skeleton
from ...geometry.mesh import box_diagonal

#: absolute log ratio of two bone lengths and of two part areas that counts as one unit of dissimilarity
LENGTH, AREA = 0.25, 0.5
#: the largest mean dissimilarity of a pair, and the factor by which that of any other match of either must be
#: larger
MAX_DISSIMILARITY, MIN_RIVAL_RATIO = 1.0, 1.5
#: share of the area of two branches from which an unmatched branch counts fully
UNMATCHED_SHARE = 0.1
#: dissimilarities below this are not distinguished
MIN_DISSIMILARITY = 0.1


class _Match(NamedTuple):
    """The dissimilarity of two branches."""

    #: sum of squared dissimilarities over their joints, and the number of terms
    dissimilarity: float
    num_terms: float
    pairs: tuple[tuple[int, int], ...]

    @property
    def mean(self) -> float:
        return float(np.sqrt(self.dissimilarity / self.num_terms))


def detect_left_right_pairs(skeleton: Skeleton, areas: Float[np.ndarray, "J"]) -> Int[np.ndarray, "P 2"]:
    """Find pairs of joints that mirror each other, the lesser index first.

    Two branches of one joint are a pair if they match joint by joint in pose-invariant properties: the
    lengths of their bones, the distance from the parent joint, and the areas of their parts. Only unambiguous
    pairs are returned: a pair must match, and match better than either branch matches any other.

    **Arguments:** `areas (J,)` of the surface parts in any unit.
    """
    centres = np.asarray(skeleton.centres, float)
    areas = np.asarray(areas, float)
    children = [
        [k for k, parent in enumerate(skeleton.parents) if parent == j] for j in range(skeleton.num_joints)
    ]
    lengths = np.array(
        [np.linalg.norm(centres[j] - centres[p]) if p >= 0 else 0.0 for j, p in enumerate(skeleton.parents)]
    )
    floor = 0.02 * box_diagonal(centres)
    found: list[tuple[int, int]] = []
    for siblings in children:
        found += _siblings(siblings, children, np.maximum(lengths, floor), np.maximum(areas, 1e-12))
    return np.array(sorted(found), int).reshape(-1, 2)


def _siblings(branches: list[int], children, lengths, areas) -> list[tuple[int, int]]:
    """Find the unambiguous pairs among the branches of one joint, best first."""
    matches = {
        (a, b): _match(a, b, children, lengths, areas)
        for i, a in enumerate(branches)
        for b in branches[i + 1 :]
    }
    found = []
    taken: set[int] = set()
    for (a, b), match in sorted(matches.items(), key=lambda item: item[1].mean):
        if match.mean > MAX_DISSIMILARITY or taken & {a, b}:
            continue
        rivals = [
            other.mean
            for pair, other in matches.items()
            if pair != (a, b) and {a, b} & set(pair) and not taken & set(pair)
        ]
        if min(rivals, default=np.inf) < MIN_RIVAL_RATIO * max(match.mean, MIN_DISSIMILARITY):
            continue
        taken |= {a, b}
        found += [(min(pair), max(pair)) for pair in match.pairs]
    return found


def _match(a: int, b: int, children, lengths, areas) -> _Match:
    """Compute the dissimilarity of two branches, including the best match of their own branches.

    A branch without a partner counts by its share of the area.
    """
    doubt = (np.log(lengths[a] / lengths[b]) / LENGTH) ** 2 + (np.log(areas[a] / areas[b]) / AREA) ** 2
    terms, pairs = 2.0, [(a, b)]
    ours, theirs = list(children[a]), list(children[b])
    while ours and theirs:
        options = [(_match(p, q, children, lengths, areas), p, q) for p in ours for q in theirs]
        best, p, q = min(options, key=lambda option: option[0].mean)
        doubt, terms = doubt + best.dissimilarity, terms + best.num_terms
        pairs += best.pairs
        ours.remove(p)
        theirs.remove(q)
    # an unmatched branch counts as one twice as large as its partner, unless it is a small share of the whole
    alone = sum(_whole(j, children, areas) for j in ours + theirs)
    share = min(1.0, alone / (UNMATCHED_SHARE * (_whole(a, children, areas) + _whole(b, children, areas))))
    lonely = share * (len(ours) + len(theirs))
    return _Match(doubt + lonely * 2 * (np.log(2) / LENGTH) ** 2, terms + 2 * lonely, tuple(pairs))


def _whole(joint: int, children, areas) -> float:
    """Return the area of a branch."""
    return float(areas[joint]) + sum(_whole(child, children, areas) for child in children[joint])
