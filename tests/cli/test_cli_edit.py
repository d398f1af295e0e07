"""`jaxcap edit` as a user types it, and what is refused."""

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
from jaxcap.cli import main
from jaxcap.edit.retargeting.soles import lowest
from jaxcap.errors import InputError
from jaxcap.geometry import rotation
from jaxcap.io.meshes.colours import read_colours
from jaxcap.io.registry import read_motion
from jaxcap.io.skeletons.joint_names import read_joint_names

SKELETON = jc.make_skeleton(
    ["Hips", "Chest", "Neck", "Head", "LeftArm", "RightArm"],
    [-1, 0, 1, 2, 1, 1],
    ["free"] + ["ball"] * 5,
    [[0, 1.0, 0], [0, 1.3, 0], [0, 1.5, 0], [0, 1.6, 0.02], [0.2, 1.4, 0], [-0.2, 1.4, 0]],
)


def gait(frames=60, speed=0.04, rate=30.0):
    phase = 2 * np.pi * np.arange(frames)[:, None, None] / 20
    vectors = 0.3 * np.sin(phase + np.arange(6)[:, None] + np.arange(3))
    translations = np.zeros((frames, 6, 3))
    translations[:, 0, 2] = speed * np.arange(frames)
    return jc.Motion(
        jc.Pose(jnp.asarray(translations), rotation.exp(jnp.asarray(vectors)), jnp.ones(frames)), rate
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("edit")
    jc.save_motion(folder / "a.npz", gait(), SKELETON)
    jc.write_bvh(folder / "b.bvh", SKELETON, gait(40))
    other = jc.make_skeleton(["x", "y"], [-1, 0], ["free", "ball"], [[0, 0, 0], [0, 1.0, 0]])
    still = jc.Pose(jnp.zeros((5, 2, 3)), jnp.tile(jnp.array([1.0, 0, 0, 0]), (5, 2, 1)), jnp.ones(5))
    jc.save_motion(folder / "other.npz", jc.Motion(still, 30.0), other)
    return folder


def test_clips_are_cut_resampled_joined_looped_and_mirrored(capsys, folder):
    a, out = folder / "a.npz", folder / "out.npz"
    assert "20 frames at 30" in runs(capsys, "edit", "cut", a, "-o", out, "--frames", 10, 29)
    runs(capsys, "edit", "cut", a, "-o", folder / "s.npz", "--seconds", 0.5, 1.0)
    assert len(jc.load_motion(folder / "s.npz")) == 16
    assert "119 frames at 60" in runs(capsys, "edit", "resample", a, "-o", out, "--rate", 60, "--overwrite")
    told = runs(
        capsys, "edit", "join", a, folder / "b.bvh", "-o", out, "--blend", 0.2, "--find", "--overwrite"
    )
    assert "from frame" in told and "0 mm apart" in told
    told = runs(capsys, "edit", "loop", a, "-o", out, "--in-place", "--overwrite")
    assert "a round takes 0.67 s and stays in place" in told
    x = np.asarray(joint_paths(SKELETON, jc.load_motion(out).poses))
    assert len(x) == 21
    np.testing.assert_array_equal(x[0], x[-1])
    runs(capsys, "edit", "mirror", a, "-o", out, "--overwrite")
    mirrored = np.asarray(joint_paths(SKELETON, jc.load_motion(out).poses))
    own = np.asarray(joint_paths(SKELETON, gait().poses))
    np.testing.assert_allclose(mirrored, own[:, [0, 1, 2, 3, 5, 4]] * [-1, 1, 1], atol=1e-6)


def test_keys_are_written_by_joint_and_as_a_motion(capsys, folder):
    a, out, keys = folder / "a.npz", folder / "keys.npz", folder / "keys.json"
    told = runs(
        capsys,
        "edit",
        "keys",
        a,
        "-o",
        out,
        "--keys",
        keys,
        "--per-joint",
        "--degrees",
        3,
        "--millimetres",
        20,
    )
    assert "keys of 6 joints for 60 frames" in told
    content = json.loads(keys.read_text())
    assert content["frames"] == 60 and set(content["joints"]) == set(SKELETON.names)
    head = content["joints"]["Head"]
    np.testing.assert_allclose(
        head["rotations"], np.asarray(gait().poses.rotations)[head["frames"], 3], atol=1e-6
    )
    found = jc.load_motion(out)
    assert np.degrees(rotation.distance(found.poses.rotations, gait().poses.rotations)).max() <= 3
    runs(capsys, "edit", "keys", a, "--keys", folder / "all.npz")
    with np.load(folder / "all.npz", allow_pickle=False) as arrays:
        assert arrays["rotations"].shape == (len(arrays["frames"]), 4)


def test_gaze_goes_to_a_target_for_some_frames(capsys, folder):
    a, out = folder / "a.npz", folder / "gaze.npz"
    told = runs(
        capsys, "edit", "gaze", a, "-o", out, "--target", 1, 1.8, 3, "--frames", 10, 49, "--fade", 0.3
    )
    assert "Chest 10 %, Neck 40 %, Head 50 %" in told and "and 0.00° after" in told
    found = jc.load_motion(out).poses.rotations
    np.testing.assert_array_equal(found[:10], gait().poses.rotations[:10])
    assert np.abs(found[30] - gait().poses.rotations[30]).max() > 0.01


def test_retarget_brings_feet_to_the_floor_and_hands_together(capsys, folder):
    from jaxcap.demo.performance import walk_and_wave

    tall = jc.human(resolution="low", height=1.9)
    jc.save_motion(folder / "tall.npz", walk_and_wave(tall.skeleton, 0.4, 10.0), tall.skeleton)
    (folder / "points.txt").write_text("LeftHand LeftHand\nRightHand RightHand 2  # twice\n")
    told = runs(capsys, "edit", "retarget", folder / "tall.npz", "human:height=1.5,low", "-o", folder / "short.npz",
                "--by", "names", "--source", "human:height=1.9,low", "--ground", "--points", folder / "points.txt")  # fmt: skip
    assert "by the names of joints" in told and "LeftHand and LeftHand: " in told
    moved = jc.load_motion(folder / "short.npz")
    short = jc.human(resolution="low", height=1.5)
    assert np.abs(lowest(short, moved.poses) + 0.82).max() < 0.02
    told = runs(capsys, "edit", "retarget", folder / "tall.npz", "human:height=1.5,low", "-o", folder / "skin.npz",
                "--source", "human:height=1.9,low")  # fmt: skip
    assert "retargeted by the surface" in told
    moved = jc.load_motion(folder / "skin.npz")
    assert np.abs(lowest(short, moved.poses) + 0.82).max() < 0.01


def test_retarget_says_what_matches_and_a_refusal_writes_a_table(capsys, folder):
    """Joints of another program; and arms that nothing shows, until a table says which they are."""
    target = build()
    still = lambda skeleton: jc.stack_poses([jc.rest_pose(skeleton)] * 2)  # noqa: E731
    jc.save_motion(folder / "sticks.npz", still(target), target)
    scheme = "Hips {s}UpperLeg {s}LowerLeg {s}Foot {s}Toes Spine Chest Neck Tail_1 Collar_{s} UpperArm_{s} LowerArm_{s} Hand_{s}"
    source = build(scheme=scheme)
    jc.save_motion(folder / "other_rig.npz", still(source), source)
    words = ("edit", "retarget", folder / "other_rig.npz", folder / "sticks.npz", "-o")
    told = runs(capsys, *words, folder / "matched.npz", "--write-names", folder / "table.json")
    assert "20 joints of the source match one of the target" in told and "LeftUpperLeg = LeftUpLeg" in told
    assert "no match in the source: Tail_1: left out" in told
    assert "no match in the target: Head: stays at rest, moved by Neck" in told
    table = read_joint_names(folder / "table.json")
    assert table["LowerArm_Left"] == "LeftForeArm" and table["Tail_1"] is None
    # arms by names that say something else, of which no lengths show what they are
    wrong = {name: f"tail_{row}" for row, name in enumerate(source.names) if "Arm" in name or "Hand" in name}
    called = [wrong.get(name, name) for name in source.names]
    source = jc.make_skeleton(called, source.parents, source.kinds, source.centres)
    jc.save_motion(folder / "other_rig.npz", still(source), source)
    said = fails(capsys, *words, folder / "armed.npz")
    assert (
        "No arm of the target has a match in the source" in said
        and "armed_names.json has what was found" in said
    )
    assert not (folder / "armed.npz").exists()
    table = json.loads((folder / "armed_names.json").read_text())
    assert "LeftForeArm" in table["unmatched"] and table["names"]["LeftUpperLeg"] == "LeftUpLeg"
    said = fails(capsys, *words, folder / "armed.npz")
    assert "armed_names.json is there already" in said
    for name, other in wrong.items():
        side = "Left" if "Left" in name else "Right"
        part = {"UpperArm": "Arm", "LowerArm": "ForeArm", "Hand": "Hand"}[name.split("_")[0]]
        table["names"][other] = side + part
    (folder / "armed_names.json").write_text(json.dumps(table))
    told = runs(capsys, *words, folder / "armed.npz", "--names", folder / "armed_names.json")
    # clavicles and chest are still "" in the table, and show as soon as there are arms
    assert "20 joints of the source match" in told and "LowerArm_Left" not in told


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "names.json:1: this is not JSON"),
        ('{"a": 1}', "'a' leads to 1"),
        ('{"a": "b", "a": "c"}', "'a' stands twice"),
        ('{"format": "other", "names": {}}', "this is 'other' of version None"),
        ("[]", "there is no table of joints"),
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


def test_the_floor_of_a_motion_with_z_up_is_below_its_feet(capsys, folder, upright):
    """Somebody walks away along -y, half a metre over the origin, and is given to a body of three quarters."""
    tall, lying = upright
    steps = np.zeros((6, 8, 3))
    steps[:, 0] = [0, -2.0, 0.4] + np.arange(6)[:, None] * [0, -0.3, 0.01]
    still = jnp.tile(jnp.array([1.0, 0, 0, 0]), (6, 8, 1))
    motion = jc.Motion(jc.Pose(jnp.asarray(steps), still, jnp.ones(6)), 30.0)
    jc.write_bvh(folder / "lying.bvh", lying, motion)
    small = jc.make_skeleton(tall.names, tall.parents, tall.kinds, 0.75 * np.asarray(tall.centres))
    box = trimesh.creation.box((0.6, 1.2, 0.3)).subdivide()
    vertices = jnp.asarray(box.vertices + [0, 0.6, 0])
    body = jc.Body(small, jc.RigidSkin(jnp.zeros(len(vertices), int)), vertices, jnp.asarray(box.faces))
    jc.save_body(folder / "small.npz", body)
    (folder / "feet.txt").write_text("LeftFoot LeftFoot\n")
    told = runs(capsys, "edit", "retarget", folder / "lying.bvh", folder / "small.npz", "-o", folder / "up.npz", "--ground",
                "--points", folder / "feet.txt")  # fmt: skip
    # the lowest joint is 0.1 m over the soles and goes from 0.5 m on
    assert "1 m becomes 0.750 m, the floor is at 0.50" in told
    assert "LeftFoot and LeftFoot: 0.0 mm apart, 0.0 mm at most" in told
    moved = jc.load_motion(folder / "up.npz")
    low = lowest(body, moved.poses, np.array([0, 0, 1.0]))
    np.testing.assert_allclose(low, 0.501 + 0.75 * 0.01 * np.arange(6), atol=2e-3)
    feet = np.asarray(joint_paths(small, moved.poses))[:, 3]
    np.testing.assert_allclose(feet[:, 1], 0.75 * (-2.0 - 0.3 * np.arange(6)), atol=1e-3)


def test_motions_that_do_not_say_whose_they_are_take_the_body(capsys, folder):
    """AMASS's own files hold no skeleton, and ours need not."""
    body = jc.human(resolution="low")
    poses = jc.stack_poses([jc.rest_pose(body.skeleton)] * 3)
    jc.save_body(folder / "human.npz", body)
    jc.save_motion(folder / "bare.npz", poses)
    jc.write_amass(folder / "own.npz", body.skeleton, poses)
    with np.load(folder / "own.npz", allow_pickle=False) as arrays:
        kept = {name: arrays[name] for name in ("poses", "trans", "mocap_framerate")}
    np.savez(folder / "amass.npz", **kept)
    for name in ("bare", "amass"):
        motion, out = folder / f"{name}.npz", folder / f"{name}_out.npz"
        fails(capsys, "edit", "gaze", motion, "-o", out, "--target", 1, 0.5, 3, "--fade", 0)
        told = runs(
            capsys, "edit", "gaze", motion, "-o", out, "--target", 1, 0.5, 3, "--fade", 0, "--body", folder / "human.npz"
        )  # fmt: skip
        assert "3 of them looking" in told and "and 0.00° after" in told
        runs(capsys, "edit", "retarget", motion, folder / "human.npz", "-o", out, "--source", folder / "human.npz",
             "--by", "names", "--overwrite")  # fmt: skip
        found = joint_paths(body.skeleton, jc.load_motion(out).poses)
        np.testing.assert_allclose(found, joint_paths(body.skeleton, poses.poses), atol=1e-5)


def test_a_scan_moves_with_its_body_in_its_colours(capsys, folder):
    body = jc.human(resolution="low")
    jc.save_body(folder / "body.npz", body)
    rest = jc.rest_pose(body.skeleton)
    lifted = jc.Pose(rest.translations.at[0, 1].add(0.5), rest.rotations, rest.scale)
    jc.save_motion(folder / "lift.npz", jc.stack_poses([rest, lifted]), body.skeleton)
    rng = np.random.default_rng(1)
    scan = trimesh.Trimesh(np.asarray(body.vertices) + 0.005, np.asarray(body.faces), process=False)
    scan.visual.vertex_colors = rng.integers(0, 255, (len(scan.vertices), 4)).astype(np.uint8)
    scan.export(folder / "scan.ply")
    glue = ("edit", "glue", *(folder / name for name in ("scan.ply", "body.npz", "lift.npz")), "-o")
    told = runs(capsys, *glue, folder / "glued")
    assert "2 meshes of" in told and "with their colours" in told
    for frame, lift in ((0, 0.0), (1, 0.5)):
        found = trimesh.load(folder / "glued" / f"glued_{frame:04d}.ply", process=False)
        np.testing.assert_allclose(found.vertices, scan.vertices + [0, lift, 0], atol=1e-5)
        np.testing.assert_array_equal(found.faces, scan.faces)
        np.testing.assert_array_equal(found.visual.vertex_colors, scan.visual.vertex_colors)
    runs(capsys, *glue, folder / "glued", "--as", "obj", "--frames", 1, 1, "--overwrite")
    assert [path.name for path in (folder / "glued").iterdir()] == ["glued_0001.obj"]
    again = jc.read_mesh(folder / "glued" / "glued_0001.obj")
    tinted = folder / "glued" / "glued_0001.obj"
    np.testing.assert_array_equal(
        trimesh.load(tinted, process=False).visual.vertex_colors[:, :3], scan.visual.vertex_colors[:, :3]
    )
    np.testing.assert_array_equal(
        read_colours(tinted, len(scan.vertices))[:, :3], scan.visual.vertex_colors[:, :3]
    )
    np.testing.assert_allclose(again.vertices, scan.vertices + [0, 0.5, 0], atol=1e-5)
    said = fails(capsys, *glue, folder / "glued")
    assert "give --overwrite" in said
    said = fails(capsys, *glue, folder / "g2", "--unit", "cm")
    assert "say by --unit" in said
    said = fails(capsys, *glue, folder / "g2", "--frame", 2)
    assert "there is no frame 2" in said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("cut a.npz -o new.txt --frames 0 3", "not written as '.txt'"),
        ("cut a.npz -o new.npz --frames 0 60", "frames 0 to 60 are not in this motion"),
        ("cut a.npz -o new.npz", "by --frames or by --seconds"),
        ("cut a.npz -o a.npz --frames 0 3", "give --overwrite"),
        ("cut none.npz -o new.npz --frames 0 3", "none.npz"),
        ("cut b.bvh -o new.npz --frames 0 3 --unit m", "say by --unit"),
        ("cut a.npz -o new.npz --frames 0 3 --unit mm", "leave --unit mm out"),
        ("cut a.npz -o new.npz --seconds 0 inf", "--seconds is 0 inf"),
        ("cut a.npz -o empty.bvh --frames 0 3 --overwrite", "empty.bvh: this is a folder"),
        ("cut bare.npz -o new.npz --frames 0 3", "does not say its skeleton"),
        ("cut marked.npz -o new.npz --frames 0 3", "an unmarked file of other arrays, not a 'jaxcap motion'"),
        ("resample a.npz -o new.npz --rate 1e9", "that makes 2e+09 frames"),
        ("keys a.npz -o new.npz --keys new.npz", "give them two names"),
        ("retarget a.npz a.npz -o new.npz --names none.txt", "jaxcap: none.txt: there is no such file"),
        ("retarget a.npz a.npz -o new.npz --source human:low", "--source human:low is not the body"),
        ("glue cloud.obj human:low still.npz -o glued2", "still.npz: there are no frames in this motion"),
        ("resample a.npz -o new.npz --rate 0", "above 0 frames a second"),
        ("join a.npz other.npz -o new.npz", "another skeleton than"),
        ("join a.npz b.bvh -o new.npz --blend 9", "blend over less"),
        ("loop a.npz -o new.npz --frames 2 30", "takes the 6 frames before it"),
        ("loop a.npz -o new.npz --least 5", "does not fit into a motion"),
        ("mirror other.npz -o new.npz", "No joint has a twin"),
        ("keys a.npz -o new.npz --degrees 0", "--degrees is 0"),
        ("keys a.npz", "nothing to write"),
        ("keys a.npz --keys keys.txt", "written as .json or .npz"),
        ("gaze a.npz -o new.npz", "--target or by --direction"),
        ("gaze a.npz -o new.npz --target 0 1.6 0.05", "from between the eyes"),
        ("gaze a.npz -o new.npz --target 0 1.6 3 --joints Head,Neck,Chest", "does not hang on"),
        ("gaze a.npz -o new.npz --target 0 1.6 3 --frames 0 9", "do not fit into frames 0 to 9"),
        ("gaze other.npz -o new.npz --target 0 1.6 3", "name chest, neck and head"),
        ("retarget a.npz other.npz -o new.npz", "say which do with a table"),
        ("retarget a.npz a.npz -o new.npz --by surface", "give it by --source"),
        ("retarget a.npz a.npz -o new.npz --ground", "this is a skeleton"),
        ("retarget a.npz a.npz -o new.npz --points one.txt", "one.txt:1: this line has 1 words"),
    ],
)  # fmt: skip
def test_wrong_input_ends_in_one_sentence(capsys, folder, monkeypatch, words, said):
    monkeypatch.chdir(folder)
    (folder / "one.txt").write_text("LeftHand\n")
    (folder / "empty.bvh").mkdir(exist_ok=True)
    (folder / "cloud.obj").write_text("v 0 0 0\n")
    jc.save_motion(folder / "bare.npz", gait())
    np.savez(folder / "marked.npz", a=np.ones(3))
    human = jc.human(resolution="low").skeleton
    jc.save_motion(folder / "still.npz", jc.stack_poses([jc.rest_pose(human)]).slice(slice(0, 0)), human)
    assert said in fails(capsys, "edit", *words.split())
    assert not (folder / "new.npz").exists()


def test_a_unit_may_be_a_number_of_metres(capsys, folder):
    """As CMU's captures have it, in which a unit is a length without a name."""
    jc.write_bvh(folder / "odd.bvh", SKELETON, gait(3), unit=0.0564)
    runs(
        capsys,
        "edit",
        "cut",
        folder / "odd.bvh",
        "-o",
        folder / "metres.npz",
        "--frames",
        0,
        2,
        "--unit",
        "0.0564",
    )
    found = read_motion(folder / "metres.npz")[0]
    here = np.asarray(found.centres)[found.names.index("Head")]
    np.testing.assert_allclose(here, np.asarray(SKELETON.centres)[3], atol=1e-5)
    said = fails(
        capsys,
        "edit",
        "cut",
        folder / "odd.bvh",
        "-o",
        folder / "x.npz",
        "--frames",
        0,
        2,
        "--unit",
        "league",
    )
    assert "'league' is not a unit of length" in said and "the metres in one" in said
    said = fails(
        capsys, "edit", "cut", folder / "odd.bvh", "-o", folder / "x.npz", "--frames", 0, 2, "--unit", "-1"
    )
    assert "give a number above zero" in said


def test_a_floor_in_another_unit_is_told(capsys, folder):
    runs(
        capsys, "edit", "retarget", folder / "a.npz", folder / "b.bvh", "-o", folder / "low.npz", "--floor", 0
    )
    assert not capsys.readouterr().err
    main(["edit", "retarget", *(str(folder / name) for name in ("a.npz", "b.bvh")), "-o", str(folder / "far.npz"),
          "--floor", "80"])  # fmt: skip
    assert "--floor is 80 m, and the lowest joint of the motion is at" in capsys.readouterr().err


def test_two_files_that_do_not_say_their_units(capsys, folder):
    """`info` proposes the unit of each, and both can be given."""
    person = build()
    still = jc.stack_poses([jc.rest_pose(person)] * 2)
    for name in ("one.bvh", "two.bvh", "cm.bvh"):
        jc.write_bvh(folder / name, person, still, unit="cm" if name == "cm.bvh" else "dm")
    jc.save_motion(folder / "metres.npz", still, person)
    next_line = runs(capsys, "info", folder / "one.bvh").splitlines()[-1]
    assert (
        "view" in next_line
        and f"edit retarget {folder / 'one.bvh'} human -o human.npz --unit dm`" in next_line
    )
    assert "--unit 0.1`" in runs(capsys, "info", folder / "one.bvh", "--unit", 0.1)
    assert "--unit" not in runs(capsys, "info", folder / "cm.bvh")
    words = (
        "edit",
        "retarget",
        folder / "one.bvh",
        folder / "two.bvh",
        "-o",
        folder / "both.npz",
        "--unit",
        "dm",
    )
    said = fails(capsys, *words)
    assert (
        "say by --unit what the motion's lengths are in or by --target-unit what the target's lengths are in"
        in said
    )
    assert "1 m becomes 1.000 m" in runs(capsys, *words, "--target-unit", "dm")
    said = fails(capsys, *words[:3], folder / "metres.npz", *words[4:], "--overwrite", "--target-unit", "dm")
    assert "metres.npz: this says its unit itself; leave --target-unit dm out" in said
    jc.write_bvh(folder / "vast.bvh", person, still, unit=1e-9)
    assert "no usual unit makes it a person's" in runs(capsys, "info", folder / "vast.bvh")


def test_a_skeleton_is_retargeted_to_itself(capsys, folder):
    runs(capsys, "edit", "retarget", folder / "a.npz", folder / "b.bvh", "-o", folder / "same.bvh")
    skeleton, moved = read_motion(folder / "same.bvh")
    names = [skeleton.names.index(name) for name in SKELETON.names]
    here = np.asarray(joint_paths(skeleton, moved.poses))[:, names]
    np.testing.assert_allclose(here, joint_paths(SKELETON, gait().poses), atol=2e-4)
