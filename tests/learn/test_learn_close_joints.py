"""Joints that are close to each other, and the priors that keep what no motion shows."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from helpers import chain_body
from scipy.spatial.transform import Rotation

import jaxcap as jc
from jaxcap.body.body import posed_vertices
from jaxcap.geometry.laplacian import make_conformance
from jaxcap.geometry.procrustes import group_moments
from jaxcap.learn.anatomy.close_joints import close_joints, hidden_joints, hinges
from jaxcap.learn.anatomy.small_joints import free_small_joints
from jaxcap.learn.objective import objective
from jaxcap.learn.skeleton.centre_constraints import KeptBones, MiddlePlanes, kept_bones
from jaxcap.learn.skeleton.given_centres import GivenCentres
from jaxcap.learn.skeleton.joint_centre_prior import (
    MIN_ROTATION,
    MIN_ROTATION_GIVEN,
    ROUGH,
    fixed_centre_prior,
    given_centre_prior,
    rotation_that_determines,
)
from jaxcap.learn.skeleton.joints import JointProblem, improve_joints, make_curvature
from jaxcap.learn.skeleton.pose_from_parts import fit_poses
from tests.learn.test_learn_projection import arm
from tests.learn.test_learn_steps import NONE
from tests.learn.test_learn_terms import checked_information


def test_neck_and_wrist_of_the_human_are_close():
    skeleton = jc.human(resolution="low", joints="tracking").skeleton
    names = np.array(skeleton.names)
    assert [tuple(names[list(pair)]) for pair in close_joints(skeleton)] == [
        ("Neck", "Neck1"),
        ("Neck1", "Head"),
    ]
    hidden = {str(names[joint]) for joint in hidden_joints(skeleton)}
    assert hidden >= {"Neck", "Neck1", "Head", "LeftShoulder", "RightShoulder"}
    assert not hidden & {"LeftUpLeg", "LeftArm", "LeftForeArm", "Spine", "LeftFoot", "LeftToeBase"}
    kinds = [
        "ball" if name.endswith("FingerBase") else kind
        for name, kind in zip(names, skeleton.kinds, strict=True)
    ]
    bending = dataclasses.replace(skeleton, kinds=tuple(kinds))
    pairs = [tuple(names[list(pair)]) for pair in close_joints(bending)]
    assert ("LeftHand", "LeftFingerBase") in pairs and ("RightHand", "RightFingerBase") in pairs
    # two joints in one place are no chain of three
    assert "LeftHand" not in {str(names[joint]) for joint in hidden_joints(bending)}
    assert hidden_joints(chain_body().skeleton) == hinges(chain_body().skeleton) == ()
    assert {str(names[joint]) for joint in hinges(bending)} == {
        "LeftForeArm",
        "RightForeArm",
        "LeftLeg",
        "RightLeg",
    }
    assert close_joints(chain_body().skeleton) == ()


def test_constraints_have_their_derivatives(rng):
    centres = jnp.asarray(rng.normal(size=(5, 3)))
    bones = KeptBones(jnp.asarray(rng.normal(size=(2, 3))), ((0, 3), (3, 4)))
    planes = MiddlePlanes(jnp.asarray(rng.normal(size=(2, 3))), jnp.asarray(rng.normal(size=(2, 3))), (1, 4))
    for constraint in (bones, planes):
        slopes = constraint.differences(centres)[1]
        np.testing.assert_allclose(slopes, jax.jacobian(lambda c, k=constraint: k.differences(c)[0])(centres))
    np.testing.assert_allclose(bones.differences(centres)[0][:3], centres[3] - centres[0] - bones.vectors[0])
    given = GivenCentres(centres)
    np.testing.assert_allclose(kept_bones(given, ((1, 2),), NONE).differences(centres)[0], 0.0)
    assert kept_bones(given, (), NONE) is None
    # left and right of equal length, in their own directions
    paired = kept_bones(given, ((0, 1), (0, 3)), np.array([[1, 3]]))
    assert paired is not None
    lengths = np.linalg.norm(np.asarray(centres)[[1, 3]] - np.asarray(centres)[0], axis=1)
    np.testing.assert_allclose(np.linalg.norm(paired.vectors, axis=1), lengths.mean())
    np.testing.assert_allclose(np.cross(paired.vectors[1], centres[3] - centres[0]), 0.0, atol=1e-12)


def test_equations_with_a_prior_are_the_gradient(rng):
    body, poses = arm(rng, 3)
    targets = posed_vertices(body, poses) + 0.01 * rng.normal(size=(3, len(body.vertices), 3))
    metric = make_conformance(np.asarray(body.faces), len(body.vertices), 1.0)
    given = GivenCentres(
        body.skeleton.centres + 0.02 * jnp.asarray(rng.normal(size=body.skeleton.centres.shape))
    )
    prior = given_centre_prior(body, poses, given, 1e-4)
    # heavy, so that an error of its gradient shows
    prior = eqx.tree_at(lambda p: p.rotations, prior, 1e3 * prior.rotations)
    problem = JointProblem(body, targets, metric, make_curvature(metric), prior, 0.7)
    info = checked_information(problem, poses)
    alone = dataclasses.replace(problem, centre_prior=None).information(problem.start(poses))
    for found, without in zip(info.grad, alone.grad, strict=True):
        assert float(jnp.abs(found - without).max()) > 1e-3
    away = np.asarray(body.skeleton.centres - given.centres)
    quadratic = 0.5 * np.einsum("ja,jab,jb->", away, np.asarray(prior.weights), away)
    np.testing.assert_allclose(prior.energy(body.skeleton.centres), quadratic)
    # with half of each distance outside of its sphere
    length = np.linalg.norm(away, axis=1)
    small = eqx.tree_at(lambda p: p.radii, prior, jnp.asarray(0.5 * length))
    checked_information(dataclasses.replace(problem, centre_prior=small), poses)
    outside = 0.5 * np.sum(np.asarray(prior.beyond) * (0.5 * length) ** 2)
    np.testing.assert_allclose(small.energy(body.skeleton.centres), quadratic + outside)


def test_a_centre_that_data_place_outside_of_the_body_stays_near_the_given_one(rng):
    """The end of a limb that is shifted, as cloth is, looks like a rotation about a distant point."""
    body, poses = arm(rng, 8)
    joint = body.skeleton.num_joints - 1
    distant = eqx.tree_at(
        lambda b: b.skeleton.centres, body, body.skeleton.centres.at[joint].add(jnp.array([0, 0, 0.6]))
    )
    targets = posed_vertices(distant, poses)
    metric = make_conformance(np.asarray(body.faces), len(body.vertices), 1.0)
    given, curvature = GivenCentres(body.skeleton.centres), make_curvature(metric)
    value = float(objective(body, poses, targets, metric))
    for _ in range(4):
        found = improve_joints(body, poses, targets, metric, curvature, NONE, 1e-4, value, 4, given)
        body, poses, value = found.body, found.poses, found.value
    radius = float(given_centre_prior(body, poses, given, value / targets.size).radii[joint])
    moved = float(jnp.linalg.norm(body.skeleton.centres[joint] - given.centres[joint]))
    assert moved < 1.2 * radius, (moved, radius)


def test_finer_data_need_less_rotation_to_determine_a_centre(rng):
    body, poses = arm(rng, 6)
    size = float(np.linalg.norm(np.ptp(np.asarray(body.vertices), axis=0)))
    assert rotation_that_determines(body, size**2) == MIN_ROTATION_GIVEN
    np.testing.assert_allclose(
        rotation_that_determines(body, (0.5 * ROUGH * size) ** 2), 0.5 * MIN_ROTATION_GIVEN
    )
    assert rotation_that_determines(body, 0.0) == MIN_ROTATION
    given = GivenCentres(body.skeleton.centres)
    rough, fine = (np.asarray(given_centre_prior(body, poses, given, v).weights) for v in (1.0, 1e-10))
    moving = np.trace(rough, axis1=1, axis2=2) > 0
    assert np.all(np.trace(fine, axis1=1, axis2=2)[moving] < 0.1 * np.trace(rough, axis1=1, axis2=2)[moving])
    assert not fixed_centre_prior(body, 6).weights[0].any()


def test_close_joints_move_together(rng):
    body, poses = arm(rng, 8)
    targets = posed_vertices(body, poses)
    metric = make_conformance(np.asarray(body.faces), len(body.vertices), 1.0)
    joints = [j for j, parent in enumerate(body.skeleton.parents) if parent >= 0][:2]
    off = eqx.tree_at(lambda b: b.skeleton.centres, body, body.skeleton.centres.at[joints[1]].add(0.02))
    given, pair = GivenCentres(off.skeleton.centres), (tuple(joints),)
    curvature = make_curvature(metric)
    start = float(objective(off, poses, targets, metric))
    together = improve_joints(off, poses, targets, metric, curvature, NONE, 1e-4, start, 4, given, close=pair)
    single = improve_joints(off, poses, targets, metric, curvature, NONE, 1e-4, start, 4, given)
    bone = lambda b: np.asarray(b.skeleton.centres[joints[1]] - b.skeleton.centres[joints[0]])  # noqa: E731
    assert together.value < start
    np.testing.assert_allclose(bone(together.body), bone(off), atol=1e-9)
    assert np.linalg.norm(bone(single.body) - bone(off)) > 1e-3
    assert np.linalg.norm(np.asarray(together.body.skeleton.centres - off.skeleton.centres)) > 1e-3


def bending_hand(rng, pivot: int):
    """Return a forearm and fingers with a short hand between them, moved about one of the two joints of the hand."""
    names = ["forearm", "LeftHand", "LeftFingers", "RightHand", "RightFingers"]
    centres = np.array([[0, 0, 0], [0.3, 0, 0], [0.34, 0, 0], [0.3, 1, 0], [0.34, 1, 0]])
    kinds = ["free", "ball", "fixed", "ball", "fixed"]
    skeleton = jc.make_skeleton(names, [-1, 0, 1, 0, 3], kinds, centres)
    arm_points = rng.uniform([0, -0.03, -0.03], [0.3, 0.03, 0.03], (40, 3))
    fingers = rng.uniform([0.34, -0.04, -0.02], [0.5, 0.04, 0.02], (30, 3))
    rest = np.concatenate([arm_points, fingers, [[0.31, 0, 0]]])
    labels = np.array([0] * 40 + [2] * 30 + [1])
    shapes = []
    for angle in np.linspace(-0.6, 0.6, 9):
        moved = rest.copy()
        turn = Rotation.from_rotvec([0, 0, angle])
        moved[40:70] = turn.apply(rest[40:70] - centres[pivot]) + centres[pivot]
        shapes.append(moved)
    # in one mesh the fingers are somewhere else
    shapes[4] = shapes[4] + np.where(labels[:, None] == 2, 0.1, 0.0)
    return skeleton, rest, np.array(shapes), labels


def test_the_base_of_the_fingers_is_free_if_the_hand_bends_there(rng):
    freed = free_small_joints(*bending_hand(rng, pivot=2))
    assert freed.kinds[1:3] == ("revolute", "ball")
    # the wrist twists about the forearm
    np.testing.assert_allclose(freed.axes[1, 0], [1, 0, 0], atol=1e-6)
    assert free_small_joints(*bending_hand(rng, pivot=1)).kinds[1:3] == ("ball", "fixed")
    skeleton, rest, shapes, labels = bending_hand(rng, pivot=2)
    # a hand that does not move shows nothing
    assert free_small_joints(skeleton, rest, np.repeat(rest[None], 4, 0), labels).kinds[2] == "fixed"
    # nor does one without vertices
    assert free_small_joints(skeleton, rest, shapes, labels).kinds[3:] == ("ball", "fixed")


def test_a_thumb_is_free_if_it_moves_otherwise_than_the_fingers(rng):
    skeleton, rest, shapes, labels = bending_hand(rng, pivot=1)
    skeleton = jc.make_skeleton(
        [*skeleton.names, "LThumb"],
        [*skeleton.parents, 1],
        [*skeleton.kinds, "fixed"],
        np.concatenate([np.asarray(skeleton.centres), [[0.31, 0.03, 0]]]),
    )
    thumb = rng.uniform([0.31, 0.03, -0.01], [0.36, 0.06, 0.01], (12, 3))
    rest, labels = np.concatenate([rest, thumb]), np.append(labels, [5] * 12)
    angles = np.linspace(-0.6, 0.6, 9)
    for turns, kind in ((0 * angles, "fixed"), (rng.permutation(angles), "ball")):
        # the hand, with the thumb, about the wrist; the thumb about its own joint before
        hand = Rotation.from_rotvec(angles[:, None] * [0, 0, 1])
        own = Rotation.from_rotvec(turns[:, None] * [0, 1, 0])
        bent = np.stack([turn.apply(thumb - thumb[0]) + thumb[0] for turn in own])
        moved = np.stack(
            [turn.apply(b - [0.3, 0, 0]) + [0.3, 0, 0] for turn, b in zip(hand, bent, strict=True)]
        )
        moved[4] += 0.1
        freed = free_small_joints(skeleton, rest, np.concatenate([shapes, moved], 1), labels)
        assert freed.kinds[1:3] + freed.kinds[5:] == ("ball", "fixed", kind)


def test_two_points_do_not_rotate_a_part(rng):
    skeleton, rest, shapes, labels = bending_hand(rng, pivot=2)
    skeleton = dataclasses.replace(skeleton, kinds=("free", "ball", "ball", "ball", "ball"))
    # noise moves the two points of the hand by more than their distance
    shapes = shapes[[0, 1, 2, 6, 7, 8]]
    shapes[:, -1] += rng.normal(scale=0.02, size=(6, 3))
    groups = (labels == np.arange(5)[:, None]).astype(float)
    groups[1] *= 0.1
    poses = fit_poses(skeleton, group_moments(groups, rest, shapes.transpose(1, 0, 2)))
    angles = np.degrees(np.linalg.norm(np.asarray(jc.geometry.rotation.log(poses.rotations)), axis=2))
    assert angles[:, 1].max() < 20
    expected = np.degrees(np.abs(np.linspace(-0.6, 0.6, 9)))[[0, 1, 2, 6, 7, 8]]
    np.testing.assert_allclose(angles[:, 2], expected, atol=20)
