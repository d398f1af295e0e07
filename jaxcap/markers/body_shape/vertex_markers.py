"""Vertices of a body as markers of a motion."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from ...arguments import checked
from ...body.body import Body, posed_vertices, take_vertices
from ...body.pose import Motion
from ...observe.markers import MarkerFrames, make_markers


@checked
def vertex_frames(body: Body, motion: Motion, vertices: Sequence[int], labels: Sequence[str]) -> MarkerFrames:
    """Compute the positions of some vertices in every frame as markers with the given labels.

    **Raises:** `InputError` where labels are too many, too few, empty or repeated; `ValueError` where the
    body has no such vertex, or the motion other joints.
    """
    count = len(body.vertices)
    wrong = [vertex for vertex in vertices if not 0 <= vertex < count]
    if wrong:
        raise ValueError(f"There is no vertex {wrong[0]}; the body has the vertices 0 to {count - 1}.")
    chosen = jnp.asarray(vertices, int)
    positions = posed_vertices(take_vertices(body, chosen), motion.poses)
    return make_markers(np.asarray(positions), labels, motion.rate)
