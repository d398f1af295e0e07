"""Retargeting: bones point where the source's point, whatever the rest poses are."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcap.body.body import pose_body
from jaxcap.body.kinematics import forward_kinematics, joint_positions
from jaxcap.body.people.human import human
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.body.pose import Motion, rest_pose, stack_poses
from jaxcap.body.retraction import retract
from jaxcap.body.skeleton import make_skeleton
from jaxcap.edit.retargeting.retarget import floor_height, retarget, size_ratio
from jaxcap.edit.retargeting.soles import ground, lowest_heights, sole_heights
from jaxcap.geometry import rotation
from jaxcap.io.skeletons.amc import read_amc
from jaxcap.io.skeletons.asf import read_asf

positions = jax.jit(jax.vmap(lambda s, p: joint_positions(s, forward_kinematics(s, p)), in_axes=(None, 0)))

NAMES = ["Hips", "LeftUpLeg", "LeftLeg", "LeftFoot", "RightUpLeg", "RightLeg", "RightFoot"]
NAMES += ["Spine", "LeftShoulder", "LeftArm", "LeftForeArm", "LeftHand"]
NAMES += ["RightShoulder", "RightArm", "RightForeArm", "RightHand"]
PARENTS = [-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 9, 10, 7, 12, 13, 14]
BONES = [("UpLeg", "Leg"), ("Leg", "Foot"), ("Arm", "ForeArm"), ("ForeArm", "Hand")]


def person(arm, forearm, size=1.0, turn=None, kinds=None):
    """A stick figure whose left arm goes along `arm`, then `forearm`; the right one mirrors it."""
    arm, forearm = np.array(arm, float), np.array(forearm, float)
    left = [(0.1, 0.9, 0), (0.12, 0.5, 0.01), (0.13, 0.1, 0)]
    right = [(-x, y, z) for x, y, z in left]
    shoulder, socket = np.array([0.02, 1.4, 0]), np.array([0.2, 1.42, 0])
    arms = [shoulder, socket, socket + 0.3 * arm, socket + 0.3 * arm + 0.25 * forearm]
    centres = [(0, 1, 0), *left, *right, (0, 1.2, 0), *arms, *(a * [-1, 1, 1] for a in arms)]
    centres = size * np.array(centres)
    if turn is not None:
        centres = centres @ turn.T
    return make_skeleton(NAMES, PARENTS, kinds or ["free"] + ["ball"] * 15, centres)


def directions(skeleton, poses):
    x = np.asarray(positions(skeleton, poses))
    steps = [
        x[:, skeleton.index(side + last)] - x[:, skeleton.index(side + first)]
        for side in ("Left", "Right")
        for first, last in BONES
    ]
    steps = np.stack(steps, 1)
    return steps / np.linalg.norm(steps, axis=-1, keepdims=True)


def random_motion(skeleton, rng, frames=5):
    rest = rest_pose(skeleton)
    return stack_poses(
        [
            retract(skeleton, rest, jnp.asarray(rng.normal(size=skeleton.num_dofs)) * 0.5)
            for _ in range(frames)
        ],
        60.0,
    )


down = np.array([0.7, -0.7, 0]) / np.linalg.norm([0.7, -0.7, 0])
bent = np.array([0.5, -0.5, 0.7]) / np.linalg.norm([0.5, -0.5, 0.7])


@pytest.mark.parametrize("turn", [np.eye(3), np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])])
def test_limbs_point_alike_whatever_the_rest_pose(rng, turn):
    source, target = person([1, 0, 0], [1, 0, 0], 1.3, turn), person(down, bent)
    motion = random_motion(source, rng)
    moved = retarget(motion, source, target)
    assert moved.rate == 60.0
    np.testing.assert_allclose(directions(target, moved.poses), directions(source, motion.poses), atol=1e-9)


def test_the_hips_follow_at_the_size_of_the_legs(rng):
    source, target = person([1, 0, 0], [1, 0, 0], 2.0), person(down, bent)
    motion = random_motion(source, rng)
    moved = retarget(motion, source, target, floor=0.0)
    here, there = positions(target, moved.poses), positions(source, motion.poses)
    for x, s in ((here, target), (there, source)):
        assert s.names[1] == "LeftUpLeg"
        assert x.shape[0] == 5
    np.testing.assert_allclose(here[:, [1, 4]].mean(1), there[:, [1, 4]].mean(1) / 2.0, atol=1e-9)


@pytest.mark.parametrize("height", [-0.82, 0.0, 3.0])
@pytest.mark.parametrize("turn", [np.eye(3), np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])])
def test_feet_stand_on_the_floor_wherever_it_is(rng, height, turn):
    """A skeleton and itself at seven tenths, on one floor: every joint is at seven tenths of its height."""
    source, target = person(down, bent, 1.0, turn), person(down, bent, 0.7)
    up = np.array([0.0, 1.0, 0.0]) @ turn.T
    motion = random_motion(source, rng)
    lift = (height - (positions(source, motion.poses) @ up).min()) * up
    poses = eqx.tree_at(lambda p: p.translations, motion.poses, motion.poses.translations.at[:, 0].add(lift))
    there = positions(source, poses) @ up
    moved = retarget(Motion(poses, 60.0), source, target, floor=height)
    np.testing.assert_allclose(
        positions(target, moved.poses) @ up - height, 0.7 * (there - height), atol=1e-9
    )
    # found from the motion it is as high but for the frames that are allowed to be lower
    assert 0 <= floor_height(positions(source, poses), up) - height < 0.05


def test_a_motion_of_tall_people_is_on_the_floor_of_short_ones():
    """The embedded human stands on a floor that is not at the height of zero."""
    tall, short = human(resolution="low", height=1.95), human(resolution="low", height=1.5)
    motion = walk_and_wave(tall.skeleton, seconds=0.8, rate=15.0)
    floor = float(lowest_heights(tall, motion.poses).min())
    assert floor == pytest.approx(-0.82, abs=0.03)
    moved = retarget(motion, tall.skeleton, short.skeleton, floor=floor)
    assert np.abs(lowest_heights(short, moved.poses) - floor).max() < 0.02
    # without its soles the lowest joint stands in for them
    moved = retarget(motion, tall.skeleton, short.skeleton)
    assert np.abs(lowest_heights(short, moved.poses) - floor).max() < 0.03
    # soles brought to the source's are there
    heights = floor + 0.7 * (lowest_heights(tall, motion.poses) - floor)
    np.testing.assert_allclose(lowest_heights(short, ground(short, moved, heights).poses), heights, atol=1e-9)


@pytest.mark.shared
@pytest.mark.parametrize("height", [1.5, 1.95])
def test_a_real_walk_on_the_floor(shared, height):
    folder = shared / "data" / "motion"
    asf = read_asf(folder / "02.asf")
    motion = read_amc(folder / "02_01.amc", asf).slice(slice(None, None, 12))
    body = human(resolution="low", height=height)
    moved = retarget(motion, asf.skeleton, body.skeleton)
    # the floor of this capture rises by four centimetres along the walk, and the body goes with it
    ratio = size_ratio(asf.skeleton, body.skeleton)
    low = lowest_heights(body, moved.poses)
    off = low - ratio * np.asarray(positions(asf.skeleton, motion.poses))[..., 1].min(1)
    assert np.abs(low[:6]).max() < 0.035
    # soles are below the lowest joint, by as much in every frame
    assert np.ptp(off) < 0.025


def test_soles_are_told_by_the_joints_that_bear():
    """Ankle and toes of a foot: flat, on the heel, on the toes, in the air; and a hand that never comes near."""
    ankle, toes, hand = [0.08, 0.08, 0.20, 0.18], [0.02, 0.10, 0.02, 0.12], [0.9, 0.9, 0.8, 1.0]
    paths = np.zeros((200, 3, 3))
    paths[..., 1] = 0.5 + np.tile(np.stack([ankle, toes, hand], 1), (50, 1))
    np.testing.assert_allclose(sole_heights(paths), np.tile([0.0, 0.0, 0.0, 0.1], 50), atol=1e-9)
    assert floor_height(paths) == pytest.approx(0.52)


def test_a_skeleton_given_its_own_motion_keeps_it(rng):
    kinds = [
        "free",
        *["ball", "revolute", "universal"] * 2,
        "ball",
        *["fixed", "universal", "revolute", "ball"] * 2,
    ]
    source = person(down, bent, kinds=kinds)
    motion = random_motion(source, rng)
    moved = retarget(motion, source, source)
    np.testing.assert_allclose(
        rotation.distance(moved.poses.rotations, motion.poses.rotations), 0.0, atol=1e-7
    )
    np.testing.assert_allclose(positions(source, moved.poses), positions(source, motion.poses), atol=1e-9)


def test_a_revolute_knee_takes_the_part_about_its_axis(rng):
    kinds = ["free"] + [
        "revolute" if name.endswith("Leg") and "Up" not in name else "ball" for name in NAMES[1:]
    ]
    source, target = person([1, 0, 0], [1, 0, 0]), person([1, 0, 0], [1, 0, 0], kinds=kinds)
    pose = rest_pose(source)
    knee = source.index("LeftLeg")
    bend = rotation.about_axis(jnp.array([1.0, 0, 0]), jnp.array(0.8))
    motion = stack_poses([type(pose)(pose.translations, pose.rotations.at[knee].set(bend), pose.scale)])
    moved = retarget(motion, source, target)
    np.testing.assert_allclose(moved[0].rotations[knee], bend, atol=1e-9)
    # about another axis nothing is left for the knee to do
    bend = rotation.about_axis(jnp.array([0, 0, 1.0]), jnp.array(0.8))
    motion = stack_poses([type(pose)(pose.translations, pose.rotations.at[knee].set(bend), pose.scale)])
    np.testing.assert_allclose(retarget(motion, source, target)[0].rotations[knee], [1, 0, 0, 0], atol=1e-9)


def test_what_does_not_match_is_told(rng):
    source = person([1, 0, 0], [1, 0, 0])
    stranger = make_skeleton(["a", "b", "c"], [-1, 0, 1], ["free", "ball", "ball"], np.eye(3))
    motion = random_motion(source, rng, 1)
    with pytest.raises(ValueError, match="0 joints of the source"):
        retarget(motion, source, stranger)
    with pytest.raises(ValueError, match="no joint 'd' in the target"):
        retarget(motion, source, stranger, {"Hips": "d"})
    with pytest.raises(ValueError, match="has 16 joints, but the source skeleton has 3"):
        retarget(motion, stranger, source)


@pytest.mark.shared
def test_a_real_punch_on_the_human(shared):
    folder = shared / "data" / "motion"
    asf = read_asf(folder / "02.asf")
    motion = read_amc(folder / "02_05.amc", asf).slice(slice(None, None, 100))
    body = human()
    moved = retarget(motion, asf.skeleton, body.skeleton)
    table = {
        "UpLeg": "femur",
        "Leg": "tibia",
        "Foot": "foot",
        "Arm": "humerus",
        "ForeArm": "radius",
        "Hand": "wrist",
    }
    x, y = positions(asf.skeleton, motion.poses), positions(body.skeleton, moved.poses)
    for side in ("Left", "Right"):
        for first, last in BONES:
            here = y[:, body.skeleton.index(side + last)] - y[:, body.skeleton.index(side + first)]
            short = side[0].lower()
            there = (
                x[:, asf.skeleton.index(short + table[last])] - x[:, asf.skeleton.index(short + table[first])]
            )
            cosine = np.sum(here * there, -1) / np.linalg.norm(here, axis=-1) / np.linalg.norm(there, axis=-1)
            np.testing.assert_allclose(cosine, 1.0, atol=1e-12)
    # the source's elbow is a hinge: so is the human's, about its own axis of flexion
    for name in ("LeftForeArm", "RightForeArm", "LeftLeg", "RightLeg"):
        joint = body.skeleton.index(name)
        turns = np.asarray(rotation.log(moved.poses.rotations[:, joint]))
        sideways = turns - np.outer(turns @ body.skeleton.axes[joint, 0], body.skeleton.axes[joint, 0])
        assert np.degrees(np.linalg.norm(sideways, axis=1)).max() < 2.5
    lowest = jax.jit(jax.vmap(lambda pose: pose_body(body, pose).vertices[:, 1].min()))(moved.poses)
    assert np.abs(lowest).max() < 0.03
    assert isinstance(moved, Motion)
