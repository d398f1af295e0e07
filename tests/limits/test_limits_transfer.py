"""Limits for other people, takes, skeletons and rest poses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from limits_legs import HUMAN, leg_motion, quaternions
from scipy.spatial.transform import Rotation

import jaxcap as jc
from jaxcap.limits.learning.held_out import make_folds, mean_quantile, widest_held_out
from jaxcap.limits.learning.samples import JointSamples


def unit_bone(skeleton: jc.Skeleton, begin: str, end: str) -> np.ndarray:
    bone = np.subtract(*(np.asarray(skeleton.centres[skeleton.index(name)], float) for name in (end, begin)))
    return bone / np.linalg.norm(bone)


def posed_at_rest(skeleton: jc.Skeleton, motion: jc.Motion, extra: dict[str, Rotation], turn: Rotation):
    """The same person and motion with another rest pose: joints are rotated by `extra` in it, and the whole by `turn`."""
    centres = np.array(skeleton.centres, float)
    placed, above, rest = centres.copy(), [], []
    for joint, parent in enumerate(skeleton.parents):
        above.append(turn if parent < 0 else rest[parent])
        rest.append(above[-1] * extra.get(skeleton.names[joint], Rotation.identity()))
        start = np.zeros(3) if parent < 0 else placed[parent]
        placed[joint] = start + above[-1].apply(centres[joint] - (0 if parent < 0 else centres[parent]))
    axes = [each.apply(pair) for each, pair in zip(rest, np.array(skeleton.axes, float), strict=True)]
    made = jc.make_skeleton(skeleton.names, skeleton.parents, skeleton.kinds, placed, axes=axes)
    rotations = np.array(motion.poses.rotations, float)
    for joint in range(skeleton.num_joints):
        own = Rotation.from_quat(rotations[:, joint], scalar_first=True)
        # bones point in the same directions: G' C = turn G, for the rotation C of a bone from one rest pose to the other
        rotations[:, joint] = quaternions(above[joint] * own * rest[joint].inv())
    poses = jc.Pose(motion.poses.translations, jnp.asarray(rotations), motion.poses.scale)
    return made, jc.Motion(poses, motion.rate)


def other_rig(skeleton: jc.Skeleton, motion: jc.Motion, spread: float, turn: Rotation):
    """The same person and motion, with other names, legs spread by `spread` degrees at rest, and the whole rest pose turned."""
    swings = {
        f"{side}UpLeg": Rotation.from_euler("z", sign * spread, degrees=True)
        for side, sign in (("Left", 1), ("Right", -1))
    }
    made, same = posed_at_rest(skeleton, motion, swings, turn)
    names = [f"rig:{name.replace('UpLeg', 'Thigh').replace('Leg', 'Shin')}" for name in made.names]
    return jc.make_skeleton(names, made.parents, made.kinds, made.centres, axes=made.axes), same


@pytest.fixture(scope="module")
def learned() -> jc.limits.SurfaceLimits:
    takes = [(HUMAN, leg_motion(seed)) for seed in range(3)]
    knee = jc.biomechanics.gather_person_samples(takes, "LeftLeg", "LeftUpLeg")
    return jc.limits.learn_limits(
        {"LeftUpLeg": knee.parent, "LeftLeg": knee}, voxel=np.radians(10), keyframe=np.radians(20)
    )


@pytest.mark.parametrize("spread", [0.0, 25.0])
@pytest.mark.parametrize("turn", [Rotation.identity(), Rotation.from_euler("xz", [90, 40], degrees=True)])
def test_another_rest_pose_gives_the_same_answers(learned, spread, turn):
    motion = leg_motion(5, 60, 1.2)
    rig, same = other_rig(HUMAN, motion, spread, turn)
    anatomy = jc.biomechanics.find_anatomical_joints(rig)
    limits = jc.limits.transfer_limits(learned, rig, anatomy)
    assert [each.joint for each in limits.surfaces] == ["rig:LeftThigh", "rig:LeftShin"]
    before = np.asarray(jc.limits.residual_frames(learned, HUMAN, motion))
    after = np.asarray(jc.limits.residual_frames(limits, rig, same))
    assert (before > 0.05).any() and (before == 0).any()
    np.testing.assert_allclose(after, before, atol=2e-6)
    distances = (
        np.asarray(jc.limits.sample_distance_frames(one, body, moving))
        for one, body, moving in ((learned, HUMAN, motion), (limits, rig, same))
    )
    np.testing.assert_allclose(*distances, atol=1e-5)
    comforts = (
        np.asarray(jc.limits.comfort_frames(one, body, moving))
        for one, body, moving in ((learned, HUMAN, motion), (limits, rig, same))
    )
    np.testing.assert_allclose(*comforts, atol=0.02)
    # projected onto the limits, both are allowed
    nearest = jc.limits.nearest_frames(limits, rig, same)
    assert jc.limits.allowed_frames(limits, rig, nearest).all()


def about(axis: str, angle: float) -> Rotation:
    return Rotation.from_euler(axis, angle, degrees=True)


KNEE = np.asarray(HUMAN.axes[HUMAN.index("LeftLeg"), 0], float)
#: rotations of the left leg at rest: below the knee, on both of its sides, and about the thigh
REST_POSES = {
    "flexed": {"LeftLeg": Rotation.from_rotvec(0.4 * KNEE)},
    "both": {"LeftUpLeg": about("x", -20.0), "LeftLeg": Rotation.from_rotvec(0.6 * KNEE)},
    "twist": {"LeftUpLeg": Rotation.from_rotvec(np.radians(30.0) * unit_bone(HUMAN, "LeftUpLeg", "LeftLeg"))},
}


def same_person_at_rest(learned, skeleton: jc.Skeleton, motion: jc.Motion, rest) -> np.ndarray:
    """The differences, in radians, of the violations of limits from those in another rest pose of the same person."""
    rig, same = posed_at_rest(skeleton, motion, rest, Rotation.identity())
    limits = jc.limits.transfer_limits(learned, rig, jc.biomechanics.find_anatomical_joints(rig))
    assert [each.joint for each in limits.surfaces] == [each.joint for each in learned.surfaces]
    before = np.asarray(jc.limits.residual_frames(learned, skeleton, motion))
    assert (before > 0.05).any() and (before == 0).any()
    return np.abs(np.asarray(jc.limits.residual_frames(limits, rig, same)) - before)


@pytest.mark.parametrize("rest", REST_POSES)
def test_each_segment_of_a_joint_may_have_another_rest_pose(learned, rest):
    assert same_person_at_rest(learned, HUMAN, leg_motion(5, 60, 1.2), REST_POSES[rest]).max() < 2e-6


def arm_motion(seed: int, size: float, frames: int = 120) -> jc.Motion:
    """The left shoulder and the elbow turn any way; the rest of the body rests."""
    rng = np.random.default_rng(seed)
    rotations = np.tile([1.0, 0, 0, 0], (frames, BENT.num_joints, 1))
    for joint in ("LeftArm", "LeftForeArm"):
        waves = np.sin(np.arange(frames)[:, None] * rng.uniform(0.02, 0.2, 3) + rng.uniform(0, 6, 3))
        rotations[:, BENT.index(joint)] = quaternions(Rotation.from_rotvec(size * waves))
    still = jnp.zeros((frames, BENT.num_joints, 3))
    return jc.Motion(jc.Pose(still, jnp.asarray(rotations), jnp.ones(frames)), 30.0)


#: arms of which bent elbows and thumbs show every rotation
BENT = jc.human(resolution="low").skeleton
UPPER, FORE = (unit_bone(BENT, *ends) for ends in (("LeftArm", "LeftForeArm"), ("LeftForeArm", "LeftHand")))
FLEXION = np.cross(UPPER, FORE) / np.linalg.norm(np.cross(UPPER, FORE))
#: arms out, down, and raised forward; the elbow flexed, the forearm turned about its bone, and all of these
ARMS = {
    "T": {"LeftArm": about("z", 42.0), "RightArm": about("z", -42.0)},
    "down": {"LeftArm": about("z", -40.0), "RightArm": about("z", 40.0)},
    "front": {"LeftArm": about("x", -50.0)},
    "flexed": {"LeftForeArm": Rotation.from_rotvec(0.6 * FLEXION)},
    "pronated": {"LeftForeArm": Rotation.from_rotvec(0.8 * FORE)},
    "all": {
        "LeftArm": about("z", 42.0) * Rotation.from_rotvec(0.4 * UPPER),
        "LeftForeArm": Rotation.from_rotvec(-0.3 * FLEXION) * Rotation.from_rotvec(-0.8 * FORE),
    },
}


@pytest.mark.parametrize("rest", ARMS)
def test_arms_may_have_another_rest_pose(rest):
    """Elbows stay bent by more than ten degrees, so the skeleton shows the axes of both segments."""
    samples = jc.biomechanics.gather_person_samples([(BENT, arm_motion(1, 0.5))], "LeftForeArm", "LeftArm")
    limits = jc.limits.learn_limits(
        {"LeftArm": samples.parent, "LeftForeArm": samples}, voxel=np.radians(15), keyframe=np.radians(30)
    )
    assert same_person_at_rest(limits, BENT, arm_motion(2, 0.8, 60), ARMS[rest]).max() < 2e-6


def test_a_thigh_may_be_rotated_at_rest_above_an_equal_shank():
    """Without hinges the axes of a thigh are known to about a degree."""
    motion = leg_motion(1)
    samples = jc.biomechanics.gather_person_samples([(BENT, motion)], "LeftLeg")
    limits = jc.limits.learn_limits({"LeftLeg": samples}, voxel=np.radians(5))
    assert limits.surfaces[0].chart.kind == "hinge"
    rest = {"LeftUpLeg": about("z", 14.6), "LeftLeg": about("z", -14.6)}
    bent = np.tile([1.0, 0, 0, 0], (60, BENT.num_joints, 1))
    bent[:, BENT.index("LeftLeg")] = quaternions(about("x", np.linspace(-40, 100, 60)[:, None]))
    wild = jc.Motion(jc.Pose(jnp.zeros((60, BENT.num_joints, 3)), jnp.asarray(bent), jnp.ones(60)), 30.0)
    assert same_person_at_rest(limits, BENT, wild, rest).max() < np.radians(2.0)


def test_files_of_limits_apply_to_another_rig(learned, tmp_path):
    jc.io.save_limits(tmp_path / "limits.npz", learned)
    motion = leg_motion(6, 40, 1.2)
    rig, same = other_rig(HUMAN, motion, 25.0, Rotation.identity())
    limits = jc.io.read_limits(tmp_path / "limits.npz", rig)
    np.testing.assert_allclose(
        jc.limits.residual_frames(limits, rig, same),
        jc.limits.residual_frames(learned, HUMAN, motion),
        atol=2e-6,
    )
    animal = jc.make_skeleton(("a", "b"), (-1, 0), ("free", "ball"), [[0.0, 1, 0], [0.2, 1.4, 0]])
    with pytest.raises(
        jc.InputError, match="'LeftUpLeg' is not among the joints a, b.*no joint that is recognised"
    ):
        jc.io.read_limits(tmp_path / "limits.npz", animal)


def test_samples_of_two_rigs_are_those_of_one(learned):
    motion = leg_motion(2)
    rig, same = other_rig(HUMAN, motion, 25.0, Rotation.from_euler("y", 70, degrees=True))
    takes = [(HUMAN, leg_motion(1)), (rig, same)]
    mixed = jc.biomechanics.gather_person_samples(takes, "LeftLeg", "LeftUpLeg", people=["a", "b"])
    plain = jc.limits.gather_samples([(HUMAN, leg_motion(1)), (HUMAN, motion)], "LeftLeg", "LeftUpLeg")
    for one, two in ((mixed, plain), (mixed.parent, plain.parent)):
        apart = Rotation.from_quat(one.rotations, scalar_first=True).inv() * Rotation.from_quat(
            two.rotations, scalar_first=True
        )
        assert apart.magnitude().max() < 1e-6
    assert widest_held_out(mixed) == "people"


def test_the_other_side_is_its_mirror_image():
    motion = leg_motion(3, 50)
    mirrored = jc.edit.mirror(HUMAN, motion)
    right = jc.biomechanics.gather_person_samples([(HUMAN, motion)], "RightUpLeg").rotations
    left = jc.biomechanics.gather_person_samples([(HUMAN, mirrored)], "LeftUpLeg", both_sides=True)
    own, other = np.split(left.rotations, 2)
    apart = Rotation.from_quat(own, scalar_first=True).inv()
    swapped = jc.biomechanics.gather_person_samples(
        [(HUMAN, motion)], "LeftUpLeg", both_sides=True
    ).rotations[50:]
    assert (apart * Rotation.from_quat(swapped, scalar_first=True)).magnitude().max() < np.radians(1.0)
    assert other.shape == right.shape


def with_twist_joint(skeleton: jc.Skeleton, motion: jc.Motion, name: str, child: str):
    """The same person with a twist joint in the middle of a bone."""
    names, parents, kinds = list(skeleton.names), list(skeleton.parents), list(skeleton.kinds)
    centres = np.asarray(skeleton.centres)
    above, below = skeleton.index(name), skeleton.index(child)
    parents[below] = len(names)
    made = jc.make_skeleton(
        [*names, f"{name}Twist"],
        [*parents, above],
        [*kinds, "ball"],
        [*centres, centres[[above, below]].mean(0)],
    )
    order = [[*names, f"{name}Twist"].index(each) for each in made.names]
    turns = np.concatenate([motion.poses.rotations, np.tile([1.0, 0, 0, 0], (len(motion), 1, 1))], 1)[
        :, order
    ]
    poses = jc.Pose(jnp.zeros((*turns.shape[:2], 3)), jnp.asarray(turns), jnp.ones(len(motion)))
    return made, jc.Motion(poses, motion.rate)


def test_both_sides_have_to_be_recognised_where_one_has_a_twist_joint():
    motion = leg_motion(3, 50)
    twisted = with_twist_joint(HUMAN, motion, "RightUpLeg", "RightLeg")
    assert "hip_r" not in jc.biomechanics.find_anatomical_joints(twisted[0])
    whole = jc.biomechanics.gather_person_samples([twisted], "LeftLeg", "LeftUpLeg")
    assert len(whole.rotations) == len(whole.parent.rotations) == 50
    with pytest.raises(jc.InputError, match="motion 2: there is no joint that is recognised as 'hip_r'"):
        jc.biomechanics.gather_person_samples(
            [(HUMAN, motion), twisted], "LeftLeg", "LeftUpLeg", both_sides=True
        )
    with pytest.raises(jc.InputError, match="1 names for 2 motions"):
        jc.biomechanics.gather_person_samples([(HUMAN, motion)] * 2, "LeftLeg", names=["one"])


def test_sides_have_charts_of_one_kind():
    frames = 120
    motion = leg_motion(0, frames)
    rotations = np.array(motion.poses.rotations)
    bend = Rotation.from_rotvec(np.linspace(-0.4, 0.4, frames)[:, None] * [1.0, 0, 0])
    rotations[:, HUMAN.index("LeftFoot")] = quaternions(bend)
    rng = np.random.default_rng(0)
    rotations[:, HUMAN.index("RightFoot")] = quaternions(
        Rotation.from_rotvec(rng.uniform(-0.4, 0.4, (frames, 3)))
    )
    motion = jc.Motion(jc.Pose(motion.poses.translations, jnp.asarray(rotations), jnp.ones(frames)), 30.0)
    samples = {
        foot: jc.biomechanics.gather_person_samples([(HUMAN, motion)], foot)
        for foot in ("LeftFoot", "RightFoot")
    }
    alone = jc.limits.learn_limits({"LeftFoot": samples["LeftFoot"]}, voxel=np.radians(10))
    both = jc.limits.learn_limits(samples, voxel=np.radians(10))
    assert [each.chart.kind for each in alone.surfaces] == ["hinge"]
    assert [each.chart.kind for each in both.surfaces] == ["ball", "ball"]
    assert jc.limits.allowed_frames(both, HUMAN, motion).all()


def spin(joint: str, frames: int = 400) -> JointSamples:
    turns = Rotation.from_rotvec(np.linspace(0, 2 * np.pi, frames)[:, None] * [0.0, 0, 1])
    return JointSamples(joint, "ball", np.eye(3)[:2], quaternions(turns), np.arange(frames) // 40)


def test_full_turns_are_left_out_and_named():
    child = JointSamples(
        "child",
        "ball",
        np.eye(3)[:2],
        quaternions(Rotation.from_rotvec(np.random.default_rng(1).uniform(-0.5, 0.5, (400, 3)))),
        np.arange(400) // 40,
        spin("wheel"),
    )
    found = jc.limits.find_full_turns({"wheel": spin("wheel"), "child": child})
    assert list(found) == ["wheel"] and np.degrees(found["wheel"]) > 340
    limits = jc.limits.learn_limits({"wheel": spin("wheel"), "child": child})
    assert [(each.joint, each.parent) for each in limits.surfaces] == [("child", None)]
    with pytest.raises(jc.InputError, match="wheel rotate through a full turn"):
        jc.limits.learn_limits({"wheel": spin("wheel")})


def test_margins_are_the_distances_between_takes():
    """Two takes of a hinge: from 0 to 40 degrees, and from 20 to 60: 20 degrees of each are not in the other."""
    angles = np.concatenate([np.linspace(0, 40, 2000), np.linspace(20, 60, 2000)])
    turned = quaternions(Rotation.from_euler("z", angles[:, None], degrees=True))
    takes = np.repeat([0, 1], 2000)
    samples = JointSamples(
        "hinge",
        "revolute",
        np.eye(3)[[2, 0]],
        turned,
        np.zeros(4000, int),
        takes=takes,
        people=np.zeros(4000, int),
    )
    assert widest_held_out(samples) == "takes"
    train, test = make_folds(samples, "takes")[0]
    assert set(takes[train]) == {1} and set(takes[test]) == {0}
    whole, most = (
        float(np.degrees(2 * jc.limits.learn_limits({"h": samples}, coverage=share).surfaces[0].margin))
        for share in (1.0, 0.75)
    )
    # without the width of a voxel, two degrees
    assert whole == pytest.approx(20.0, abs=2.0)
    assert most == pytest.approx(10.0, abs=2.0)
    one = samples._replace(takes=None)
    assert widest_held_out(one) == "blocks"
    assert float(jc.limits.learn_limits({"h": one}).surfaces[0].margin) == 0.0


def test_margins_are_measured_from_voxels_with_enough_samples():
    """The first take covers 0 to 40 degrees densely and has one frame at 59; the second one covers 0 to 60 degrees."""
    angles = np.concatenate([np.linspace(0, 40, 2000), [59.0], np.linspace(0, 60, 3000)])
    samples = JointSamples(
        "hinge",
        "revolute",
        np.eye(3)[[2, 0]],
        quaternions(Rotation.from_euler("z", angles[:, None], degrees=True)),
        np.zeros(len(angles), int),
        takes=np.repeat([0, 1], [2001, 3000]),
    )

    def margin(least: int) -> float:
        found = jc.limits.learn_limits({"h": samples}, coverage=1.0, min_samples=least).surfaces[0]
        return float(np.degrees(2 * found.margin))

    # half of the way from 40 to 59, and the whole way to 60, less the width of a voxel
    assert margin(1) == pytest.approx(9.0, abs=1.5)
    assert margin(5) == pytest.approx(19.0, abs=1.5)
    with pytest.raises(jc.InputError, match="No voxel has 500 samples when a part of the motion is left out"):
        margin(500)


def test_margins_grow_where_the_parent_was_not_seen():
    """The parent of the second take goes on to 60 degrees, and the child bends by two degrees more for each of them."""
    rng = np.random.default_rng(0)
    above = np.concatenate([rng.uniform(0, 30, 4000), rng.uniform(0, 60, 4000)])
    most = 20 + 2 * np.maximum(above - 30, 0) * (np.arange(8000) >= 4000)
    skeleton = jc.make_skeleton(
        ("a", "b"), (-1, 0), ("revolute",) * 2, [[0.0, 0, 0], [1, 0, 0]], axes=[np.eye(3)[[2, 0]]] * 2
    )

    def turns(angles) -> np.ndarray:
        return quaternions(Rotation.from_euler("z", np.asarray(angles, float)[:, None], degrees=True))

    parent, child = (
        JointSamples(
            name,
            "revolute",
            np.eye(3)[[2, 0]],
            turns(angles),
            np.zeros(8000, int),
            takes=np.repeat([0, 1], 4000),
        )
        for name, angles in (("a", above), ("b", rng.uniform(0, most)))
    )
    surface = jc.limits.learn_limits({"b": child._replace(parent=parent)}, coverage=0.999).surfaces[0]
    # the second take goes 60 degrees beyond the first one, all of it where the parent was not seen
    assert np.degrees(2 * float(surface.margin)) < 15
    asked = [(10, 18), (10, 60), (59, 70), (80, 100), (80, 175)]
    rotations = np.stack([turns(column) for column in zip(*asked, strict=True)], 1)
    motion = jc.Motion(jc.Pose(jnp.zeros((5, 2, 3)), jnp.asarray(rotations), jnp.ones(5)), 30.0)
    limits = jc.limits.SurfaceLimits((surface,))
    assert np.asarray(jc.limits.allowed_frames(limits, skeleton, motion))[:, 1].tolist() == [
        True,
        False,
        True,
        True,
        False,
    ]
    # the growth is no part of what was seen
    distances = np.degrees(np.asarray(jc.limits.sample_distance_frames(limits, skeleton, motion)))[:, 0]
    np.testing.assert_allclose(distances[[0, 2, 3]], [0, 0, 20], atol=5.0)


def test_a_given_margin_grows_alike_with_given_and_with_chosen_keyframes():
    takes = [(HUMAN, leg_motion(seed)) for seed in range(2)]
    knee = jc.biomechanics.gather_person_samples(takes, "LeftLeg", "LeftUpLeg")
    growths = [
        [float(each.growth) for each in jc.limits.learn_limits(both, margin=np.radians(10), **more).surfaces]
        for both in [{"LeftUpLeg": knee.parent, "LeftLeg": knee}]
        for more in ({}, {"keyframe": np.radians(40)})
    ]
    # two degrees for each degree of the parent; a joint without a parent has no growth
    assert growths == [[0.0, 2.0]] * 2


def test_the_margin_between_people_is_that_of_children_too():
    takes = [(HUMAN, leg_motion(seed)) for seed in range(2)]
    knee = jc.biomechanics.gather_person_samples(takes, "LeftLeg", "LeftUpLeg")
    sizes = {"voxel": np.radians(20), "keyframe": np.radians(40), "margin": np.radians(5)}
    found = jc.limits.learn_limits(
        {"LeftUpLeg": knee.parent, "LeftLeg": knee}, person_margin=np.radians(7), **sizes
    )
    assert [float(np.degrees(2 * each.margin)) for each in found.surfaces] == pytest.approx([12.0, 12.0])


def test_the_quantile_weighs_folds_equally():
    folds = [np.arange(10.0), np.array([100.0])]
    assert mean_quantile(folds, 0.5) == 9.0
    assert mean_quantile(folds, 0.51) == 100.0


def test_the_distance_from_what_was_seen_is_an_angle():
    turns = np.random.default_rng(0).uniform(-0.3, 0.3, (4000, 3))
    samples = JointSamples(
        "s", "ball", np.eye(3)[:2], quaternions(Rotation.from_rotvec(turns)), np.arange(4000) // 400
    )
    skeleton = jc.make_skeleton(("s",), (-1,), ("ball",), [[0.0, 0, 0]])
    limits = jc.limits.learn_limits({"s": samples}, voxel=np.radians(4), margin=np.radians(15))
    angles = np.radians([0.0, 15.0, 25.0, 60.0, 120.0])
    rotations = quaternions(Rotation.from_rotvec(angles[:, None] * [1.0, 0, 0]))[:, None]
    motion = jc.Motion(jc.Pose(jnp.zeros((5, 1, 3)), jnp.asarray(rotations), jnp.ones(5)), 30.0)
    found = np.degrees(np.asarray(jc.limits.sample_distance_frames(limits, skeleton, motion)))[:, 0]
    expected = np.maximum(np.degrees(angles) - np.degrees(0.3), 0.0)
    # samples at the corner of the cube of rotation vectors, and the balls around voxels of four degrees, are nearer
    np.testing.assert_allclose(found, expected, atol=5.0)
    assert np.asarray(jc.limits.allowed_frames(limits, skeleton, motion))[:, 0].tolist() == [
        True,
        True,
        True,
        False,
        False,
    ]
    slope = jax.grad(
        lambda q: jc.limits.sample_distance(limits, skeleton, jc.Pose(jnp.zeros((1, 3)), q, jnp.ones(())))[0]
    )
    assert np.isfinite(np.asarray(slope(jnp.asarray(rotations[3])))).all()
