"""Limits for other skeletons, sides and rest poses."""

import jax.numpy as jnp
import numpy as np
import pytest
from limits_legs import HUMAN, leg_motion, quaternions
from scipy.spatial.transform import Rotation

import jaxcap as jc
from jaxcap.limits.learning.held_out import widest_held_out


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
