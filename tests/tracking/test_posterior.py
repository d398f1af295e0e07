"""The E-step against a slow, obvious reference, and what a posterior must be."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

from jaxcap.fit.correspondence import nearest as nearest_module
from jaxcap.fit.correspondence.nearest import nearest_vertices
from jaxcap.fit.correspondence.part_blocks import make_part_blocks
from jaxcap.geometry import rotation
from jaxcap.geometry.mesh import vertex_normals
from jaxcap.geometry.sampling import spatial_order
from jaxcap.observe.clouds import Cloud
from jaxcap.tracking.expectation_maximisation.e_step import (
    log_likelihood,
    posterior,
    update_priors,
    update_sigma,
)

SETTINGS = {"normal_threshold": 0.4, "outlier": 0.1, "box_volume": 8.0}
NUM_PARTS = 6
_e_step, search = eqx.filter_jit(posterior), eqx.filter_jit(nearest_vertices)


def e_step(*arguments, candidates=None, **settings):
    """`posterior`, with numbers as arrays, so that new ones do not compile again."""
    arguments, settings = jax.tree.map(jnp.asarray, (arguments, settings))
    return _e_step(*arguments, candidates=candidates, **settings)


def limbs(seed=0, num_points=230):
    """A row of noisy capsule-like parts of very different sizes (part 3 has no vertex), and a
    cloud near them with far outliers, unknown normals and padding."""
    rng = np.random.default_rng(seed)
    bones = rng.permutation(np.repeat([0, 1, 2, 4, 5], [90, 3, 40, 33, 64]))
    normals = _directions(rng, len(bones))
    vertices = (
        0.1 * normals + np.array([0.25, 0.02, 0.0]) * bones[:, None] + 0.01 * rng.normal(size=normals.shape)
    )
    chosen = rng.integers(len(bones), size=num_points)
    points = vertices[chosen] + 0.02 * rng.normal(size=(num_points, 3))
    point_normals = normals[chosen] + 0.3 * rng.normal(size=(num_points, 3))
    point_normals /= np.linalg.norm(point_normals, axis=1, keepdims=True)
    points[:20] = rng.uniform(-1, 2, (20, 3))
    point_normals[20:30] = 0.0
    weights = rng.uniform(0.5, 2.0, num_points)
    weights[30:37] = 0.0
    cloud = Cloud(jnp.array(points), jnp.array(point_normals), jnp.array(weights))
    return bones, jnp.array(vertices), jnp.array(normals), cloud


def _directions(rng, count):
    directions = rng.normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def reference(bones, vertices, normals, cloud, sigma, priors, *, normal_threshold, outlier, box_volume):
    """Kineben, eqs. 20 and 21, in loops; densities, not logs, so it needs a moderate sigma."""
    bones, vertices, normals = map(np.asarray, (bones, vertices, normals))
    count = len(cloud.points)
    weights, nearest = np.zeros((count, NUM_PARTS)), np.zeros((count, NUM_PARTS), int)
    outliers, density = np.ones(count), np.ones(count)
    for i in np.flatnonzero(np.asarray(cloud.weights) > 0):
        y, n = np.asarray(cloud.points[i]), np.asarray(cloud.normals[i])
        joint, nowhere = np.zeros(NUM_PARTS), outlier / box_volume
        for k in range(NUM_PARTS):
            compatible = (normals @ n > normal_threshold) | (not n.any())
            members = np.flatnonzero((bones == k) & compatible)
            if members.size == 0:
                continue
            squared = np.sum((vertices[members] - y) ** 2, 1)
            nearest[i, k] = members[np.argmin(squared)]
            normal = (2 * np.pi * sigma**2) ** -1.5 * np.exp(-squared.min() / (2 * sigma**2))
            joint[k] = (1 - outlier) * priors[k] * normal
        density[i] = joint.sum() + nowhere
        weights[i], outliers[i] = joint / density[i], nowhere / density[i]
    return weights, nearest, outliers, np.log(density)


@pytest.mark.parametrize("sigma", [0.005, 0.02, 0.1, 0.3])
def test_equals_the_loops(sigma):
    bones, vertices, normals, cloud = limbs()
    priors = np.array([0.3, 0.1, 0.2, 0.05, 0.15, 0.2])
    weights, nearest, outliers, density = reference(
        bones, vertices, normals, cloud, sigma, priors, **SETTINGS
    )
    for positions in (None, vertices):
        parts = make_part_blocks(bones, NUM_PARTS, positions)
        got = e_step(parts, vertices, normals, cloud, sigma, priors=jnp.array(priors), **SETTINGS)
        np.testing.assert_allclose(got.weights, weights, rtol=0, atol=1e-12)
        np.testing.assert_allclose(got.outlier, outliers, rtol=0, atol=1e-12)
        np.testing.assert_allclose(got.log_density, density, rtol=1e-12, atol=1e-12)
        np.testing.assert_array_equal(
            np.where(weights > 1e-13, got.vertices, 0), np.where(weights > 1e-13, nearest, 0)
        )
        np.testing.assert_array_equal(got.parts, np.tile(np.arange(NUM_PARTS), (len(weights), 1)))


def test_a_culled_search_finds_the_same():
    """Points in spatial order with a small reach take the short way, which must not be seen."""
    bones, vertices, normals, cloud = limbs()
    spread = jnp.array([8.0, 1.0, 1.0])
    vertices, cloud = vertices * spread, eqx.tree_at(lambda c: c.points, cloud, cloud.points * spread)
    order = spatial_order(cloud.points, cloud.weights)
    assert np.all(np.asarray(cloud.weights)[order[-7:]] == 0)
    ordered = jax.tree.map(lambda x: x[order], cloud)
    parts = make_part_blocks(bones, NUM_PARTS, vertices)
    reach = jnp.array(0.1)
    squared, nearest = search(parts, vertices, normals, ordered, normal_threshold=0.4, reach=reach)
    everything, vertex = search(
        parts, vertices, normals, ordered, normal_threshold=0.4, reach=jnp.array(jnp.inf)
    )
    real = np.asarray(ordered.weights) > 0
    within = (np.asarray(everything) <= reach**2) & real
    assert within.sum() > 80
    np.testing.assert_array_equal(np.asarray(squared)[:, real], np.where(within, everything, np.inf)[:, real])
    np.testing.assert_array_equal(np.asarray(nearest)[within], np.asarray(vertex)[within])
    # and as few pairs as this were gone through
    tiles, blocks = nearest_module._tiles_and_blocks(parts, vertices, normals, ordered, 0.4)
    assert np.mean(nearest_module._in_reach(tiles, blocks, reach)) < nearest_module.MAX_CULLED_SHARE


@pytest.mark.shared
def test_a_human_in_any_order(shared):
    """Culled (ordered points) and not (shuffled ones), float32: the very same numbers."""
    data = np.load(shared / "data/body/makehuman_cmu31.npz", allow_pickle=False)
    vertices, faces = jnp.array(data["vertices"]), jnp.array(data["faces"])
    # a quarter of the vertices compiles faster
    normals, vertices = vertex_normals(vertices, faces)[::4], vertices[::4]
    rng = np.random.default_rng(11)
    chosen = rng.permutation(len(vertices))[:2000]
    points = vertices[chosen] + jnp.array(0.004 * rng.normal(size=(2000, 3)), jnp.float32)
    cloud = Cloud(points, normals[chosen], jnp.ones(2000, jnp.float32))
    bones = data["weights"][::4].argmax(1)
    parts = make_part_blocks(bones, data["weights"].shape[1], vertices)
    order = spatial_order(points)
    ordered = jax.tree.map(lambda x: x[order], cloud)
    for sigma in (0.005, 0.3):
        plain = e_step(parts, vertices, normals, cloud, jnp.float32(sigma), candidates=4, **SETTINGS)
        culled = e_step(parts, vertices, normals, ordered, jnp.float32(sigma), candidates=4, **SETTINGS)
        jax.tree.map(lambda a, b: np.testing.assert_array_equal(a[order], b), plain, culled)
    tree = cKDTree(vertices)
    free = e_step(
        parts, vertices, normals, ordered, jnp.float32(0.005), **SETTINGS | {"normal_threshold": -1.1}
    )
    np.testing.assert_allclose(
        np.sqrt(free.squared_distances.min(1)), tree.query(np.asarray(ordered.points))[0], atol=1e-6
    )


def test_rows_sum_to_one_and_padding_is_no_inlier():
    bones, vertices, normals, cloud = limbs()
    got = e_step(make_part_blocks(bones, NUM_PARTS), vertices, normals, cloud, 0.05, **SETTINGS)
    np.testing.assert_allclose(got.weights.sum(1) + got.outlier, 1.0, atol=1e-12)
    padding = np.asarray(cloud.weights) == 0
    assert np.all(got.weights[padding] == 0)
    assert np.all(got.log_density[padding] == 0)
    assert np.all(got.weights[:, 3] == 0)


def test_candidates_are_the_likeliest_parts():
    bones, vertices, normals, cloud = limbs()
    parts = make_part_blocks(bones, NUM_PARTS, vertices)
    dense = e_step(parts, vertices, normals, cloud, 0.1, **SETTINGS)
    few = e_step(parts, vertices, normals, cloud, 0.1, candidates=2, **SETTINGS)
    order = np.argsort(-dense.weights, 1, kind="stable")[:, :2]
    assert few.weights.shape == (len(cloud.points), 2)
    for name in ("weights", "vertices", "squared_distances"):
        expected = np.take_along_axis(np.asarray(getattr(dense, name)), order, 1)
        certain = np.take_along_axis(np.asarray(dense.weights), order, 1) > 0
        np.testing.assert_array_equal(np.asarray(getattr(few, name))[certain], expected[certain])
    np.testing.assert_array_equal(few.outlier, dense.outlier)
    np.testing.assert_array_equal(few.log_density, dense.log_density)


def test_small_sigma_is_the_nearest_neighbour():
    bones, vertices, normals, _ = limbs()
    rng = np.random.default_rng(3)
    points = vertices + 1e-5 * jnp.array(rng.normal(size=vertices.shape))
    cloud = Cloud(points, normals, jnp.ones(len(points)))
    got = e_step(make_part_blocks(bones, NUM_PARTS), vertices, normals, cloud, 1e-4, candidates=2, **SETTINGS)
    np.testing.assert_array_equal(got.vertices[:, 0], np.arange(len(points)))
    np.testing.assert_array_equal(got.parts[:, 0], bones)
    np.testing.assert_allclose(got.weights[:, 0], 1.0, atol=1e-9)


def test_no_compatible_vertex_means_outlier():
    bones, vertices, normals, _ = limbs()
    facing = jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), normals.shape)
    cloud = Cloud(vertices, -facing, jnp.ones(len(vertices)))
    parts = make_part_blocks(bones, NUM_PARTS)
    for share in (0.1, 0.0):
        settings = SETTINGS | {"outlier": share}
        got = e_step(parts, vertices, facing, cloud, 0.05, **settings)
        np.testing.assert_allclose(got.outlier, 1.0, atol=1e-12)
        unknown = eqx.tree_at(lambda c: c.normals, cloud, jnp.zeros_like(facing))
        got = e_step(parts, vertices, facing, unknown, 0.05, **settings)
        assert np.all(got.outlier < 0.01)


def test_a_rigid_motion_of_both_changes_nothing_and_points_may_be_shuffled():
    bones, vertices, normals, cloud = limbs()
    parts = make_part_blocks(bones, NUM_PARTS, vertices)
    before = e_step(parts, vertices, normals, cloud, 0.03, **SETTINGS)
    turn = rotation.to_matrix(rotation.exp(jnp.array([0.4, -1.1, 0.7])))
    shift = jnp.array([0.3, -2.0, 1.0])
    order = np.random.default_rng(5).permutation(len(cloud.points))
    moved = Cloud(
        (cloud.points @ turn.T + shift)[order], (cloud.normals @ turn.T)[order], cloud.weights[order]
    )
    after = e_step(parts, vertices @ turn.T + shift, normals @ turn.T, moved, 0.03, **SETTINGS)
    np.testing.assert_allclose(after.weights, before.weights[order], atol=1e-10)
    np.testing.assert_allclose(after.outlier, before.outlier[order], atol=1e-10)


def test_float32_agrees_with_float64():
    """Within 1e-3 at a sigma of 1 cm, the body three metres from the origin."""
    bones, vertices, normals, cloud = limbs()
    vertices, cloud = vertices + 3.0, eqx.tree_at(lambda c: c.points, cloud, cloud.points + 3.0)
    parts = make_part_blocks(bones, NUM_PARTS, vertices)
    exact = e_step(parts, vertices, normals, cloud, 0.01, **SETTINGS)
    single = jax.tree.map(lambda x: x.astype(jnp.float32), (vertices, normals, cloud))
    rounded = e_step(parts, *single, jnp.float32(0.01), **SETTINGS)
    assert rounded.weights.dtype == rounded.log_density.dtype == jnp.float32
    np.testing.assert_allclose(rounded.weights, exact.weights, atol=1e-3)
    np.testing.assert_allclose(rounded.outlier, exact.outlier, atol=1e-3)


def test_new_sigma_and_priors_raise_the_likelihood():
    bones, vertices, normals, cloud = limbs()
    parts = make_part_blocks(bones, NUM_PARTS, vertices)
    # vertices that stand still keep their points, so every round is a true step of EM
    sigma, priors = jnp.array(0.2), jnp.array([0.2, 0.2, 0.2, 0.0, 0.2, 0.2])
    values = []
    for _ in range(30):
        got = e_step(parts, vertices, normals, cloud, sigma, priors=priors, **SETTINGS)
        values.append(float(log_likelihood(got, cloud.weights)))
        sigma = update_sigma(got, got.squared_distances, cloud.weights)
        priors = update_priors(got, cloud.weights, NUM_PARTS)
    assert np.all(np.diff(values) > -1e-9)
    assert values[-1] - values[0] > 10
    np.testing.assert_allclose(priors.sum(), 1.0, atol=1e-12)
    assert priors[3] == 0


def test_sigma_is_recovered_from_known_correspondences():
    rng = np.random.default_rng(7)
    vertices = jnp.array(rng.uniform(-50, 50, (2000, 3)))
    cloud = Cloud(
        vertices + 0.02 * jnp.array(rng.normal(size=(2000, 3))), jnp.zeros((2000, 3)), jnp.ones(2000)
    )
    parts = make_part_blocks(np.zeros(2000, int), 1)
    got = e_step(parts, vertices, jnp.zeros((2000, 3)), cloud, 0.03, **SETTINGS)
    np.testing.assert_allclose(update_sigma(got, got.squared_distances, cloud.weights), 0.02, rtol=0.03)


def test_equal_shapes_are_traced_once():
    bones, vertices, normals, cloud = limbs()
    parts = make_part_blocks(bones, NUM_PARTS, vertices)
    traces = []

    @eqx.filter_jit
    def counted(parts, vertices, normals, cloud, sigma):
        traces.append(1)
        return posterior(parts, vertices, normals, cloud, sigma, **SETTINGS)

    counted(parts, vertices, normals, cloud, jnp.array(0.1))
    counted(make_part_blocks(bones, NUM_PARTS, vertices), vertices + 1, normals, limbs(1)[3], jnp.array(0.2))
    assert len(traces) == 1


def test_blocks_hold_every_vertex_in_its_own_part():
    bones, vertices, *_ = limbs()
    for positions in (None, vertices):
        parts = make_part_blocks(bones, NUM_PARTS, positions)
        assert parts.blocks_of_part == (3, 1, 2, 0, 2, 2)
        of_block = np.repeat(np.arange(NUM_PARTS), parts.blocks_of_part)
        slots = np.asarray(parts.slots)
        assert np.all(bones[slots] == of_block[:, None])
        assert set(slots.ravel()) == set(range(len(bones)))


def test_wrong_parts_are_said():
    with pytest.raises(ValueError, match="Vertex 1 belongs to bone 7"):
        make_part_blocks(np.array([0, 7]), 2)
    with pytest.raises(ValueError, match="at least one vertex"):
        make_part_blocks(np.array([], int), 2)
    with pytest.raises(ValueError, match=r"expected \(2, 3\)"):
        make_part_blocks(np.array([0, 1]), 2, np.zeros((3, 3)))
