"""The cover of maximal rigid sets: the maximal cliques of a relation between markers."""

import numpy as np
from jaxtyping import Bool, Float

#: more sets than this are not listed; a relation of markers that all but stand still can have 3^(M/3)
LIMIT = 4000


def maximal_sets(
    related: Bool[np.ndarray, "M M"], deviations: Float[np.ndarray, "M M"], limit: int = LIMIT
) -> list[tuple[int, ...]]:
    """All maximal sets of markers of which every two are related (Bron and Kerbosch 1973, with the
    pivot of Tomita et al. 2006), the biggest first, of equal ones the one that deviates least.

    Where there are more than `limit`, only those are listed that grow from a marker by the one that
    deviates least from all inside.
    """
    around = [set(np.flatnonzero(row).tolist()) - {i} for i, row in enumerate(related)]
    found: list[tuple[int, ...]] = []
    stack: list[tuple[list[int], set[int], set[int]]] = [([], set(range(len(related))), set())]
    while stack and len(found) <= limit:
        inside, open_, done = stack.pop()
        if not open_:
            if not done:
                found.append(tuple(sorted(inside)))
            continue
        pivot = max(sorted(open_ | done), key=lambda v: len(around[v] & open_))
        for marker in sorted(open_ - around[pivot]):
            stack.append(([*inside, marker], open_ & around[marker], done & around[marker]))
            open_ = open_ - {marker}
            done = done | {marker}
    if len(found) > limit:
        found = list({_grown(start, around, deviations) for start in range(len(related))})
    return sorted(found, key=lambda some: (-len(some), _spread(some, deviations)))


def _grown(start: int, around: list[set[int]], deviations: np.ndarray) -> tuple[int, ...]:
    inside, open_ = [start], set(around[start])
    while open_:
        rest = sorted(open_)
        worst = deviations[np.ix_(rest, inside)].max(1)
        inside.append(rest[int(np.argmin(worst))])
        open_ &= around[inside[-1]]
    return tuple(sorted(inside))


def _spread(some: tuple[int, ...], deviations: np.ndarray) -> float:
    return float(deviations[np.ix_(some, some)].sum())
