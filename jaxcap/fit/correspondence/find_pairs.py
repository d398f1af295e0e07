"""Matching of points on a posed body with points of a scan (Adaptation, section 4.1.2)."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ...arguments import checked
from ...energy.data.cloud_extent import beyond_ends
from ...energy.data.pairs import PointPairs
from ...geometry.camera import Camera, is_in_image
from .nearest_assignment import AbstractAssignment, Assignment, IndexedScan, NearestVertex, PosedSurface

_beyond_ends = eqx.filter_jit(beyond_ends)


class Matching(NamedTuple):
    """Options of matching."""

    #: largest angle between the two normals, degrees
    max_normal_angle: float = 90.0
    #: largest distance, metres
    max_distance: float = 0.3
    #: search from the scan to the body, and from the body to the scan
    from_scan: bool = True
    from_body: bool = True
    #: in every triangle of the body and of the scan, or among a cloud's points at one vertex, leave out the
    #: pair with the largest distance; does not apply to means of many points
    uniform: bool = True
    #: distance up to which distances count squared, and beyond linearly (Charbonnier), metres
    charbonnier: float = 0.003
    #: weight of squared distances along the surface relative to those across it: 1 is point to point, 0 point
    #: to plane; a nearest vertex is only approximately the correct one
    tangential_weight: float = 0.05
    #: nearest vertices, nearest points of the surface, or Gaussian shares
    assignment: AbstractAssignment = NearestVertex()
    #: the sensors, for a body that may be partly out of view: vertices outside every sensor's angle of
    #: aperture are not matched; without sensors all vertices may be
    aperture: tuple[Camera, ...] = ()
    #: a vertex that is farther than this beyond an end of the scan is matched with that end, not with a point, metres;
    #: infinity matches no vertex with ends
    end_tolerance: float = np.inf


@checked
def find_pairs(
    vertices: Float[np.ndarray, "V 3"],
    normals: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    scan: IndexedScan,
    matching: Matching = Matching(),
    visible: Bool[np.ndarray, "V"] | None = None,
) -> PointPairs:
    """Match every point of a scan with a point on a body, then every vertex with a point of the scan.

    **Arguments:** `vertices` and `normals` of the posed body; `visible`, mask of its vertices that some
    camera sees (`visible_vertices`): the others are not matched. It also restricts the body to the cameras'
    images; `Matching.aperture` only does that, for a body without known occlusions.

    Vertices beyond an end of the scan (`Matching.end_tolerance`) are matched with the plane of this end.

    A normal of zero, which is unknown, counts as perpendicular to all others. The number of pairs is that of
    the scan's points, with padding (of the vertices for soft assignment), and of the vertices.
    """
    seen = np.ones(len(vertices), bool) if visible is None else visible
    if matching.aperture:
        seen = seen & within_aperture(matching.aperture, vertices)
    surface = PosedSurface(vertices, normals, faces, seen)
    normal_threshold = float(np.cos(np.radians(matching.max_normal_angle)) - 1e-9)
    ways = matching.assignment.from_scan, matching.assignment.from_body
    found = [
        way(surface, scan, matching.max_distance, normal_threshold)
        for way, wanted in zip(ways, (matching.from_scan, matching.from_body), strict=True)
        if wanted
    ]
    width = max(part.vertices.shape[1] for part in found)
    parts = [_weighted_pairs(part, surface, scan, width, normal_threshold, matching) for part in found]
    if matching.from_body and np.isfinite(matching.end_tolerance):
        parts[-1] = _match_ends(parts[-1], vertices, scan, matching.end_tolerance)
    rows, shares, points, both, weights = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return PointPairs(
        jnp.asarray(rows, jnp.int32),
        *(jnp.asarray(part, float) for part in (shares, points, both, weights)),
        tangential_weights=jnp.full(len(weights), matching.tangential_weight, float),
    )


def within_aperture(cameras: Sequence[Camera], vertices: Float[np.ndarray, "V 3"]) -> Bool[np.ndarray, "V"]:
    """Find the vertices within some camera's angle of aperture, occluded or not.

    This is the visibility constraint for a body partly out of view (Adaptation, 4.1.2, after Ye et al. 2016).
    The aperture of a pinhole camera is its image.
    """
    inside = np.zeros(len(vertices), bool)
    for camera in cameras:
        inside |= np.asarray(is_in_image(camera, jnp.asarray(vertices, float)))
    return inside


def _weighted_pairs(
    found: Assignment,
    surface: PosedSurface,
    scan: IndexedScan,
    width: int,
    normal_threshold: float,
    matching: Matching,
) -> tuple[np.ndarray, ...]:
    """Compute vertices, shares, points, directions and weights of the pairs of one direction, with weight
    zero for rejected pairs.
    """
    count = len(surface.vertices)
    own = _unit(np.einsum("ck,cka->ca", found.shares, surface.normals[found.vertices]))
    positions = np.einsum("ck,cka->ca", found.shares, surface.vertices[found.vertices])
    distances = np.linalg.norm(positions - found.points, axis=1)
    good = (found.mass > 0) & (np.sum(own * found.normals, 1) >= normal_threshold)
    if matching.uniform and found.row_type == "point" and len(scan.faces):
        good &= ~_furthest_in(scan.faces, np.where(good, distances, 0.0))
    elif matching.uniform and found.row_type == "point":
        corner = np.take_along_axis(found.vertices, np.argmax(found.shares, 1)[:, None], 1)[:, 0]
        good &= ~_furthest_at(corner, np.where(good, distances, 0.0), count)
    elif matching.uniform and found.row_type == "vertex":
        good &= ~_furthest_in(surface.faces, np.where(good, distances, 0.0))
    weights = np.where(good, found.mass * _charbonnier_weights(distances, matching), 0.0)
    wide = ((0, 0), (0, width - found.vertices.shape[1]))
    columns = (
        # padded with a repeated vertex with share zero
        np.pad(found.vertices, wide, mode="edge"),
        np.pad(found.shares, wide),
        found.points,
        _unit(own + _unit(found.normals)),
        weights,
    )
    if found.row_type != "point":
        return columns
    *positions, weights = columns
    extra = (0, scan.padded_size - len(weights))
    return *(np.pad(part, (extra, (0, 0)), mode="edge") for part in positions), np.pad(weights, extra)


def _match_ends(
    columns: tuple[np.ndarray, ...], vertices: Float[np.ndarray, "V 3"], scan: IndexedScan, tolerance: float
) -> tuple[np.ndarray, ...]:
    """Match vertices beyond the ends of a scan with these ends, with full weight, and leave the other pairs as they are.

    Points of the scan pull such vertices only weakly, as they are far away, and those of a shoe without a sole only
    sideways.
    """
    rows, shares, points, directions, weights = columns
    found = _beyond_ends(jnp.asarray(vertices, float), jnp.asarray(scan.ends, float))
    beyond, ahead = (np.asarray(part, float) for part in found)
    outside = beyond > tolerance
    inward = vertices - beyond[:, None] * ahead
    points, directions = (
        np.where(outside[:, None], at_end, part) for at_end, part in ((inward, points), (ahead, directions))
    )
    return rows, shares, points, directions, np.where(outside, 1.0, weights)


def _unit(rows: Float[np.ndarray, "C 3"]) -> Float[np.ndarray, "C 3"]:
    return rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-12)


def _charbonnier_weights(distances: Float[np.ndarray, "C"], matching: Matching) -> Float[np.ndarray, "C"]:
    """Compute the weights that turn squared distances into Charbonnier's norm (eq. 4.6), one at zero."""
    return matching.charbonnier / np.sqrt(distances**2 + matching.charbonnier**2)


def _furthest_in(faces: Int[np.ndarray, "F 3"], distances: Float[np.ndarray, "V"]) -> Bool[np.ndarray, "V"]:
    """Find the vertex of each triangle with the largest distance of its pair."""
    worst = np.zeros(len(distances), bool)
    worst[faces[np.arange(len(faces)), np.argmax(distances[faces], 1)]] = True
    return worst


def _furthest_at(rows: Int[np.ndarray, "N"], distances: Float[np.ndarray, "N"], count: int):
    """Find the most distant of three or more points matched with one vertex."""
    largest = np.zeros(count)
    np.maximum.at(largest, rows, distances)
    many = np.bincount(rows, minlength=count) >= 3
    return many[rows] & (distances >= largest[rows])
