"""Learned correctives: known ones are recovered, noise is not learned, and each vertex follows joints near it only."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, random_pose

import jaxcap as jc
from jaxcap.body.body import posed_vertices
from jaxcap.body.pose import Motion, stack_poses
from jaxcap.body.skin import CorrectedSkin, RotationMatrixFeatures
from jaxcap.body.skin.low_rank import factorise_by_joint
from jaxcap.energy.priors.reference_pose import RestPrior
from jaxcap.learn.correctives.choose import successive_folds
from jaxcap.learn.correctives.equations import make_equations, solve_directions
from jaxcap.learn.correctives.near_joints import find_near_joints, list_columns
from jaxcap.learn.correctives.pose_basis import make_pose_basis, pose_values

FEATURES = RotationMatrixFeatures()
COUNT, TESTED = 80, 8
STRENGTH = jnp.asarray(0.3)


@pytest.fixture(scope="module")
def truth():
    """A body with displacements of rank two at each joint, about 1 cm, each at vertices near the joint; and poses."""
    rng = np.random.default_rng(0)
    body = chain_body("linear", rings=5)
    near = find_near_joints(body)[:, 1:]
    layer, owners = [], []
    for joint in np.flatnonzero(near.any(0)):
        for _ in range(2):
            row = np.zeros(FEATURES.num_features(9))
            row[9 * joint : 9 * joint + 9] = rng.normal(size=9) / 3
            layer.append(row)
            owners.append(joint)
    directions = 0.012 * rng.normal(size=(len(near), 3, len(layer))) * near[:, None, owners]
    skin = CorrectedSkin(
        body.skin, FEATURES, jnp.asarray(directions), jnp.asarray(np.array(layer)), rectified=False
    )
    corrected = eqx.tree_at(lambda b: b.skin, body, skin)
    poses = stack_poses([random_pose(body.skeleton, rng, 0.5) for _ in range(COUNT + TESTED)]).poses
    return body, corrected, poses


def take(poses, rows):
    return jax.tree.map(lambda leaf: leaf[rows], poses)


@pytest.fixture(scope="module")
def learned(truth):
    body, corrected, poses = truth
    training = take(poses, slice(COUNT))
    meshes = jc.MeshSequence(posed_vertices(corrected, training), body.faces)
    return jc.learn.learn_correctives(body, Motion(training), meshes)


def rms(gaps) -> float:
    return float(np.sqrt(np.mean(np.sum(np.asarray(gaps) ** 2, -1))))


def test_known_correctives_are_recovered_in_poses_that_were_not_learned(truth, learned):
    body, corrected, poses = truth
    unseen = take(poses, slice(COUNT, None))
    true = posed_vertices(corrected, unseen)
    before = rms(posed_vertices(body, unseen) - true)
    assert 0.006 < before < 0.03
    assert learned.is_used
    assert rms(posed_vertices(learned.body, unseen) - true) < 0.12 * before
    # the estimate from left-out poses is about the error of new ones
    assert learned.choice.error_without == pytest.approx(before, rel=0.25)
    assert learned.choice.error_with < 0.3 * before


def test_a_vertex_follows_joints_near_it_only(truth, learned):
    body, _, _ = truth
    skin, skeleton = learned.body.skin, body.skeleton
    full = np.asarray(skin.directions) @ np.asarray(skin.layer)
    follows = full.reshape(len(body.vertices), 3, -1, 9).any((1, 3))
    weights = np.asarray(body.skin.bone_weights(9))
    for vertex in range(0, len(weights), 7):
        bones = set(np.flatnonzero(weights[vertex] > 0.02).tolist())
        around = bones | {skeleton.parents[bone] for bone in bones}
        around |= {bone for bone in range(9) if skeleton.parents[bone] in bones}
        assert set((1 + np.flatnonzero(follows[vertex])).tolist()) <= around - {0, skeleton.index("tool")}
    assert learned.by_joint.names == tuple(skeleton.names[joint] for joint in learned.by_joint.joints)
    # units reach one in the poses of the meshes
    units = np.array([skin.units(pose) for pose in map(learned.motion.__getitem__, range(COUNT))])
    largest = np.abs(units.reshape(COUNT, -1)).max(0)
    assert largest.max() < 1.3 and largest.min() > 0.7


def test_the_report_of_joints_is_what_they_move(truth, learned):
    body = learned.body
    joint = int(learned.by_joint.joints[0])
    rest = np.asarray(learned.motion.poses.rotations).copy()
    rest[:, [other for other in range(9) if other != joint]] = [1.0, 0, 0, 0]
    moved = np.array(
        [
            body.skin.displacements(
                jc.Pose(
                    *(leaf[0] for leaf in (learned.motion.poses.translations, turned[None])), jnp.ones(())
                )
            )
            for turned in jnp.asarray(rest)
        ]
    )
    assert learned.by_joint.largest[0] == pytest.approx(np.linalg.norm(moved, axis=2).max(), rel=1e-6)


def test_noise_is_not_learned(truth):
    body, _, poses = truth
    training = take(poses, slice(COUNT))
    noise = 0.004 * np.random.default_rng(1).normal(size=(COUNT, len(body.vertices), 3))
    meshes = jc.MeshSequence(posed_vertices(body, training) + noise, body.faces)
    found = jc.learn.learn_correctives(body, Motion(training), meshes)
    assert not found.is_used and found.body is body
    assert found.by_joint.names == ()
    assert found.choice.error_without == pytest.approx(0.004 * np.sqrt(3), rel=0.05)


def test_directions_are_the_regularised_least_squares_solution_and_have_derivatives(truth, rng):
    body, corrected, poses = truth
    training = take(poses, slice(12))
    targets = posed_vertices(corrected, training)
    values = np.asarray(pose_values(FEATURES, training))
    basis = make_pose_basis(values, 9)
    used = find_near_joints(body)[:, basis.joints]
    equations = make_equations(
        body, training, targets, jnp.asarray(values @ basis.rows.T), *list_columns(used)
    )
    shift, directions = solve_directions(equations, STRENGTH)
    for vertex in (0, 17, 40):
        columns = np.flatnonzero(used[vertex])
        units = np.concatenate([np.ones((12, 1)), (values @ basis.rows.T)[:, columns]], 1)
        slopes = np.asarray(equations.slopes[:, vertex])
        rows = np.concatenate([np.kron(units[f], slopes[f]) for f in range(12)])
        prior = np.sqrt(float(STRENGTH)) * np.eye(3 * len(units[0]))[3:]
        side = np.concatenate([np.asarray(equations.errors[:, vertex]).ravel(), np.zeros(len(prior))])
        x = np.linalg.lstsq(np.concatenate([rows, prior]), side, rcond=None)[0].reshape(-1, 3)
        np.testing.assert_allclose(shift[vertex], x[0], atol=1e-9)
        np.testing.assert_allclose(np.asarray(directions[vertex])[:, columns], x[1:].T, atol=1e-9)
        assert not np.asarray(directions[vertex])[:, ~used[vertex]].any()
    probe = jnp.asarray(rng.normal(size=directions.shape))

    def measured(errors, slopes):
        moved = eqx.tree_at(lambda e: (e.errors, e.slopes), equations, (errors, slopes))
        return jnp.vdot(probe, solve_directions(moved, STRENGTH)[1])

    given = equations.errors, equations.slopes
    gradients = jax.grad(measured, (0, 1))(*given)
    for number, gradient in enumerate(gradients):
        step = jnp.asarray(rng.normal(size=gradient.shape))
        ends = [
            measured(*(x + share * step if i == number else x for i, x in enumerate(given)))
            for share in (1e-5, -1e-5)
        ]
        np.testing.assert_allclose(jnp.vdot(gradient, step), (ends[0] - ends[1]) / 2e-5, rtol=1e-5)


def test_folds_are_runs_of_meshes():
    folds = successive_folds(13, 5)
    assert (np.diff(folds) >= 0).all() and set(folds.tolist()) == set(range(5))
    assert np.ptp(np.bincount(folds)) <= 1


def test_values_that_do_not_occur_have_no_unit(rng):
    # as of a joint that turns about one axis only
    values = rng.normal(size=(20, 3)) * [1.0, 1.0, 0.0]
    unused = rng.normal(size=(5, 3, 3)) * [0.0, 0.0, 1.0]
    assert factorise_by_joint(unused, values, np.zeros(3, int), 3).layer.shape == (0, 3)
    directions = rng.normal(size=(5, 3, 3))
    found = factorise_by_joint(directions, values, np.zeros(3, int), 3)
    assert np.isfinite(found.layer).all()
    units = values @ found.layer.T
    np.testing.assert_allclose(np.abs(units).max(0), 1.0)
    np.testing.assert_allclose(found.directions @ units.T, directions @ values.T, atol=1e-9)


def test_energies_of_the_poses_hold_with_correctives_too(truth):
    body, corrected, poses = truth
    training = take(poses, slice(COUNT))
    meshes = jc.MeshSequence(posed_vertices(corrected, training), body.faces)
    hinge = body.skeleton.index("elbow")
    free = jc.learn.learn_correctives(body, Motion(training), meshes)
    found = jc.learn.learn_correctives(body, Motion(training), meshes, (RestPrior(jnp.full((9, 3), 0.01)),))

    def turned(motion):
        return np.linalg.norm(np.asarray(motion.poses.rotations)[:, hinge, 1:], axis=1)

    assert turned(found.motion).mean() < 0.9 * turned(free.motion).mean()


def test_what_cannot_be_learned_from_is_refused(truth, learned):
    body, corrected, poses = truth
    training = take(poses, slice(COUNT))
    vertices = posed_vertices(corrected, training)

    def attempt(body=body, count=COUNT, still=False, posed=COUNT, unknown=()):
        rows = np.zeros(count, int) if still else np.arange(count)
        known = jnp.ones(count).at[jnp.array(unknown, int)].set(jnp.nan)
        meshes = jc.MeshSequence(vertices[rows] * known[:, None, None], body.faces)
        return jc.learn.learn_correctives(body, Motion(take(training, rows[:posed])), meshes)

    for options, sentence in (
        ({"count": 7}, "there are 7 meshes; expected at least 8"),
        ({"count": 9, "still": True}, "no joint rotates by more than 0.0 degrees .* expected at least 10"),
        ({"count": 9, "posed": 8}, "8 poses and 9 meshes"),
        ({"body": learned.body}, "has correctives already"),
        ({"unknown": (2, 5)}, r"the meshes \[2, 5\] hold numbers that are not finite"),
    ):
        with pytest.raises(jc.InputError, match=sentence):
            attempt(**options)
    with pytest.raises(jc.InputError, match="not those of `learn_correctives`"):
        jc.learn.measure_correctives(body, Motion(training))
