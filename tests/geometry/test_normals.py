"""Estimated normals against surfaces whose normals are known."""

import numpy as np

from jaxcap.geometry.normals import estimate_normals


def sphere(rng, count: int, centre=(0.0, 0.0, 0.0), radius: float = 1.0):
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.asarray(centre) + radius * directions, directions


def degrees(found, expected) -> np.ndarray:
    return np.degrees(np.arccos(np.clip(np.sum(found * expected, 1), -1.0, 1.0)))


def test_a_sphere_looks_outwards(rng):
    points, normals = sphere(rng, 1500, (1.0, -2.0, 3.0))
    found = estimate_normals(points)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-12)
    errors = degrees(found, normals)
    assert np.median(errors) < 3.0
    assert errors.max() < 15.0


def test_two_pieces_each_look_outwards(rng):
    """Signs are carried along each piece alone; their common middle is outside of both."""
    one, normals_one = sphere(rng, 600, (-2.0, 0.0, 0.0), 0.5)
    two, normals_two = sphere(rng, 600, (2.0, 0.0, 0.0), 0.5)
    shuffled = rng.permutation(1200)
    errors = degrees(
        estimate_normals(np.concatenate([one, two])[shuffled]),
        np.concatenate([normals_one, normals_two])[shuffled],
    )
    assert errors.max() < 20.0


def test_a_tilted_plane_has_one_normal(rng):
    normal, along = np.array([1.0, 2.0, 2.0]) / 3.0, np.array([[2.0, -2.0, 1.0], [-2.0, -1.0, 2.0]]) / 3.0
    flat = rng.uniform(size=(300, 2)) @ along
    exact = estimate_normals(flat)
    # a plane has no outside, but all its normals agree
    np.testing.assert_allclose(np.abs(exact @ normal), 1.0, atol=1e-12)
    np.testing.assert_allclose(exact @ exact[0], 1.0, atol=1e-12)
    rough = estimate_normals(flat + 0.002 * rng.normal(size=(300, 1)) * normal)
    assert degrees(rough * np.sign(rough @ normal)[:, None], normal).max() < 10.0


def test_a_normal_turns_with_its_points(rng):
    points, _ = sphere(rng, 400)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    np.testing.assert_allclose(
        estimate_normals(points @ turn.T), estimate_normals(points) @ turn.T, atol=1e-9
    )


def test_what_has_no_plane_has_no_normal(rng):
    line = np.outer(rng.uniform(size=60), [1.0, 2.0, 3.0])
    heap = np.ones((60, 3))
    for points in (line, heap, rng.normal(size=(3, 3)), np.zeros((1, 3))):
        np.testing.assert_array_equal(estimate_normals(points), np.zeros_like(points))
