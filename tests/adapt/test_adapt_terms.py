"""The objective's terms: against differences, slow sums, and what is known of them."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, random_pairs, random_pose

import jaxcap as jc
from jaxcap.adapt.objective import balancing_weight, motion_energy, pose_energy, symmetry_energy
from jaxcap.adapt.shape.shape_prior import body_shape_prior, shape_energy
from jaxcap.body.pose import Motion, rest_pose, stack_poses
from jaxcap.body.retraction import retract
from jaxcap.body.shape_modes import apply_modes, joint_modes
from jaxcap.body.symmetry import find_left_right_pairs
from jaxcap.energy.data.pairs import PairDistances, PointPairs
from jaxcap.energy.priors.reference_pose import RestPrior
from jaxcap.fit.linearise import linearise
from jaxcap.stacking import stack_trees

BODY = chain_body("swing_twist")
PRIOR = RestPrior(jnp.full((BODY.skeleton.num_joints, 3), 0.7))


def test_pairs_as_a_term_are_the_pairs_energy_with_its_slope(rng):
    pairs, pose = random_pairs(BODY, rng, corners=3), random_pose(BODY.skeleton, rng, 0.6)
    term = PairDistances(pairs)
    residual, jacobian = eqx.filter_jit(linearise)(term, BODY, pose)
    n = np.asarray(pairs.normals)
    places = np.asarray(jc.pose_body(BODY, pose).vertices)[np.asarray(pairs.vertices)]
    apart = np.einsum("ck,cka->ca", pairs.barycentric, places) - pairs.points
    across = np.einsum("ca,ca->c", n, apart)
    along = np.sum(apart**2, 1) - across**2
    assert float(residual @ residual) == pytest.approx(
        float(np.sum(pairs.weights * (across**2 + pairs.tangential_weights * along)))
    )

    @eqx.filter_jit
    def energy(d):
        r = term.residual(jc.pose_body(BODY, retract(BODY.skeleton, pose, d)))
        return r @ r

    h, zero = 1e-6, np.zeros(BODY.skeleton.num_dofs)
    found = [(energy(zero + h * e) - energy(zero - h * e)) / (2 * h) for e in np.eye(len(zero))]
    np.testing.assert_allclose(2 * jacobian.T @ residual, found, atol=1e-6 * np.abs(found).max())


def test_pairs_as_a_term_are_solved_beside_a_users_own(rng):
    truth = random_pose(BODY.skeleton, rng, 0.3)
    posed = jc.pose_body(BODY, truth)
    rows = jnp.arange(len(BODY.vertices), dtype=jnp.int32)[:, None]
    ones = jnp.ones(len(BODY.vertices))
    pairs = PointPairs(rows, ones[:, None], posed.vertices, posed.normals, ones, ones)
    found = jc.solve(PairDistances(pairs) + 1e-9 * PRIOR, BODY, jc.rest_pose(BODY.skeleton))
    np.testing.assert_allclose(jc.pose_body(BODY, found.pose).vertices, posed.vertices, atol=1e-5)


def test_a_body_keeps_its_own_shape_and_loses_it_where_it_is_changed(rng):
    prior = body_shape_prior(BODY, 3)
    assert shape_energy(prior, BODY) < 1e-20
    shifts = 0.01 * rng.normal(size=BODY.vertices.shape)
    rough = eqx.tree_at(lambda b: b.vertices, BODY, BODY.vertices + shifts)
    total = 0.0
    neighbours = [{int(v) for face in np.asarray(BODY.faces) if u in face for v in face} - {u} for u in range(len(shifts))]  # fmt: skip
    for number in range(3):
        pose = jc.Pose(*(leaf[number] for leaf in (prior.poses.translations, prior.poses.rotations, prior.poses.scale)))  # fmt: skip
        mesh = np.asarray(jc.pose_body(rough, pose).vertices)
        for u, near in enumerate(neighbours):
            total += np.sum((mesh[u] - np.mean([mesh[v] for v in near], 0) - prior.vectors[number][u]) ** 2)
    assert shape_energy(prior, rough) == pytest.approx(total / (3 * len(shifts)), rel=1e-6)


def test_the_human_is_symmetric_until_a_bone_grows():
    skeleton = jc.human(resolution="low", joints="tracking").skeleton
    pairs = find_left_right_pairs(skeleton)
    assert symmetry_energy(skeleton, pairs) < 1e-8
    along = skeleton.centres[skeleton.index("LeftForeArm")] - skeleton.centres[skeleton.index("LeftArm")]
    shift = 0.02 * along / jnp.linalg.norm(along)
    joints = [skeleton.index(name) for name in skeleton.names if skeleton.descendants[skeleton.index("LeftForeArm"), skeleton.index(name)]]  # fmt: skip
    grown = eqx.tree_at(lambda s: s.centres, skeleton, skeleton.centres.at[jnp.array(joints)].add(shift))
    assert symmetry_energy(grown, pairs) == pytest.approx(0.02**2, rel=0.01)


def test_the_pose_term_is_the_mean_and_balance_makes_terms_worth_alike(rng):
    poses = [random_pose(BODY.skeleton, rng, 0.5) for _ in range(3)]
    each = [float(jnp.sum(PRIOR.residual(jc.pose_body(BODY, pose)) ** 2)) for pose in poses]
    assert pose_energy(PRIOR, BODY, stack_trees(poses)) == pytest.approx(np.mean(each))
    assert balancing_weight(1e-5, 0.2) * 0.2 == pytest.approx(1e-5)
    assert balancing_weight(1e-5, 0.0) == 0.0


def test_the_temporal_term_of_too_few_frames_is_none(rng):
    poses = [random_pose(BODY.skeleton, rng, 0.1) for _ in range(4)]
    assert motion_energy(BODY.skeleton, stack_poses(poses[:2], 30.0)) == 0.0
    assert motion_energy(BODY.skeleton, stack_poses(poses, 30.0)) > 0
    still = Motion(stack_trees([poses[0]] * 4), 30.0)
    assert motion_energy(BODY.skeleton, still) == pytest.approx(0.0, abs=1e-20)


def test_wild_frames_may_be_left_out_of_the_temporal_term(rng):
    way = 0.01 * rng.normal(size=BODY.skeleton.num_dofs)
    bent = [retract(BODY.skeleton, rest_pose(BODY.skeleton), jnp.asarray(n**2 * way)) for n in range(9)]
    wild = stack_poses([*bent[:3], random_pose(BODY.skeleton, rng, 1.0), *bent[4:]], 30.0)
    # a joint that turns about one axis has the same second derivative wherever it is looked at
    whole = motion_energy(BODY.skeleton, stack_poses(bent, 30.0))
    assert motion_energy(BODY.skeleton, wild, excluded=(3,)) == pytest.approx(whole)
    assert motion_energy(BODY.skeleton, wild) > 10 * whole
    assert motion_energy(BODY.skeleton, wild, excluded=range(9)) == motion_energy(BODY.skeleton, wild)


def test_modes_move_joints_and_skin_together(rng):
    amounts = jnp.asarray(0.01 * rng.normal(size=3 * BODY.skeleton.num_joints))
    there = apply_modes(BODY, joint_modes(BODY, move_surface=False), amounts)
    np.testing.assert_array_equal(there.vertices, BODY.vertices)
    np.testing.assert_allclose(there.skeleton.centres, BODY.skeleton.centres + amounts.reshape(-1, 3), atol=1e-12)  # fmt: skip
