"""Matching of points on a posed body with a scan: the nearest vertex, or the nearest point of the surface
(Adaptation, section 4.1.2).
"""

import abc
from typing import Literal, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from ...arguments import checked
from ...energy.data.cloud_extent import extent_heights
from ...geometry.closest import nearest_on_surface
from ...observe import Scan
from ...observe.clouds import Cloud, as_cloud, make_cloud, padded_size, unit_normals
from .nearest_at_vertices import nearest_at_vertices


class IndexedScan(NamedTuple):
    """The points of a cloud without padding, or the vertices of a mesh, with a search tree, made once per
    frame.
    """

    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]
    tree: KDTree
    #: number of points of the cloud with its padding
    padded_size: int
    #: the triangles of the points; none for a cloud
    faces: Int[np.ndarray, "F 3"]
    #: where the person ends, as `extent_heights` has it, metres
    ends: Float[np.ndarray, "K"]


@checked
def make_scan(cloud: Cloud) -> IndexedScan:
    """Make a scan from a cloud's points of positive weight, with their tree.

    **Raises:** `ValueError` where there is none.
    """
    valid = np.asarray(cloud.weights) > 0
    if not valid.any():
        raise ValueError("The cloud has no points with a weight above zero.")
    points, normals = (np.asarray(part, float)[valid] for part in (cloud.points, cloud.normals))
    ends = np.asarray(extent_heights(cloud), float)
    return IndexedScan(points, normals, KDTree(points), len(valid), np.zeros((0, 3), int), ends)


def as_scan(frame: IndexedScan | Cloud | Scan) -> IndexedScan:
    """Convert a frame to a scan: the points of a cloud, or of a frame read from a file; a scan is returned
    unchanged.
    """
    return frame if isinstance(frame, IndexedScan) else make_scan(as_cloud(frame))


@checked
def make_mesh_scan(
    vertices: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"], faces: Int[np.ndarray, "F 3"]
) -> IndexedScan:
    """Make the scan of a triangle mesh; vertices in metres, normals of any length.

    **Raises:** `ValueError` for a mesh without vertices or with one that is not finite, or for a triangle
    with a missing vertex.
    """
    if not len(vertices) or not np.isfinite(vertices).all() or normals.shape != vertices.shape:
        raise ValueError(
            f"The mesh has {len(vertices)} vertices and {len(normals)} normals; expected at least one "
            "vertex, finite positions, and one normal for each vertex."
        )
    if len(faces) and not (faces.min() >= 0 and faces.max() < len(vertices)):
        raise ValueError(
            f"`faces` has vertices {faces.min()} to {faces.max()}, but the mesh has {len(vertices)} vertices."
        )
    normals = unit_normals(normals)
    ends = np.asarray(extent_heights(make_cloud(vertices, normals)), float)
    return IndexedScan(vertices, normals, KDTree(vertices), padded_size(len(vertices)), faces, ends)


class PosedSurface(NamedTuple):
    """A posed body, with a mask of the vertices that may be matched."""

    vertices: Float[np.ndarray, "V 3"]
    #: unit, or zero where unknown
    normals: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    visible: Bool[np.ndarray, "V"]


class Assignment(NamedTuple):
    """Points on a body, `sum_k shares_k vertices_k`, each with its matched point of a scan."""

    vertices: Int[np.ndarray, "C K"]
    #: at least zero, one in sum
    shares: Float[np.ndarray, "C K"]
    points: Float[np.ndarray, "C 3"]
    #: the scan's normals there, of length one at most
    normals: Float[np.ndarray, "C 3"]
    #: number of points that a pair represents; zero where there is no pair
    mass: Float[np.ndarray, "C"]
    #: one for every point of the scan, in their order; for every vertex of the body with its nearest point;
    #: or for every vertex with a mean of all points that it explains
    row_type: Literal["point", "vertex", "mean"]


class AbstractAssignment(eqx.Module):
    """An assignment method. Both directions search up to `max_distance`, metres.

    Normals of hard pairs are tested after the search; soft pairs require the least `normal_threshold` between normals
    within it.
    """

    @abc.abstractmethod
    def from_scan(
        self, surface: PosedSurface, scan: IndexedScan, max_distance: float, normal_threshold: float
    ) -> Assignment:
        """Match the scan's points with points on the body."""

    @abc.abstractmethod
    def from_body(
        self, surface: PosedSurface, scan: IndexedScan, max_distance: float, normal_threshold: float
    ) -> Assignment:
        """Match the body's visible vertices with points of the scan."""


class NearestVertex(AbstractAssignment):
    """The nearest vertex for every point of a scan; the nearest point for every vertex."""

    def from_scan(self, surface, scan, max_distance, normal_threshold):
        del normal_threshold
        chosen = np.flatnonzero(surface.visible)
        if not len(chosen):
            return _empty_assignment(scan, 1)
        distances, nearest = KDTree(surface.vertices[chosen]).query(
            scan.points, distance_upper_bound=max_distance, workers=-1
        )
        found = np.isfinite(distances)
        row = np.where(found, chosen[np.minimum(nearest, len(chosen) - 1)], 0)
        shares = np.ones((len(row), 1))
        return Assignment(row[:, None], shares, scan.points, scan.normals, found.astype(float), "point")

    def from_body(self, surface, scan, max_distance, normal_threshold):
        del normal_threshold
        return nearest_points(surface, scan, max_distance)


class NearestOnSurface(AbstractAssignment):
    """The nearest point of the body's surface for every point of a scan, and the nearest point of the scan for
    every vertex.

    The latter is on the scan's surface for a mesh, and one of the points for a cloud, because distances along
    normals measure the distance from a cloud's surface.

    Only triangles of the body with all corners visible are searched.
    """

    #: search all triangles; if False, only those at the vertex nearest to a point, in a tenth of the time
    exact: bool = eqx.field(default=True, static=True)

    def from_scan(self, surface, scan, max_distance, normal_threshold):
        del normal_threshold
        faces = surface.faces
        faces = faces if surface.visible.all() else faces[surface.visible[faces].all(1)]
        if not len(faces):
            return _empty_assignment(scan, 3)
        nearest = (
            nearest_on_surface(scan.points, surface.vertices, faces, max_distance)
            if self.exact
            else nearest_at_vertices(
                scan.points, surface.vertices, faces, max_distance, scan.padded_size, len(surface.faces)
            )
        )
        found = np.isfinite(nearest.distances).astype(float)
        return Assignment(
            faces[nearest.triangles], nearest.barycentric, scan.points, scan.normals, found, "point"
        )

    def from_body(self, surface, scan, max_distance, normal_threshold):
        del normal_threshold
        if not len(scan.faces):
            return nearest_points(surface, scan, max_distance)
        nearest = nearest_on_surface(surface.vertices, scan.points, scan.faces, max_distance)
        corners, every = scan.faces[nearest.triangles], np.arange(len(surface.vertices))[:, None]
        points, normals = (
            np.einsum("ck,cka->ca", nearest.barycentric, part[corners])
            for part in (scan.points, scan.normals)
        )
        found = (np.isfinite(nearest.distances) & surface.visible).astype(float)
        return Assignment(every, np.ones(every.shape), points, normals, found, "vertex")


def nearest_points(surface: PosedSurface, scan: IndexedScan, max_distance: float) -> Assignment:
    """Match every vertex with its nearest point of a scan."""
    distances, nearest = scan.tree.query(surface.vertices, distance_upper_bound=max_distance, workers=-1)
    found = np.isfinite(distances) & surface.visible
    place = np.where(found, np.minimum(nearest, len(scan.points) - 1), 0)
    every = np.arange(len(surface.vertices))[:, None]
    return Assignment(
        every, np.ones(every.shape), scan.points[place], scan.normals[place], found.astype(float), "vertex"
    )


def _empty_assignment(scan: IndexedScan, corners: int) -> Assignment:
    """Make an empty assignment with one row per point."""
    count = len(scan.points)
    shares = np.eye(1, corners).repeat(count, 0)
    vertices = np.zeros((count, corners), int)
    return Assignment(vertices, shares, scan.points, scan.normals, np.zeros(count), "point")
