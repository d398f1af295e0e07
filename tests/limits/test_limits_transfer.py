"""Limits for other people, takes, skeletons and rest poses, and from tables of joint angles."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

import jaxcap as jc
from jaxcap.limits.learning.held_out import make_folds, mean_quantile, widest_held_out
from jaxcap.limits.learning.samples import JointSamples


def hinged(skeleton: jc.Skeleton) -> jc.Skeleton:
    """Knees as hinges, whose axes define those of thigh and shank exactly."""
    kinds = [
        "revolute" if name in ("LeftLeg", "RightLeg") else kind
        for name, kind in zip(skeleton.names, skeleton.kinds, strict=True)
    ]
    return jc.make_skeleton(skeleton.names, skeleton.parents, kinds, skeleton.centres, axes=skeleton.axes)


HUMAN = hinged(jc.human(resolution="low").skeleton)
PAIRS = (("LeftUpLeg", "LeftLeg"), ("RightUpLeg", "RightLeg"))


def quaternions(turns: Rotation) -> np.ndarray:
    return turns.as_quat(scalar_first=True)


def leg_motion(seed: int, frames: int = 240, size: float = 0.7) -> jc.Motion:
    """Hips that turn any way, and knees that bend; the arms rest."""
    rng = np.random.default_rng(seed)
    rotations = np.tile([1.0, 0, 0, 0], (frames, HUMAN.num_joints, 1))
    for hip, knee in PAIRS:
        waves = np.sin(np.arange(frames)[:, None] * rng.uniform(0.02, 0.2, 3) + rng.uniform(0, 6, 3))
        rotations[:, HUMAN.index(hip)] = quaternions(Rotation.from_rotvec(size * waves))
        bend = 0.6 * (1 + np.sin(0.13 * np.arange(frames) + seed))
        rotations[:, HUMAN.index(knee)] = quaternions(Rotation.from_rotvec(bend[:, None] * [1.0, 0, 0]))
    still = jnp.zeros((frames, HUMAN.num_joints, 3))
    return jc.Motion(jc.Pose(still, jnp.asarray(rotations), jnp.ones(frames)), 30.0)


def other_rig(skeleton: jc.Skeleton, motion: jc.Motion, spread: float, turn: Rotation):
    """The same person and motion, with other names, legs spread by `spread` degrees at rest, and the whole rest pose turned."""
    names = [f"rig:{name.replace('UpLeg', 'Thigh').replace('Leg', 'Shin')}" for name in skeleton.names]
    centres = np.array(skeleton.centres, float)
    # the rotation of every bone from the old rest pose to the new one
    rest = [turn] * skeleton.num_joints
    for side, sign in (("Left", 1), ("Right", -1)):
        hip = skeleton.index(f"{side}UpLeg")
        swing = Rotation.from_euler("z", sign * spread, degrees=True)
        for joint in np.flatnonzero(np.asarray(skeleton.descendants)[hip]):
            rest[joint] = turn * swing
            centres[joint] = centres[hip] + swing.apply(centres[joint] - centres[hip])
    axes = [each.apply(pair) for each, pair in zip(rest, np.array(skeleton.axes, float), strict=True)]
    made = jc.make_skeleton(names, skeleton.parents, skeleton.kinds, turn.apply(centres), axes=axes)
    rotations = np.array(motion.poses.rotations, float)
    for joint, parent in enumerate(skeleton.parents):
        above = turn if parent < 0 else rest[parent]
        own = Rotation.from_quat(rotations[:, joint], scalar_first=True)
        # bones point in the same directions: G' C = C0 G for rest rotations C, whole turn C0
        rotations[:, joint] = quaternions(above * own * rest[joint].inv())
        if parent < 0:
            rotations[:, joint] = quaternions(turn * own * turn.inv())
    poses = jc.Pose(motion.poses.translations, jnp.asarray(rotations), motion.poses.scale)
    return made, jc.Motion(poses, motion.rate)


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


@pytest.mark.parametrize("suffix", [".csv", ".mot", ".mat"])
def test_a_table_of_angles_gives_the_limits_of_its_motion(tmp_path, suffix):
    motion = leg_motion(4)
    angles = jc.joint_angles(HUMAN, motion)
    path = tmp_path / f"angles{suffix}"
    if suffix == ".mat":
        columns = {name: np.asarray(angles[name]) for name in angles.names}
        savemat(path, {"angles": columns, "time": np.arange(len(motion)) / 30.0})
        read = jc.io.read_angles(path, "isb-radians")
    else:
        jc.io.write_angles(path, angles)
        read = jc.io.read_angles(path)
    assert read.rate == pytest.approx(30.0, rel=1e-4)
    samples = jc.biomechanics.gather_angle_samples([read], "knee_l", "hip_l")
    limits = jc.limits.learn_limits(
        {"hip_l": samples.parent, "knee_l": samples}, voxel=np.radians(10), keyframe=np.radians(20)
    )
    here = jc.limits.transfer_limits(limits, HUMAN, jc.biomechanics.find_anatomical_joints(HUMAN))
    assert [(each.joint, each.parent) for each in here.surfaces] == [
        ("LeftUpLeg", None),
        ("LeftLeg", "LeftUpLeg"),
    ]
    assert jc.limits.allowed_frames(here, HUMAN, motion).all()
    wild = leg_motion(9, size=2.5)
    assert not jc.limits.allowed_frames(here, HUMAN, wild).all()


def test_tables_without_a_convention_or_with_another_unit_are_refused(tmp_path):
    path = tmp_path / "knee.csv"
    path.write_text("time,knee_angle_r\n0,0.1\n0.1,1.2\n0.2,0.4\n")
    with pytest.raises(
        jc.InputError, match="does not state the convention of its angles; give --convention isb"
    ):
        jc.io.read_angles(path)
    with pytest.raises(jc.InputError, match="looks like radians; give --convention isb-radians"):
        jc.io.read_angles(path, "isb")
    read = jc.io.read_angles(path, "isb-radians")
    knee = jc.biomechanics.gather_angle_samples([read], "knee_r")
    # flexion turns the shank backward: about -Z of anatomical axes
    np.testing.assert_allclose(
        Rotation.from_quat(knee.rotations, scalar_first=True).as_rotvec()[:, 2],
        [-0.1, -1.2, -0.4],
        atol=1e-12,
    )
    with pytest.raises(jc.InputError, match="no angles of 'hip_r'; there are those of knee_r"):
        jc.biomechanics.gather_angle_samples([read], "hip_r")
    with pytest.raises(jc.InputError, match="'Bein' is no anatomical joint"):
        jc.biomechanics.gather_angle_samples([read], "Bein")
    path.write_text("time,knee_angle_r\n0,10\n0.1,120\n0.2,40\n")
    with pytest.raises(jc.InputError, match="more than a turn in radians; give --convention isb"):
        jc.io.read_angles(path, "isb-radians")
    path.write_text("time,knie\n0,10\n0.1,120\n0.2,40\n")
    with pytest.raises(jc.InputError, match="the columns time, knie are no joint angles"):
        jc.io.read_angles(path, "isb")
