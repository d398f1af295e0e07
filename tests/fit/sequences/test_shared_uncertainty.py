"""Uncertainty of calibrations and of learned joints, against the dense inverse; bone lengths as unknowns."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, random_pose

import jaxcap as jc
from jaxcap.body.body import posed_vertices
from jaxcap.body.pose import stack_poses
from jaxcap.geometry.laplacian import apply_conformance
from tests.learn.test_learn_projection import arm
from tests.markers.test_markers_problem import scene


def dense_blocks(problem, y):
    """The diagonal blocks of the inverse of the whole matrix, on its equalities."""
    info = problem.information_of_data(y)
    whole = np.linalg.inv(np.asarray(info.hessian.as_matrix()))
    frames, dofs = info.hessian.diagonal()[0].shape
    if info.constraints is not None and info.constraints.equalities is not None:
        rows = np.pad(np.asarray(info.constraints.equalities.rows), ((0, 0), (frames * dofs, 0)))
        across = whole @ rows.T
        whole = whole - across @ np.linalg.pinv(rows @ across) @ across.T
    poses = [whole[dofs * f : dofs * (f + 1), dofs * f : dofs * (f + 1)] for f in range(frames)]
    return np.array(poses), whole[frames * dofs :, frames * dofs :]


def test_a_calibration_has_an_uncertainty(rng):
    problem, y = scene(rng)
    found = jc.markers.solve_calibration(problem, y)
    known = jc.fit.sequence_uncertainty(problem, found)
    poses, shared = dense_blocks(problem, found.estimate)
    np.testing.assert_allclose(known.poses, poses, rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(known.shared, shared, rtol=1e-5, atol=1e-12)
    # frames that are not independent tell less of what they share
    fewer = eqx.tree_at(lambda p: p.frames_per_observation, problem, jnp.asarray(4.0))
    lasting = jc.fit.sequence_uncertainty(fewer, jc.markers.solve_calibration(fewer, y))
    assert 1.2 < np.median(np.diagonal(lasting.shared) / np.diagonal(known.shared)) < 5
    ratios = np.diagonal(lasting.poses, axis1=1, axis2=2) / np.diagonal(known.poses, axis1=1, axis2=2)
    assert 1.0 < np.median(ratios) < 2
    assert len(known.names) == known.shared.shape[0]
    assert known.names[0].startswith("centre of ") and known.names[-1].startswith("sliding of ")
    assert jc.fit.describe_sequence(problem, known) == []


def test_a_frame_without_markers_is_named(rng):
    problem, y = scene(rng)
    hidden = eqx.tree_at(lambda p: p.seen, problem, problem.seen.at[0].set(False))
    known = jc.fit.sequence_uncertainty(hidden, jc.markers.solve_calibration(hidden, y))
    assert known.unobservable_poses[0].any() and not known.unobservable_poses[1:].any()
    lines = jc.fit.describe_sequence(hidden, known)
    assert lines and all("in frames 0" in line for line in lines)


def test_deviations_of_learned_joints_are_their_spread(rng):
    """For errors that are smooth over the surface, with the inverse of the metric as covariance."""
    body, poses = arm(rng, 5)
    clean = posed_vertices(body, poses)
    problem = jc.learn.make_joint_problem(body, clean, alpha=10.0)
    root = np.linalg.cholesky(
        np.linalg.inv(
            jax.vmap(lambda e: apply_conformance(problem.metric, e[:, None])[:, 0])(
                np.eye(len(body.vertices))
            )
        )
    )

    @eqx.filter_jit
    def solve(targets):
        moved = eqx.tree_at(lambda p: p.targets, problem, targets)
        found = jc.learn.solve_joints(moved, poses)
        known = jc.fit.sequence_uncertainty(moved, found)
        return found.body.skeleton.centres[1:].reshape(-1), jnp.diagonal(known.shared)

    noise = 1e-3 * np.einsum("vw,nfwa->nfva", root, rng.normal(size=(40, *clean.shape)))
    centres, variances = (
        np.array(part) for part in zip(*(solve(clean + each) for each in noise), strict=True)
    )
    rows = [number for number, name in enumerate(problem.shared_names()) if "centre" in name]
    spread, told = centres.std(0), np.sqrt(np.median(variances[:, rows], 0))
    assert np.isfinite(told).sum() >= 3
    seen = np.isfinite(told)
    assert 0.7 < np.median(told[seen] / spread[seen]) < 1.4


def test_learned_joints_have_an_uncertainty(rng):
    body, poses = arm(rng, 5)
    targets = posed_vertices(body, poses) + 1e-3 * rng.normal(size=(5, len(body.vertices), 3))
    problem = jc.learn.make_joint_problem(body, targets, alpha=1.0)
    found = jc.learn.solve_joints(problem, poses)
    known = jc.fit.sequence_uncertainty(problem, found)
    assert len(known.names) == known.shared.shape[0] == len(problem.slots)
    poses_of, shared = dense_blocks(problem, found.estimate)
    rows = targets.size - 5 * body.skeleton.num_dofs - len(problem.slots)
    variance = float(found.energy) / rows
    if not known.unobservable.any():
        np.testing.assert_allclose(known.shared, variance * shared, rtol=1e-3, atol=1e-14)
        np.testing.assert_allclose(known.poses, variance * poses_of, rtol=1e-3, atol=1e-14)
    deviations = np.sqrt(np.diagonal(np.asarray(known.shared)))
    assert 1e-5 < np.median(deviations[np.isfinite(deviations)]) < 2e-3


def test_bone_lengths_are_found_with_the_poses(rng):
    """The middle two bones are longer, both by one factor, and the next is shorter."""
    body = chain_body()
    groups = [(1, 2), 3]
    unknown = jc.fit.bone_length_changes(body, groups)
    truth = jnp.array([0.12, -0.1])
    poses = stack_poses([random_pose(body.skeleton, rng, 0.4) for _ in range(4)], 30.0).poses
    places = posed_vertices(unknown.apply(body, truth), poses)
    rows = jnp.arange(len(body.vertices))
    seen = jc.energy.stack_energies([jc.VertexLandmarks(rows, each, jnp.ones(len(rows))) for each in places])
    problem = jc.fit.SequenceProblem(body, seen, jnp.arange(4.0), {"lengths": unknown})
    found = jc.fit.solve_sequence(problem, poses)
    np.testing.assert_allclose(found.values["lengths"], truth, atol=1e-6)
    before, after = (
        np.linalg.norm(
            np.asarray(b.skeleton.centres)[1:4] - np.asarray(b.skeleton.centres)[[0, 1, 2]], axis=1
        )
        for b in (body, found.body)
    )
    np.testing.assert_allclose(after, before * [1.12, 1.12, 0.9], rtol=1e-6)


@pytest.mark.parametrize(
    ("joints", "word"),
    [
        ([0], "has no parent"),
        ([99], "there is no joint 99"),
        ([(1, -1)], "there is no joint -1"),
        ([3, (2, 3)], "twice; expected each joint once"),
        ([3, ()], "an entry without joints"),
        (["knee"], "there is no joint 'knee'"),
    ],
)
def test_bones_that_are_none_are_refused(joints, word):
    with pytest.raises(jc.InputError, match=word):
        jc.fit.bone_length_changes(chain_body(), joints)
    with pytest.raises(jc.InputError, match="`largest_change` is 0"):
        jc.fit.bone_length_changes(chain_body(), largest_change=0.0)
