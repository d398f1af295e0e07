"""Agglomerative clustering by rigid errors, with the whole curve of the error over the number of parts."""

import heapq
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...geometry.procrustes import Moments, rigid_errors


class Dendrogram(NamedTuple):
    """The sequence of merges of N sets into one; each merges the neighbours whose union costs least."""

    #: (N - 1, 2): the set that remains, and the one merged into it
    merges: Int[np.ndarray, "M 2"]
    #: (N,) total error with 1, 2, ... N sets
    errors: Float[np.ndarray, "N"]


def agglomerate(moments: Moments, neighbours: Int[np.ndarray, "B 2"]) -> Dendrogram:
    """Merge neighbouring sets by Ward's method, with the exact rigid error over all frames as the cost.

    **Arguments:** `moments` of N sets; `neighbours` are pairs of adjacent sets, which must connect all of
    them. **Source:** Ward 1963; the error of a union follows from summed moments.
    """
    count = len(moments.mass)
    moments = Moments(*(field.copy() for field in moments))
    around = [set() for _ in range(count)]
    for a, b in np.unique(np.sort(neighbours, axis=1), axis=0):
        around[a].add(int(b))
        around[b].add(int(a))
    errors = rigid_errors(moments)
    total = [float(errors.sum())]
    age = np.zeros(count, int)
    pairs = np.array([(a, b) for a in range(count) for b in around[a] if a < b], int).reshape(-1, 2)
    heap: list[tuple[float, int, int, int, int]] = []
    _push(heap, moments, errors, age, pairs)
    steps = []
    while len(steps) < count - 1:
        gain, a, b, age_a, age_b = heapq.heappop(heap)
        if age[a] != age_a or age[b] != age_b:
            continue
        for field in moments:
            field[a] += field[b]
        steps.append((a, b))
        total.append(total[-1] + gain)
        errors[a] += errors[b] + gain
        around[a] |= around[b]
        around[a] -= {a, b}
        for other in around[b]:
            around[other].discard(b)
            if other != a:
                around[other].add(a)
        age[a] += 1
        age[b] = -1
        _push(heap, moments, errors, age, np.array([(a, other) for other in sorted(around[a])], int))
    return Dendrogram(np.array(steps, int).reshape(-1, 2), np.maximum(total[::-1], 0.0))


def merged_labels(merging: Dendrogram, count: int) -> Int[np.ndarray, "N"]:
    """Return the label, 0 to `count` - 1, of each of the N initial sets when `count` sets are left."""
    size = len(merging.errors)
    owner = np.arange(size)
    for a, b in merging.merges[: size - count]:
        owner[owner == b] = a
    return np.unique(owner, return_inverse=True)[1]


def _push(heap: list, moments: Moments, errors: np.ndarray, age: np.ndarray, pairs: np.ndarray) -> None:
    if len(pairs) == 0:
        return
    a, b = pairs.T
    gains = rigid_errors(moments.at(a).plus(moments.at(b))) - errors[a] - errors[b]
    for gain, i, j in zip(gains.tolist(), a.tolist(), b.tolist(), strict=True):
        heapq.heappush(heap, (gain, i, j, int(age[i]), int(age[j])))
