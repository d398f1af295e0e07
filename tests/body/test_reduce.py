"""Decimation and carrying over, on a sphere and a plane, where the answers are known."""

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from jaxcap.body.body import Body
from jaxcap.body.decimate import decimate, reduce_body
from jaxcap.body.skeleton import make_skeleton
from jaxcap.body.skin import AbstractSkin, LinearSkin, RigidSkin
from jaxcap.geometry.attachment import attach_points, attached_positions


@pytest.fixture(scope="module")
def sphere() -> trimesh.Trimesh:
    """2,562 vertices, radius one."""
    return trimesh.creation.icosphere(subdivisions=4)


def two_bones(mesh: trimesh.Trimesh, skin: AbstractSkin) -> Body:
    skeleton = make_skeleton(["a", "b"], [-1, 0], ["free", "ball"], np.zeros((2, 3)))
    return Body(
        skeleton, skin, jnp.asarray(np.array(mesh.vertices)), jnp.asarray(np.array(mesh.faces), jnp.int32)
    )


@pytest.mark.parametrize("count", [1200, 300])
def test_a_sphere_stays_a_sphere(sphere, count):
    # weights that are linear in z are what linear interpolation must give back
    share = 0.5 * (1 + np.array(sphere.vertices)[:, 2])
    body = two_bones(sphere, LinearSkin(jnp.asarray(np.stack([share, 1 - share], 1))))
    reduced = reduce_body(body, count)
    mesh = trimesh.Trimesh(np.asarray(reduced.vertices), np.asarray(reduced.faces), process=False)
    assert len(mesh.vertices) == count
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.euler_number == 2
    assert mesh.area_faces.min() > 0
    # the largest polyhedron of so many triangles loses about 8.5 / count of its volume
    assert abs(mesh.volume / (4 / 3 * np.pi) - 1) < 10 / count
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 1.0, atol=10 / count)
    assert np.array_equal(np.unique(reduced.faces), np.arange(count))
    truth = 0.5 * (1 + mesh.vertices[:, 2])
    np.testing.assert_allclose(reduced.skin.bone_weights(2)[:, 0], truth, atol=10 / count)
    np.testing.assert_allclose(reduced.skin.bone_weights(2).sum(1), 1.0, atol=1e-12)
    again = reduce_body(body, count)
    np.testing.assert_array_equal(reduced.vertices, again.vertices)
    np.testing.assert_array_equal(reduced.faces, again.faces)


def test_rigid_bones_are_those_of_the_nearest_vertex(sphere):
    upper = np.array(sphere.vertices)[:, 2] > 0
    reduced = reduce_body(two_bones(sphere, RigidSkin(jnp.asarray(upper.astype(int)))), 400)
    z = np.asarray(reduced.vertices)[:, 2]
    clear = np.abs(z) > 0.05  # more than half an edge from the seam
    assert clear.mean() > 0.9
    np.testing.assert_array_equal(np.asarray(reduced.skin.dominant_bones())[clear], z[clear] > 0)


def test_an_open_flat_surface_stays_flat():
    x, y = np.meshgrid(np.linspace(0, 1, 30), np.linspace(0, 2, 40), indexing="ij")
    vertices = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3)
    corner = (np.arange(29)[:, None] * 40 + np.arange(39)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 40, corner + 1], 1), np.stack([corner + 1, corner + 40, corner + 41], 1)]
    )
    points, triangles = decimate(vertices, faces, 200)
    mesh = trimesh.Trimesh(points, triangles, process=False)
    assert 150 < len(points) < 250
    np.testing.assert_allclose(points[:, 2], 0.0, atol=1e-9)
    assert abs(mesh.area - 2.0) < 0.04
    assert mesh.face_normals[:, 2].min() > 0.99


def test_attached_points_follow_rigid_motions_and_stretches(sphere, rng):
    vertices, faces = np.array(sphere.vertices), np.array(sphere.faces)
    points = vertices[rng.integers(len(vertices), size=50)] * rng.uniform(0.98, 1.02, (50, 1))
    hold = attach_points(points, vertices, faces)
    np.testing.assert_allclose(attached_positions(hold, vertices), points, atol=1e-12)
    turn = trimesh.transformations.random_rotation_matrix(rng.uniform(size=3))[:3, :3]
    np.testing.assert_allclose(
        attached_positions(hold, vertices @ turn.T + 3.0), points @ turn.T + 3.0, atol=1e-12
    )
    # a stretch leaves the height over the triangle as it is, at most 2 % of the radius
    np.testing.assert_allclose(attached_positions(hold, vertices * [1, 2, 1]), points * [1, 2, 1], atol=0.03)


def test_requests_that_cannot_be_met_end_in_a_sentence(sphere):
    body = two_bones(sphere, RigidSkin(jnp.zeros(len(sphere.vertices), int)))
    assert reduce_body(body, 2562) is body
    with pytest.raises(ValueError, match="cannot be reduced to 3 vertices; ask for 4 or more"):
        reduce_body(body, 3)
