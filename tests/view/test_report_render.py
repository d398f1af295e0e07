"""Surfaces and scans in pictures: what is lit, what is hidden, and where a shadow falls."""

import numpy as np
import trimesh
from matplotlib.figure import Figure

from jaxcap.report.plots import draw_scan
from jaxcap.report.render import draw_shadow, draw_surface, raise_view, rotate_view, visible_points


def test_points_behind_a_surface_are_hidden(rng):
    ball = trimesh.creation.icosphere(subdivisions=4)
    points = rng.normal(size=(500, 3))
    points *= rng.choice([0.5, 1.5], size=(500, 1)) / np.linalg.norm(points, axis=1, keepdims=True)
    # the eye looks along -z: hidden is what lies inside the ball, or behind it
    within = np.hypot(points[:, 0], points[:, 1])
    sure = np.abs(within - 1.0) > 0.15
    hidden = (within < 1.0) & (points[:, 2] < 1.0)
    shown = visible_points(np.asarray(ball.vertices), points, cell=0.08)
    found = np.zeros(500, bool)
    found[shown] = True
    np.testing.assert_array_equal(found[sure], ~hidden[sure])
    assert (np.diff(points[shown, 2]) >= 0).all()


def test_light_comes_from_the_upper_left_and_colours_stay():
    ball = trimesh.creation.icosphere(subdivisions=3)
    plot = Figure().subplots()
    seen = draw_surface(plot, ball.vertices, ball.faces, np.eye(3), np.array([0.6, 0.3, 0.2]))
    np.testing.assert_array_equal(seen, ball.vertices)
    (drawn,) = plot.collections
    middles = np.array([path.vertices[:3].mean(0) for path in drawn.get_paths()])
    paint = drawn.get_facecolors()[:, :3]
    # four triangles for each that faces the eye, and no hole in the disc that they cover
    assert len(middles) > 0.4 * 4 * len(ball.faces)
    corners = np.array([path.vertices[:3] for path in drawn.get_paths()])
    area = 0.5 * np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum()
    assert abs(area - np.pi) < 0.05
    left, right = (
        paint[np.argmin(np.linalg.norm(middles - at, axis=1))] for at in ([-0.45, 0.6], [0.45, -0.6])
    )
    assert left.mean() > 1.3 * right.mean()
    assert (paint[:, 0] > paint[:, 1]).all() and (paint[:, 1] > paint[:, 2]).all()


def test_a_shadow_lies_on_the_floor():
    box = trimesh.creation.box((0.2, 1.0, 0.2))
    plot = Figure().subplots()
    view = raise_view(rotate_view(np.eye(3), 30.0), 20.0)
    np.testing.assert_allclose(view @ view.T, np.eye(3), atol=1e-12)
    seen = draw_shadow(plot, box.vertices, box.faces, view)
    flat = seen @ view
    np.testing.assert_allclose(flat[:, 1], -0.5, atol=1e-12)
    foot = box.vertices[:, 1] < 0
    np.testing.assert_allclose(flat[foot], box.vertices[foot], atol=1e-12)


def test_a_scan_has_the_colours_of_its_distances():
    ball = trimesh.creation.icosphere(subdivisions=4)
    points = np.array([[0.0, 0.0, 1.005], [0.3, 0.0, 1.2], [0.0, 0.0, -1.3]])
    plot = Figure().subplots()
    distances = draw_scan(plot, points, ball.vertices, ball.faces, np.eye(3), far=0.02)
    np.testing.assert_allclose(distances, np.linalg.norm(points, axis=1) - 1.0, atol=0.003)
    (dots,) = plot.collections
    # the one behind is hidden, far ones come first
    np.testing.assert_allclose(dots.get_array(), distances[[0, 1]])
    np.testing.assert_allclose(dots.get_offsets(), points[[0, 1], :2])
