"""Triangle meshes as arrays: normals and areas."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int


def face_normals(vertices: Float[Array, "V 3"], faces: Int[Array, "F 3"]) -> Float[Array, "F 3"]:
    """Normals of the triangles, twice their area long; zero for a degenerate triangle."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return jnp.cross(b - a, c - a)


@partial(jax.jit, inline=True)
def vertex_normals(vertices: Float[Array, "V 3"], faces: Int[Array, "F 3"]) -> Float[Array, "V 3"]:
    """Unit normals at the vertices, each triangle counted by its area.

    A vertex of no triangle, or of degenerate ones only, has the zero vector for a normal.
    Differentiable also there.
    """
    across = face_normals(vertices, faces)
    total = jnp.zeros_like(vertices).at[faces.reshape(-1)].add(jnp.repeat(across, 3, axis=0))
    squared = jnp.sum(total * total, -1, keepdims=True)
    degenerate = squared < jnp.finfo(vertices.dtype).tiny
    return total / jnp.sqrt(jnp.where(degenerate, 1.0, squared))


def triangle_sides(faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "S 2"]:
    """The three sides of every triangle, along its own direction: all first ones, then all second, then
    all third."""
    faces = np.asarray(faces)
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def mesh_edges(faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "E 2"]:
    """Every pair of vertices that share a triangle, once, the lesser first, in rising order."""
    pairs = np.unique(np.sort(triangle_sides(faces), axis=1), axis=0)
    return pairs[pairs[:, 0] < pairs[:, 1]]
