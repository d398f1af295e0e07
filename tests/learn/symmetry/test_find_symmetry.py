"""Left and right found on posed surfaces, against made ones whose mirror is known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse.csgraph
import trimesh

import jaxcap as jc
from jaxcap.geometry.laplacian import cotangent_laplacian
from jaxcap.geometry.mesh import mesh_edges, vertex_areas
from jaxcap.learn.symmetry.extremities import Extremities, list_exchanges
from jaxcap.learn.symmetry.intrinsic_surface import geodesic_distances, make_intrinsic_surface
from jaxcap.learn.symmetry.involution import nearest_involution
from jaxcap.learn.symmetry.point_map import nearest_points, nearest_rows
from jaxcap.observe.meshes import MeshSequence
from tests.learn.symmetry.made_animal import make_animal, rotate_leg


def meshes_of(shapes, faces) -> MeshSequence:
    return MeshSequence(jnp.asarray(shapes), jnp.asarray(faces))


def true_mirror(rest: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The mirrored point of each vertex on a surface that is symmetric about x = 0."""
    surface = trimesh.Trimesh(rest, faces, process=False)
    return trimesh.proximity.closest_point(surface, rest * [-1, 1, 1])[0]


@pytest.fixture(scope="module")
def human():
    body = jc.human(resolution="low")
    poses = jc.body.sample_poses(body.skeleton, count=3)
    posed = jax.lax.map(lambda pose: jc.pose_body(body, pose).vertices, poses)
    return np.asarray(body.vertices, float), np.asarray(body.faces), np.asarray(posed, float)


@pytest.mark.parametrize("pose", [1, 2])
def test_one_posed_human(human, pose):
    rest, faces, posed = human
    found, sentence = jc.learn.find_symmetry(meshes_of(posed[pose : pose + 1], faces))
    assert found is not None, sentence
    assert "symmetry was found" in sentence
    errors = np.linalg.norm(found.mirrored_points(rest) - true_mirror(rest, faces), axis=1)
    # edges are 40 mm long, and the pose changes distances along the surface
    assert np.median(errors) < 0.02
    assert np.mean(errors < 0.1) > 0.98
    assert found.quality.reversed > 0.9
    off_middle = found.sides != 0
    agreement = np.mean(found.sides[off_middle] == np.sign(rest[off_middle, 0]))
    assert max(agreement, 1 - agreement) > 0.95
    assert np.quantile(np.abs(rest[~off_middle, 0]), 0.9) < 0.05


@pytest.fixture(scope="module")
def animal():
    rest, faces = make_animal()
    return rest, faces, rotate_leg(rotate_leg(rest, 0, 1, 0.6), 1, -1, -0.5)


def test_animal_in_any_rotation(animal, rng):
    rest, faces, posed = animal
    found, sentence = jc.learn.find_symmetry(meshes_of(posed[None], faces))
    assert found is not None, sentence
    errors = np.linalg.norm(found.mirrored_points(rest) - rest * [-1, 1, 1], axis=1)
    assert np.median(errors) < 0.008
    assert np.mean(errors < 0.03) > 0.95
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn = turn * np.sign(np.linalg.det(turn))
    turned, _ = jc.learn.find_symmetry(meshes_of((posed @ turn.T + rng.normal(size=3))[None], faces))
    assert turned is not None
    moved = np.linalg.norm(turned.mirrored_points(rest) - found.mirrored_points(rest), axis=1)
    assert np.mean(moved < 1e-3) > 0.99
    np.testing.assert_array_equal(np.abs(turned.sides), np.abs(found.sides))


def test_a_reflected_mesh_has_the_reflected_symmetry(animal):
    rest, faces, posed = animal
    found, _ = jc.learn.find_symmetry(meshes_of((posed * [1, 1, -1])[None], faces[:, ::-1]))
    assert found is not None
    errors = np.linalg.norm(found.mirrored_points(rest) - rest * [-1, 1, 1], axis=1)
    assert np.median(errors) < 0.008


@pytest.mark.parametrize(
    ("legs", "lengths"),
    [
        (((0, -1), (0, 1), (1, -1), (1, 1)), (1.0, 0.5, 1.0, 0.6)),
        (((0, -1), (0, 1), (1, -1)), (1.0, 1.0, 1.0)),
        (((0, -1), (1, 1)), (1.0, 0.7)),
        (((0, -1),), (1.0,)),
    ],
)
def test_a_surface_with_different_sides_has_none(legs, lengths):
    vertices, faces = make_animal(legs, lengths)
    found, sentence = jc.learn.find_symmetry(meshes_of(vertices[None], faces))
    assert found is None
    assert sentence.startswith("No left-right symmetry was found: ")


def test_small_and_disconnected_surfaces_have_none():
    box = trimesh.creation.box()
    found, sentence = jc.learn.find_symmetry(meshes_of(box.vertices[None], box.faces.astype(np.int32)))
    assert found is None
    assert "8 vertices" in sentence
    ball = trimesh.creation.icosphere(3, 0.5)
    two = trimesh.util.concatenate([ball, ball.copy().apply_translation([2, 0, 0])])
    found, sentence = jc.learn.find_symmetry(meshes_of(two.vertices[None], two.faces.astype(np.int32)))
    assert found is None
    assert "2 connected components" in sentence
    found, sentence = jc.learn.find_symmetry(meshes_of(ball.vertices[None], ball.faces.astype(np.int32)))
    assert found is None


def test_components_beside_the_body_follow_it(animal):
    rest, faces, posed = animal
    eye = trimesh.creation.icosphere(1, 0.02)
    eyes = [eye.vertices + [x, 0.87, 0.62] for x in (0.06, -0.06)]
    shape = np.concatenate([posed, *eyes])
    count = len(eye.vertices)
    more = np.concatenate([faces, eye.faces + len(rest), eye.faces + len(rest) + count]).astype(np.int32)
    found, _ = jc.learn.find_symmetry(meshes_of(shape[None], more))
    assert found is not None
    points = found.mirrored_points(np.concatenate([rest, *eyes]))[len(rest) :]
    assert (points[:count, 0] < 0.02).all() and (points[count:, 0] > -0.02).all()


def test_intrinsic_operators_are_those_of_the_mesh(animal):
    rest, faces, _ = animal
    surface = make_intrinsic_surface(np.stack([rest, rest @ np.eye(3)[[1, 2, 0]]]), faces)
    np.testing.assert_allclose(surface.areas, vertex_areas(rest, faces), rtol=1e-9)
    wanted = cotangent_laplacian(rest, faces)
    assert np.abs(surface.laplacian - wanted).max() < 1e-9 * np.abs(wanted).max()


def test_distances_on_a_plane_and_a_sphere():
    side = np.arange(21) / 20
    x, y = np.meshgrid(side, side, indexing="ij")
    grid = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1)
    corner = (np.arange(20)[:, None] * 21 + np.arange(20)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + 21, corner + 22], 1),
            np.stack([corner, corner + 22, corner + 1], 1),
        ]
    )
    found = geodesic_distances(make_intrinsic_surface(grid[None], faces), np.array([0, 20]))
    true = np.linalg.norm(grid[[0, 20]][:, None] - grid, axis=-1)
    # paths have eight directions; with those along edges alone, distances along one diagonal are 41 % too long
    assert (found >= true - 1e-9).all()
    assert (found <= true / np.cos(np.pi / 8) + 1e-9).all()
    edges = mesh_edges(faces)
    lengths = np.linalg.norm(grid[edges[:, 0]] - grid[edges[:, 1]], axis=1)
    graph = scipy.sparse.csr_matrix((lengths, edges.T), shape=(len(grid), len(grid)))
    along_edges = scipy.sparse.csgraph.dijkstra(graph, directed=False, indices=[0, 20])
    assert (found <= along_edges + 1e-9).all()
    ball = trimesh.creation.icosphere(4)
    found = geodesic_distances(make_intrinsic_surface(ball.vertices[None], ball.faces), np.array([0]))[0]
    true = np.arccos(np.clip(ball.vertices @ ball.vertices[0], -1, 1))
    assert np.abs(found - true).max() < 0.06 * np.pi


def test_the_nearest_involution_is_one(rng):
    basis = np.linalg.qr(rng.normal(size=(9, 9)))[0]
    parities = np.array([1, 1, 1, 1, 1, -1, -1, -1, -1])
    truth = (basis * parities) @ basis.T
    found = nearest_involution(truth + 0.05 * rng.normal(size=(9, 9)))
    np.testing.assert_allclose(found @ found, np.eye(9), atol=1e-12)
    np.testing.assert_allclose(found, truth, atol=0.3)
    np.testing.assert_allclose(nearest_involution(truth), truth, atol=1e-12)
    assert np.linalg.matrix_rank(nearest_involution(basis * [1, 1, 1, 1, 1, 1, 1, 1, 0] @ basis.T)) == 8


def test_nearest_points_in_many_dimensions(rng):
    corners = rng.normal(size=(30, 5))
    faces = np.array([rng.permutation(30)[:3] for _ in range(40)])
    weights = rng.dirichlet(np.ones(3), 40)
    inside = np.einsum("tc,tck->tk", weights, corners[faces])
    rows = nearest_rows(inside, corners)
    wanted = np.argmin(np.linalg.norm(inside[:, None] - corners, axis=-1), 1)
    np.testing.assert_array_equal(rows, wanted)
    found = nearest_points(inside, corners, faces)
    used = np.array([(faces == row).any() for row in rows])
    # at least as near as the nearest vertex, and exact where its triangles have the point
    away = np.linalg.norm(found.pull_back(corners) - inside, axis=1)
    assert (away[used] <= np.linalg.norm(corners[rows] - inside, axis=1)[used] + 1e-9).all()
    own = np.array([row in face for row, face in zip(rows, faces, strict=True)])
    assert own.any() and away[own].max() < 1e-9


def test_exchanges_of_the_ends_of_a_cross():
    # a head at 1 from the middle, two hands at 2, two feet at 3; the two hands are nearer to the head than the feet
    depths = np.array([1.0, 2.0, 2.0, 3.0, 3.0])
    distances = depths[:, None] + depths
    np.fill_diagonal(distances, 0.0)
    ends = Extremities(np.arange(5), distances, distances.mean(1))
    found = list_exchanges(ends)
    best = [exchange.partners for exchange in found if exchange.change < 1e-12]
    assert set(best) == {(0, 2, 1, 3, 4), (0, 1, 2, 4, 3), (0, 2, 1, 4, 3)}
    assert all(exchange.partners[0] == 0 for exchange in found if exchange.change < 0.05)
