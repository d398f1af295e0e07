"""Matches of points on a body with observed points."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...arguments import checked
from ...body.body import Posed
from ...small_matrices import apply_small, interpolate_corners
from ...stacking import stack_trees
from ..energy import safe_sqrt
from .vertices import AbstractVertexEnergy


class PointPairs(eqx.Module):
    """Matches of points on a body with their targets; equally many in every frame, padded with weight zero.

    A point on the body is `sum_k barycentric_k x[vertices_k]`. With K = 1 it is a vertex, with K = 3 a point
    in a triangle.
    """

    #: any two vertices of a pair are equal or share an edge
    vertices: Int[Array, "*frames C K"]
    #: barycentric, one in sum
    barycentric: Float[Array, "*frames C K"]
    #: points of the scan, metres
    points: Float[Array, "*frames C 3"]
    #: unit directions of the distances: the mean of the scan's normal and the body's
    normals: Float[Array, "*frames C 3"]
    weights: Float[Array, "*frames C"]
    #: weight of squared distances along the surface, relative to those across it
    tangential_weights: Float[Array, "*frames C"]


def stack_pairs(parts: Sequence[PointPairs]) -> PointPairs:
    """Stack pairs of single frames, padded with pairs of weight zero to equal numbers."""
    count = max(len(part.weights) for part in parts)

    def padded(part: PointPairs) -> PointPairs:
        extra = (0, count - len(part.weights))
        wide = jax.tree.map(
            lambda leaf: jnp.pad(leaf, (extra, *[(0, 0)] * (leaf.ndim - 1)), mode="edge"), part
        )
        return eqx.tree_at(lambda p: p.weights, wide, jnp.pad(part.weights, extra))

    return stack_trees([padded(part) for part in parts])


class PairDistances(AbstractVertexEnergy):
    """Distances of a posed body from its matched points: full across the surface, with the weight
    `PointPairs.tangential_weights` along it (Adaptation, eq. 4.4, for fixed pairs).

    Adds to any other energy, for `solve`.
    """

    pairs: PointPairs

    def residual(self, posed: Posed) -> Float[Array, "R"]:
        differences = pair_positions(self.pairs, posed.vertices) - self.pairs.points
        return apply_small(pair_directions(self.pairs), differences).reshape(-1)

    def vertex_jacobian(self, posed: Posed):
        del posed
        return self.pairs.vertices, corner_directions(self.pairs)


@checked
def pair_positions(pairs: PointPairs, vertices: Float[Array, "V 3"]) -> Float[Array, "C 3"]:
    """Compute the points on a surface of the pairs of one frame, metres."""
    return interpolate_corners(pairs.barycentric, vertices[pairs.vertices])


def pair_directions(pairs: PointPairs) -> Float[Array, "C 3 3"]:
    """Compute three weighted directions per pair: one across the surface, and two along it, with
    the weight `PointPairs.tangential_weights`.
    """
    n = pairs.normals
    axes = jnp.eye(3, dtype=n.dtype)
    first = jnp.cross(n, jnp.where(jnp.abs(n[:, :1]) < 0.6, axes[0], axes[1]))
    first = first / jnp.maximum(jnp.linalg.norm(first, axis=1, keepdims=True), 1e-9)
    second = jnp.cross(n, first)
    by = safe_sqrt(pairs.tangential_weights)[:, None]
    return safe_sqrt(pairs.weights)[:, None, None] * jnp.stack([n, by * first, by * second], 1)


def corner_directions(pairs: PointPairs) -> Float[Array, "C K 3 3"]:
    """Compute the directions of a pair at each of its vertices, weighted by its share."""
    return pairs.barycentric[:, :, None, None] * pair_directions(pairs)[:, None]


def num_pairs(pairs: PointPairs) -> Float[Array, ""]:
    """Count the pairs of one frame with positive weight; at least one."""
    return jnp.maximum(jnp.sum(pairs.weights > 0), 1).astype(pairs.weights.dtype)
