"""The ranges of knees and elbows: the same angles of the segments for every skeleton of a person."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_energy

import jaxcap as jc
from jaxcap.body.kinematics import forward_kinematics, joint_positions
from jaxcap.energy.priors.flexion_limits import human_flexion_limits
from jaxcap.geometry import rotation
from jaxcap.limits.abstract_limits import allowed
from jaxcap.observe.clouds import make_cloud
from jaxcap.tracking.track_frame import penalty

BODY = jc.human(resolution="low", joints="tracking")
HUMAN = BODY.skeleton
#: names as Mixamo's
PREFIX = "mixamorig:"


def flexed(skeleton, limits, angles) -> jc.Pose:
    """The pose in which the limited joints are rotated by some angles about their axes."""
    joints = jnp.asarray(limits.indices(skeleton))
    rest = jc.rest_pose(skeleton)
    turns = rotation.about_axis(limits.axes, jnp.asarray(angles, limits.axes.dtype))
    return eqx.tree_at(lambda p: p.rotations, rest, rest.rotations.at[joints].set(turns))


def flexions(skeleton, pose) -> np.ndarray:
    """Knees and elbows, left and right, degrees, by the conventions of biomechanics."""
    table = jc.joint_angles(skeleton, jc.stack_poses([pose], 30.0))
    names = ("knee_angle_l", "knee_angle_r", "elbow_flex_l", "elbow_flex_r")
    return np.degrees([np.asarray(table.values)[0, table.names.index(name)] for name in names])


def raised_arms():
    """The embedded human's tree with other names, and arms that point sideways at rest."""
    rest = jc.rest_pose(HUMAN)
    turns = rotation.about_axis(jnp.tile(jnp.array([0.0, 0.0, 1.0]), (2, 1)), jnp.array([0.7, -0.7]))
    arms = jnp.array([HUMAN.index("LeftArm"), HUMAN.index("RightArm")])
    raised = eqx.tree_at(lambda p: p.rotations, rest, rest.rotations.at[arms].set(turns))
    centres = joint_positions(HUMAN, forward_kinematics(HUMAN, raised))
    return jc.make_skeleton([PREFIX + name for name in HUMAN.names], HUMAN.parents, HUMAN.kinds, centres)


@pytest.mark.parametrize("skeleton", [HUMAN, raised_arms()], ids=["own", "raised"])
def test_the_ends_are_those_of_anatomy(skeleton):
    limits = human_flexion_limits(skeleton).limits
    for ends, knee, elbow in ((limits.lower, -5, -5), (limits.upper, 150, 150)):
        found = flexions(skeleton, flexed(skeleton, limits, ends))
        np.testing.assert_allclose(found, [knee, knee, elbow, elbow], atol=8)


@pytest.mark.parametrize("beyond", [(-0.3, -0.2, 0.0, 0.1), (0.0, 0.4, 0.2, -0.1)])
def test_the_residual_is_the_angle_beyond_the_range(beyond):
    energy = human_flexion_limits(HUMAN)
    limits = energy.limits
    angles = np.where(np.array(beyond) < 0, limits.lower, limits.upper) + beyond
    pose = flexed(HUMAN, limits, np.where(np.array(beyond) == 0, 0.4, angles))
    np.testing.assert_allclose(limits.residual(HUMAN, pose), beyond, atol=1e-6)
    check_energy(energy, BODY, [pose])
    projected = limits.project(HUMAN, pose)
    assert np.all(np.asarray(allowed(limits, HUMAN, projected)))
    np.testing.assert_allclose(limits.residual(HUMAN, projected), 0.0, atol=1e-6)
    same = np.setdiff1d(np.arange(HUMAN.num_joints), limits.indices(HUMAN)[np.array(beyond) != 0])
    np.testing.assert_array_equal(projected.rotations[same], pose.rotations[same])


def test_a_partly_seen_person_pays_for_knees_that_bend_backwards(rng):
    tracker = jc.make_tracker(BODY, partial=True)
    cloud = make_cloud(rng.normal(size=(500, 3)), rng.normal(size=(500, 3)))
    without = eqx.tree_at(lambda t: t.flexion_limits, tracker, None)
    limits = tracker.flexion_limits.limits
    backwards, forwards = (flexed(HUMAN, limits, [angle, angle, 0.0, 0.0]) for angle in (-0.5, 0.5))
    extra = [
        float(penalty(tracker, cloud, pose) - penalty(without, cloud, pose)) for pose in (backwards, forwards)
    ]
    # half of two squares of the angle, twice for each point
    np.testing.assert_allclose(extra, [2 * (0.5 - 0.19) ** 2, 0.0], atol=1e-5)
    assert jc.make_tracker(BODY).flexion_limits is None


def test_skeletons_that_are_no_persons_have_no_ranges():
    unnamed = jc.make_skeleton(
        [f"joint{k}" for k in range(HUMAN.num_joints)], HUMAN.parents, HUMAN.kinds, HUMAN.centres
    )
    assert human_flexion_limits(unnamed) is None
