"""Gaze: the target is met, by shares of one turn, and nothing else moves."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcap.body.kinematics import forward_kinematics
from jaxcap.body.people.human import human
from jaxcap.body.pose import Motion, Pose
from jaxcap.body.skeleton import make_skeleton
from jaxcap.edit.gaze import fade_weights, look_at_target
from jaxcap.edit.gaze_line import gaze_line_of_joint, gaze_line_of_vertices, gaze_shares, human_gaze_line
from jaxcap.geometry import rotation
from jaxcap.limits.ranges_and_cones import Cone, JointRanges, make_joint_ranges

NAMES = ["Hips", "Chest", "Neck", "Neck1", "Head", "Head.end", "LeftArm", "RightArm"]
CENTRES = [
    [0, 1.0, 0],
    [0, 1.3, 0],
    [0, 1.5, 0],
    [0, 1.55, 0.01],
    [0, 1.6, 0.02],
    [0, 1.8, 0.02],
    [0.2, 1.4, 0],
    [-0.2, 1.4, 0],
]
SKELETON = make_skeleton(
    NAMES, [-1, 0, 1, 2, 3, 4, 1, 1], ["free"] + ["ball"] * 4 + ["fixed"] + ["ball"] * 2, CENTRES
)
TARGET = np.array([1.0, 1.9, 2.0])

worlds = jax.jit(jax.vmap(lambda pose: forward_kinematics(SKELETON, pose).rotations))


@pytest.fixture(scope="module")
def motion():
    rng = np.random.default_rng(5)
    vectors = 0.2 * rng.normal(size=(1, 8, 3)) + 0.1 * np.sin(0.2 * np.arange(40))[:, None, None]
    vectors[:, 5] = 0.0
    translations = np.zeros((40, 8, 3))
    translations[:, 0, 2] = 0.02 * np.arange(40)
    return Motion(Pose(jnp.asarray(translations), rotation.exp(jnp.asarray(vectors)), jnp.ones(40)), 30.0)


@pytest.fixture(scope="module")
def looking(motion):
    line, shares = gaze_line_of_joint(SKELETON, "Head"), gaze_shares(SKELETON)
    return look_at_target(SKELETON, motion, line, TARGET, shares, first=5, last=34, fade=0.3)


def test_the_target_is_met_and_other_frames_stay(motion, looking):
    full = looking.magnitude == 1.0
    assert full.sum() == 12 and looking.before[full].min() > 10
    assert looking.after[full].max() < 1e-6
    outside = np.r_[0:6, 34:40]
    assert (looking.magnitude[outside] == 0).all()
    np.testing.assert_array_equal(looking.motion.poses.rotations[outside], motion.poses.rotations[outside])
    # by hand: the ray through the middle of the head's bone along its front goes through the target
    world = np.asarray(worlds(looking.motion.poses))
    place = jax.vmap(lambda pose: forward_kinematics(SKELETON, pose).translations)(looking.motion.poses)
    eyes = world[:, 4] @ np.array([0, 1.7, 0.02]) + np.asarray(place)[:, 4]
    want = TARGET - eyes
    want /= np.linalg.norm(want, axis=1, keepdims=True)
    np.testing.assert_allclose((world[:, 4] @ [0, 0, 1.0])[full], want[full], atol=1e-8)


def test_chest_neck_and_head_share_one_turn(motion, looking):
    before, after = (np.asarray(worlds(m.poses)) for m in (motion, looking.motion))
    turns = rotation.log(rotation.from_matrix(jnp.asarray(after @ np.swapaxes(before, -1, -2))))
    turns = np.asarray(turns)[looking.magnitude > 0]
    whole = turns[:, NAMES.index("Head")]
    for name, share in (
        ("Hips", 0.0),
        ("Chest", 0.1),
        ("LeftArm", 0.1),
        ("Neck", 0.5),
        ("Neck1", 0.5),
        ("Head.end", 1.0),
    ):
        np.testing.assert_allclose(turns[:, NAMES.index(name)], share * whole, atol=1e-9, err_msg=name)
    # joints that take no part keep their own rotations
    for name in ("Hips", "Neck1", "LeftArm", "RightArm"):
        joint = NAMES.index(name)
        np.testing.assert_array_equal(
            looking.motion.poses.rotations[:, joint], motion.poses.rotations[:, joint]
        )


def test_a_direction_and_the_most_that_it_turns(motion):
    line, shares = gaze_line_of_joint(SKELETON, "Head"), gaze_shares(SKELETON, ["Chest", "Neck", "Head"])
    free = look_at_target(SKELETON, motion, line, np.array([5.0, 0, 0]), shares, is_direction=True, fade=0.0)
    assert free.after.max() < 1e-6 and not free.limited.any()
    some = look_at_target(
        SKELETON, motion, line, np.array([5.0, 0, 0]), shares, is_direction=True, fade=0.0, max_angle=30.0
    )
    np.testing.assert_allclose(some.before - some.after, 30.0, atol=1e-6)
    assert some.limited.all()


def test_limits_hold_the_turn(motion):
    ranges = make_joint_ranges(
        SKELETON, cones={"Head": Cone((0, 0, 1.0), np.radians(25), (0, 1.0, 0), np.radians(60))}
    )
    assert isinstance(ranges, JointRanges)
    line, shares = gaze_line_of_joint(SKELETON, "Head"), gaze_shares(SKELETON)
    far = look_at_target(
        SKELETON,
        motion,
        line,
        np.array([-1.0, 0, -1.0]),
        shares,
        is_direction=True,
        fade=0.2,
        limits=ranges,
    )
    front = rotation.to_matrix(far.motion.poses.rotations[:, 4])[..., 2]
    used = far.magnitude > 0
    assert np.degrees(np.arccos(np.asarray(front)[used, 2])).max() < 25.01
    assert far.limited.any()


def test_who_is_recorded_beyond_limits_comes_back_into_them_with_the_fade(motion):
    """The head alone is turned by 50 degrees and may by 30: no frame jumps, and where the gaze is whole it is held."""
    turned = jnp.zeros((40, 8, 3)).at[:, 4, 1].set(np.radians(50.0))
    posed = Motion(Pose(motion.poses.translations, rotation.exp(turned), motion.poses.scale), 30.0)
    limits = make_joint_ranges(
        SKELETON, cones={"Head": Cone((0, 0, 1.0), np.radians(30), (0, 1.0, 0), np.pi)}
    )
    line, shares = gaze_line_of_joint(SKELETON, "Head"), gaze_shares(SKELETON)
    ahead = look_at_target(
        SKELETON, posed, line, np.array([np.sin(1.2), 0, np.cos(1.2)]), shares, is_direction=True, first=5, last=34,
        fade=0.4, limits=limits,
    )  # fmt: skip
    front = np.asarray(rotation.to_matrix(ahead.motion.poses.rotations[:, 4]))[..., 2]
    angle = np.degrees(np.arccos(front[:, 2]))
    share = ahead.magnitude
    np.testing.assert_allclose(angle, 50 - 20 * share, atol=1e-4)
    assert (share[:6] == 0).all() and (share == 1).any()


def test_fades_are_flat_at_their_ends():
    weights = fade_weights(100, 10, 89, 20.0)
    assert (weights[:11] == 0).all() and (weights[30:70] == 1).all() and (weights[89:] == 0).all()
    assert (np.diff(weights[10:31]) >= 0).all() and weights[20] == pytest.approx(0.5)
    np.testing.assert_allclose(weights[10:90], weights[89:9:-1], atol=1e-12)
    assert np.abs(np.diff(weights))[[10, 29, 69, 88]].max() < 1e-6
    with pytest.raises(ValueError, match="do not fit"):
        fade_weights(100, 10, 40, 20.0)


@pytest.mark.parametrize("resolution", ["full", "medium", "low"])
def test_the_human_looks_ahead_from_between_its_eyes(resolution):
    line = human_gaze_line(human(resolution=resolution, height=1.6))
    assert np.degrees(np.arccos(np.asarray(line.direction)[2])) < 3
    assert np.abs(np.asarray(line.eyes)[0]) < 0.005


def test_what_cannot_look_is_told(motion):
    body = human(resolution="low")
    line, shares = gaze_line_of_joint(SKELETON, "Head"), gaze_shares(SKELETON)
    assert human_gaze_line(eqx.tree_at(lambda b: b.faces, body, body.faces[1:])) is None

    def look(target=TARGET, shares=shares, **rest):
        return look_at_target(SKELETON, motion, line, target, shares, **rest)

    eyes = np.asarray(line.eyes) + [0, 0, 0.1]
    for call, words in (
        (lambda: look(eyes, fade=0.0), "from the point between the eyes"),
        (lambda: look(shares={"Chest": 0.5, "Head": 0.4}), "add up to 0.9"),
        (lambda: look(shares={"Head": 0.5, "Chest": 0.5}), "is not a descendant of"),
        (lambda: look(shares={"Nose": 1.0}), "no joint 'Nose'"),
        (lambda: look(shares={"Head.end": 1.0}), "is fixed"),
        (lambda: look(first=30, last=50), "not in a motion of 40"),
        (lambda: look(max_angle=0.0), "largest rotation of the gaze"),
        (lambda: look(np.zeros(3), is_direction=True, fade=0.0), "zero length"),
        (lambda: gaze_shares(SKELETON, ["Head"]), "1 joints are named"),
        (lambda: gaze_line_of_vertices(body, 3, 3, "Head"), "the same mean position"),
        (lambda: gaze_line_of_vertices(body, 3, 10**6, "Head"), "not all in the body"),
    ):
        with pytest.raises(ValueError, match=words):
            call()
