"""Places on a body against the points that belong to them."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...arguments import checked
from ...body.body import Posed
from ..energy import root
from .vertices import AbstractVertexEnergy


class Pairs(eqx.Module):
    """Places on a body with those they are to reach; as many for every frame, weight zero where there is none.

    A place is `sum_k shares_k x[vertices_k]`: K = 1 is a vertex, K = 3 a point in a triangle.
    """

    #: any two of a pair's vertices are one, or share an edge
    vertices: Int[Array, "*frames C K"]
    #: one in sum
    shares: Float[Array, "*frames C K"]
    #: points of the scan, metres
    points: Float[Array, "*frames C 3"]
    #: unit directions along which distances count: the mean of the scan's normal and the body's
    normals: Float[Array, "*frames C 3"]
    weights: Float[Array, "*frames C"]
    #: the share by which squares of distances along the surface count, of those across it
    along: Float[Array, "*frames C"]


class PairDistances(AbstractVertexEnergy):
    """Distances of a posed body from the points that belong to it: whole across the surface, by `Pairs.along` along it
    (Adaptation, eq. 4.4, for fixed pairs). It sums with any other energy, for `solve`."""

    pairs: Pairs

    def residual(self, posed: Posed) -> Float[Array, "R"]:
        apart = places_on(self.pairs, posed.vertices) - self.pairs.points
        return jnp.einsum("cra,ca->cr", pair_directions(self.pairs), apart).reshape(-1)

    def slopes(self, posed: Posed):
        del posed
        return self.pairs.vertices, corner_directions(self.pairs)


@checked
def places_on(pairs: Pairs, vertices: Float[Array, "V 3"]) -> Float[Array, "C 3"]:
    """The places of the pairs of one frame on a surface, metres."""
    return jnp.einsum("ck,cka->ca", pairs.shares, vertices[pairs.vertices])


def pair_directions(pairs: Pairs) -> Float[Array, "C 3 3"]:
    """Three directions a pair, weighed: across the surface, and two along it, whose squares count by the pair's share."""
    n = pairs.normals
    axes = jnp.eye(3, dtype=n.dtype)
    first = jnp.cross(n, jnp.where(jnp.abs(n[:, :1]) < 0.6, axes[0], axes[1]))
    first = first / jnp.maximum(jnp.linalg.norm(first, axis=1, keepdims=True), 1e-9)
    second = jnp.cross(n, first)
    by = root(pairs.along)[:, None]
    return root(pairs.weights)[:, None, None] * jnp.stack([n, by * first, by * second], 1)


def corner_directions(pairs: Pairs) -> Float[Array, "C K 3 3"]:
    """The directions of a pair at each of its vertices, by its share."""
    return pairs.shares[:, :, None, None] * pair_directions(pairs)[:, None]


def num_pairs(pairs: Pairs) -> Float[Array, ""]:
    """How many pairs of one frame there are, by their weights; at least one."""
    return jnp.maximum(jnp.sum(pairs.weights > 0), 1).astype(pairs.weights.dtype)
