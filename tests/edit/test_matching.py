"""Joints of two skeletons matched by names and by the tree, whatever a program calls them."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from stick_person import PERSON, build

from jaxcap.body.kinematics import joint_paths
from jaxcap.body.matching.hinges import hinge_axis
from jaxcap.body.matching.joint_matches import UnmatchedJoints
from jaxcap.body.matching.limbs import find_limbs
from jaxcap.body.matching.match_joints import match_joints
from jaxcap.body.matching.names import parse_joint_name
from jaxcap.body.matching.person_joints import identify_joints
from jaxcap.body.matching.plan import plan_retarget
from jaxcap.body.matching.upright_pose import joint_transforms
from jaxcap.body.people.human import human
from jaxcap.body.pose import Motion, Pose
from jaxcap.body.skeleton import make_skeleton
from jaxcap.edit.retargeting.retarget import retarget

#: other programs' names of the same joints, in that order
SCHEMES = {
    "bandai": "Hips UpperLeg_{s} LowerLeg_{s} Foot_{s} Toes_{s} Spine Chest Neck Head Shoulder_{s} UpperArm_{s} LowerArm_{s} Hand_{s}",
    "unreal": "pelvis thigh_{s} calf_{s} foot_{s} ball_{s} spine_01 spine_02 neck_01 head clavicle_{s} upperarm_{s} lowerarm_{s} hand_{s}",
    "asf": "root {s}femur {s}tibia {s}foot {s}toes lowerback upperback lowerneck head {s}clavicle {s}humerus {s}radius {s}wrist",
    "biovision": "Hips {s}Hip {s}Knee {s}Ankle {s}Toe Chest Chest2 Neck Head {s}Collar {s}Shoulder {s}Elbow {s}Wrist",
    "kinect": "SPINE_BASE HIP_{s} KNEE_{s} ANKLE_{s} FOOT_{s} SPINE_NAVEL SPINE_CHEST NECK HEAD CLAVICLE_{s} SHOULDER_{s} ELBOW_{s} WRIST_{s}",
    "poser": "hip {s}Thigh {s}Shin {s}Foot {s}Toe abdomen chest neck head {s}Collar {s}Shldr {s}ForeArm {s}Hand",
    "xsens": "Pelvis {s}UpperLeg {s}LowerLeg {s}Foot {s}Toe L5 T8 Neck Head {s}Shoulder {s}UpperArm {s}ForeArm {s}Hand",
    "made up": "zut ab{s} bc{s} cd{s} de{s} ef fg gh hi ij{s} jk{s} kl{s} lm{s}",
}
SIDES = {
    "unreal": "lr",
    "asf": "lr",
    "poser": "lr",
    "kinect": ("LEFT", "RIGHT"),
    "bandai": "LR",
    "made up": "yx",
}


def make_pose(shifts, turns, scale):
    return Pose(*(jnp.asarray(each) for each in (shifts, turns, scale)))


def still(skeleton, frames=1):
    count = skeleton.num_joints
    return Motion(
        make_pose(np.zeros((frames, count, 3)), np.tile([1.0, 0, 0, 0], (frames, count, 1)), np.ones(frames)),
        30.0,
    )


def test_names_of_many_programs_say_side_and_part():
    said = {
        "mixamorig:LeftForeArm": ("left", "forearm"),
        "UpperArm_L": ("left", "upper_arm"),
        "lfemur": ("left", "thigh"),
        "rbuttock": ("right", "hip_side"),
        "J_Bip_L_UpperLeg": ("left", "thigh"),
        "ValveBiped.Bip01_R_Calf": ("right", "shin"),
        "Bip01 L Toe0": ("left", "toes"),
        "HipLeft": ("left", "thigh"),
        "Hip": (None, "pelvis"),
        "T12": (None, "spine"),
        "f_avg_R_Collar": ("right", "clavicle"),
        "Actor_1:LFArm": ("left", "forearm"),
        "DEF-shin.R": ("right", "shin"),
        "Right Upper Arm": ("right", "upper_arm"),
        "lowerleg02.R": ("right", "shin"),
        "J_Bip_L_HipJoint": ("left", "hip_side"),
        "Skel_RHipJoint": ("right", "hip_side"),
        "DEF-FingerBase.L": ("left", "palm"),
    }
    for name, (side, part) in said.items():
        found = parse_joint_name(name)
        assert (found.side, found.parts[0]) == (side, part), name
    assert parse_joint_name("lShldrTwist").helper and parse_joint_name("upperarm_twist_01_l").helper
    assert parse_joint_name("cuisse_G").parts == ()


@pytest.mark.parametrize("scheme", list(SCHEMES))
def test_every_joint_matches_whatever_it_is_called(scheme):
    """Also by names in no table, and with a vertical of another axis and size."""
    target = build()
    sides = SIDES.get(scheme, ("Left", "Right"))
    source = build(sides=sides, scheme=SCHEMES[scheme], place=lambda x: 100 * x[[2, 0, 1]])
    found = match_joints(source, target)
    # both are built in one order
    assert found.pairs == {joint: joint for joint in range(target.num_joints)}
    assert not found.unmatched_source and not found.unmatched_target and not found.warnings


@pytest.mark.parametrize("prefix", ["", "J_Bip_", "Skel_", "DEF-", "ORG-", "Bip01_", "mixamorig:", "jnt_"])
def test_a_joint_between_pelvis_and_thigh_is_not_the_thigh(prefix):
    """Whatever stands before the names; and where there is no other thigh, it is the thigh."""
    scheme = " ".join(prefix + name for name in SCHEMES["poser"].replace("{s}", "{s}_").split())
    target = build()
    hung = [(name, "{s}HipJoint" if name == "{s}UpLeg" else parent, place) for name, parent, place in PERSON]
    hung.insert(1, ("{s}HipJoint", "Hips", (0.02, 1.0, 0)))
    called = dict(zip([name for name, _, _ in PERSON], scheme.split(), strict=True))
    called["{s}HipJoint"] = prefix + "{s}_HipJoint"
    source = build([(called[n], called[p] if p else None, c) for n, p, c in hung], sides="LR")
    found = match_joints(source, target).names
    assert found[f"{prefix}L_HipJoint"] is None and found[f"{prefix}R_Thigh"] == "RightUpLeg"
    scheme = scheme.replace("Thigh", "Hip_Joint").replace("Shin", "Knee_Joint")
    found = match_joints(build(sides="LR", scheme=scheme), target).names
    assert found[f"{prefix}L_Hip_Joint"] == "LeftUpLeg" and found[f"{prefix}R_Knee_Joint"] == "RightLeg"


def test_sides_without_names_are_where_the_toes_say():
    """Seen from behind: the first of each pair is the right one."""
    source = build(sides="yx", scheme=SCHEMES["made up"], place=lambda x: x * [-1, 1, 1])
    found = match_joints(source, build())
    assert source.names[found.pairs[found.target.names.index("LeftArm")]] == "jkx"
    blunt = [row for row in PERSON if "Toe" not in row[0]]
    names = SCHEMES["made up"].split()
    called = dict(zip([name for name, _, _ in PERSON], names, strict=True))
    source = build([(called[n], called[p] if p else None, c) for n, p, c in blunt], sides="yx")
    with pytest.raises(ValueError, match="In the source: No joint name states left or right"):
        match_joints(source, build())


def test_names_that_contradict_the_toes_are_refused():
    with pytest.raises(ValueError, match="The joint names and the toes disagree on left and right"):
        match_joints(build(place=lambda x: x * [-1, 1, 1]), build())


def test_joints_without_a_match_are_composed_or_stay():
    """More spine in the source, a twist joint, a weapon; no clavicles and no neck. The report says all of it."""
    rows = [("Root", None, (0, 0, 0)), ("Hips", "Root", (0, 1.0, 0)), *PERSON[1:]]
    rows = [row for row in rows if "Shoulder" not in row[0] and row[0] != "Neck"]
    swap = {"{s}Arm": "Spine1", "Head": "Spine1", "Spine": "Spine0", "{s}ForeArm": "{s}ArmTwist"}
    rows = [(name, swap.get(name, parent), centre) for name, parent, centre in rows]
    rows.insert(rows.index(("Spine", "Spine0", (0, 1.1, 0))), ("Spine0", "Hips", (0, 1.05, 0)))
    rows.insert([name for name, _, _ in rows].index("{s}ForeArm"), ("{s}ArmTwist", "{s}Arm", (0.33, 1.45, 0)))
    rows.append(("{s}Weapon", "{s}Hand", (0.72, 1.45, 0.9)))
    source, target = build(rows), build()
    found = match_joints(source, target)
    lost, rest = found.unmatched_source, found.unmatched_target
    assert lost["Root"] == "composed onto Hips"
    assert lost["LeftArmTwist"] == "composed onto LeftArm"
    assert lost["LeftWeapon"].startswith("left out")
    assert rest["LeftShoulder"] == "stays at rest, moved by Spine1"
    assert rest["Neck"] == "interpolated, 50% from Spine1 to Head"
    # three joints of the source's spine for two: the lower one is between the first and the second
    assert rest["Spine"] == "interpolated, 50% from Spine0 to Spine"
    said = " ".join(found.lines())
    assert all(name in said for name in [*lost, *rest])
    # the upper arm turns as its far end does
    arm = target.names.index("LeftArm")
    assert source.names[found.followed[arm][0]] == "LeftArmTwist"
    assert source.names[found.pairs[arm]] == "LeftArm"


def test_limbs_without_a_match_are_refused_or_warned_of():
    armless = [row for row in PERSON if not any(part in row[0] for part in ("Shoulder", "Arm", "Hand"))]
    with pytest.raises(UnmatchedJoints, match="No arm of the target has a match in the source") as refused:
        match_joints(build(armless), build())
    assert refused.value.names["LeftLeg"] == "LeftLeg"
    # the table says so: a warning is left of it
    found = match_joints(build(armless), build(), refused.value.names)
    assert found.warnings == ("no arm of the target has a match in the source by the table of names",)
    whole = build()
    kept = [
        i
        for i, name in enumerate(whole.names)
        if not (name.startswith("Left") and any(part in name for part in ("Arm", "Hand")))
    ]
    index = {old: new for new, old in enumerate(kept)}
    single = make_skeleton(
        [whole.names[i] for i in kept],
        [index.get(whole.parents[i], -1) for i in kept],
        [whole.kinds[i] for i in kept],
        np.asarray(whole.centres)[kept],
    )
    assert match_joints(single, whole).warnings == (
        "the left arm of the target has no match in the source and stays at rest",
    )
    assert match_joints(whole, single).warnings == (
        "the left arm of the source is left out, as the target has none",
    )


def test_a_table_of_names_is_checked():
    source, target = build(scheme=SCHEMES["xsens"]), build()
    table = {"Pelvis": "Hips", "L5": "Spine", "T8": "Spine1", "Neck": None}
    assert match_joints(source, target, table).names["Neck"] is None
    with pytest.raises(ValueError, match="no joint 'Elbow' in the target"):
        match_joints(source, target, {**table, "Head": "Elbow"})
    with pytest.raises(ValueError, match="no joint 'Elbow' in the source"):
        match_joints(source, target, {**table, "Elbow": None})
    with pytest.raises(ValueError, match="'Pelvis' and 'Head' of the source are both given for 'Hips'"):
        match_joints(source, target, {**table, "Head": "Hips"})


@pytest.mark.parametrize("joints", ["full", "tracking"])
def test_limbs_of_a_human_without_names_are_those_that_its_names_say(joints):
    skeleton = human(resolution="low", joints=joints).skeleton
    named = find_limbs(skeleton, [parse_joint_name(name) for name in skeleton.names])
    alone = find_limbs(skeleton, [parse_joint_name(f"joint{row}") for row in range(skeleton.num_joints)])
    for wanted, found in zip(named, alone, strict=True):
        assert len(found) == 2
        assert {limb.joints for limb in found} == {limb.joints for limb in wanted}


def test_two_equal_chains_are_no_arms():
    """A rig whose limbs could be several chains by their lengths is not guessed."""
    rows = [("root", None, (0, 0, 0))]
    for limb, side in (("p", 1), ("q", -1)):
        above = "root"
        for step in range(6):
            rows.append((f"{limb}{'abcdef'[step]}", above, (0.3 * side, 0.3 * (step + 1), 0)))
            above = rows[-1][0]
    person = identify_joints(build(rows))
    assert not person.parts and person.pelvis == -1


def test_places_and_rotations_are_those_of_the_kinematics(rng):
    skeleton = build()
    turns = Rotation.random(4 * skeleton.num_joints, random_state=1).as_quat().reshape(4, -1, 4)
    shifts = rng.normal(size=(4, skeleton.num_joints, 3))
    poses = make_pose(shifts, turns[..., [3, 0, 1, 2]], [1.0, 1.0, 1.0, 0.7])
    np.testing.assert_allclose(joint_transforms(skeleton, poses)[0], joint_paths(skeleton, poses), atol=1e-9)


def test_hinges_show_in_the_motion_whatever_the_frames_and_the_twist_of_the_forearm(rng):
    """An elbow that bends about an axis across the upper arm, while forearm and shoulder turn as they like."""
    skeleton = build()
    limb = tuple(skeleton.names.index(name) for name in ("LeftArm", "LeftForeArm", "LeftHand"))
    axis = np.array([0, 0.6, -0.8])
    frames = 40
    turns = np.tile([0, 0, 0, 1.0], (frames, skeleton.num_joints, 1))
    shoulder = Rotation.random(frames, random_state=2)
    bend = Rotation.from_rotvec(np.linspace(0.1, 1.5, frames)[:, None] * axis)
    twist = Rotation.from_rotvec(rng.normal(size=(frames, 1)) * [1.0, 0, 0])
    turns[:, limb[0]], turns[:, limb[1]] = shoulder.as_quat(), (bend * twist).as_quat()
    poses = make_pose(np.zeros((frames, skeleton.num_joints, 3)), turns[..., [3, 0, 1, 2]], np.ones(frames))
    places, whole = joint_transforms(skeleton, poses)
    rest = np.asarray(skeleton.centres)
    matrices = Rotation.from_quat(whole[:, limb[0]][:, [1, 2, 3, 0]]).as_matrix()
    found = hinge_axis(skeleton, limb, places, matrices, rest, np.eye(3))
    np.testing.assert_allclose(found, axis, atol=1e-9)
    # straight at rest, and in too few frames
    assert hinge_axis(skeleton, limb, places[:1], matrices[:1], rest, np.eye(3)) is None


def folded(skeleton, motion):
    """The same motion in a file whose joints have frames of their own: all bones along x at rest."""
    own = []
    centres = np.asarray(skeleton.centres, float)
    for joint, name in enumerate(skeleton.names):
        below = [child for child, parent in enumerate(skeleton.parents) if parent == joint]
        bone = centres[below[0]] - centres[joint] if below else np.array([0, 1.0, 0])
        own.append(Rotation.align_vectors(bone[None], [[-1.0 if name.startswith("Right") else 1.0, 0, 0]])[0])
    places, turns = joint_transforms(skeleton, motion.poses)
    rest = np.zeros_like(centres)
    rotations = np.zeros(turns.shape)
    for joint, parent in enumerate(skeleton.parents):
        whole = Rotation.from_quat(turns[:, joint][:, [1, 2, 3, 0]]) * own[joint]
        if parent >= 0:
            rest[joint] = rest[parent] + own[parent].inv().apply(centres[joint] - centres[parent])
            whole = (Rotation.from_quat(turns[:, parent][:, [1, 2, 3, 0]]) * own[parent]).inv() * whole
        rotations[:, joint] = whole.as_quat()[:, [3, 0, 1, 2]]
    shifts = np.zeros(places.shape)
    shifts[:, 0] = places[:, 0] - rest[0]
    changed = make_skeleton(skeleton.names, skeleton.parents, skeleton.kinds, rest)
    return changed, Motion(make_pose(shifts, rotations, np.ones(len(places))), motion.rate)


def test_a_rest_pose_of_nobody_is_replaced_by_a_frame_that_stands():
    """Joint frames of their own fold the rest pose; the motion that comes out is the same."""
    skeleton, frames = build(), 12
    turns = np.tile([1.0, 0, 0, 0], (frames, skeleton.num_joints, 1))
    for name, axis in (
        ("LeftUpLeg", 0),
        ("RightArm", 1),
        ("LeftForeArm", 1),
        ("RightForeArm", 1),
        ("LeftLeg", 0),
        ("RightLeg", 0),
    ):
        angles = np.linspace(0, 1.2, frames) * (1 if name.startswith("Left") or axis == 0 else -1)
        turns[:, skeleton.names.index(name)] = Rotation.from_rotvec(
            angles[:, None] * np.eye(3)[axis]
        ).as_quat()[:, [3, 0, 1, 2]]
    motion = Motion(make_pose(np.zeros((frames, skeleton.num_joints, 3)), turns, np.ones(frames)), 30.0)
    source, moving = folded(skeleton, motion)
    np.testing.assert_allclose(
        joint_transforms(source, moving.poses)[0], joint_transforms(skeleton, motion.poses)[0], atol=1e-9
    )
    plan = plan_retarget(source, skeleton, None, moving)
    assert plan.matches.references[0].frame == 0 and plan.ratio == pytest.approx(1.0)
    assert "frame 0, the most upright one" in " ".join(plan.matches.lines())
    found = retarget(moving, source, skeleton, plan=plan)
    np.testing.assert_allclose(
        joint_transforms(skeleton, found.poses)[0], joint_transforms(skeleton, motion.poses)[0], atol=1e-6
    )
    with pytest.raises(ValueError, match="rest pose of the source is not upright"):
        match_joints(source, skeleton)
    with pytest.raises(ValueError, match="rest pose of the target is not upright"):
        match_joints(skeleton, source)
    with pytest.raises(ValueError, match="neither at rest nor in any frame"):
        match_joints(source, skeleton, motion=still(source, 2))
