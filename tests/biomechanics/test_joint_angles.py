"""Joint angles against SciPy's Euler angles of frames built by hand, mirror images, turns and finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from neutral_person import in_world, mirrored, person, pose
from scipy.spatial.transform import Rotation

import jaxcap as jc
from jaxcap.biomechanics import angle_conventions, find_anatomical_frames, pose_angles
from jaxcap.io.registry import read_motion

#: joint of the person, name of the angle on one side or in the middle, axis X, Y or Z, sign; from the anatomical position
SINGLE = [
    ("spine", "lumbar_extension", "Z", 1), ("spine", "lumbar_bending", "X", 1), ("spine", "lumbar_rotation", "Y", 1),
    ("neck", "neck_extension", "Z", 1), ("head", "neck_bending", "X", 1), ("head", "neck_rotation", "Y", 1),
    ("thigh", "hip_flexion", "Z", 1), ("thigh", "hip_adduction", "X", 1), ("thigh", "hip_rotation", "Y", 1),
    ("shin", "knee_angle", "Z", -1), ("shin", "knee_adduction", "X", 1), ("shin", "knee_rotation", "Y", 1),
    ("foot", "ankle_angle", "Z", 1), ("foot", "ankle_inversion", "X", 1), ("foot", "ankle_rotation", "Y", 1),
    ("forearm", "elbow_flex", "Z", 1), ("forearm", "elbow_carrying", "X", -1), ("forearm", "pro_sup", "Y", 1),
    ("hand", "wrist_flex", "Z", 1), ("hand", "wrist_dev", "X", 1), ("hand", "wrist_rot", "Y", 1),
]  # fmt: skip
#: joint, order and signs of the angles on one side
TRIPLES = [
    ("thigh", "ZXY", ("hip_flexion", "hip_adduction", "hip_rotation"), (1, 1, 1)),
    ("shin", "ZXY", ("knee_angle", "knee_adduction", "knee_rotation"), (-1, 1, 1)),
    ("foot", "ZXY", ("ankle_angle", "ankle_inversion", "ankle_rotation"), (1, 1, 1)),
    ("upper_arm", "YXY", ("elv_angle", "shoulder_elv", "shoulder_rot"), (1, -1, 1)),
    ("upper_arm", "ZXY", ("arm_flex", "arm_add", "arm_rot"), (1, 1, 1)),
    ("forearm", "ZXY", ("elbow_flex", "elbow_carrying", "pro_sup"), (1, -1, 1)),
    ("hand", "ZXY", ("wrist_flex", "wrist_dev", "wrist_rot"), (1, 1, 1)),
]


def degrees(skeleton, pose, frames=None):
    angles = jc.joint_angles(skeleton, pose, frames).to_degrees()
    return dict(zip(angles.names, np.asarray(angles.values), strict=True))


def of_side(rotation, side):
    return in_world(mirrored(rotation) if side == "l" else rotation)


@pytest.mark.parametrize("smpl", [False, True])
def test_the_anatomical_position_has_no_angles(smpl):
    skeleton, _ = person(smpl)
    angles = jc.joint_angles(skeleton, jc.rest_pose(skeleton))
    assert angles.names == tuple(each.name for each in angle_conventions())
    assert angles.describe_missing() is None
    np.testing.assert_allclose(angles.values, 0, atol=1e-7)


@pytest.mark.parametrize("amount", [30.0, 80.0])
def test_a_rotation_about_one_axis_changes_one_angle(amount):
    skeleton, index = person()
    frames = find_anatomical_frames(skeleton)
    for part, name, axis, sign in SINGLE:
        for side in ("",) if part in index else ("_r", "_l"):
            turn = of_side(Rotation.from_euler(axis, sign * amount, degrees=True), side[1:])
            found = degrees(skeleton, pose(skeleton, {index[part + side]: turn}), frames)
            expected = dict.fromkeys(found, 0.0) | {name + side: amount}
            np.testing.assert_allclose(
                list(found.values()), list(expected.values()), atol=1e-6, err_msg=name + side
            )


def test_a_right_angle_of_a_hinge_is_ninety_degrees():
    skeleton, index = person()
    for part, name, sign in (
        ("thigh", "hip_flexion", 1),
        ("shin", "knee_angle", -1),
        ("forearm", "elbow_flex", 1),
    ):
        turn = in_world(Rotation.from_euler("Z", sign * 90, degrees=True))
        found = degrees(skeleton, pose(skeleton, {index[part + "_l"]: turn}))
        assert found.pop(name + "_l") == pytest.approx(90, abs=1e-6)
        np.testing.assert_allclose(list(found.values()), 0, atol=1e-6)


def test_directions_of_the_limbs_are_those_of_the_words():
    """By positions alone: forward is +z, the right side is at -x."""
    skeleton, index = person()

    def moved(part, joint, name, amount, side="r"):
        """The movement of a joint, if one angle has an amount."""
        row = next(row for row in SINGLE if row[1] == name)
        turn = of_side(Rotation.from_euler(row[2], row[3] * amount, degrees=True), side)
        here = pose(skeleton, {index[f"{part}_{side}"]: turn})
        assert degrees(skeleton, here)[f"{name}_{side}"] == pytest.approx(amount)
        posed = jc.forward_kinematics(skeleton, here)
        joint = index[f"{joint}_{side}"]
        centre = skeleton.centres[joint]
        return np.asarray(posed.rotations[joint] @ centre + posed.translations[joint] - centre)

    for side, inward in (("r", 1), ("l", -1)):
        assert moved("thigh", "foot", "hip_flexion", 40, side)[2] > 0.1
        assert moved("shin", "foot", "knee_angle", 40, side)[2] < -0.1
        assert moved("foot", "toes", "ankle_angle", 20, side)[1] > 0.01
        assert moved("forearm", "hand", "elbow_flex", 40, side)[2] > 0.1
        assert moved("hand", "finger", "wrist_flex", 40, side)[2] > 0.01
        assert inward * moved("thigh", "foot", "hip_adduction", 20, side)[0] > 0.1
        assert inward * moved("shin", "foot", "knee_adduction", 20, side)[0] > 0.1
        assert inward * moved("thigh", "toes", "hip_rotation", 20, side)[0] > 0.01
        assert inward * moved("hand", "finger", "wrist_dev", 20, side)[0] > 0.01
        assert inward * moved("forearm", "hand", "elbow_carrying", 10, side)[0] < -0.01
        # pronation turns the thumb from the side to the front
        assert moved("forearm", "thumb", "pro_sup", 90, side)[2] > 0.02


@pytest.mark.parametrize("side", ["r", "l"])
def test_euler_angles_are_scipy_s(rng, side):
    skeleton, index = person()
    frames = find_anatomical_frames(skeleton)
    for part, order, names, signs in TRIPLES:
        for _ in range(5):
            first, last = rng.uniform(-170, 170, 2)
            middle = rng.uniform(-170, -10) if order == "YXY" else rng.uniform(-80, 80)
            turn = of_side(Rotation.from_euler(order, (first, middle, last), degrees=True), side)
            found = degrees(skeleton, pose(skeleton, {index[f"{part}_{side}"]: turn}), frames)
            expected = np.array(signs) * (first, middle, last)
            np.testing.assert_allclose([found[f"{name}_{side}"] for name in names], expected, atol=1e-5)


def test_the_arm_is_raised_sideways_and_forward():
    skeleton, index = person()
    for rise, plane in (("X", 0.0), ("Z", 90.0)):
        turn = Rotation.from_euler(rise, -70 if rise == "X" else 70, degrees=True)
        for side in "rl":
            found = degrees(skeleton, pose(skeleton, {index[f"upper_arm_{side}"]: of_side(turn, side)}))
            assert found[f"elv_angle_{side}"] == pytest.approx(plane, abs=1e-5)
            assert found[f"shoulder_elv_{side}"] == pytest.approx(70, abs=1e-5)


def test_pelvis_is_measured_in_its_own_heading(rng):
    skeleton, _ = person()
    for heading in (0.0, 90.0, -140.0):
        rotation, list_, tilt = heading, 8.0, -12.0
        turn = Rotation.from_euler("YXZ", (rotation, list_, tilt), degrees=True)
        found = degrees(skeleton, pose(skeleton, {0: in_world(turn)}))
        assert found.pop("pelvis_rotation") == pytest.approx(rotation, abs=1e-6)
        assert (found.pop("pelvis_list"), found.pop("pelvis_tilt")) == pytest.approx((list_, tilt), abs=1e-6)
        np.testing.assert_allclose(list(found.values()), 0, atol=1e-6)


def test_mirror_images_exchange_the_sides():
    skeleton = jc.human(resolution="low").skeleton
    motion = jc.Motion(jc.body.sample_poses(skeleton, count=20), 30.0)
    own, other = (jc.joint_angles(skeleton, each) for each in (motion, jc.edit.mirror(skeleton, motion)))
    swapped = {"r": "l", "l": "r"}
    for name in own.names:
        twin = name[:-1] + swapped[name[-1]] if name[-2:] in ("_r", "_l") else name
        sign = (
            -1
            if name.endswith(("_list", "_bending"))
            or name in ("pelvis_rotation", "lumbar_rotation", "neck_rotation")
            else 1
        )
        np.testing.assert_allclose(sign * other[twin], own[name], atol=1e-6, err_msg=name)


def test_turns_of_the_whole_person_change_the_pelvis_only(rng):
    skeleton = jc.human(resolution="low").skeleton
    poses = jc.body.sample_poses(skeleton, count=10)
    before = jc.joint_angles(skeleton, poses)
    turn = Rotation.from_euler("Y", 50, degrees=True)
    turned = turn * Rotation.from_quat(np.asarray(poses.rotations[:, 0]), scalar_first=True)
    rotations = np.array(poses.rotations)
    rotations[:, 0] = turned.as_quat(scalar_first=True)
    after = jc.joint_angles(
        skeleton, jc.Pose(poses.translations + 0.3, jnp.asarray(rotations), 1.1 * poses.scale)
    )
    for name in before.names:
        change = np.degrees(np.asarray(after[name] - before[name]))
        np.testing.assert_allclose(change, 50.0 if name == "pelvis_rotation" else 0.0, atol=1e-5)


def test_the_heading_of_a_motion_is_continuous():
    skeleton, _ = person()
    headings = np.arange(0, 800, 25.0)
    poses = [pose(skeleton, {0: Rotation.from_euler("Y", angle, degrees=True)}) for angle in headings]
    angles = jc.joint_angles(skeleton, jc.stack_poses(poses, 10.0))
    np.testing.assert_allclose(np.degrees(angles["pelvis_rotation"]), headings, atol=1e-5)
    assert angles.rate == 10.0
    with pytest.raises(KeyError, match="There is no angle 'hip'; there are pelvis_rotation"):
        _ = angles["hip"]


@jax.jit
def along(skeleton, frames, pose, step):
    return pose_angles(skeleton, frames, jc.retract(skeleton, pose, step))


all_along = jax.jit(jax.vmap(along, (None, None, None, 0)))


def test_derivatives_are_those_of_finite_differences():
    skeleton = jc.human(resolution="low").skeleton
    frames = find_anatomical_frames(skeleton)
    poses = jc.body.sample_poses(skeleton, count=4)
    for frame in range(1, 4):
        here = jax.tree.map(lambda array, frame=frame: array[frame], poses)
        exact = jax.jacfwd(along, argnums=3)(skeleton, frames, here, jnp.zeros(skeleton.num_dofs))
        changes = [
            all_along(skeleton, frames, here, sign * 1e-6 * jnp.eye(skeleton.num_dofs)) for sign in (1, -1)
        ]
        np.testing.assert_allclose(exact, (changes[0] - changes[1]).T / 2e-6, atol=2e-6)


def test_derivatives_are_finite_in_gimbal_lock():
    """Arms along the trunk, and raised sideways by a right angle."""
    skeleton, index = person()
    frames = find_anatomical_frames(skeleton)
    raised = of_side(Rotation.from_euler("X", -90, degrees=True), "l")
    here = pose(skeleton, {index["upper_arm_l"]: raised})
    for locked in (jc.rest_pose(skeleton), here):
        slope = jax.jacrev(along, argnums=3)(skeleton, frames, locked, jnp.zeros(skeleton.num_dofs))
        assert np.isfinite(slope).all()


@pytest.mark.shared
def test_walking_has_the_ranges_of_gait(shared):
    """Perry and Burnfield, Gait Analysis: knee 0 to 65 degrees, hip 40 to 55 in all, ankle -20 to 15; with margins for
    the neutral poses of a skeleton from markers."""
    skeleton, motion = read_motion(shared / "data/motion/02_01.amc")
    angles = jc.joint_angles(skeleton, motion).to_degrees()
    for side in "rl":
        knee, hip, ankle = (
            np.asarray(angles[f"{name}_{side}"]) for name in ("knee_angle", "hip_flexion", "ankle_angle")
        )
        assert -5 < knee.min() < 15
        assert 55 < knee.max() < 80
        assert 40 < np.ptp(hip) < 60
        assert -25 < ankle.min() < -10
        assert 10 < ankle.max() < 25
        # the knee flexes most while the hip flexes, in swing
        peaks = knee > 0.9 * knee.max()
        assert (np.gradient(hip)[peaks] > 0).mean() > 0.8
        assert np.abs(np.asarray(angles[f"knee_adduction_{side}"])).max() < 0.01
        assert np.abs(np.asarray(angles[f"elbow_carrying_{side}"])).max() < 0.01
    assert np.corrcoef(angles["hip_flexion_r"], angles["hip_flexion_l"])[0, 1] < -0.8
    assert np.corrcoef(angles["hip_flexion_r"], angles["arm_flex_l"])[0, 1] > 0.5


def test_the_page_describes_every_angle(checkout):
    rows = [line.split("|") for line in (checkout / "docs/joint_angles.md").read_text("utf-8").splitlines()]
    listed = [row[1].strip() for row in rows if len(row) == 7 and row[1].startswith(" `")]
    assert listed == [
        f"`{each.name.removesuffix('_r')}`" for each in angle_conventions() if not each.mirrored
    ]
