"""Maximal rigid sets of markers: the maximal cliques of a relation between markers."""

import numpy as np
from jaxtyping import Bool, Float

#: largest number of sets that are enumerated; a relation of nearly static markers can have 3^(M/3)
MAX_CLIQUES = 4000


def maximal_cliques(
    related: Bool[np.ndarray, "M M"], deviations: Float[np.ndarray, "M M"], max_cliques: int = MAX_CLIQUES
) -> list[tuple[int, ...]]:
    """Enumerate the maximal cliques of related markers, the largest first, ties by least deviation.

    Algorithm of Bron and Kerbosch (1973) with the pivot of Tomita et al. (2006). If there are more than
    `max_cliques`, only greedy cliques are returned: from each marker one that grows by the marker with the least
    deviation from all its members.
    """
    around = [set(np.flatnonzero(row).tolist()) - {i} for i, row in enumerate(related)]
    found: list[tuple[int, ...]] = []
    stack: list[tuple[list[int], set[int], set[int]]] = [([], set(range(len(related))), set())]
    while stack and len(found) <= max_cliques:
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
    if len(found) > max_cliques:
        found = list({_grow_clique(start, around, deviations) for start in range(len(related))})
    return sorted(found, key=lambda some: (-len(some), _total_deviation(some, deviations)))


def _grow_clique(start: int, neighbours: list[set[int]], deviations: np.ndarray) -> tuple[int, ...]:
    inside, open_ = [start], set(neighbours[start])
    while open_:
        rest = sorted(open_)
        worst = deviations[np.ix_(rest, inside)].max(1)
        inside.append(rest[int(np.argmin(worst))])
        open_ &= neighbours[inside[-1]]
    return tuple(sorted(inside))


def _total_deviation(clique: tuple[int, ...], deviations: np.ndarray) -> float:
    return float(deviations[np.ix_(clique, clique)].sum())
