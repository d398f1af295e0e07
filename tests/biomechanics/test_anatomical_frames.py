"""Anatomical axes of skeletons with other rest poses, hinges, twist joints, and joints that are missing."""

import jax.numpy as jnp
import numpy as np
import pytest
from neutral_person import in_world, mirrored, person, pose
from scipy.spatial.transform import Rotation

import jaxcap as jc
from jaxcap.biomechanics import find_anatomical_frames


def degrees(skeleton, pose):
    angles = jc.joint_angles(skeleton, pose).to_degrees()
    return dict(zip(angles.names, np.asarray(angles.values), strict=True))


def rest_in(skeleton, here):
    """The skeleton of the same person with another pose as its rest pose."""
    moved = jc.forward_kinematics(skeleton, here)
    centres = jnp.einsum("jab,jb->ja", moved.rotations, skeleton.centres) + moved.translations
    return jc.make_skeleton(skeleton.names, skeleton.parents, skeleton.kinds, np.asarray(centres))


@pytest.mark.parametrize("raised", [45.0, 80.0])
def test_a_rest_pose_with_raised_arms_is_not_neutral(raised):
    """The arms are raised with the thumbs forward, as in the A-poses and T-poses of most skeletons."""
    skeleton, index = person()
    out = Rotation.from_euler("X", -raised, degrees=True)
    thumb = Rotation.from_euler("Y", 90, degrees=True)
    turns = {index[f"upper_arm_{side}"]: in_world(mirrored(out) if side == "l" else out) for side in "rl"}
    turns |= {index[f"forearm_{side}"]: in_world(mirrored(thumb) if side == "l" else thumb) for side in "rl"}
    rest = rest_in(skeleton, pose(skeleton, turns))
    found = degrees(rest, jc.rest_pose(rest))
    for side in "rl":
        assert found.pop(f"shoulder_elv_{side}") == pytest.approx(raised, abs=1e-5)
        assert found.pop(f"arm_add_{side}") == pytest.approx(-raised, abs=1e-5)
        assert found.pop(f"pro_sup_{side}") == pytest.approx(90, abs=1e-5)
    np.testing.assert_allclose(list(found.values()), 0, atol=1e-5)
    # lowered arms: only the forearms stay pronated
    down = {
        joint: turn.inv()
        for joint, turn in turns.items()
        if joint in (index["upper_arm_r"], index["upper_arm_l"])
    }
    found = degrees(rest, pose(rest, down))
    assert (found.pop("pro_sup_r"), found.pop("pro_sup_l")) == pytest.approx((90, 90), abs=1e-5)
    np.testing.assert_allclose(list(found.values()), 0, atol=1e-5)


def test_thumbs_that_are_not_modelled_point_forward():
    skeleton, _ = person(leave_out=("thumb",))
    found = degrees(skeleton, jc.rest_pose(skeleton))
    assert (found.pop("pro_sup_r"), found.pop("pro_sup_l")) == pytest.approx((90, 90), abs=1e-5)
    np.testing.assert_allclose(list(found.values()), 0, atol=1e-5)


def test_the_bend_of_an_elbow_at_rest_is_flexion():
    """A rest pose with the upper arm rotated inward, whose bent elbow shows it."""
    skeleton, index = person()
    bend, inward = Rotation.from_euler("Z", 40, degrees=True), Rotation.from_euler("Y", 30, degrees=True)
    turns = {index["forearm_r"]: in_world(bend), index["upper_arm_r"]: in_world(inward)}
    rest = rest_in(skeleton, pose(skeleton, turns))
    found = degrees(rest, jc.rest_pose(rest))
    assert found["elbow_flex_r"] == pytest.approx(40, abs=1e-5)
    assert found["arm_rot_r"] == pytest.approx(30, abs=1e-5)
    assert found["elbow_carrying_r"] == pytest.approx(0, abs=1e-5)


def test_a_file_in_which_every_joint_has_its_own_axes(rng):
    """All bones at rest have arbitrary directions, and the first frame shows the person."""
    plain, index = person()
    whole = Rotation.random(plain.num_joints, rng=rng)
    centres = np.array(plain.centres)
    rest = np.zeros_like(centres)
    local = []
    for joint, parent in enumerate(plain.parents):
        above = whole[parent] if parent >= 0 else Rotation.identity()
        rest[joint] = (
            centres[joint]
            if parent < 0
            else rest[parent] + above.inv().apply(centres[joint] - centres[parent])
        )
        local.append(above.inv() * whole[joint])
    skeleton = jc.make_skeleton(plain.names, plain.parents, plain.kinds, rest)
    stands = pose(skeleton, dict(enumerate(local)))
    thigh = index["thigh_l"]
    flexed = list(local)
    flexed[thigh] = (
        whole[plain.parents[thigh]].inv()
        * in_world(Rotation.from_euler("Z", 35, degrees=True))
        * whole[thigh]
    )
    motion = jc.stack_poses([stands, pose(skeleton, dict(enumerate(flexed)))])
    angles = jc.joint_angles(skeleton, motion).to_degrees()
    np.testing.assert_allclose(angles.values[0], 0, atol=1e-5)
    assert float(angles["hip_flexion_l"][1]) == pytest.approx(35, abs=1e-5)
    with pytest.raises(jc.InputError, match="The person stands upright neither at rest nor in a frame"):
        jc.joint_angles(skeleton, jc.rest_pose(skeleton))


def test_hinges_give_the_axes_of_knee_and_elbow():
    """Axes that are oblique to the person, on either side and in either direction."""
    oblique = {
        "shin_r": (0.9, 0.0, 0.3),
        "shin_l": (-0.9, 0.0, 0.3),
        "forearm_r": (0.8, 0.0, 0.5),
        "forearm_l": (0.8, 0.0, -0.5),
    }
    skeleton, index = person(kinds=dict.fromkeys(oblique, "revolute"), axes=oblique)
    for key, name in (("shin", "knee_angle"), ("forearm", "elbow_flex")):
        for side in "rl":
            axis = np.asarray(skeleton.axes[index[f"{key}_{side}"], 0])
            # flexion moves the foot backward and the hand forward
            backward = np.cross(axis, [0, -1.0, 0])[2] < 0
            amount = np.radians(50.0) * (1 if backward == (key == "shin") else -1)
            turn = Rotation.from_rotvec(amount * axis)
            found = degrees(skeleton, pose(skeleton, {index[f"{key}_{side}"]: turn}))
            assert found[f"{name}_{side}"] == pytest.approx(50, abs=1e-5)
            others = ("knee_adduction", "knee_rotation") if key == "shin" else ("elbow_carrying",)
            np.testing.assert_allclose([found[f"{other}_{side}"] for other in others], 0, atol=1e-5)


def test_a_segment_moves_with_its_last_joint():
    """A twist joint in the forearm carries the radius."""
    plain, index = person()
    hand, forearm = index["hand_r"], index["forearm_r"]
    centres = np.array(plain.centres)
    middle = (centres[hand] + centres[forearm]) / 2
    parents = list(plain.parents)
    parents[hand] = plain.num_joints
    skeleton = jc.make_skeleton(
        [*plain.names, "RightForeArmTwist"], [*parents, forearm], [*plain.kinds, "ball"], [*centres, middle]
    )
    turn = in_world(Rotation.from_euler("Y", 60, degrees=True))
    found = degrees(skeleton, pose(skeleton, {skeleton.index("RightForeArmTwist"): turn}))
    assert found["pro_sup_r"] == pytest.approx(60, abs=1e-5)
    assert found["wrist_rot_r"] == pytest.approx(0, abs=1e-5)


def test_missing_joints_are_left_out():
    arms = ("clavicle", "upper_arm", "forearm", "hand", "finger", "thumb")
    skeleton, _ = person(leave_out=("neck", "head", *arms))
    angles = jc.joint_angles(skeleton, jc.rest_pose(skeleton))
    assert not [name for name in angles.names if name.startswith(("neck", "arm", "elbow", "wrist", "pro"))]
    assert {"hip_flexion_r", "ankle_angle_l", "pelvis_tilt"} <= set(angles.names)
    said = angles.describe_missing()
    assert said is not None
    assert said.startswith(
        "the angles of head, humerus_r, forearm_r, hand_r, humerus_l, forearm_l, hand_l are"
    )


def test_a_skeleton_without_a_person_is_refused():
    chain = jc.make_skeleton(
        ["a", "b"], [-1, 0], ["free", "ball"], np.array([[0, 0, 0], [0, -0.4, 0]], float)
    )
    with pytest.raises(jc.InputError, match="The joints a, b are not recognised as a person"):
        jc.joint_angles(chain, jc.rest_pose(chain))


def test_swapped_sides_are_refused():
    plain, _ = person()
    swap = {"Left": "Right", "Righ": "Left"}
    names = [
        swap[name[:4]] + name[len("Left" if name[0] == "L" else "Right") :] if name[:4] in swap else name
        for name in plain.names
    ]
    skeleton = jc.make_skeleton(names, plain.parents, plain.kinds, np.asarray(plain.centres))
    with pytest.raises(
        jc.InputError, match="do not determine the left and the right of the person, or contradict"
    ):
        jc.joint_angles(skeleton, jc.rest_pose(skeleton))


def test_axes_are_right_handed():
    frames = find_anatomical_frames(jc.human(resolution="low").skeleton)
    assert frames.missing == ()
    np.testing.assert_allclose(jnp.linalg.det(frames.axes), 1, atol=1e-6)
    np.testing.assert_allclose(
        frames.axes @ jnp.swapaxes(frames.axes, 1, 2), np.tile(np.eye(3), (15, 1, 1)), atol=1e-6
    )


def test_a_trunk_without_arms_is_found_by_its_name():
    """Legs, a pelvis and a torso, as in OpenSim's models of gait."""
    arms = ("clavicle", "upper_arm", "forearm", "hand", "finger", "thumb", "spine", "chest", "neck", "head")
    legs, index = person(leave_out=arms)
    names, parents = [*legs.names, "torso"], [*legs.parents, index["pelvis"]]
    centres = np.concatenate([legs.centres, [[0, 1.1, 0]]])
    skeleton = jc.make_skeleton(names, parents, [*legs.kinds, "ball"], centres)
    # the person looks along z, so that Z of the axes is -x of the world
    bent = pose(skeleton, {len(names) - 1: Rotation.from_rotvec([-0.3, 0, 0])})
    found = degrees(skeleton, bent)
    assert found["lumbar_extension"] == pytest.approx(np.degrees(0.3), abs=1e-4)
    assert found["lumbar_bending"] == pytest.approx(0, abs=1e-4)
    assert "elbow_flex_r" not in found
