"""Summaries, distances to surfaces, errors at joints: against analysis, SciPy and trimesh."""

import numpy as np
import pytest
import scipy.stats
import trimesh

from jaxcap.body.people.human import human
from jaxcap.fit.correspondence.nearest_at_vertices import nearest_at_vertices
from jaxcap.geometry.closest import closest_barycentric, nearest_on_surface
from jaxcap.metrics import distance_summary, joint_errors, scan_to_surface


def test_summary_by_hand():
    summary = distance_summary(np.array([1.0, 2.0, 3.0, 4.0, 10.0]))
    assert summary == (4.0, pytest.approx(np.sqrt(10.0)), 3.0, 1.0, 2.0, 5)


def test_summary_against_scipy(rng):
    distances = rng.exponential(size=1001)
    summary = distance_summary(distances)
    assert summary.mad == pytest.approx(scipy.stats.median_abs_deviation(distances))
    assert summary.iqr == pytest.approx(scipy.stats.iqr(distances))
    assert summary.sd == pytest.approx(scipy.stats.tstd(distances) * np.sqrt(1000 / 1001))


def test_summary_leaves_out_what_is_not_finite():
    assert distance_summary(np.array([np.nan, 1.0, np.inf])).count == 1
    with pytest.raises(ValueError, match="no finite distance"):
        distance_summary(np.array([np.nan]))


def test_points_on_triangles_with_one_middle_are_on_the_surface(rng):
    """The halves of squares have boxes with the same middle, and which is nearer is a tie."""
    grid = np.stack(np.meshgrid(np.arange(12.0), np.arange(12.0), indexing="ij"), -1).reshape(-1, 2)
    vertices = np.pad(grid, ((0, 0), (0, 1)))
    corner = np.array([i * 12 + j for i in range(11) for j in range(11)])
    faces = np.concatenate([corner[:, None] + [0, 12, 13], corner[:, None] + [0, 13, 1]])
    points = np.pad(rng.uniform(0, 11, (3000, 2)), ((0, 0), (0, 1)))
    np.testing.assert_allclose(scan_to_surface(points, vertices, faces), 0.0, atol=1e-12)


def test_distance_to_a_box(rng):
    """Outside: the distance to the clipped point; inside: the distance to the nearest side."""
    box = trimesh.creation.box((2.0, 2.0, 2.0))
    points = rng.uniform(-3, 3, (500, 3))
    outside = np.linalg.norm(points - np.clip(points, -1, 1), axis=1)
    inside = 1 - np.abs(points).max(1)
    expected = np.where(inside > 0, inside, outside)
    np.testing.assert_allclose(scan_to_surface(points, box.vertices, box.faces), expected, atol=1e-12)


def test_distance_with_triangles_of_all_sizes(rng):
    """One triangle that is far larger than the rest, needles, and points near, far and on it."""
    vertices = np.concatenate([rng.normal(size=(60, 3)), [[-90, -3, -80], [90, -3, -80], [0, -3, 95]]])
    vertices[:10] *= [20.0, 0.01, 0.01]
    faces = np.concatenate([rng.permutation(60).reshape(20, 3), [[60, 61, 62]]])
    points = np.concatenate([rng.normal(size=(80, 3)), 100 * rng.normal(size=(20, 3)), vertices])
    everyone = np.repeat(vertices[faces][None], len(points), 0).reshape(-1, 3, 3)
    asked = np.repeat(points, len(faces), 0)
    nearest = trimesh.triangles.closest_point(everyone, asked)
    slow = np.linalg.norm(nearest - asked, axis=1).reshape(len(points), -1).min(1)
    np.testing.assert_allclose(scan_to_surface(points, vertices, faces), slow, atol=1e-12)


def test_distance_to_a_person_is_exact(rng):
    body = human(resolution="medium")
    vertices, faces = np.asarray(body.vertices, float), np.asarray(body.faces)
    near = vertices[rng.integers(len(vertices), size=2700)] + 0.01 * rng.normal(size=(2700, 3))
    points = np.concatenate([near, rng.uniform(-2, 2, (300, 3))])
    surface = trimesh.Trimesh(vertices, faces, process=False)
    chosen = rng.choice(len(points), 150, replace=False)
    distances = scan_to_surface(points, vertices, faces)
    _, expected, _ = trimesh.proximity.closest_point(surface, points[chosen])
    np.testing.assert_allclose(distances[chosen], expected, atol=1e-9)


def test_places_are_where_the_distances_say_and_none_beyond_reach(rng):
    body = human(resolution="low")
    vertices, faces = np.asarray(body.vertices, float), np.asarray(body.faces)
    points = vertices[rng.integers(len(vertices), size=500)] + 0.1 * rng.normal(size=(500, 3))
    triangles, shares, distances = nearest_on_surface(points, vertices, faces)
    places = np.einsum("nk,nka->na", shares, vertices[faces[triangles]])
    np.testing.assert_allclose(np.linalg.norm(places - points, axis=1), distances, atol=1e-12)
    assert shares.min() >= 0
    np.testing.assert_allclose(shares.sum(1), 1.0, atol=1e-12)
    reach = float(np.median(distances))
    near = nearest_on_surface(points, vertices, faces, reach)
    within = distances <= reach
    # which of the triangles about an edge has the place is a tie
    np.testing.assert_allclose(near.distances, np.where(within, distances, np.inf), atol=1e-15)
    again = np.einsum("nk,nka->na", near.barycentric, vertices[faces[near.triangles]])
    np.testing.assert_allclose(again[within], places[within], atol=1e-12)


def test_points_at_vertices_are_the_nearest_of_the_triangles_around_each(rng):
    """For nearly all points; for the others they are in another of these triangles."""
    body = human(resolution="low")
    vertices, faces = np.asarray(body.vertices, float), np.asarray(body.faces)
    # the last vertex has no triangle
    vertices = np.concatenate([vertices, [[0.0, 0.0, 0.0]]])
    points = vertices[rng.integers(len(vertices) - 1, size=60)] + 0.005 * rng.normal(size=(60, 3))
    triangles, shares, distances = nearest_at_vertices(points, vertices, faces)
    used, equal = np.unique(faces), 0
    for point, triangle, share, distance in zip(points, triangles, shares, distances, strict=True):
        nearest = used[np.argmin(np.linalg.norm(vertices[used] - point, axis=1))]
        around = np.flatnonzero((faces == nearest).any(1))
        expected = min(nearest_on_surface(point[None], vertices, faces[[n]]).distances[0] for n in around)
        assert triangle in around
        assert np.linalg.norm(share @ vertices[faces[triangle]] - point) == pytest.approx(distance, abs=1e-12)
        equal += distance == pytest.approx(expected, abs=1e-12)
    assert equal >= 58
    reach = float(np.median(distances))
    near = nearest_at_vertices(points, vertices, faces, reach).distances
    np.testing.assert_array_equal(near, np.where(distances <= reach, distances, np.inf))
    assert not len(nearest_at_vertices(points[:0], vertices, faces).distances)


def test_triangles_without_an_area_have_their_sides(rng):
    """Three corners in a line, two in one place, and all in one."""
    a, b = rng.normal(size=(2, 3))
    triangles = np.array([[a, b, 0.3 * a + 0.7 * b], [2 * b - a, a, b], [a, b, b], [b, a, b], [a, a, a]])
    points = rng.normal(size=(300, 3))
    ends = [(a, b), (2 * b - a, a), (a, b), (a, b), (a, a)]
    for triangle, (start, end) in zip(triangles, ends, strict=True):
        shares, squared = closest_barycentric(np.repeat(triangle[None], len(points), 0), points)
        length = max(float(np.sum((end - start) ** 2)), 1e-300)
        share = np.clip((points - start) @ (end - start) / length, 0, 1)[:, None]
        expected = start + share * (end - start)
        np.testing.assert_allclose(shares @ triangle, expected, atol=1e-7)
        np.testing.assert_allclose(squared, np.sum((expected - points) ** 2, 1), atol=1e-12)


def test_joint_errors():
    truth = np.zeros((2, 3, 3))
    joints = truth.copy()
    joints[1, 2] = [3.0, 0.0, 4.0]
    np.testing.assert_array_equal(joint_errors(joints, truth), [[0, 0, 0], [0, 0, 5]])
