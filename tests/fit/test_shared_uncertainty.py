"""Uncertainty of calibrations and of learned joints, against the dense inverse; bone lengths as unknowns."""

import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, random_pose

import jaxcap as jc
from jaxcap.body.body import posed_vertices
from jaxcap.body.pose import stack_poses
from tests.learn.test_learn_projection import arm
from tests.markers.test_markers_problem import scene


def dense_blocks(problem, y):
    """The diagonal blocks of the inverse of the whole matrix, on its equalities."""
    info = problem.information(y)
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
    factor = float(problem.frames_per_observation)
    np.testing.assert_allclose(known.poses, factor * poses, rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(known.shared, factor * shared, rtol=1e-5, atol=1e-12)
    assert len(known.names) == known.shared.shape[0]
    assert known.names[0].startswith("centre of ") and known.names[-1].startswith("sliding of ")
    assert jc.fit.describe_sequence(problem, known) == []


def test_learned_joints_have_an_uncertainty(rng):
    """The position of a hinge along its axis is observable by nothing, and is named."""
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
    unknown = jc.fit.bone_lengths(body, groups)
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
    [([0], "has no parent"), ([99], "there is no joint 99"), ([(1, -1)], "there is no joint -1")],
)
def test_bones_that_are_none_are_refused(joints, word):
    with pytest.raises(jc.InputError, match=word):
        jc.fit.bone_lengths(chain_body(), joints)
    with pytest.raises(jc.InputError, match="`largest_change` is 0"):
        jc.fit.bone_lengths(chain_body(), largest_change=0.0)
