"""Clouds: padding, order, thinning, and what is refused."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

from jaxcap.errors import InputError
from jaxcap.geometry.sampling import spatial_order
from jaxcap.observe import stack_clouds, thin_cloud
from jaxcap.observe.clouds import make_cloud, padded_size


def unit(rng, count: int) -> np.ndarray:
    directions = rng.normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def rows(*columns) -> set:
    """The rows of arrays side by side, as a set that knows no order."""
    return set(map(tuple, np.round(np.column_stack([np.asarray(column) for column in columns]), 9)))


def test_the_ladder_of_sizes_rises_slowly():
    sizes = np.array([padded_size(count) for count in range(1, 9000)])
    counts = np.arange(1, 9000)
    assert (sizes >= counts).all()
    assert (np.diff(sizes) >= 0).all()
    # four rungs to a doubling: at most a quarter more than needed, from the first rung on
    assert (sizes[64:] / counts[64:]).max() <= 1.25
    assert len(set(sizes)) <= 4 * np.log2(9000 / 64) + 2
    # what is on a rung stays there
    assert all(padded_size(size) == size for size in set(sizes.tolist()))
    assert [padded_size(count, (16,), 4) for count in (0, 16, 17, 64, 65, 1025)] == [
        16,
        16,
        64,
        64,
        256,
        4096,
    ]


def test_a_cloud_holds_its_points_and_padding_that_weighs_nothing(rng):
    points, normals, weights = rng.normal(size=(70, 3)), unit(rng, 70), rng.uniform(0.1, 1, 70)
    cloud = make_cloud(points, 5.0 * normals, weights)
    assert cloud.points.shape == (80, 3)
    real = np.asarray(cloud.weights) > 0
    assert real.sum() == 70
    assert rows(cloud.points[real], cloud.normals[real], cloud.weights[real]) == rows(
        points, normals, weights
    )
    assert np.asarray(cloud.points).min() == points.min()
    assert np.asarray(cloud.points).max() == points.max()


def test_normals_that_are_no_direction_are_not_known(rng):
    normals = unit(rng, 70)
    normals[3], normals[4, 1] = 0.0, np.nan
    cloud = make_cloud(rng.normal(size=(70, 3)), normals)
    lengths = np.linalg.norm(cloud.normals[:70], axis=1)
    assert np.isin(np.round(lengths, 12), [0.0, 1.0]).all()
    assert (lengths == 0).sum() == 2


POINTS = np.random.default_rng(0).normal(size=(70, 3))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((np.zeros((0, 3)),), "empty"),
        ((np.zeros((5, 2)),), r"shape \(5, 2\)"),
        (
            (np.where(np.arange(210).reshape(70, 3) == 100, np.nan, POINTS),),
            "1 points .* not finite.* point 33",
        ),
        ((np.where(np.arange(210).reshape(70, 3) > 203, np.inf, POINTS),), "2 points .* point 68"),
        ((POINTS, POINTS[1:]), "70 points, but normals"),
        ((POINTS, POINTS, np.ones(3)), "70 points, but normals"),
        ((POINTS, POINTS, np.full(70, -1.0)), "weight below zero"),
        ((POINTS, POINTS, np.full(70, np.nan)), "weight below zero"),
    ],
)
def test_what_is_no_cloud_is_refused_in_one_sentence(arguments, said):
    with pytest.raises(InputError, match=said) as caught:
        make_cloud(*arguments, name="scan 7")
    assert str(caught.value).startswith("scan 7 ")
    assert str(caught.value).endswith(".")
    assert "\n" not in str(caught.value)


def test_the_order_in_space_is_a_permutation_that_keeps_neighbours_together(rng):
    points = rng.uniform(size=(800, 3))
    weights = np.where(np.arange(800) % 5, 1.0, 0.0)
    order = spatial_order(points, weights)
    np.testing.assert_array_equal(np.sort(order), np.arange(800))
    assert not weights[order[-160:]].any()
    steps = np.linalg.norm(np.diff(points[order[:640]], axis=0), axis=1)
    alike = cKDTree(points[order[:640]]).query(points[order[:640]], 2)[0][:, 1]
    # a random order steps across the cube, 0.66 in the mean
    assert steps.mean() < 3 * alike.mean()
    np.testing.assert_array_equal(spatial_order(points, np.zeros(800)), np.arange(800))
    np.testing.assert_array_equal(np.sort(spatial_order(np.ones((9, 3)))), np.arange(9))


def test_clouds_of_several_sizes_stack(rng):
    clouds = [make_cloud(points, points) for points in (rng.normal(size=(70, 3)), rng.normal(size=(100, 3)))]
    stacked = stack_clouds(clouds)
    assert stacked.points.shape == (2, 112, 3)
    for number, cloud in enumerate(clouds):
        real = np.asarray(stacked.weights[number]) > 0
        assert real.sum() == (70, 100)[number]
        kept = np.asarray(cloud.weights) > 0
        np.testing.assert_array_equal(stacked.points[number][real], cloud.points[kept])
        np.testing.assert_array_equal(stacked.normals[number][real], cloud.normals[kept])


def test_thinning_draws_points_by_weight(rng):
    points = rng.normal(size=(1000, 3))
    cloud = make_cloud(points, points, np.repeat([0.0, 1.0, 4.0], [200, 400, 400]))
    thin = thin_cloud(cloud, 100)
    kept = np.asarray(thin.weights) > 0
    assert thin.points.shape == (padded_size(100), 3)
    assert kept.sum() == 100
    found = rows(thin.points[kept], thin.normals[kept])
    assert len(found) == 100
    heavy, light = (
        rows(cloud.points[chosen], cloud.normals[chosen])
        for chosen in (cloud.weights == 4, cloud.weights == 1)
    )
    assert found <= heavy | light
    # four of five are expected to be heavy, with a deviation of less than four
    assert 65 <= len(found & heavy) <= 92
    everything = thin_cloud(cloud, 5000)
    assert jnp.sum(everything.weights > 0) == 800
    assert rows(thin_cloud(cloud, 100, seed=1).points) != rows(thin.points)
    nothing = thin_cloud(make_cloud(points, points, np.zeros(1000)), 100)
    assert nothing.points.shape == thin.points.shape
    assert not nothing.weights.any()
