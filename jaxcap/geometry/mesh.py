"""Triangle meshes as arrays: normals, areas, edges and random points. Normals are those of NumPy or JAX arrays."""

from typing import Any, TypeVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..arguments import checked

Floats = TypeVar("Floats", np.ndarray, Array)


def array_module(array: Array | np.ndarray) -> Any:
    """Return the module of an array's functions, `numpy` or `jax.numpy`."""
    return np if isinstance(array, np.ndarray) else jnp


def box_diagonal(points: Float[Array | np.ndarray, "N 3"]) -> float:
    """Compute the diagonal of the bounding box of points, in their unit."""
    return float(np.linalg.norm(np.ptp(np.asarray(points, float), axis=0)))


def area_normals(triangles: Float[Floats, "*F 3 3"]) -> Float[Floats, "*F 3"]:
    """Compute normals of triangles from their corners, with twice the area as length; zero for a degenerate one."""
    a, b, c = (triangles[..., corner, :] for corner in range(3))
    return array_module(triangles).cross(b - a, c - a)


def unit_vectors(vectors: Float[Floats, "*N 3"]) -> Float[Floats, "*N 3"]:
    """Scale vectors to length one, differentiably; those without length stay as they are."""
    xp = array_module(vectors)
    squared = xp.sum(vectors * vectors, -1, keepdims=True)
    degenerate = squared < jnp.finfo(vectors.dtype).tiny
    return vectors / xp.sqrt(xp.where(degenerate, 1.0, squared))


def vertex_normals(
    vertices: Float[Floats, "V 3"], faces: Int[Array | np.ndarray, "F 3"]
) -> Float[Floats, "V 3"]:
    """Compute unit normals at the vertices, weighted by triangle area.

    A vertex without triangles, or with degenerate ones only, has the zero vector as normal. Differentiable
    also there.
    """
    across = area_normals(vertices[faces])[:, None]
    if isinstance(vertices, np.ndarray):
        total = np.zeros_like(vertices)
        np.add.at(total, np.asarray(faces), across)
        return unit_vectors(total)
    return unit_vectors(jnp.zeros_like(vertices).at[faces].add(across))


def facet_heights(
    vertices: Float[Array, "V 3"], faces: Int[Array, "F 3"], normals: Float[Array, "V 3"]
) -> Float[Array, "V"]:
    """Compute the mean height of the flat triangles around each vertex over its tangent plane, negative where they are convex.

    The third of a triangle that is nearest to a corner, in barycentric coordinates, belongs to this corner; its centre is at
    `(11/18, 7/36, 7/36)`.
    """
    corners = vertices[faces]
    areas = jnp.linalg.norm(area_normals(corners), axis=1, keepdims=True)
    across = jnp.sum(normals[faces] * (corners.sum(1, keepdims=True) - 3.0 * corners), -1) * (7.0 / 36.0)
    zeros = jnp.zeros(len(vertices), vertices.dtype)
    total = zeros.at[faces].add(areas * across)
    return total / jnp.maximum(zeros.at[faces].add(areas), jnp.finfo(vertices.dtype).tiny)


def vertex_areas(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "V"]:
    """Compute a third of the area of each vertex's triangles, in squared units of `vertices`."""
    thirds = np.linalg.norm(area_normals(vertices[faces]), axis=1) / 6
    # without faces, bincount returns whole numbers
    return np.bincount(faces.reshape(-1), np.repeat(thirds, 3), len(vertices)).astype(float)


def count_other_triangles(faces: Int[np.ndarray, "F 3"], reference: Int[np.ndarray, "F 3"]) -> int:
    """Count the triangles that connect other vertices than those of a reference, in any order and from any corner on."""
    if np.array_equal(faces, reference):
        return 0
    rows, others = (set(map(tuple, _rotate_corners(each).tolist())) for each in (faces, reference))
    return len(rows - others)


def _rotate_corners(faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "F 3"]:
    """Rotate the corners of each triangle so that its smallest index comes first."""
    start = faces.argmin(1)[:, None]
    return np.take_along_axis(faces, (start + np.arange(3)) % 3, 1)


def triangle_sides(faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "S 2"]:
    """List the three directed sides of every triangle: all first ones, then all second, then all third."""
    faces = np.asarray(faces)
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def corners_at_vertices(
    faces: Int[np.ndarray, "F 3"], vertices: Int[np.ndarray, "N"]
) -> tuple[Int[np.ndarray, "C"], Int[np.ndarray, "C"]]:
    """List the corners of triangles at some vertices, one vertex after the other: its row, and the index in the flattened faces."""
    order = np.argsort(faces, axis=None, kind="stable")
    first, end = (np.searchsorted(faces.ravel()[order], vertices, side) for side in ("left", "right"))
    counts = end - first
    rows = np.repeat(np.arange(len(vertices)), counts)
    within = np.arange(len(rows)) - (np.cumsum(counts) - counts)[rows]
    return rows, order[first[rows] + within]


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
    normals = area_normals(corners)
    areas = np.linalg.norm(normals, axis=1)
    chosen = rng.choice(len(faces), count, p=areas / areas.sum())
    first, second = np.sqrt(rng.uniform(size=count)), rng.uniform(size=count)
    weights = np.stack([1 - first, first * (1 - second), first * second], 1)
    return np.einsum("nc,nca->na", weights, corners[chosen]), normals[chosen] / areas[chosen, None]
