"""Pairs of a scan's points and a body's vertices: both ways, by normals, by sight, without the furthest."""

import numpy as np
import pytest
import trimesh

from jaxcap.fit.correspond import Matching, find_pairs, make_scan
from jaxcap.observe import make_cloud

BALL = trimesh.creation.icosphere(subdivisions=3)
VERTICES, FACES = np.asarray(BALL.vertices, float), np.asarray(BALL.faces)
PLAIN = Matching(uniform=False)


def scan_of(rng, count: int = 400, size: float = 1.05):
    points = rng.normal(size=(count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return make_scan(make_cloud(size * points, points))


def pairs_of(scan, matching=PLAIN, visible=None):
    found = find_pairs(VERTICES, VERTICES, FACES, scan, matching, visible)
    return [np.asarray(part) for part in (found.vertices, found.points, found.normals, found.weights)]


def test_nearest_both_ways_as_brute_force_has_them(rng):
    scan = scan_of(rng)
    rows, points, _, weights = pairs_of(scan)
    apart = np.linalg.norm(scan.points[:, None] - VERTICES[None], axis=2)
    count = len(scan.points)
    assert (rows[:count] == apart.argmin(1)).all()
    np.testing.assert_allclose(points[scan.padded :], scan.points[apart.argmin(0)])
    # as many pairs for every scan of one padding, those of the padding without weight
    assert len(rows) == scan.padded + len(VERTICES)
    assert (weights[count : scan.padded] == 0).all()
    assert (weights[:count] > 0).all()


def test_opposite_normals_and_far_points_are_no_pairs(rng):
    scan = scan_of(rng)
    turned = scan._replace(normals=-scan.normals)
    assert (pairs_of(turned)[3] == 0).all()
    assert (pairs_of(scan, PLAIN._replace(reach=0.01))[3] == 0).all()


def test_weights_are_those_of_charbonniers_norm(rng):
    scan = scan_of(rng, size=1.2)
    rows, points, _, weights = pairs_of(scan, PLAIN._replace(charbonnier=0.05))
    count = len(scan.points)
    apart = np.linalg.norm(VERTICES[rows[:count]] - points[:count], axis=1)
    np.testing.assert_allclose(weights[:count], 0.05 / np.sqrt(apart**2 + 0.05**2), rtol=1e-6)


def test_what_no_camera_sees_is_in_no_pair(rng):
    front = VERTICES[:, 2] > 0
    rows, _, _, weights = pairs_of(scan_of(rng), visible=front)
    assert front[rows[weights > 0]].all()


def test_every_triangle_loses_the_pair_that_is_furthest_apart(rng):
    scan = scan_of(rng)
    plain, uniform = pairs_of(scan)[3], pairs_of(scan, Matching())[3]
    body = slice(scan.padded, None)
    apart = np.linalg.norm(VERTICES - pairs_of(scan)[1][body], axis=1)
    worst = FACES[np.arange(len(FACES)), apart[FACES].argmax(1)]
    assert (uniform[body][worst] == 0).all()
    kept = np.setdiff1d(np.arange(len(VERTICES)), worst)
    np.testing.assert_array_equal(uniform[body][kept], plain[body][kept])


def test_directions_are_the_means_of_both_normals(rng):
    _, points, directions, weights = pairs_of(scan_of(rng))
    good = weights > 0
    np.testing.assert_allclose(np.linalg.norm(directions[good], axis=1), 1.0, atol=1e-6)
    # of two balls about one middle both normals are nearly radial
    assert (np.sum(directions[good] * points[good], 1) > 1.03).all()


@pytest.mark.parametrize("ways", [(True, False), (False, True)])
def test_one_way_alone(rng, ways):
    scan = scan_of(rng)
    rows, *_ = pairs_of(scan, PLAIN._replace(from_scan=ways[0], from_body=ways[1]))
    assert len(rows) == (scan.padded if ways[0] else len(VERTICES))
