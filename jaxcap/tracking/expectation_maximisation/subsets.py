"""Subsets of a cloud's points, with which a step of expectation maximisation works one after the other."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...observe.clouds import Cloud

#: least number of points of a subset
MIN_POINTS = 1280


class Subsets(NamedTuple):
    """Clouds that divide the points of one cloud, and how many of them a step uses."""

    #: K clouds of M points each
    clouds: Cloud
    #: number of subsets that are used, the first ones
    count: Int[Array, ""] | int

    def cloud(self) -> Cloud:
        """Return all points, one subset after the other; those of unused subsets have weight zero."""
        is_used = jnp.arange(len(self.clouds.weights)) < self.count
        used = jnp.where(is_used[:, None], self.clouds.weights, 0.0)
        points, normals = (leaf.reshape(-1, 3) for leaf in (self.clouds.points, self.clouds.normals))
        return Cloud(points, normals, used.reshape(-1))


def divide_cloud(cloud: Cloud, least: int = MIN_POINTS) -> Cloud:
    """Divide the points of a cloud into K subsets of at least `least` points that each cover the whole cloud, `(K, M, ...)`.

    Points are in the order of space, so that every K-th one with weight is a subset. K is a power of two.
    """
    size, real = len(cloud.weights), cloud.weights > 0
    number = 1 << max((size // least).bit_length() - 1, 0)
    if number > 1:
        # points with weight come first
        row = jnp.where(real, jnp.cumsum(real), jnp.sum(real) + jnp.cumsum(~real)) - 1
        order = jnp.zeros(size, row.dtype).at[row].set(jnp.arange(size, dtype=row.dtype), unique_indices=True)
        cloud = Cloud(cloud.points[order], cloud.normals[order], cloud.weights[order])

    def divide(leaf: Float[Array, "N *rest"]) -> Float[Array, "K M *rest"]:
        padded = jnp.pad(leaf, ((0, -size % number), *[(0, 0)] * (leaf.ndim - 1)))
        return jnp.swapaxes(padded.reshape(-1, number, *leaf.shape[1:]), 0, 1)

    return jax.tree.map(divide, Cloud(cloud.points, cloud.normals, cloud.weights))


def first_subset(subsets: Subsets, number: Int[Array, ""] | int) -> Subsets:
    """Rotate the order of subsets, so that the one with this number is the first."""
    rolled = jax.tree.map(lambda leaf: jnp.roll(leaf, -number, 0), subsets.clouds)
    return Subsets(rolled, subsets.count)


def whole_cloud(cloud: Cloud) -> Subsets:
    """Make a cloud its only subset."""
    return Subsets(
        jax.tree.map(lambda leaf: leaf[None], Cloud(cloud.points, cloud.normals, cloud.weights)), 1
    )
