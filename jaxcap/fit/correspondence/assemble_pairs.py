"""Weighted pairs of assignments, compiled: directions, rejections, and weights (Adaptation, section 4.1.2)."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...energy.data.cloud_extent import beyond_ends
from ...energy.data.pairs import PointPairs
from ...small_matrices import interpolate_corners
from .nearest_assignment import Assignment


class Options(eqx.Module):
    """Numbers of `Matching` that no compiled function depends on."""

    #: number of points of the scan, without padding
    count: Int[Array | np.ndarray, ""]
    #: least cosine between the normals of a pair
    normal_threshold: Float[Array | np.ndarray, ""]
    charbonnier: Float[Array | np.ndarray, ""]
    tangential_weight: Float[Array | np.ndarray, ""]
    end_tolerance: Float[Array | np.ndarray, ""]
    uniform: Bool[Array | np.ndarray, ""]


@eqx.filter_jit
def assemble_pairs(
    found: Sequence[Assignment],
    vertices: Float[Array | np.ndarray, "V 3"],
    normals: Float[Array | np.ndarray, "V 3"],
    faces: Int[Array | np.ndarray, "F 3"],
    scan_faces: Int[Array | np.ndarray, "G 3"],
    ends: Float[Array | np.ndarray, "K"] | None,
    options: Options,
) -> PointPairs:
    """Compute the pairs of assignments, one after the other, with weight zero for rejected pairs.

    **Arguments:** `ends` of the scan, with which the vertices of the last assignment are matched that are beyond them.
    """
    width = max(part.vertices.shape[1] for part in found)
    parts = [_weighted_pairs(part, vertices, normals, faces, scan_faces, width, options) for part in found]
    if ends is not None:
        parts[-1] = _match_ends(
            parts[-1], jnp.asarray(vertices), jnp.asarray(ends), jnp.asarray(options.end_tolerance)
        )
    rows, shares, points, directions, weights = (
        jnp.concatenate(columns) for columns in zip(*parts, strict=True)
    )
    along = jnp.full(len(weights), options.tangential_weight, weights.dtype)
    return PointPairs(rows.astype(jnp.int32), shares, points, directions, weights, along)


def _weighted_pairs(
    found: Any, vertices, normals, faces, scan_faces, width: int, options: Options
) -> tuple[Array, ...]:
    """Compute vertices, shares, points, directions and weights of the pairs of one direction, with weight
    zero for rejected pairs.
    """
    own = _unit(interpolate_corners(found.shares, normals[found.vertices]))
    positions = interpolate_corners(found.shares, vertices[found.vertices])
    distances = jnp.linalg.norm(positions - found.points, axis=1)
    good = (found.mass > 0) & (jnp.sum(own * found.normals, 1) >= options.normal_threshold)
    gaps = jnp.where(good, distances, 0.0)
    if found.row_type == "point" and len(scan_faces):
        good &= ~(options.uniform & _furthest_in(scan_faces, gaps))
    elif found.row_type == "point":
        corner = jnp.take_along_axis(found.vertices, jnp.argmax(found.shares, 1)[:, None], 1)[:, 0]
        real = jnp.arange(len(gaps)) < options.count
        good &= ~(options.uniform & _furthest_at(corner, gaps, real, len(vertices)))
    elif found.row_type == "vertex":
        good &= ~(options.uniform & _furthest_in(faces, gaps))
    # the weights that turn squared distances into Charbonnier's norm (eq. 4.6), one at zero
    charbonnier = options.charbonnier / jnp.sqrt(distances**2 + options.charbonnier**2)
    wide = ((0, 0), (0, width - found.vertices.shape[1]))
    return (
        # padded with a repeated vertex with share zero
        jnp.pad(found.vertices, wide, mode="edge"),
        jnp.pad(found.shares, wide),
        found.points,
        _unit(own + _unit(found.normals)),
        jnp.where(good, found.mass * charbonnier, 0.0),
    )


def _match_ends(
    columns: tuple[Array, ...],
    vertices: Float[Array, "V 3"],
    ends: Float[Array, "K"],
    tolerance: Float[Array, ""],
) -> tuple[Array, ...]:
    """Match vertices beyond the ends of a scan with these ends, with full weight, and leave the other pairs as they are.

    Points of the scan pull such vertices only weakly, as they are far away, and those of a shoe without a sole only
    sideways.
    """
    rows, shares, points, directions, weights = columns
    beyond, ahead = beyond_ends(vertices, ends)
    outside = beyond > tolerance
    points = jnp.where(outside[:, None], vertices - beyond[:, None] * ahead, points)
    directions = jnp.where(outside[:, None], ahead, directions)
    return rows, shares, points, directions, jnp.where(outside, 1.0, weights)


def _unit(rows: Float[Array, "C 3"]) -> Float[Array, "C 3"]:
    return rows / jnp.maximum(jnp.linalg.norm(rows, axis=1, keepdims=True), 1e-12)


def _furthest_in(faces: Int[Array, "F 3"], distances: Float[Array, "V"]) -> Bool[Array, "V"]:
    """Find the vertex of each triangle with the largest distance of its pair."""
    furthest = jnp.argmax(distances[faces], 1)[:, None]
    return jnp.zeros(len(distances), bool).at[jnp.take_along_axis(faces, furthest, 1)[:, 0]].set(True)


def _furthest_at(
    rows: Int[Array, "N"], distances: Float[Array, "N"], real: Bool[Array, "N"], count: int
) -> Bool[Array, "N"]:
    """Find the most distant of three or more points matched with one vertex; only `real` ones count."""
    largest = jnp.zeros(count, distances.dtype).at[rows].max(distances)
    many = jnp.zeros(count, jnp.int32).at[rows].add(real) >= 3
    return many[rows] & (distances >= largest[rows])
