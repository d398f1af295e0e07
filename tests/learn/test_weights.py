"""Skinning weights by block coordinate descent: known weights come back, and Q only falls."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import random_pose
from scipy.spatial import Delaunay

from jaxcap.body.body import Body, posed_vertices
from jaxcap.body.pose import stack_poses
from jaxcap.body.skeleton import make_skeleton
from jaxcap.body.skin import DualQuaternionSkin, LinearSkin, RigidSkin, SwingTwistSkin
from jaxcap.geometry.laplacian import make_conformance, matrix
from jaxcap.learn.decimated_meshes import DecimatedMeshes, decimate_meshes
from jaxcap.learn.full_resolution import corners_of_kept
from jaxcap.learn.weights import coordinate_descent as sweeping
from jaxcap.learn.weights.graph_colouring import colour_vertices
from jaxcap.learn.weights.improve_weights import improve_weights
from jaxcap.observe.meshes import MeshSequence

SIDES, RINGS, FRAMES = 8, 25, 12


def tube() -> tuple[np.ndarray, np.ndarray]:
    """A tube of a metre along x, radius 6 cm."""
    rings, sides = np.meshgrid(np.arange(RINGS), np.arange(SIDES), indexing="ij")
    angle = 2 * np.pi * sides / SIDES
    points = np.stack([rings / (RINGS - 1), 0.06 * np.cos(angle), 0.06 * np.sin(angle)], -1)
    a, b = (rings[:-1] * SIDES + sides[:-1]).ravel(), (rings[:-1] * SIDES + (sides[:-1] + 1) % SIDES).ravel()
    return points.reshape(-1, 3), np.concatenate(
        [np.stack([a, a + SIDES, b], 1), np.stack([b, a + SIDES, b + SIDES], 1)]
    )


def scene(skin: str):
    """A tube over a chain of three bones: the true body, the same with parts, poses, meshes."""
    skeleton = make_skeleton(
        ["root", "middle", "end"],
        [-1, 0, 1],
        ["free", "ball", "ball"],
        [[0, 0, 0], [0.35, 0, 0], [0.7, 0, 0]],
    )
    vertices, faces = tube()
    ramp = np.clip((vertices[:, :1] - np.array([0.35, 0.7])) / 0.2 + 0.5, 0, 1)
    part = (ramp > 0.5).sum(1)
    if skin == "linear":
        weights = np.stack([1 - ramp[:, 0], ramp[:, 0] - ramp[:, 1], ramp[:, 1]], 1)
        true, start = LinearSkin(jnp.asarray(weights)), LinearSkin(jnp.asarray(np.eye(3)[part]))
    else:
        bases = (ramp[:, 1] > 0).astype(int)
        twist = np.zeros((len(vertices), 3))
        twist[np.arange(len(vertices)), bases + 1] = ramp[np.arange(len(vertices)), bases]
        true = SwingTwistSkin(jnp.asarray(bases), jnp.asarray(twist**1.5), jnp.asarray(twist))
        nothing = jnp.zeros((len(vertices), 3))
        start = SwingTwistSkin(jnp.asarray(part), nothing, nothing)
    rng = np.random.default_rng(3)
    poses = stack_poses([random_pose(skeleton, rng, 0.6) for _ in range(FRAMES)]).poses
    body = Body(skeleton, true, jnp.asarray(vertices), jnp.asarray(faces))
    return body, eqx.tree_at(lambda b: b.skin, body, start), poses, posed_vertices(body, poses)


def plain_q(body, poses, targets, metric) -> float:
    """Q by a sparse matrix."""
    errors = np.asarray(targets - posed_vertices(body, poses))
    return sum(np.sum(error * (matrix(metric) @ error)) for error in errors)


def assert_weights(skin) -> None:
    arrays = [skin.weights] if isinstance(skin, LinearSkin) else [skin.swing, skin.twist]
    for weights in arrays:
        assert np.min(weights) >= 0 and np.max(np.sum(weights, 1)) <= 1 + 1e-12


@pytest.mark.parametrize("alpha", [0.0, 100.0])
@pytest.mark.parametrize("skin", ["linear", "swing_twist"])
def test_parts_become_the_true_weights(skin, alpha):
    _, start, poses, targets = scene(skin)
    metric = make_conformance(np.asarray(start.faces), len(start.vertices), alpha)
    better, energies = improve_weights(start, poses, targets, metric, sweeps=16, tolerance=0.0)
    before, errors = (
        np.linalg.norm(posed_vertices(body, poses) - targets, axis=-1).mean() for body in (start, better)
    )
    assert before > 2e-3 and errors < 1e-4
    assert_weights(better.skin)
    np.testing.assert_allclose(energies[0], plain_q(start, poses, targets, metric), rtol=1e-9)
    np.testing.assert_allclose(energies[-1], plain_q(better, poses, targets, metric), rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("skin", ["linear", "swing_twist"])
def test_every_sweep_lowers_q_where_nothing_fits_and_nothing_retraces(skin):
    _, start, poses, targets = scene(skin)
    targets = targets + 0.005 * np.random.default_rng(4).normal(size=targets.shape)
    metric = make_conformance(np.asarray(start.faces), len(start.vertices), 100.0)
    better, energies = improve_weights(start, poses, targets, metric, sweeps=8, tolerance=0.0, coarse=False)
    assert (np.diff(energies) <= 0).all() and energies[-1] < 0.9 * energies[0]
    np.testing.assert_allclose(energies[-1], plain_q(better, poses, targets, metric), rtol=1e-9)
    assert_weights(better.skin)
    traces = sweeping.sweep._cache_size()
    again = improve_weights(better, poses, targets, metric, sweeps=3)
    assert again.energies[-1] <= energies[-1] * (1 + 1e-9)
    # blocks of a fourth of the size are the only other shape
    assert sweeping.sweep._cache_size() <= traces + 1


def test_a_gain_is_what_the_sparse_matrix_says():
    """After many sweeps no single vertex can do better: its weights solve its own problem."""
    _, start, poses, targets = scene("linear")
    targets = targets + 0.005 * np.random.default_rng(4).normal(size=targets.shape)
    metric = make_conformance(np.asarray(start.faces), len(start.vertices), 10.0)
    better, energies = improve_weights(start, poses, targets, metric, sweeps=80, tolerance=0.0)
    rng = np.random.default_rng(6)
    for vertex in rng.integers(len(start.vertices), size=12):
        other = 0.99 * better.skin.weights[vertex] + 0.01 * rng.dirichlet(np.ones(3))
        moved = eqx.tree_at(lambda b: b.skin.weights, better, better.skin.weights.at[vertex].set(other))
        assert plain_q(moved, poses, targets, metric) >= energies[-1] * (1 - 1e-9)


def test_rigid_vertices_find_their_bones():
    true, start, poses, _ = scene("linear")
    bones = true.skin.dominant_bones()
    targets = posed_vertices(eqx.tree_at(lambda b: b.skin, true, RigidSkin(bones)), poses)
    lost = eqx.tree_at(lambda b: b.skin, start, RigidSkin(jnp.zeros_like(bones)))
    metric = make_conformance(np.asarray(start.faces), len(start.vertices), 100.0)
    found = improve_weights(lost, poses, targets, metric).body
    np.testing.assert_array_equal(found.skin.bones, bones)


def test_influences_are_limited_to_so_many():
    _, start, poses, targets = scene("linear")
    targets = targets + 0.01 * np.random.default_rng(4).normal(size=targets.shape)
    metric = make_conformance(np.asarray(start.faces), len(start.vertices), 0.0)
    better = improve_weights(start, poses, targets, metric, influences=2).body
    assert np.max(np.sum(better.skin.weights > 0, 1)) == 2


def test_colours_keep_apart_what_meets_in_the_metric():
    vertices, faces = tube()
    metric = make_conformance(faces, len(vertices), 100.0)
    colours = colour_vertices(metric)
    rows, columns = matrix(metric).nonzero()
    apart = rows != columns
    assert (colours[rows[apart]] != colours[columns[apart]]).all()
    sizes = np.bincount(colours)
    assert len(sizes) <= 30 and sizes.max() <= 2 * len(vertices) / len(sizes)


def test_what_cannot_be_improved_is_said():
    true, start, poses, targets = scene("linear")
    metric = make_conformance(np.asarray(start.faces), len(start.vertices), 1.0)
    blended = eqx.tree_at(lambda b: b.skin, true, DualQuaternionSkin(true.skin.weights))
    with pytest.raises(
        ValueError, match="has a DualQuaternionSkin; expected a SwingTwistSkin, LinearSkin or RigidSkin"
    ):
        improve_weights(blended, poses, targets, metric)
    short = jax.tree.map(lambda a: a[:-1], poses)
    with pytest.raises(ValueError, match="with 11 frames"):
        improve_weights(start, short, targets, metric)


def sheets(rng, gap: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two irregular flat sheets, one above the other at a distance; their triangles, and the sheet of each vertex."""
    x, y = np.meshgrid(np.arange(20.0), np.arange(20.0), indexing="ij")
    flat = np.stack([x.ravel(), y.ravel()], 1) + rng.uniform(-0.2, 0.2, (400, 2))
    triangles = Delaunay(flat).simplices
    vertices = np.concatenate([np.column_stack([flat, np.full(400, height)]) for height in (0.0, gap)])
    return vertices, np.concatenate([triangles, triangles + 400]), np.repeat([0, 1], 400)


def test_kept_vertices_interpolate_linear_fields_on_their_own_sheet(rng):
    vertices, faces, sheet = sheets(rng, 1e-3)
    meshes = MeshSequence(jnp.asarray(vertices)[None], jnp.asarray(faces), 30.0)
    coarse = decimate_meshes(meshes, 250)
    corners, shares = corners_of_kept(coarse, vertices)
    # sheets that touch do not mix
    np.testing.assert_array_equal(sheet[coarse.kept][corners], np.repeat(sheet[:, None], 3, 1))
    assert (shares >= -1e-9).all()
    np.testing.assert_allclose(shares.sum(1), 1)
    kept = np.einsum("vc,vca->va", shares, vertices[coarse.kept][corners])
    np.testing.assert_allclose(kept[coarse.kept], vertices[coarse.kept], atol=1e-9)
    # a linear function is exact where a triangle of the nearest kept vertex covers the vertex
    inside = (np.abs(vertices[:, :2] - 9.5) < 7).all(1)
    errors = np.linalg.norm(kept - vertices, axis=1)[inside]
    assert np.mean(errors < 1e-9) > 0.95
    assert errors.max() < 0.25


def test_a_vertex_without_triangles_takes_its_kept_one():
    vertices = np.eye(3)
    meshes = MeshSequence(jnp.asarray(vertices)[None], jnp.zeros((0, 3), int), 30.0)
    corners, shares = corners_of_kept(DecimatedMeshes(meshes, np.arange(3), np.array([2, 1, 0])), vertices)
    np.testing.assert_array_equal(corners[:, 0], [2, 1, 0])
    np.testing.assert_array_equal(shares[:, 0], 1)
