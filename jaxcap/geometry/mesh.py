"""Triangle meshes as arrays: normals, edges and random points."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..arguments import checked


def face_normals(vertices: Float[Array, "V 3"], faces: Int[Array, "F 3"]) -> Float[Array, "F 3"]:
    """Compute normals of the triangles with twice their area as length; zero for a degenerate triangle."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return jnp.cross(b - a, c - a)


@partial(jax.jit, inline=True)
def vertex_normals(vertices: Float[Array, "V 3"], faces: Int[Array, "F 3"]) -> Float[Array, "V 3"]:
    """Compute unit normals at the vertices, weighted by triangle area.

    A vertex without triangles, or with degenerate ones only, has the zero vector as normal. Differentiable
    also there.
    """
    across = face_normals(vertices, faces)
    total = jnp.zeros_like(vertices).at[faces.reshape(-1)].add(jnp.repeat(across, 3, axis=0))
    squared = jnp.sum(total * total, -1, keepdims=True)
    degenerate = squared < jnp.finfo(vertices.dtype).tiny
    return total / jnp.sqrt(jnp.where(degenerate, 1.0, squared))


def triangle_sides(faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "S 2"]:
    """List the three directed sides of every triangle: all first ones, then all second, then all third."""
    faces = np.asarray(faces)
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def mesh_edges(faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "E 2"]:
    """List every undirected edge once, the smaller vertex first, in ascending order."""
    pairs = np.unique(np.sort(triangle_sides(faces), axis=1), axis=0)
    return pairs[pairs[:, 0] < pairs[:, 1]]


@checked
def sample_surface(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    count: int,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"]]:
    """Sample points on a surface uniformly by area, with the unit normals of their triangles."""
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    chosen = rng.choice(len(faces), count, p=areas / areas.sum())
    first, second = np.sqrt(rng.uniform(size=count)), rng.uniform(size=count)
    weights = np.stack([1 - first, first * (1 - second), first * second], 1)
    return np.einsum("nc,nca->na", weights, corners[chosen]), normals[chosen] / areas[chosen, None]
