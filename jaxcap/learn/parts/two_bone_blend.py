"""What two rigid motions mixed explain of a vertex: the error of parts as a skin would have it.

Around a joint that bends, skin moves as a mixture of the two bones. Judged by rigid motions alone it
looks like a small part of its own; judged by mixtures it does not.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Mixed(NamedTuple):
    """How well each vertex is moved by its own part mixed with one other."""

    #: squared distance, summed over frames
    errors: Float[np.ndarray, "V"]
    #: the share of the own part, 0 to 1
    shares: Float[np.ndarray, "V"]
    #: the other part; the own one where nothing is to be mixed
    partners: Int[np.ndarray, "V"]


class Motions(NamedTuple):
    """Sums over frames of products of K rigid motions, from which all mixtures follow."""

    rotations: Float[np.ndarray, "K F 3 3"]
    translations: Float[np.ndarray, "K F 3"]
    #: (K, K, 4, 4) sums of `[R_a t_a]^T [R_b t_b]`
    products: Float[np.ndarray, "K K 4 4"]


def make_motions(rotations: np.ndarray, translations: np.ndarray) -> Motions:
    """The motions `(K, F, 3, 3)` and `(K, F, 3)` with their products."""
    affine = np.concatenate([rotations, translations[..., None]], -1)
    count = len(affine)
    flat = np.ascontiguousarray(affine.transpose(0, 3, 1, 2)).reshape(4 * count, -1)
    products = (flat @ flat.T).reshape(count, 4, count, 4).transpose(0, 2, 1, 3)
    return Motions(rotations, translations, products)


def mix(
    points: Float[np.ndarray, "N 3"],
    paths: Float[np.ndarray, "N F 3"],
    motions: Motions,
    pairs: Int[np.ndarray, "P 2"],
) -> tuple[Float[np.ndarray, "N P"], Float[np.ndarray, "N P"]]:
    """The least squared distances, summed over frames, of points at rest to their paths under
    mixtures `w T_a + (1 - w) T_b` with w from 0 to 1, for each pair; and those shares w.

    No frame is visited: every inner product is a quadratic form of the point.
    """
    used = np.unique(pairs)
    place = np.searchsorted(used, pairs)
    flat = paths.reshape(len(paths), -1)
    whole = with_one(points)
    towards = np.einsum("nkb,nb->nk", carried_sums(paths, motions, used), whole)
    quadratic = np.einsum("na,nb->nab", whole, whole).reshape(-1, 16)
    own = quadratic @ motions.products[used, used].reshape(-1, 16).T
    both = quadratic @ motions.products[pairs[:, 0], pairs[:, 1]].reshape(-1, 16).T
    a, b = place.T
    squares = np.einsum("ni,ni->n", flat, flat)[:, None]
    apart = own[:, a] - 2 * both + own[:, b]
    gap = squares - 2 * towards[:, b] + own[:, b]
    along = towards[:, a] - towards[:, b] - both + own[:, b]
    shares = np.clip(along / np.where(apart > 0, apart, 1.0), 0.0, 1.0)
    return np.maximum(gap - 2 * shares * along + shares**2 * apart, 0.0), shares


def with_one(points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 4"]:
    """Points in homogeneous coordinates."""
    return np.concatenate([points, np.ones((len(points), 1))], 1)


def carried_sums(
    paths: Float[np.ndarray, "N F 3"], motions: Motions, used: Int[np.ndarray, "U"]
) -> Float[np.ndarray, "N U 4"]:
    """Sums over frames of `[R t]^T x`, for some of the motions."""
    affine = np.concatenate([motions.rotations[used], motions.translations[used][..., None]], -1)
    columns = affine.transpose(1, 2, 0, 3).reshape(3 * affine.shape[1], -1)
    return (paths.reshape(len(paths), -1) @ columns).reshape(len(paths), -1, 4)


def mix_parts(
    points: Float[np.ndarray, "V 3"],
    paths: Float[np.ndarray, "V F 3"],
    labels: Int[np.ndarray, "V"],
    motions: Motions,
    touching: Int[np.ndarray, "P 2"],
) -> Mixed:
    """The best mixture of each vertex's own part with one that touches it."""
    errors, shares, partners = np.zeros(len(points)), np.ones(len(points)), labels.copy()
    for part in np.unique(labels):
        own = np.flatnonzero(labels == part)
        around = np.unique(touching[(touching == part).any(1)])
        around = np.append(around[around != part], part)
        pairs = np.stack([np.full(len(around), part), around], 1)
        found, weights = mix(points[own], paths[own], motions, pairs)
        best = np.argmin(found, axis=1)
        rows = np.arange(len(own))
        errors[own] = found[rows, best]
        # with itself the whole is its own
        shares[own] = np.where(around[best] == part, 1.0, weights[rows, best])
        partners[own] = around[best]
    return Mixed(errors, shares, partners)
