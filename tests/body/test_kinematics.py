"""Forward kinematics against a closed form, a slow recursion, and rigid facts."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import awkward_poses, chain_skeleton, random_pose
from scipy.spatial.transform import Rotation

from jaxcap.body.kinematics import forward_kinematics, joint_positions, world_axes
from jaxcap.body.pose import rest_pose
from jaxcap.body.retraction import retract
from jaxcap.body.skeleton import dof_layout, make_skeleton
from jaxcap.geometry import rotation

SKELETON = chain_skeleton()
axes_of = eqx.filter_jit(world_axes)


@eqx.filter_jit
def transforms_of(skeleton, pose):
    return forward_kinematics(skeleton, pose)


@eqx.filter_jit
def joints_of(skeleton, pose, d):
    moved = retract(skeleton, pose, d)
    return joint_positions(skeleton, forward_kinematics(skeleton, moved))


@eqx.filter_jit
def slopes_of(skeleton, pose):
    return jax.jacfwd(partial(joints_of, skeleton, pose))(jnp.zeros(skeleton.num_dofs))


def slow_kinematics(skeleton, pose) -> np.ndarray:
    """4 x 4 matrices, one joint at a time, straight from the definition."""
    matrices = []
    for joint, parent in enumerate(skeleton.parents):
        centre = np.asarray(skeleton.centres[joint])
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_quat(np.asarray(pose.rotations[joint]), scalar_first=True).as_matrix()
        to, back = np.eye(4), np.eye(4)
        to[:3, 3], back[:3, 3] = centre + np.asarray(pose.translations[joint]), -centre
        above = np.diag([*3 * [float(pose.scale)], 1.0]) if parent < 0 else matrices[parent]
        matrices.append(above @ to @ turn @ back)
    return np.array(matrices)


def test_two_links_in_a_plane():
    skeleton = make_skeleton(
        ["shoulder", "elbow", "tip"],
        [-1, 0, 1],
        ["revolute", "revolute", "fixed"],
        [[0, 0, 0], [0.3, 0, 0], [0.5, 0, 0]],
        axes=np.tile([[0, 0, 1.0], [1.0, 0, 0]], (3, 1, 1)),
    )
    for first, second in ((0.0, 0.0), (0.7, -1.1), (np.pi / 2, np.pi / 2), (-3.0, 2.5)):
        places = joints_of(skeleton, rest_pose(skeleton), jnp.array([first, second]))
        elbow = 0.3 * np.array([np.cos(first), np.sin(first), 0])
        tip = elbow + 0.2 * np.array([np.cos(first + second), np.sin(first + second), 0])
        np.testing.assert_allclose(places, [np.zeros(3), elbow, tip], atol=1e-15)


@pytest.mark.parametrize("scale", [1.0, 1.3])
def test_chains_agree_with_a_recursion_over_joints(scale, rng):
    for pose in [*awkward_poses(SKELETON), random_pose(SKELETON, rng, 1.0)]:
        pose = eqx.tree_at(lambda p: p.scale, pose, jnp.asarray(scale))
        expected = slow_kinematics(SKELETON, pose)
        transforms = transforms_of(SKELETON, pose)
        np.testing.assert_allclose(transforms.rotations, expected[:, :3, :3], atol=1e-13)
        np.testing.assert_allclose(transforms.translations, expected[:, :3, 3], atol=1e-13)


def test_several_roots_and_any_order_of_joints(rng):
    names = [f"j{i}" for i in range(8)]
    parents = [3, 0, -1, 2, 6, -1, 5, 0]
    skeleton = make_skeleton(names, parents, ["free"] * 8, rng.normal(size=(8, 3)))
    pose = random_pose(skeleton, rng, 1.0)
    transforms = transforms_of(skeleton, pose)
    np.testing.assert_allclose(transforms.rotations, slow_kinematics(skeleton, pose)[:, :3, :3], atol=1e-13)
    np.testing.assert_allclose(transforms.translations, slow_kinematics(skeleton, pose)[:, :3, 3], atol=1e-13)


def test_a_joint_moves_what_hangs_on_it_by_axis_times_lever(rng):
    pose = random_pose(SKELETON, rng, 1.0, scale=1.2)
    transforms = transforms_of(SKELETON, pose)
    places = np.asarray(joint_positions(SKELETON, transforms))
    shifts, turns = axes_of(SKELETON, pose, transforms)
    layout, slopes = dof_layout(SKELETON), np.asarray(slopes_of(SKELETON, pose))
    for number, joint in enumerate(layout.joints):
        place = np.argwhere(layout.translations[joint] == number)
        turn = np.argwhere(layout.rotations[joint] == number)
        for other in range(SKELETON.num_joints):
            expected = np.zeros(3)
            if SKELETON.descendants[joint, other] and place.size:
                expected = shifts[joint, place[0, 0]]
            elif SKELETON.descendants[joint, other]:
                expected = np.cross(turns[joint, turn[0, 0]], places[other] - places[joint])
            np.testing.assert_allclose(slopes[other, :, number], expected, atol=1e-12)


def test_world_axes_are_unit_turned_axes_of_the_joints(rng):
    pose = random_pose(SKELETON, rng, 1.0, scale=1.2)
    transforms = transforms_of(SKELETON, pose)
    shifts, turns = axes_of(SKELETON, pose, transforms)
    layout = dof_layout(SKELETON)
    held = layout.rotations < SKELETON.num_dofs
    np.testing.assert_allclose(np.linalg.norm(turns, axis=-1), held, atol=1e-13)
    moves = layout.translations < SKELETON.num_dofs
    np.testing.assert_allclose(np.linalg.norm(shifts, axis=-1), 1.2 * moves, atol=1e-13)
    # a revolute axis turns with its parent: turning the joint itself leaves it where it is
    elbow = SKELETON.index("elbow")
    carried = transforms.rotations[SKELETON.parents[elbow]] @ SKELETON.axes[elbow, 0] / 1.2
    np.testing.assert_allclose(turns[elbow, 0], carried, atol=1e-13)


def test_moving_the_root_moves_all_as_one_body(rng):
    pose = random_pose(SKELETON, rng, 1.0)
    before = np.asarray(joints_of(SKELETON, pose, jnp.zeros(SKELETON.num_dofs)))
    d = jnp.zeros(SKELETON.num_dofs).at[:6].set(jnp.asarray(rng.normal(size=6)))
    after = np.asarray(joints_of(SKELETON, pose, d))
    turn = Rotation.from_quat(
        np.asarray(rotation.multiply(pose.rotations[0], rotation.exp(d[3:6]))), scalar_first=True
    )
    turn = turn * Rotation.from_quat(np.asarray(pose.rotations[0]), scalar_first=True).inv()
    np.testing.assert_allclose(after, after[0] + turn.apply(before - before[0]), atol=1e-13)
    np.testing.assert_allclose(after[0], before[0] + np.asarray(d[:3]), atol=1e-14)


def test_scale_is_a_similarity_about_the_origin(rng):
    pose = random_pose(SKELETON, rng, 1.0)
    scaled = eqx.tree_at(lambda p: p.scale, pose, jnp.asarray(1.7))
    still = jnp.zeros(SKELETON.num_dofs)
    np.testing.assert_allclose(
        joints_of(SKELETON, scaled, still), 1.7 * joints_of(SKELETON, pose, still), atol=1e-13
    )


def test_two_poses_take_one_trace(rng):
    traces = 0

    @eqx.filter_jit
    def counted(skeleton, pose):
        nonlocal traces
        traces += 1
        return forward_kinematics(skeleton, pose)

    for size in (0.1, 1.0):
        counted(SKELETON, random_pose(SKELETON, rng, size))
    # another skeleton of the same tree is data, too
    counted(eqx.tree_at(lambda s: s.centres, SKELETON, SKELETON.centres + 0.1), rest_pose(SKELETON))
    assert traces == 1
