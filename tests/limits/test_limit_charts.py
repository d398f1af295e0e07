"""Charts of rotations, voxels, and matched primitives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rotation_samples import quaternions, samples_of
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from jaxcap.limits.learning.fit_chart import chart_coordinates, find_chart, middle_rotation
from jaxcap.limits.learning.primitive_matching import match_primitives
from jaxcap.limits.learning.voxels import voxelise


def test_a_chart_has_as_many_angles_as_a_joint_used(rng):
    axis = Rotation.random(random_state=2)
    angles = rng.uniform(-1.0, 1.5, (200, 3))
    hinge = find_chart(samples_of(Rotation.from_rotvec(angles[:, :1] * axis.apply([0, 0, 1.0]))))
    pair = axis.apply(np.eye(3)[:2])
    two = Rotation.from_rotvec(angles[:, :1] * pair[0]) * Rotation.from_rotvec(angles[:, 1:2] * pair[1])
    universal = find_chart(samples_of(two))
    ball = find_chart(samples_of(Rotation.from_rotvec(angles)))
    assert (hinge.kind, universal.kind, ball.kind) == ("hinge", "universal", "ball")
    for chart, turned in (
        (hinge, Rotation.from_rotvec(angles[:, :1] * axis.apply([0, 0, 1.0]))),
        (universal, two),
    ):
        places = chart_coordinates(chart, quaternions(turned))
        back = Rotation.from_quat(
            np.asarray(jax.vmap(chart.rotation)(jnp.asarray(places))), scalar_first=True
        )
        assert np.degrees((back.inv() * turned).magnitude().max()) < 1e-3
        # the middle of each angle's range is the chart's
        spread = places[:, : chart.dimension]
        np.testing.assert_allclose(spread.max(0), -spread.min(0), atol=1e-6)


def test_a_hinge_that_is_turned_at_all_times_is_still_a_hinge(rng):
    turns = Rotation.from_rotvec(rng.uniform(0, 2.0, (200, 1)) * np.array([0.0, 0.6, 0.8]))
    turned = Rotation.from_rotvec([0.3, 0.0, 0.1]) * turns
    chart = find_chart(samples_of(turned))
    assert chart.kind == "hinge"
    places = chart_coordinates(chart, quaternions(turned))
    back = Rotation.from_quat(np.asarray(jax.vmap(chart.rotation)(jnp.asarray(places))), scalar_first=True)
    assert (back.inv() * turned).magnitude().max() < 1e-9


def test_a_middle_is_the_centre_of_the_smallest_ball(rng):
    vectors = rng.normal(size=(400, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    middle = Rotation.from_rotvec([0.5, -1.0, 2.0])
    turned = middle * Rotation.from_rotvec(1.2 * vectors)
    # more samples on one side draw the mean, not the middle
    crowd = middle * Rotation.from_rotvec(np.tile([1.0, 0, 0], (2000, 1)))
    found = middle_rotation(quaternions(Rotation.concatenate([turned, crowd])))
    assert (Rotation.from_quat(found, scalar_first=True).inv() * middle).magnitude() < 0.05


@pytest.mark.parametrize("kind", ["ball", "revolute"])
def test_ranges_that_wrap_are_refused(rng, kind):
    if kind == "ball":
        turned = Rotation.random(4000, random_state=3)
    else:
        turned = Rotation.from_rotvec(rng.uniform(-np.pi, np.pi, (4000, 1)) * np.array([1.0, 0, 0]))
    with pytest.raises(ValueError, match="half a turn"):
        find_chart(samples_of(turned, kind))


def test_voxels_hold_all_samples_and_join_only_within(rng):
    places = rng.uniform(-0.5, 0.5, (40000, 3))
    places = places[np.linalg.norm(places, axis=1) < 0.5]
    voxels, plain = voxelise(places, 3, 0.05), voxelise(places, 3, 0.05, levels=0)
    inside = (np.abs(places[:, None] - voxels.centres[None]) <= voxels.widths[:, None] / 2 + 1e-12).all(-1)
    assert inside.any(1).all()
    assert voxels.counts.sum() == plain.counts.sum() == len(places)
    assert len(voxels.counts) < 0.8 * len(plain.counts)
    # the ball around a voxel reaches over no more than the one layer of voxels that is kept around it
    large = voxels.widths > 0.05
    assert large.any()
    assert (
        np.linalg.norm(voxels.centres[large], axis=1) + np.sqrt(3) * voxels.widths[large] / 2 < 0.5 + 0.05
    ).all()


def test_a_threshold_leaves_out_what_is_thin_and_says_when_nothing_is_left(rng):
    places = np.concatenate([rng.uniform(0, 0.1, (1000, 3)), [[0.45, 0.45, 0.45]]])
    assert (voxelise(places, 3, 0.1, min_samples=5).counts >= 5).all()
    with pytest.raises(ValueError, match="No voxel has 5000 samples"):
        voxelise(places, 3, 0.1, min_samples=5000)


def test_matches_are_the_best_one_to_one_and_then_the_closest(rng):
    centres, others = rng.normal(size=(12, 3)), rng.normal(size=(7, 3))
    thickness, other_thickness = rng.uniform(size=12), rng.uniform(size=7)
    found = match_primitives(centres, thickness, others, other_thickness)
    cost = ((centres[:, None] - others) ** 2).sum(-1) + (thickness[:, None] - other_thickness) ** 2
    rows, columns = linear_sum_assignment(cost)
    assert (found[rows] == columns).all()
    rest = np.setdiff1d(np.arange(12), rows)
    assert (found[rest] == cost[rest].argmin(1)).all()
    with pytest.raises(ValueError, match="swap the two sets"):
        match_primitives(others, other_thickness, centres, thickness)


def test_matches_on_one_grid_are_themselves(rng):
    grid = np.stack(np.meshgrid(*[np.arange(4.0)] * 3), -1).reshape(-1, 3)
    some = rng.permutation(64)[:20]
    found = match_primitives(grid, np.ones(64), grid[some], np.ones(20))
    assert (found[some] == np.arange(20)).all()
