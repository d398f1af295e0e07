"""Ends of clouds of a whole person, and the energy of surface beyond them."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, check_energy

import jaxcap as jc
from jaxcap.energy.data.cloud_extent import DIRECTIONS, LAYER, TOLERANCE, UNKNOWN, CloudExtent, extent_heights

BODY = chain_body()
NUM = len(BODY.vertices)


def ball(count: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """Points of a ball of half a metre around (1, 2, 3), and their normals."""
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return np.array([1.0, 2.0, 3.0]) + 0.5 * normals, normals


def energy_of(heights, deviation: float = 0.01) -> CloudExtent:
    return CloudExtent(jnp.arange(NUM), jnp.full(NUM, 0.5), jnp.asarray(heights), jnp.asarray(deviation))


def test_a_whole_cloud_ends_in_all_directions():
    points, normals = ball()
    heights = np.asarray(extent_heights(jc.make_cloud(points, normals)))
    np.testing.assert_allclose(heights, DIRECTIONS @ [1.0, 2.0, 3.0] + 0.5, atol=0.01)


@pytest.mark.parametrize("kept", ["front", "cut"])
def test_a_cloud_seen_from_one_side_or_cut_has_no_end_there(kept):
    points, normals = ball()
    # the front as a camera on the z axis sees it; a cut at the height of the centre leaves a ring of horizontal normals
    rows = normals[:, 2] > 0.1 if kept == "front" else normals[:, 1] > 0.0
    axis = 2 if kept == "front" else 1
    heights = np.asarray(extent_heights(jc.make_cloud(points[rows], normals[rows])))
    behind = (DIRECTIONS[:, axis] < -0.9) & (np.abs(DIRECTIONS).max(1) > 0.9)
    assert behind.sum() == 1
    assert (heights[behind] == UNKNOWN).all()
    ahead = DIRECTIONS[:, axis] > 0
    np.testing.assert_allclose(heights[ahead], DIRECTIONS[ahead] @ [1.0, 2.0, 3.0] + 0.5, atol=LAYER)


def test_a_cut_cloud_has_no_end_obliquely_behind_the_cut():
    """The surface next to the cut is oblique to these directions, too, but the rest of the surface is missing beyond it."""
    points, normals = ball()
    rows = normals[:, 1] > 0.0
    heights = np.asarray(extent_heights(jc.make_cloud(points[rows], normals[rows])))
    beyond = DIRECTIONS[:, 1] < 0
    assert beyond.sum() == 9
    assert (heights[beyond] == UNKNOWN).all()


def test_a_cloud_without_normals_has_no_ends():
    points, normals = ball(500)
    assert (np.asarray(extent_heights(jc.make_cloud(points, 0 * normals))) == UNKNOWN).all()


def test_only_surface_beyond_the_ends_counts():
    posed = jc.pose_body(BODY, jc.rest_pose(BODY.skeleton))
    reach = np.asarray(posed.vertices @ DIRECTIONS.T).max(0)
    assert not np.asarray(energy_of(reach + 1e-6).residual(posed)).any()
    assert not np.asarray(energy_of(np.full(len(DIRECTIONS), UNKNOWN)).residual(posed)).any()
    within = np.asarray(energy_of(reach - 0.9 * TOLERANCE).residual(posed))
    assert not within.any()
    # 4 cm beyond one end, and the tolerance: the residual of the farthest vertex is these in deviations, by the root of its weight
    up = int(np.flatnonzero(DIRECTIONS[:, 1] == 1.0)[0])
    lower = np.where(np.arange(len(DIRECTIONS)) == up, reach - TOLERANCE - 0.04, reach + 1e-6)
    residual = np.asarray(energy_of(lower).residual(posed))
    assert residual.max() == pytest.approx(np.sqrt(0.5) * 4.0)
    below = np.asarray(posed.vertices)[:, 1] < lower[up] + TOLERANCE
    assert not residual[below].any()


def test_derivatives_are_those_of_finite_differences():
    reach = np.asarray(BODY.vertices @ DIRECTIONS.T).max(0)
    # uneven, as a vertex that is as far beyond two ends has no derivative
    energy = energy_of(reach - TOLERANCE - np.linspace(0.11, 0.17, len(DIRECTIONS)), 0.5)
    check_energy(energy, BODY, tolerance=1e-5)
    posed = jc.pose_body(BODY, jc.rest_pose(BODY.skeleton))
    rows, slopes = energy.vertex_jacobian(posed)
    np.testing.assert_array_equal(rows, np.arange(NUM))
    step = 1e-6
    for axis in range(3):
        at = [
            energy.residual(
                eqx.tree_at(lambda p: p.vertices, posed, posed.vertices.at[:, axis].add(sign * step))
            )
            for sign in (1, -1)
        ]
        np.testing.assert_allclose(slopes[:, 0, axis], (at[0] - at[1]) / (2 * step), atol=1e-5)
