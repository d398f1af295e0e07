"""Pairs with scans that are meshes: at the nearest points of their surface, without the worst of each triangle."""

import numpy as np
import pytest
import trimesh

from jaxcap.fit.correspondence.find_pairs import Matching, find_pairs
from jaxcap.fit.correspondence.nearest_assignment import NearestOnSurface, make_mesh_scan, make_scan
from jaxcap.observe.clouds import make_cloud

BALL = trimesh.creation.icosphere(subdivisions=3)
VERTICES, FACES = np.asarray(BALL.vertices, float), np.asarray(BALL.faces)
#: coarse, so that its surface is much nearer than its vertices
COARSE = trimesh.creation.icosphere(subdivisions=1, radius=1.2)
POINTS, TRIANGLES = np.asarray(COARSE.vertices, float), np.asarray(COARSE.faces)
SURFACE = Matching(assignment=NearestOnSurface(), uniform=False)


def scan_of(points=POINTS):
    return make_mesh_scan(points, points / np.linalg.norm(points, axis=1, keepdims=True), TRIANGLES)


def from_body(scan, matching=SURFACE):
    found = find_pairs(VERTICES, VERTICES, FACES, scan, matching._replace(from_scan=False))
    return [np.asarray(part) for part in (found.vertices[:, 0], found.points, found.normals, found.weights)]


def test_vertices_meet_the_scans_surface_as_trimesh_has_it():
    rows, points, normals, weights = from_body(scan_of())
    _, apart, _ = trimesh.proximity.closest_point(COARSE, VERTICES)
    np.testing.assert_array_equal(rows, np.arange(len(VERTICES)))
    np.testing.assert_allclose(np.linalg.norm(points - VERTICES, axis=1), apart, atol=1e-9)
    np.testing.assert_allclose(trimesh.proximity.closest_point(COARSE, points)[1], 0.0, atol=1e-7)
    assert (weights > 0).all()
    # directions are along the radius here, of the scan's as of the body's
    assert (np.sum(normals * VERTICES, 1) > 0.99).all()
    # and they are nearer than the nearest of its vertices
    cloud = make_scan(make_cloud(POINTS, POINTS))
    there = np.linalg.norm(from_body(cloud)[1] - VERTICES, axis=1)
    assert (apart <= there + 1e-9).all() and apart.mean() < 0.6 * there.mean()


def test_every_triangle_of_the_scan_loses_its_worst_point(rng):
    scan = scan_of(POINTS * rng.uniform(0.9, 1.1, (len(POINTS), 1)))
    matching = SURFACE._replace(uniform=True, from_body=False)
    found = find_pairs(VERTICES, VERTICES, FACES, scan, matching)
    kept = np.asarray(found.weights[: len(POINTS)]) > 0
    apart = np.linalg.norm(scan.points, axis=1)
    for triangle in TRIANGLES:
        assert not kept[triangle[np.argmax(apart[triangle])]]
    assert kept.any()
    # as many pairs as its vertices have with their padding
    assert len(found.weights) == scan.padded_size >= len(POINTS)


def test_reach_and_normals_hold_as_for_clouds():
    assert not (from_body(scan_of(), SURFACE._replace(max_distance=0.01))[3] > 0).any()
    away = make_mesh_scan(POINTS, -POINTS, TRIANGLES)
    assert not (from_body(away)[3] > 0).any()


def test_meshes_that_are_none():
    with pytest.raises(ValueError, match="vertices 0 to 99"):
        make_mesh_scan(POINTS, POINTS, np.array([[0, 1, 99]]))
    with pytest.raises(ValueError, match="0 vertices"):
        make_mesh_scan(POINTS[:0], POINTS[:0], TRIANGLES)
    with pytest.raises(ValueError, match="finite"):
        make_mesh_scan(POINTS * np.nan, POINTS, TRIANGLES)


def test_normals_of_any_length_and_none():
    """They say a direction; one that is not finite, or of no length, says none."""
    lengths = np.linspace(0.1, 5.0, len(POINTS))[:, None]
    normals = POINTS * lengths
    normals[0], normals[1] = np.nan, 0.0
    scan = make_mesh_scan(POINTS, normals, TRIANGLES)
    np.testing.assert_array_equal(scan.normals[:2], 0.0)
    np.testing.assert_allclose(scan.normals[2:], (POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True))[2:])
