"""Glue: a scan moves as the surface does that it is glued to."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from helpers import chain_body, random_pose
from scipy.spatial.transform import Rotation

from jaxcap.body.body import pose_body
from jaxcap.edit.glue import animate_scan, glue_scan
from jaxcap.geometry.attachment import attached_positions


@pytest.fixture(scope="module")
def scene():
    rng = np.random.default_rng(4)
    body = chain_body()
    pose = random_pose(body.skeleton, rng, 0.2)
    vertices = np.asarray(pose_body(body, pose).vertices)
    corners = vertices[np.asarray(body.faces)[rng.integers(0, len(body.faces), 300)]]
    points = np.einsum("nc,nca->na", rng.dirichlet(np.ones(3), 300), corners) + 0.01 * rng.normal(
        size=(300, 3)
    )
    return body, pose, vertices, points, glue_scan(points, vertices, body.faces)


def test_in_the_same_pose_the_scan_is_itself(scene):
    body, pose, vertices, points, glue = scene
    np.testing.assert_allclose(attached_positions(glue, jnp.asarray(vertices)), points, atol=1e-12)
    np.testing.assert_allclose(animate_scan(glue, body, pose), points, atol=1e-12)


def test_a_rigid_motion_carries_the_scan_along(scene, rng):
    _, _, vertices, points, glue = scene
    turn, shift = Rotation.random(random_state=3), rng.normal(size=3)
    moved = attached_positions(glue, jnp.asarray(turn.apply(vertices.copy()) + shift))
    np.testing.assert_allclose(moved, turn.apply(points.copy()) + shift, atol=1e-12)


def test_points_hang_on_the_closest_triangle_by_the_foot_of_the_perpendicular(scene):
    body, _, vertices, points, glue = scene
    surface = trimesh.Trimesh(vertices, np.asarray(body.faces), process=False)
    nearest, distances, _ = trimesh.proximity.closest_point(surface, points)
    shares, heights = np.asarray(glue.barycentric), np.asarray(glue.heights)
    np.testing.assert_allclose(shares.sum(1), 1.0, atol=1e-12)
    inside = (shares >= 0).all(1)
    foot = np.einsum("nc,nca->na", shares, vertices[np.asarray(glue.corners)])
    # inside of the triangle the foot is the closest point; outside it is beside the surface's edge
    np.testing.assert_allclose(foot[inside], nearest[inside], atol=1e-9)
    np.testing.assert_allclose(np.abs(heights[inside]), distances[inside], atol=1e-9)
    assert 0.3 < inside.mean() < 1.0
    assert (np.abs(heights[~inside]) <= distances[~inside] + 1e-12).all()


def test_other_poses_keep_the_distance_to_the_triangle(scene, rng):
    body, _, _, _, glue = scene
    pose = random_pose(body.skeleton, rng, 0.3)
    vertices = pose_body(body, pose).vertices
    points = np.asarray(animate_scan(glue, body, pose))
    a, b, c = np.moveaxis(np.asarray(vertices)[np.asarray(glue.corners)], 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(np.sum((points - a) * normal, 1), glue.heights, atol=1e-9)


def test_frames_are_traced_once_and_differentiated(scene, rng):
    body, pose, vertices, _, glue = scene
    here = jnp.asarray(vertices)
    animate_scan(glue, body, pose)
    count = animate_scan.__wrapped__._cached._cache_size()
    for _ in range(2):
        animate_scan(glue, body, random_pose(body.skeleton, rng, 0.2))
    assert animate_scan.__wrapped__._cached._cache_size() == count
    slope = jax.grad(lambda v: jnp.sum(attached_positions(glue, v) ** 2))(here)
    step = 1e-6 * jnp.asarray(np.random.default_rng(0).normal(size=here.shape))
    value = lambda v: jnp.sum(attached_positions(glue, v) ** 2)  # noqa: E731
    assert (value(here + step) - value(here - step)) / 2 == pytest.approx(
        float(jnp.sum(slope * step)), rel=1e-5
    )
    # a triangle that is folded up takes its points along, finite in value and slope
    flat = here.at[glue.corners[0]].set(here[glue.corners[0, 0]])
    assert np.isfinite(attached_positions(glue, flat)).all()
    assert np.isfinite(jax.grad(value)(flat)).all()


def test_what_cannot_be_glued_is_told(scene):
    body, _, vertices, points, _ = scene
    for arguments, words in (
        ((points, vertices, np.zeros((0, 3), int)), "no faces"),
        ((points[:0], vertices, body.faces), "no points"),
        ((1000 * points, vertices, body.faces, 0.3), "check the scan's unit"),
        ((points * np.nan, vertices, body.faces), "finite"),
    ):
        with pytest.raises(ValueError, match=words):
            glue_scan(*arguments)
