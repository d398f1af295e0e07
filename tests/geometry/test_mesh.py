"""Normals against trimesh, finite differences, and at degenerate triangles."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from jaxcap.geometry import mesh

vertex_normals = jax.jit(mesh.vertex_normals)


@pytest.fixture
def bumpy(rng) -> trimesh.Trimesh:
    sphere = trimesh.creation.icosphere(subdivisions=2)
    sphere.vertices *= 1.0 + 0.1 * rng.random((len(sphere.vertices), 1))
    return sphere


def test_area_normals_are_twice_the_area_long(bumpy):
    across = np.asarray(mesh.area_normals(jnp.asarray(bumpy.triangles)))
    np.testing.assert_allclose(across, 2 * bumpy.area_faces[:, None] * bumpy.face_normals, atol=1e-14)


def test_vertex_normals_are_weighted_by_area(bumpy):
    expected = np.zeros_like(bumpy.vertices)
    np.add.at(
        expected, bumpy.faces.ravel(), np.repeat(bumpy.area_faces[:, None] * bumpy.face_normals, 3, axis=0)
    )
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    normals = np.asarray(vertex_normals(jnp.asarray(bumpy.vertices), jnp.asarray(bumpy.faces)))
    np.testing.assert_allclose(normals, expected, atol=1e-13)
    in_numpy = mesh.vertex_normals(np.array(bumpy.vertices), np.array(bumpy.faces))
    assert isinstance(in_numpy, np.ndarray)
    np.testing.assert_allclose(in_numpy, expected, atol=1e-13)
    # trimesh counts triangles by their angle: close, not the same, and outwards like ours
    assert (np.sum(normals * bumpy.vertex_normals, axis=1) > 0.99).all()


def test_vertex_areas_share_the_triangles_out(bumpy):
    areas = mesh.vertex_areas(np.vstack([bumpy.vertices, [[9.0, 9, 9]]]), np.array(bumpy.faces))
    expected = [bumpy.area_faces[(bumpy.faces == vertex).any(1)].sum() / 3 for vertex in range(len(areas))]
    np.testing.assert_allclose(areas, expected, atol=1e-14)


def test_facet_heights_are_means_of_points_on_the_triangles(bumpy, rng):
    vertices, faces = np.array(bumpy.vertices), np.array(bumpy.faces)
    normals = mesh.vertex_normals(vertices, faces)
    heights = mesh.facet_heights(jnp.asarray(vertices), jnp.asarray(faces), jnp.asarray(normals))
    shares = rng.dirichlet(np.ones(3), (len(faces), 4000))
    points = np.einsum("fnc,fca->fna", shares, bumpy.triangles)
    nearest = np.take_along_axis(faces, shares.argmax(2).reshape(len(faces), -1), 1)
    over = np.sum((points - vertices[nearest]) * normals[nearest], 2) * bumpy.area_faces[:, None]
    areas = np.broadcast_to(bumpy.area_faces[:, None], nearest.shape)
    total, whole = (np.bincount(nearest.ravel(), each.ravel()) for each in (over, areas))
    np.testing.assert_allclose(heights, total / whole, atol=1e-3)
    assert np.abs(heights).max() > 0.02


def test_normals_of_an_octahedron_point_from_its_centre():
    corners = jnp.concatenate([jnp.eye(3), -jnp.eye(3)])
    # one triangle an octant; an odd number of negative signs turns it round
    signs = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    faces = np.arange(3) + 3 * signs
    odd = signs.sum(1) % 2 == 1
    faces[odd] = faces[odd][:, ::-1]
    np.testing.assert_allclose(vertex_normals(corners, jnp.asarray(faces)), corners, atol=1e-15)


def test_normals_do_not_change_with_scale_or_place(bumpy):
    normals = vertex_normals(jnp.asarray(bumpy.vertices), jnp.asarray(bumpy.faces))
    small = vertex_normals(jnp.asarray(1e-3 * bumpy.vertices + 2.0), jnp.asarray(bumpy.faces))
    np.testing.assert_allclose(small, normals, atol=1e-8)


def test_derivative_of_normals_against_central_differences():
    tetrahedron = jnp.array([[0.0, 0, 0], [1, 0, 0.1], [0, 1.2, 0], [0.1, 0, 0.9]])
    faces = jnp.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    at = jax.jit(lambda flat: mesh.vertex_normals(flat.reshape(4, 3), faces).reshape(-1))
    flat = tetrahedron.reshape(-1)
    numeric = np.stack([(at(flat + e) - at(flat - e)) / 2e-6 for e in 1e-6 * np.eye(12)], 1)
    np.testing.assert_allclose(jax.jit(jax.jacrev(at))(flat), numeric, atol=1e-8)


def test_degenerate_triangles_and_lone_vertices_have_no_normal_and_no_nan():
    # 0 1 2 a triangle, 3 3 4 and 4 5 6 (in a line) degenerate, 7 in no triangle at all
    vertices = jnp.array(
        [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [3, 0, 0], [4, 0, 0], [5, 0, 0], [6, 1, 0]]
    )
    faces = jnp.array([[0, 1, 2], [3, 3, 4], [4, 5, 6]])
    normals, slope = jax.jit(
        lambda v: (mesh.vertex_normals(v, faces), jax.jacrev(mesh.vertex_normals)(v, faces))
    )(vertices)
    np.testing.assert_array_equal(normals[:3], np.tile([0.0, 0, 1], (3, 1)))
    np.testing.assert_array_equal(normals[3:], 0.0)
    assert np.isfinite(slope).all()
