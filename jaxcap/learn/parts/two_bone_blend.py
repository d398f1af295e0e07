"""Residuals of vertices under a blend of two rigid motions.

Around a bending joint, skin moves as a blend of the two bones. Under rigid motions alone it looks like a
small part of its own; under blends it does not.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class TwoBoneBlend(NamedTuple):
    """The best blend of each vertex's own part with one other part."""

    #: squared distance, summed over frames
    errors: Float[np.ndarray, "V"]
    #: the weight of the own part, 0 to 1
    shares: Float[np.ndarray, "V"]
    #: the other part; the own part if nothing is blended
    partners: Int[np.ndarray, "V"]


class Motions(NamedTuple):
    """K rigid motions, and sums over frames of their products, sufficient to evaluate all blends."""

    rotations: Float[np.ndarray, "K F 3 3"]
    translations: Float[np.ndarray, "K F 3"]
    #: (K, K, 4, 4) sums of `[R_a t_a]^T [R_b t_b]`
    products: Float[np.ndarray, "K K 4 4"]


def make_motions(rotations: np.ndarray, translations: np.ndarray) -> Motions:
    """Compute the products of motions `(K, F, 3, 3)` and `(K, F, 3)`."""
    affine = np.concatenate([rotations, translations[..., None]], -1)
    count = len(affine)
    flat = np.ascontiguousarray(affine.transpose(0, 3, 1, 2)).reshape(4 * count, -1)
    products = (flat @ flat.T).reshape(count, 4, count, 4).transpose(0, 2, 1, 3)
    return Motions(rotations, translations, products)


def fit_two_bone_blends(
    points: Float[np.ndarray, "N 3"],
    paths: Float[np.ndarray, "N F 3"],
    motions: Motions,
    pairs: Int[np.ndarray, "P 2"],
) -> tuple[Float[np.ndarray, "N P"], Float[np.ndarray, "N P"]]:
    """Fit the weight `w`, 0 to 1, of the blend `w T_a + (1 - w) T_b` to each point and pair of motions.

    Returns the squared distances of the blended points from their paths, summed over frames, and the weights.
    Every inner product is a quadratic form of the point, so that no loop over frames is needed.
    """
    used = np.unique(pairs)
    place = np.searchsorted(used, pairs)
    flat = paths.reshape(len(paths), -1)
    whole = homogeneous(points)
    towards = np.einsum("nkb,nb->nk", path_products(paths, motions, used), whole)
    quadratic = np.einsum("na,nb->nab", whole, whole).reshape(-1, 16)
    squared_images = quadratic @ motions.products[used, used].reshape(-1, 16).T
    both = quadratic @ motions.products[pairs[:, 0], pairs[:, 1]].reshape(-1, 16).T
    a, b = place.T
    squares = np.einsum("ni,ni->n", flat, flat)[:, None]
    squared_distances = squared_images[:, a] - 2 * both + squared_images[:, b]
    gap = squares - 2 * towards[:, b] + squared_images[:, b]
    along = towards[:, a] - towards[:, b] - both + squared_images[:, b]
    shares = np.clip(along / np.where(squared_distances > 0, squared_distances, 1.0), 0.0, 1.0)
    return np.maximum(gap - 2 * shares * along + shares**2 * squared_distances, 0.0), shares


def homogeneous(points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 4"]:
    """Convert points to homogeneous coordinates."""
    return np.concatenate([points, np.ones((len(points), 1))], 1)


def path_products(
    paths: Float[np.ndarray, "N F 3"], motions: Motions, used: Int[np.ndarray, "U"]
) -> Float[np.ndarray, "N U 4"]:
    """Sum `[R t]^T x` over frames for the motions `used`."""
    affine = np.concatenate([motions.rotations[used], motions.translations[used][..., None]], -1)
    columns = affine.transpose(1, 2, 0, 3).reshape(3 * affine.shape[1], -1)
    return (paths.reshape(len(paths), -1) @ columns).reshape(len(paths), -1, 4)


def fit_part_blends(
    points: Float[np.ndarray, "V 3"],
    paths: Float[np.ndarray, "V F 3"],
    labels: Int[np.ndarray, "V"],
    motions: Motions,
    adjacent_pairs: Int[np.ndarray, "P 2"],
) -> TwoBoneBlend:
    """Fit the best blend of each vertex's own part with an adjacent part."""
    errors, shares, partners = np.zeros(len(points)), np.ones(len(points)), labels.copy()
    for part in np.unique(labels):
        members = np.flatnonzero(labels == part)
        around = np.unique(adjacent_pairs[(adjacent_pairs == part).any(1)])
        around = np.append(around[around != part], part)
        pairs = np.stack([np.full(len(around), part), around], 1)
        found, weights = fit_two_bone_blends(points[members], paths[members], motions, pairs)
        best = np.argmin(found, axis=1)
        rows = np.arange(len(members))
        errors[members] = found[rows, best]
        # a part blended with itself has the whole weight
        shares[members] = np.where(around[best] == part, 1.0, weights[rows, best])
        partners[members] = around[best]
    return TwoBoneBlend(errors, shares, partners)
