"""Nearest points of a surface among the triangles at the nearest vertices, compiled."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import KDTree

from ...geometry.closest import SurfacePoints
from ...geometry.mesh import corners_at_vertices


def nearest_at_vertices(
    points: Float[np.ndarray, "N 3"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    max_distance: float = np.inf,
    num_points: int = 0,
    num_faces: int = 0,
) -> SurfacePoints:
    """Find the nearest point of a surface to each point among the triangles at the nearest vertex.

    This takes a tenth of the time of `nearest_on_surface`. Of points near a closed surface of even triangles, nine of ten
    have the same result. A triangle is missed if no corner of it is nearest to the point: it is long, or belongs to another
    sheet of the surface. Vertices without a triangle are ignored.

    **Arguments:** `num_points` and `num_faces`, numbers that calls share, up to which arrays are padded: each pair of
    numbers is compiled once.
    """
    if not len(points):
        return SurfacePoints(np.zeros(0, int), np.zeros((0, 3)), np.zeros(0))
    around, first, counts = _triangles_around(np.asarray(faces, np.int32).tobytes(), len(vertices))
    used = np.flatnonzero(counts)
    tree = KDTree(vertices if len(used) == len(vertices) else vertices[used])
    nearest = used[tree.query(points, workers=-1)[1]]
    extra, spare = max(num_points - len(points), 0), max(num_faces - len(faces), 0)
    found = _nearest_around(
        np.pad(points, ((0, extra), (0, 0)), mode="edge"),
        vertices,
        np.pad(faces, ((0, spare), (0, 0))),
        np.pad(around, (0, 3 * spare)),
        *(np.pad(column[nearest], (0, extra), mode="edge") for column in (first, counts)),
    )
    triangles, shares, distances = (np.asarray(part)[: len(points)] for part in found)
    return SurfacePoints(triangles, shares, np.where(distances <= max_distance, distances, np.inf))


@functools.lru_cache(maxsize=4)
def _triangles_around(
    faces: bytes, num_vertices: int
) -> tuple[Int[np.ndarray, "C"], Int[np.ndarray, "V"], Int[np.ndarray, "V"]]:
    """List the triangles at each vertex, one vertex after the other; return also where each begins, and their numbers.

    They are the same in all poses of a body.
    """
    triangles = np.frombuffer(faces, np.int32).reshape(-1, 3)
    owners, corners = corners_at_vertices(triangles, np.arange(num_vertices))
    counts = np.bincount(owners, minlength=num_vertices).astype(np.int32)
    return (corners // 3).astype(np.int32), np.cumsum(counts, dtype=np.int32) - counts, counts


@eqx.filter_jit
def _nearest_around(
    points: Float[Array | np.ndarray, "N 3"],
    vertices: Float[Array | np.ndarray, "V 3"],
    faces: Int[Array | np.ndarray, "F 3"],
    around: Int[Array | np.ndarray, "C"],
    first: Int[Array | np.ndarray, "N"],
    counts: Int[Array | np.ndarray, "N"],
) -> tuple[Int[Array, "N"], Float[Array, "N 3"], Float[Array, "N"]]:
    """Find the nearest point of the triangles `around[first : first + counts]` to each point.

    Return the triangle, the barycentric coordinates and the distance.
    """
    corners = jnp.asarray(vertices)[jnp.asarray(faces)].reshape(-1, 9)

    def step(number, found):
        triangle = around[jnp.minimum(first + number, len(around) - 1)]
        squared, shares = _closest_barycentric(corners[triangle].T, jnp.asarray(points).T)
        nearer = (number < counts) & (squared < found[1])
        new = triangle, squared, *shares
        return tuple(jnp.where(nearer, here, best) for here, best in zip(new, found, strict=True))

    zero = jnp.zeros(len(points), points.dtype)
    start = jnp.zeros(len(points), around.dtype), zero + jnp.inf, zero, zero, zero
    triangle, squared, *shares = jax.lax.fori_loop(0, jnp.max(counts), step, start)
    return triangle, jnp.stack(shares, 1), jnp.sqrt(squared)


def _closest_barycentric(
    corners: Float[Array, "9 N"], p: Float[Array, "3 N"]
) -> tuple[Float[Array, "N"], list[Float[Array, "N"]]]:
    """Compute the squared distance and the barycentric coordinates of the nearest point of each triangle, as
    `geometry.closest.closest_barycentric`.
    """
    a, b, c = corners[:3], corners[3:6], corners[6:]
    ab, ac, ap = b - a, c - a, p - a
    bb, bc, cc, pb, pc = _dot(ab, ab), _dot(ab, ac), _dot(ac, ac), _dot(ap, ab), _dot(ap, ac)
    area = bb * cc - bc * bc
    safe = jnp.where(area > 0, area, 1.0)
    second, third = (cc * pb - bc * pc) / safe, (bb * pc - bc * pb) / safe
    first = 1.0 - second - third
    inside = (area > 0) & (first >= 0) & (second >= 0) & (third >= 0)
    differences = ap - second * ab - third * ac
    squared = jnp.where(inside, _dot(differences, differences), jnp.inf)
    shares = [jnp.where(inside, share, 0.0) for share in (first, second, third)]
    for start, end, offset, side in ((0, 1, ap, ab), (0, 2, ap, ac), (1, 2, p - b, c - b)):
        length = _dot(side, side)
        along = jnp.clip(_dot(offset, side) / jnp.where(length > 0, length, 1.0), 0.0, 1.0)
        differences = offset - along * side
        here = _dot(differences, differences)
        nearer = here < squared
        squared = jnp.where(nearer, here, squared)
        new = [jnp.zeros_like(along)] * 3
        new[start], new[end] = 1.0 - along, along
        shares = [jnp.where(nearer, *pair) for pair in zip(new, shares, strict=True)]
    return squared, shares


def _dot(a: Float[Array, "3 N"], b: Float[Array, "3 N"]) -> Float[Array, "N"]:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
