"""The shape around every vertex: Laplacian vectors of meshes, their energy, sizes, and files."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, random_pose

import jaxcap as jc
from jaxcap.adapt.shape.choose_shape_weight import choose_shape_weight
from jaxcap.adapt.shape.shape_prior import (
    body_shape_prior,
    prior_edges,
    scale_shape_prior,
    shape_energy,
    uniform_laplacian,
)
from jaxcap.adapt.shape.vertex_adaptation import adapt_shape
from jaxcap.body.body import posed_vertices, scale_body
from jaxcap.body.people.sample import select_diverse_poses
from jaxcap.energy.data.pairs import PointPairs
from jaxcap.geometry.mesh import mesh_edges
from jaxcap.io.archives.npz import load_body_limits
from jaxcap.io.archives.prior import load_shape_prior, shape_prior_size

BODY = chain_body()
SKELETON = BODY.skeleton
MESHES = 4


@pytest.fixture
def poses(rng):
    # some are of another scale, and the root is elsewhere
    drawn = [random_pose(SKELETON, rng, 0.5, scale=scale) for scale in (1.0, 1.0, 1.1, 0.9)]
    return jc.stack_poses(drawn).poses


@pytest.fixture
def meshes(rng, poses):
    return np.asarray(posed_vertices(BODY, poses)) + 0.01 * rng.normal(size=(MESHES, len(BODY.vertices), 3))


@pytest.fixture
def pairs(rng):
    """A prior of poses to be written with that of shape."""
    return jc.prior.learn_pair_prior(
        SKELETON, jc.stack_poses([random_pose(SKELETON, rng, 0.3) for _ in range(20)]), max_components=1
    )


def slow_vectors(meshes) -> np.ndarray:
    faces, vectors = np.asarray(BODY.faces), np.zeros_like(meshes)
    for number, mesh in enumerate(meshes):
        for v in range(len(mesh)):
            near = np.setdiff1d(faces[(faces == v).any(1)], v)
            vectors[number, v] = mesh[v] - mesh[near].mean(0)
    return vectors


def test_vectors_and_energy_are_those_of_a_slow_loop(poses, meshes):
    prior = jc.adapt.make_shape_prior(BODY, poses, meshes)
    np.testing.assert_allclose(prior.vectors, slow_vectors(meshes), atol=1e-14)
    own = slow_vectors(np.asarray(posed_vertices(BODY, poses)))
    expected = (
        sum(np.sum((own[m] - prior.vectors[m]) ** 2) / len(BODY.vertices) for m in range(MESHES)) / MESHES
    )
    assert shape_energy(prior, BODY) == pytest.approx(expected, rel=1e-9)
    assert shape_energy(body_shape_prior(BODY), BODY) < 1e-25


def test_a_vertex_without_neighbours_has_no_vector(poses, meshes):
    alone = eqx.tree_at(lambda b: b.faces, BODY, BODY.faces[(BODY.faces != 3).all(1)])
    vectors = jc.adapt.make_shape_prior(alone, poses, meshes).vectors
    np.testing.assert_array_equal(vectors[:, 3], 0.0)
    assert np.abs(vectors).sum(-1).min(0)[4] > 0


def test_scaled_is_the_prior_of_the_scaled_body_and_meshes(poses, meshes):
    """Roots are moved by as much more, so that posed bodies are as large about the origin."""
    size = 1.3
    body, prior = (
        scale_body(BODY, jnp.asarray(size)),
        scale_shape_prior(jc.adapt.make_shape_prior(BODY, poses, meshes), size),
    )
    np.testing.assert_allclose(
        posed_vertices(body, prior.poses), size * posed_vertices(BODY, poses), atol=1e-12
    )
    expected = jc.adapt.make_shape_prior(body, prior.poses, size * meshes)
    np.testing.assert_allclose(prior.vectors, expected.vectors, atol=1e-14)
    before = shape_energy(jc.adapt.make_shape_prior(BODY, poses, meshes), BODY)
    assert shape_energy(prior, body) == pytest.approx(size**2 * before, rel=1e-9)
    for wrong in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="expected a finite number above 0"):
            scale_shape_prior(prior, wrong)


def test_unlike_poses_are_the_furthest_from_those_before(rng):
    near = [random_pose(SKELETON, rng, 0.01) for _ in range(6)]
    far = [random_pose(SKELETON, rng, 1.0) for _ in range(2)]
    poses = jc.stack_poses([*near[:3], far[0], *near[3:], far[1]]).poses
    assert select_diverse_poses(SKELETON, poses, 3).tolist() == [0, 3, 7]
    assert select_diverse_poses(SKELETON, poses, 20).tolist() == list(range(8))
    assert select_diverse_poses(SKELETON, jc.stack_poses([near[0]] * 4).poses, 2).tolist() == [0]


def test_what_no_prior_is_made_of(poses, meshes):
    for pose, mesh, told in (
        (jc.rest_pose(SKELETON), meshes, "no poses of training meshes"),
        (
            poses,
            meshes[:, :5],
            "4 meshes of 5 vertices; expected 4, one for each pose, of 48, as in the body; register",
        ),
        (poses, meshes[:3], "3 meshes of 48 vertices; expected 4"),
        (poses, np.where(np.arange(MESHES)[:, None, None] == 2, np.nan, meshes), "Mesh 2 is not finite"),
        (
            jc.Pose(poses.translations[:, :3], poses.rotations[:, :3], poses.scale),
            meshes,
            "has 3 joints; expected 9",
        ),
    ):
        with pytest.raises(ValueError, match=told):
            jc.adapt.make_shape_prior(BODY, pose, mesh)


def test_round_trip_through_files(tmp_path, pairs, poses, meshes):
    prior = jc.adapt.make_shape_prior(BODY, poses, meshes)
    alone, beside = tmp_path / "prior.npz", tmp_path / "body.npz"
    jc.io.save_prior(alone, pairs, shape=prior)
    jc.io.save_prior(beside, pairs, None, BODY, {"angles": np.arange(3.0)}, prior)
    for path in (alone, beside):
        again = load_shape_prior(path, BODY)
        assert again is not None
        assert again.vectors.dtype == float
        # float32 in the file
        np.testing.assert_allclose(again.vectors, prior.vectors, rtol=1e-7)
        np.testing.assert_array_equal((again.laplacian - prior.laplacian).toarray(), 0.0)
        for name in ("translations", "rotations", "scale"):
            one, other = (getattr(p.poses, name) for p in (again, prior))
            assert one.dtype == BODY.vertices.dtype
            np.testing.assert_allclose(one, other, atol=1e-6)
        assert shape_energy(again, BODY) == pytest.approx(shape_energy(prior, BODY), rel=1e-4)
        assert shape_prior_size(path) == (MESHES, len(BODY.vertices))
        assert jc.io.load_prior(path, SKELETON).pairs == pairs.pairs
    np.testing.assert_array_equal(load_body_limits(beside)["angles"], np.arange(3.0))
    jc.io.save_prior(alone, pairs)
    assert load_shape_prior(alone, BODY) is None
    assert shape_prior_size(alone) is None


def test_a_file_says_the_edges_and_not_the_laplacian(tmp_path, pairs, poses, meshes):
    path = tmp_path / "prior.npz"
    prior = jc.adapt.make_shape_prior(BODY, poses, meshes)
    jc.io.save_prior(path, pairs, shape=prior)
    arrays = {name: values for name, values in np.load(path).items() if name.startswith("shape.")}
    assert arrays.keys() == {f"shape.{n}" for n in ("edges", "vectors", "translations", "rotations", "scale")}
    assert {values.dtype.name for values in arrays.values()} == {"int32", "float32"}
    np.testing.assert_array_equal(arrays["shape.edges"], mesh_edges(np.asarray(BODY.faces)))
    np.testing.assert_array_equal(prior_edges(prior), arrays["shape.edges"])
    np.testing.assert_allclose(uniform_laplacian(BODY).sum(1), 0.0, atol=1e-12)


def test_a_prior_of_another_body_is_refused(tmp_path, pairs, poses, meshes):
    path, prior = tmp_path / "prior.npz", jc.adapt.make_shape_prior(BODY, poses, meshes)
    jc.io.save_prior(path, pairs, shape=prior)
    less = eqx.tree_at(lambda b: b.faces, BODY, BODY.faces[1:-5])
    turned = eqx.tree_at(lambda b: b.faces, BODY, BODY.faces[::-1, [1, 2, 0]])
    few = jc.Body(SKELETON, jc.body.RigidSkin(jnp.zeros(3, int)), jnp.eye(3), jnp.asarray([[0, 1, 2]]))
    with pytest.raises(jc.InputError, match="has 48 vertices and the body has 3; learn a prior"):
        load_shape_prior(path, few)
    with pytest.raises(jc.InputError, match="other triangles than the body"):
        load_shape_prior(path, less)
    with pytest.raises(jc.InputError, match="other triangles than the body"):
        jc.io.save_prior(tmp_path / "body.npz", pairs, body=less, shape=prior)
    assert not (tmp_path / "body.npz").exists()
    assert load_shape_prior(path, turned) is not None
    whole = dict(np.load(path))
    for name, change, told in (
        (
            "vectors",
            lambda a: a * np.nan,
            "'shape.vectors' has numbers that are not finite, first in mesh 0;",
        ),
        ("vectors", lambda a: a[:3], "expected 3 x 9"),
        ("vectors", lambda a: a[:, :, :2], "expected any x any x 3"),
        ("rotations", lambda a: a[:, :5], "expected 4 x 9 x 4"),
        ("scale", lambda a: a * np.inf, "'shape.scale' has numbers that are not finite, first in mesh 0;"),
    ):
        np.savez(path, **{**whole, f"shape.{name}": change(whole[f"shape.{name}"])})
        with pytest.raises(jc.InputError, match=told):
            load_shape_prior(path, BODY)
    np.savez(path, **{name: values for name, values in whole.items() if name != "shape.edges"})
    with pytest.raises(jc.InputError, match=r"'shape.edges' is missing"):
        load_shape_prior(path, BODY)


def test_noisier_points_call_for_a_smoother_shape(rng):
    """The chosen weight is the one with the smallest error against the true body."""
    poses = jc.stack_poses([random_pose(SKELETON, rng, 0.5) for _ in range(6)]).poses
    rest = np.asarray(BODY.vertices)
    bump = 0.05 * np.exp(-0.5 * np.sum(((rest - rest.mean(0)) / (0.5 * np.ptp(rest, 0))) ** 2, 1))
    true = eqx.tree_at(lambda b: b.vertices, BODY, BODY.vertices + jnp.asarray(bump)[:, None])
    meshes, count = np.asarray(posed_vertices(true, poses)), len(rest)
    directions = rng.normal(size=(6, count, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    ones = jnp.ones((6, count))
    prior, weights = body_shape_prior(BODY, 2), (0.01, 1.0, 100.0)
    chosen = []
    for noise in (1e-5, 0.03):
        points = meshes + noise * rng.normal(size=meshes.shape)
        corners = jnp.broadcast_to(jnp.arange(count)[:, None], (6, count, 1))
        pairs = PointPairs(corners, ones[..., None], jnp.asarray(points), jnp.asarray(directions), ones, ones)
        bodies = [adapt_shape(BODY, poses, pairs, prior, weight) for weight in weights]
        errors = [float(jnp.linalg.norm(body.vertices - true.vertices)) for body in bodies]
        chosen.append(choose_shape_weight(BODY, poses, pairs, prior, weights))
        assert chosen[-1] == weights[int(np.argmin(errors))]
    assert chosen[0] < chosen[1]
    # a single frame leaves nothing to compare with
    alone = jax.tree.map(lambda leaf: leaf[:1], (poses, pairs))
    assert choose_shape_weight(BODY, *alone, prior, weights) == weights[0]
