"""Clothes as a part's second distribution: densities by hand, what teaches them, and what they leave alone."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from helpers import chain_body, random_pose

import jaxcap as jc
from jaxcap.body.body import pose_body
from jaxcap.body.pose import rest_pose
from jaxcap.observe.clouds import make_cloud
from jaxcap.tracking.expectation_maximisation.clothes import (
    FULLY_COVERED,
    Clothes,
    body_size,
    clothes_allowance,
    first_clothes,
)
from jaxcap.tracking.expectation_maximisation.e_step import posterior
from jaxcap.tracking.expectation_maximisation.learn_clothes import update_clothes
from jaxcap.tracking.judgement.evidence import gather_evidence
from jaxcap.tracking.judgement.region_samples import sample_regions
from jaxcap.tracking.track_frame import make_tracker, start_state, track_frame

BODY = chain_body("linear", 12, 10)
POSED = pose_body(BODY, rest_pose(BODY.skeleton))
TRACKER = make_tracker(BODY)
SIGMA, VOLUME, OUTLIER = 0.004, 1.0, 0.1
COUNT = BODY.skeleton.num_joints

_track_frame = eqx.filter_jit(track_frame)


def worn(share: float, offset: float = 0.03, deviation: float = 0.01) -> Clothes:
    ones = jnp.ones(COUNT)
    return Clothes(share * ones, offset * ones, deviation * ones, jnp.asarray(1.0))


def shell(offset: float, noise: float = 0.0, rng=None) -> jc.Cloud:
    """All vertices, moved along their normals."""
    points = np.asarray(POSED.vertices) + offset * np.asarray(POSED.normals)
    if rng is not None:
        points = points + noise * rng.normal(size=points.shape)
    return make_cloud(points, np.asarray(POSED.normals))


def assign(cloud: jc.Cloud, clothes: Clothes | None, candidates: int | None = None):
    return posterior(
        TRACKER.parts,
        POSED.vertices,
        POSED.normals,
        cloud,
        SIGMA,
        outlier=OUTLIER,
        box_volume=VOLUME,
        clothes=clothes,
        candidates=candidates,
    )


def test_probabilities_and_densities_by_hand(rng):
    """Every point has a probability of one in sum, and the density of a brute-force mixture."""
    cloud = shell(0.025, 0.01, rng)
    clothes = worn(0.6)
    found = assign(cloud, clothes)
    total = found.weights.sum(1) + found.clothes + found.outlier
    real = np.asarray(cloud.weights) > 0
    np.testing.assert_allclose(np.asarray(total)[real], 1.0, rtol=1e-5)
    bones = np.asarray(BODY.skin.dominant_bones())
    parts = np.unique(bones)
    vertices, normals = np.asarray(POSED.vertices), np.asarray(POSED.normals)
    points, directions = np.asarray(cloud.points), np.asarray(cloud.normals)
    deviation = np.sqrt(0.01**2 + SIGMA**2)
    for row in np.flatnonzero(real)[::37]:
        nearest, squares = {}, {}
        for part in parts:
            members = np.flatnonzero((bones == part) & (normals @ directions[row] > 0.5))
            if len(members):
                away = np.sum((vertices[members] - points[row]) ** 2, 1)
                nearest[part], squares[part] = members[away.argmin()], away.min()
        density = OUTLIER / VOLUME
        for square in squares.values():
            density += (
                (1 - OUTLIER)
                / len(parts)
                * 0.4
                * scipy.stats.multivariate_normal.pdf(np.sqrt(square) * np.eye(3)[0], np.zeros(3), SIGMA**2)
            )
        if squares:
            first = min(squares, key=squares.get)
            vertex = nearest[first]
            outwards = (points[row] - vertices[vertex]) @ normals[vertex]
            if outwards > 0.3 * 0.03:
                middle = vertices[vertex] + 0.03 * normals[vertex]
                density += (
                    (1 - OUTLIER)
                    / len(parts)
                    * 0.6
                    * scipy.stats.multivariate_normal.pdf(points[row], middle, deviation**2)
                )
        assert float(found.log_density[row]) == pytest.approx(np.log(density), abs=2e-3)


def learned(cloud: jc.Cloud, frames: int = 12) -> Clothes:
    clothes = first_clothes(BODY, COUNT)
    for _ in range(frames):
        clothes = update_clothes(clothes, assign(cloud, clothes, 1), POSED, cloud, jnp.asarray(SIGMA))
    return clothes


def large_parts() -> np.ndarray:
    shares = np.bincount(np.asarray(BODY.skin.dominant_bones()), minlength=COUNT)
    return shares >= 0.1 * len(BODY.vertices)


def test_a_shell_about_the_skin_is_learned_as_clothes(rng):
    offset = 0.03 * float(body_size(BODY))
    clothes = learned(shell(offset, 0.1 * offset, rng))
    parts = large_parts()
    assert parts.sum() >= 3
    assert np.asarray(clothes.share)[parts].min() > FULLY_COVERED
    np.testing.assert_allclose(np.asarray(clothes.offset)[parts], offset, rtol=0.25)
    assert np.asarray(clothes_allowance(clothes))[parts].min() > offset


@pytest.mark.parametrize("shift", [(0.0, 0.02, 0.0), (0.0, 0.0, -0.02)])
def test_the_skin_and_a_displaced_skin_teach_no_clothes(rng, shift):
    """A body that lags behind its points has as many of them inside as outside."""
    for moved in (np.zeros(3), np.array(shift)):
        cloud = shell(0.0, 0.002, rng)
        cloud = eqx.tree_at(lambda c: c.points, cloud, cloud.points + jnp.asarray(moved, cloud.points.dtype))
        clothes = learned(cloud)
        assert np.asarray(clothes.covered)[large_parts()].max() == 0.0
        assert np.asarray(clothes_allowance(clothes))[large_parts()].max() == 0.0


def test_without_covered_parts_a_frame_is_tracked_as_without_the_model(rng):
    start = random_pose(BODY.skeleton, rng, 0.05)
    cloud = shell(0.0, 0.002, rng)
    poses = []
    for clothes in (False, True):
        tracker = make_tracker(BODY, clothes=clothes)
        state, statistics = _track_frame(tracker, start_state(tracker, start, 0.02), cloud)
        poses.append((state.estimate.pose, statistics))
        assert (state.estimate.clothes is None) == (not clothes)
    for plain, other in zip(*(dataclasses.astuple(pose) for pose, _ in poses), strict=True):
        np.testing.assert_allclose(other, plain, atol=1e-5)
    assert float(poses[1][1].sigma) == pytest.approx(float(poses[0][1].sigma), rel=1e-4)


def test_points_of_clothes_pull_less_than_those_of_skin(rng):
    """A one-sided sheet over the body moves it by less where its parts are known to wear clothes."""
    offset = 0.03 * float(body_size(BODY))
    normals = np.asarray(POSED.normals)
    lifted = np.asarray(POSED.vertices) + offset * normals * (normals[:, 1:2] > 0.0)
    cloud = make_cloud(lifted, normals)
    moved = []
    for share in (0.0, 0.9):
        tracker = make_tracker(BODY, clothes=True)
        clothes = dataclasses.replace(
            tracker.clothes, share=jnp.full(COUNT, share), offset=jnp.full(COUNT, offset)
        )
        tracker = dataclasses.replace(tracker, clothes=clothes)
        state, _ = _track_frame(tracker, start_state(tracker, rest_pose(BODY.skeleton), 0.02), cloud)
        middle = np.asarray(pose_body(BODY, state.estimate.pose).vertices).mean(0)
        moved.append(float(middle[1] - np.asarray(POSED.vertices)[:, 1].mean()))
    assert moved[0] > 0.2 * offset
    assert abs(moved[1]) < 0.5 * moved[0]


def test_points_within_the_allowance_of_clothes_are_explained():
    """Also the surface under them is not empty, and points on the skin still belong to their own part."""
    surface = sample_regions(BODY)
    size = float(surface.size)
    cloud, pose = shell(0.08 * size), rest_pose(BODY.skeleton)
    bare = gather_evidence(surface, pose, cloud)
    worn_all = gather_evidence(surface, pose, cloud, allowance=jnp.full(COUNT, 0.08 * size))
    assert float(bare.unexplained.sum()) > 0.5
    assert float(worn_all.unexplained.sum()) < 0.05
    assert float(worn_all.empty.sum()) <= float(bare.empty.sum())
    one = jnp.zeros(COUNT).at[BODY.skeleton.index("chest")].set(0.2 * size)
    skin = shell(0.0)
    np.testing.assert_allclose(
        gather_evidence(surface, pose, skin, allowance=one).support,
        gather_evidence(surface, pose, skin).support,
        rtol=1e-5,
    )
