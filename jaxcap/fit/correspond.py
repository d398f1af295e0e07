"""Which vertex of a posed body belongs to which point of a scan (Adaptation, section 4.1.2)."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.spatial import KDTree

from ..observe import Cloud


class Pairs(eqx.Module):
    """Vertices of a body with the places they are to reach; as many for every frame, weight zero where
    there is none."""

    vertices: Int[Array, "C"]
    #: points of the scan, metres
    points: Float[Array, "C 3"]
    #: unit directions along which distances count: the mean of the scan's normal and the body's
    normals: Float[Array, "C 3"]
    weights: Float[Array, "C"]


class Scan(NamedTuple):
    """The real points of a cloud with a tree to search them, made once a frame."""

    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]
    tree: KDTree
    #: how many points the cloud has with its padding
    padded: int


class Matching(NamedTuple):
    """What makes a pair."""

    #: largest angle between the two normals, degrees
    angle: float = 90.0
    #: largest distance, metres
    reach: float = 0.3
    #: search from the scan to the body, and from the body to the scan
    from_scan: bool = True
    from_body: bool = True
    #: in every triangle, and among the points at one vertex, leave out the pair furthest apart
    uniform: bool = True
    #: deviation up to which distances count squared, and beyond linearly (Charbonnier), metres
    charbonnier: float = 0.003


def make_scan(cloud: Cloud) -> Scan:
    """The points of a cloud that are there, and their tree."""
    there = np.asarray(cloud.weights) > 0
    points = np.asarray(cloud.points, float)[there]
    return Scan(points, np.asarray(cloud.normals, float)[there], KDTree(points), len(there))


def find_pairs(
    vertices: Float[np.ndarray, "V 3"],
    normals: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    scan: Scan,
    matching: Matching = Matching(),  # noqa: B008
    visible: Bool[np.ndarray, "V"] | None = None,
) -> Pairs:
    """Nearest neighbours both ways: for every point of the scan a vertex, then for every vertex a point.

    **Arguments:** `vertices` and `normals` of the posed body; `visible`, which of its vertices some
    camera sees: the others are in no pair.

    A normal of zero, which is not known, is at a right angle to all others. The number of pairs is that of
    the scan's points, with padding, and of the vertices.
    """
    count = len(vertices)
    seen = np.ones(count, bool) if visible is None else visible
    chosen = np.flatnonzero(seen)
    rows, places, weights = [], [], []
    cosine = np.cos(np.radians(matching.angle)) - 1e-9
    if matching.from_scan and len(chosen):
        apart, nearest = KDTree(vertices[chosen]).query(scan.points, distance_upper_bound=matching.reach)
        found = np.isfinite(apart)
        row = np.where(found, chosen[np.minimum(nearest, len(chosen) - 1)], 0)
        good = found & (np.sum(normals[row] * scan.normals, 1) >= cosine)
        if matching.uniform:
            good &= ~_furthest_at(row, np.where(good, apart, 0.0), count)
        rows.append(np.pad(row, (0, scan.padded - len(row))))
        places.append(np.pad(np.arange(len(row)), (0, scan.padded - len(row))))
        weights.append(np.pad(good * _robust(apart, matching), (0, scan.padded - len(row))))
    if matching.from_body:
        apart, nearest = scan.tree.query(vertices, distance_upper_bound=matching.reach)
        found = np.isfinite(apart) & seen
        place = np.where(found, np.minimum(nearest, len(scan.points) - 1), 0)
        good = found & (np.sum(normals * scan.normals[place], 1) >= cosine)
        if matching.uniform:
            good &= ~_furthest_in(faces, np.where(good, apart, 0.0))
        rows.append(np.arange(count))
        places.append(place)
        weights.append(good * _robust(apart, matching))
    row, place = np.concatenate(rows), np.concatenate(places)
    both = normals[row] + scan.normals[place]
    both /= np.maximum(np.linalg.norm(both, axis=1, keepdims=True), 1e-12)
    return Pairs(
        jnp.asarray(row, jnp.int32),
        jnp.asarray(scan.points[place], float),
        jnp.asarray(both, float),
        jnp.asarray(np.concatenate(weights), float),
    )


def _robust(apart: Float[np.ndarray, "C"], matching: Matching) -> Float[np.ndarray, "C"]:
    """The weight that makes squares of distances count as Charbonnier's norm does (eq. 4.6), one at zero."""
    apart = np.where(np.isfinite(apart), apart, 0.0)
    return matching.charbonnier / np.sqrt(apart**2 + matching.charbonnier**2)


def _furthest_in(faces: Int[np.ndarray, "F 3"], apart: Float[np.ndarray, "V"]) -> Bool[np.ndarray, "V"]:
    """The vertex of each triangle whose pair is furthest apart."""
    worst = np.zeros(len(apart), bool)
    worst[faces[np.arange(len(faces)), np.argmax(apart[faces], 1)]] = True
    return worst


def _furthest_at(rows: Int[np.ndarray, "N"], apart: Float[np.ndarray, "N"], count: int):
    """Of three and more points at one vertex the one furthest from it."""
    largest = np.zeros(count)
    np.maximum.at(largest, rows, apart)
    many = np.bincount(rows, minlength=count) >= 3
    return many[rows] & (apart >= largest[rows])
