"""`jaxcap edit retarget` as a user types it: matched joints, tables of them, floors and units."""

import json
import re

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from command_line import fails, runs
from stick_person import build

import jaxcap as jc
from jaxcap.body.kinematics import joint_paths
from jaxcap.edit.retargeting.soles import lowest_heights
from jaxcap.errors import InputError
from jaxcap.io.skeletons.joint_names import read_joint_names


def test_retarget_brings_feet_to_the_floor_and_hands_together(capsys, tmp_path):
    from jaxcap.body.people.walk_and_wave import walk_and_wave

    tall = jc.human(resolution="low", height=1.9)
    jc.save_motion(tmp_path / "tall.npz", walk_and_wave(tall.skeleton, 0.4, 10.0), tall.skeleton)
    (tmp_path / "points.txt").write_text("LeftHand LeftHand\nRightHand RightHand 2  # twice\n")
    told = runs(capsys, "edit", "retarget", tmp_path / "tall.npz", "human:height=1.5,low", "-o", tmp_path / "short.npz",
                "--by", "names", "--source", "human:height=1.9,low", "--ground", "--points", tmp_path / "points.txt")  # fmt: skip
    assert (
        "retargeted by joint names" in told
        and "31 of the same name" in told
        and "LeftHand and LeftHand: " in told
    )
    moved = jc.load_motion(tmp_path / "short.npz")
    short = jc.human(resolution="low", height=1.5)
    assert np.abs(lowest_heights(short, moved.poses) + 0.82).max() < 0.02
    told = runs(capsys, "edit", "retarget", tmp_path / "tall.npz", "human:height=1.5,low", "-o", tmp_path / "skin.npz",
                "--source", "human:height=1.9,low")  # fmt: skip
    assert "retargeted by surface" in told
    moved = jc.load_motion(tmp_path / "skin.npz")
    assert np.abs(lowest_heights(short, moved.poses) + 0.82).max() < 0.01


def test_retarget_says_what_matches_and_a_refusal_writes_a_table(capsys, tmp_path):
    """Joints of another program; and arms that nothing shows, until a table says which they are."""
    target = build()
    still = lambda skeleton: jc.stack_poses([jc.rest_pose(skeleton)] * 2)  # noqa: E731
    jc.save_motion(tmp_path / "sticks.npz", still(target), target)
    scheme = "Hips {s}UpperLeg {s}LowerLeg {s}Foot {s}Toes Spine Chest Neck Tail_1 Collar_{s} UpperArm_{s} LowerArm_{s} Hand_{s}"
    source = build(scheme=scheme)
    jc.save_motion(tmp_path / "other_rig.npz", still(source), source)
    words = ("edit", "retarget", tmp_path / "other_rig.npz", tmp_path / "sticks.npz", "-o")
    told = runs(capsys, *words, tmp_path / "matched.npz", "--write-names", tmp_path / "table.json")
    assert (
        "20 joints of the source match a joint of the target" in told and "LeftUpperLeg = LeftUpLeg" in told
    )
    assert "no match in the source: Tail_1: left out" in told
    assert "no match in the target: Head: stays at rest, moved by Neck" in told
    table = read_joint_names(tmp_path / "table.json")
    assert table["LowerArm_Left"] == "LeftForeArm" and table["Tail_1"] is None
    # arms by names that say something else, of which no lengths show what they are
    wrong = {name: f"tail_{row}" for row, name in enumerate(source.names) if "Arm" in name or "Hand" in name}
    called = [wrong.get(name, name) for name in source.names]
    source = jc.make_skeleton(called, source.parents, source.kinds, source.centres)
    jc.save_motion(tmp_path / "other_rig.npz", still(source), source)
    said = fails(capsys, *words, tmp_path / "armed.npz")
    assert (
        "No arm of the target has a match in the source" in said
        and "armed_names.json contains the matches found" in said
    )
    assert not (tmp_path / "armed.npz").exists()
    table = json.loads((tmp_path / "armed_names.json").read_text())
    assert "LeftForeArm" in table["unmatched"] and table["names"]["LeftUpperLeg"] == "LeftUpLeg"
    said = fails(capsys, *words, tmp_path / "armed.npz")
    assert "armed_names.json already exists" in said
    for name, other in wrong.items():
        side = "Left" if "Left" in name else "Right"
        part = {"UpperArm": "Arm", "LowerArm": "ForeArm", "Hand": "Hand"}[name.split("_")[0]]
        table["names"][other] = side + part
    (tmp_path / "armed_names.json").write_text(json.dumps(table))
    told = runs(capsys, *words, tmp_path / "armed.npz", "--names", tmp_path / "armed_names.json")
    # clavicles and chest are still "" in the table, and show as soon as there are arms
    assert "20 joints of the source match" in told and "LowerArm_Left" not in told


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "names.json:1: this is not JSON"),
        ('{"a": 1}', "'a' is mapped to 1"),
        ('{"a": "b", "a": "c"}', "'a' occurs twice"),
        ('{"format": "other", "names": {}}', "this is 'other' of version None"),
        ("[]", "the file has no table of joints"),
        ("[" * 100000, "nested too deeply"),
    ],
)
def test_damaged_tables_of_joints_end_in_one_sentence(tmp_path, text, said):
    path = tmp_path / "names.json"
    path.write_text(text)
    with pytest.raises(InputError, match=re.escape(said)):
        read_joint_names(path)


@pytest.fixture(scope="module")
def upright():
    """A stick figure on legs, and the same lying as programs with z up have it."""
    names = ["Hips", "LeftUpLeg", "LeftLeg", "LeftFoot", "RightUpLeg", "RightLeg", "RightFoot", "Head"]
    left = [[0.1, 0.9, 0], [0.1, 0.5, 0.01], [0.1, 0.1, 0]]
    centres = np.array([[0, 1.0, 0], *left, *(np.array(left) * [-1, 1, 1]), [0, 1.6, 0]])
    build = lambda x: jc.make_skeleton(names, [-1, 0, 1, 2, 0, 4, 5, 0], ["free"] + ["ball"] * 7, x)  # noqa: E731
    return build(centres), build(centres @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]))


def test_the_floor_of_a_motion_with_z_up_is_below_its_feet(capsys, tmp_path, upright):
    """Somebody walks away along -y, half a metre over the origin, and is given to a body of three quarters."""
    tall, lying = upright
    steps = np.zeros((6, 8, 3))
    steps[:, 0] = [0, -2.0, 0.4] + np.arange(6)[:, None] * [0, -0.3, 0.01]
    still = jnp.tile(jnp.array([1.0, 0, 0, 0]), (6, 8, 1))
    motion = jc.Motion(jc.Pose(jnp.asarray(steps), still, jnp.ones(6)), 30.0)
    jc.write_bvh(tmp_path / "lying.bvh", lying, motion)
    small = jc.make_skeleton(tall.names, tall.parents, tall.kinds, 0.75 * np.asarray(tall.centres))
    box = trimesh.creation.box((0.6, 1.2, 0.3)).subdivide()
    vertices = jnp.asarray(box.vertices + [0, 0.6, 0])
    body = jc.Body(small, jc.body.RigidSkin(jnp.zeros(len(vertices), int)), vertices, jnp.asarray(box.faces))
    jc.save_body(tmp_path / "small.npz", body)
    (tmp_path / "feet.txt").write_text("LeftFoot LeftFoot\n")
    told = runs(capsys, "edit", "retarget", tmp_path / "lying.bvh", tmp_path / "small.npz", "-o", tmp_path / "up.npz", "--ground",
                "--points", tmp_path / "feet.txt")  # fmt: skip
    # the lowest joint is 0.1 m over the soles and goes from 0.5 m on
    assert "1 m becomes 0.750 m, the floor is at 0.50" in told
    assert "LeftFoot and LeftFoot: 0.0 mm apart on average, 0.0 mm at most" in told
    moved = jc.load_motion(tmp_path / "up.npz")
    low = lowest_heights(body, moved.poses, np.array([0, 0, 1.0]))
    np.testing.assert_allclose(low, 0.501 + 0.75 * 0.01 * np.arange(6), atol=2e-3)
    feet = np.asarray(joint_paths(small, moved.poses))[:, 3]
    np.testing.assert_allclose(feet[:, 1], 0.75 * (-2.0 - 0.3 * np.arange(6)), atol=1e-3)


def test_two_files_that_do_not_say_their_units(capsys, tmp_path):
    """`info` proposes the unit of each, and both can be given."""
    person = build()
    still = jc.stack_poses([jc.rest_pose(person)] * 2)
    for name in ("one.bvh", "two.bvh", "cm.bvh"):
        jc.write_bvh(tmp_path / name, person, still, unit="cm" if name == "cm.bvh" else "dm")
    jc.save_motion(tmp_path / "metres.npz", still, person)
    next_line = runs(capsys, "info", tmp_path / "one.bvh").splitlines()[-1]
    assert (
        "view" in next_line
        and f"edit retarget {tmp_path / 'one.bvh'} human -o human.npz --unit dm`" in next_line
    )
    assert "--unit 0.1`" in runs(capsys, "info", tmp_path / "one.bvh", "--unit", 0.1)
    assert "--unit" not in runs(capsys, "info", tmp_path / "cm.bvh")
    words = (
        "edit",
        "retarget",
        tmp_path / "one.bvh",
        tmp_path / "two.bvh",
        "-o",
        tmp_path / "both.npz",
        "--unit",
        "dm",
    )
    said = fails(capsys, *words)
    assert "give the unit of the motion with --unit or the unit of the target with --target-unit" in said
    assert "1 m becomes 1.000 m" in runs(capsys, *words, "--target-unit", "dm")
    said = fails(
        capsys, *words[:3], tmp_path / "metres.npz", *words[4:], "--overwrite", "--target-unit", "dm"
    )
    assert "metres.npz: its unit is known; omit --target-unit dm" in said
    jc.write_bvh(tmp_path / "vast.bvh", person, still, unit=1e-9)
    assert "no usual unit gives the size of a person" in runs(capsys, "info", tmp_path / "vast.bvh")
