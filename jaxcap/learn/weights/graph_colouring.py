"""Graph colouring of vertices: vertices of one colour are not coupled by the metric, and can be updated at
once."""

import functools

import numpy as np
from jaxtyping import Int

from ...geometry.laplacian import Conformance


def colour_vertices(metric: Conformance) -> Int[np.ndarray, "V"]:
    """Colour the vertices so that `A_uv = 0` between any two of one colour.

    Such vertices are neither neighbours nor have a common neighbour. The greedy method gives each vertex the
    least used of the allowed colours, so that colours have similar sizes: some twenty for a usual mesh. The
    result is cached for the next call with the same mesh.
    """
    neighbours = np.ascontiguousarray(metric.neighbours, np.int32)
    return _colours(neighbours.tobytes(), neighbours.shape[1])


@functools.lru_cache(maxsize=4)
def _colours(data: bytes, width: int) -> Int[np.ndarray, "V"]:
    neighbours = np.frombuffer(data, np.int32).reshape(-1, width)
    colours = np.full(len(neighbours), -1)
    sizes = np.zeros(0, int)
    for vertex, ring in enumerate(neighbours):
        taken = colours[np.append(neighbours[ring], ring)]
        open_to = np.ones(len(sizes) + 1, bool)
        open_to[taken[taken >= 0]] = False
        # the last entry is a new colour
        choices = np.flatnonzero(open_to[:-1])
        if choices.size == 0:
            choices, sizes = np.array([len(sizes)]), np.append(sizes, 0)
        colours[vertex] = choices[np.argmin(sizes[choices])]
        sizes[colours[vertex]] += 1
    colours.setflags(write=False)
    return colours


def within_two_rings(metric: Conformance, marked: np.ndarray) -> np.ndarray:
    """Mark the vertices that the metric couples to a marked one, including those, `(V,)` of bool."""
    neighbours = np.asarray(metric.neighbours)
    once = marked | marked[neighbours].any(1)
    return once | once[neighbours].any(1)
