"""Matching of points on a posed body with points of a scan (Adaptation, section 4.1.2)."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ...arguments import checked
from ...energy.data.pairs import PointPairs
from ...geometry.camera import Camera, is_in_image
from ...observe.clouds import padded_size
from .assemble_pairs import Options, assemble_pairs
from .nearest_assignment import AbstractAssignment, Assignment, IndexedScan, NearestVertex, PosedSurface


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
    rows = [_pad_rows(part, scan) for part in found]
    options = Options(
        count=np.array(len(scan.points)),
        normal_threshold=np.array(normal_threshold),
        charbonnier=np.array(matching.charbonnier),
        tangential_weight=np.array(matching.tangential_weight),
        end_tolerance=np.array(matching.end_tolerance),
        uniform=np.array(matching.uniform),
    )
    ends = scan.ends if matching.from_body and np.isfinite(matching.end_tolerance) else None
    return assemble_pairs(rows, vertices, normals, faces, _pad_faces(scan), ends, options)


def _pad_rows(found: Assignment, scan: IndexedScan) -> Assignment:
    """Add rows without mass to an assignment of the points of a scan, up to the number that clouds of similar sizes share."""
    extra = scan.padded_size - len(found.mass)
    if found.row_type != "point" or not extra:
        return found
    vertices, shares, points, normals = (
        np.pad(part, ((0, extra), (0, 0)), mode="edge") for part in found[:4]
    )
    return Assignment(vertices, shares, points, normals, np.pad(found.mass, (0, extra)), "point")


def _pad_faces(scan: IndexedScan) -> Int[np.ndarray, "F 3"]:
    """Add copies of the first triangle of a scan, up to a number that scans of similar sizes share."""
    extra = padded_size(len(scan.faces)) - len(scan.faces) if len(scan.faces) else 0
    return np.concatenate([scan.faces, np.repeat(scan.faces[:1], extra, 0)])


def within_aperture(cameras: Sequence[Camera], vertices: Float[np.ndarray, "V 3"]) -> Bool[np.ndarray, "V"]:
    """Find the vertices within some camera's angle of aperture, occluded or not.

    This is the visibility constraint for a body partly out of view (Adaptation, 4.1.2, after Ye et al. 2016).
    The aperture of a pinhole camera is its image.
    """
    inside = np.zeros(len(vertices), bool)
    for camera in cameras:
        inside |= np.asarray(is_in_image(camera, jnp.asarray(vertices, float)))
    return inside
