"""`jaxcap edit` as a user types it, and what is refused."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from command_line import fails, runs

import jaxcap as jc
from jaxcap.body.kinematics import joint_paths
from jaxcap.cli import main
from jaxcap.geometry import rotation
from jaxcap.io.meshes.colours import read_colours
from jaxcap.io.registry import read_motion

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
        capsys,
        "edit",
        "join",
        a,
        folder / "b.bvh",
        "-o",
        out,
        "--blend",
        0.2,
        "--find-transition",
        "--overwrite",
    )
    assert "from frame" in told and "0 mm apart" in told
    told = runs(capsys, "edit", "loop", a, "-o", out, "--in-place", "--overwrite")
    assert "one cycle takes 0.67 s and stays in place" in told
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


def test_motions_that_do_not_say_whose_they_are_take_the_body(capsys, folder):
    """AMASS's own files hold no skeleton, and ours need not."""
    body = jc.human(resolution="low")
    poses = jc.stack_poses([jc.rest_pose(body.skeleton)] * 3)
    jc.save_body(folder / "human.npz", body)
    jc.save_motion(folder / "bare.npz", poses)
    jc.io.write_amass(folder / "own.npz", body.skeleton, poses)
    with np.load(folder / "own.npz", allow_pickle=False) as arrays:
        kept = {name: arrays[name] for name in ("poses", "trans", "mocap_framerate")}
    np.savez(folder / "amass.npz", **kept)
    for name in ("bare", "amass"):
        motion, out = folder / f"{name}.npz", folder / f"{name}_out.npz"
        fails(capsys, "edit", "gaze", motion, "-o", out, "--target", 1, 0.5, 3, "--fade", 0)
        told = runs(
            capsys, "edit", "gaze", motion, "-o", out, "--target", 1, 0.5, 3, "--fade", 0, "--body", folder / "human.npz"
        )  # fmt: skip
        assert "3 of them with the full rotation" in told and "and 0.00° after" in told
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
    assert "with --unit" in said
    said = fails(capsys, *glue, folder / "g2", "--frame", 2)
    assert "there is no frame 2" in said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("cut a.npz -o new.txt --frames 0 3", "not written as '.txt'"),
        ("cut a.npz -o new.npz --frames 0 60", "frames 0 to 60 are not in this motion"),
        ("cut a.npz -o new.npz", "either --frames or --seconds"),
        ("cut a.npz -o a.npz --frames 0 3", "give --overwrite"),
        ("cut none.npz -o new.npz --frames 0 3", "none.npz"),
        ("cut b.bvh -o new.npz --frames 0 3 --unit m", "with --unit"),
        ("cut a.npz -o new.npz --frames 0 3 --unit mm", "omit --unit mm"),
        ("cut a.npz -o new.npz --seconds 0 inf", "--seconds is 0 inf"),
        ("cut a.npz -o empty.bvh --frames 0 3 --overwrite", "empty.bvh: this is a folder"),
        ("cut bare.npz -o new.npz --frames 0 3", "was saved without its skeleton"),
        ("cut marked.npz -o new.npz --frames 0 3", "an .npz file with unknown arrays (a); expected a motion"),
        ("resample a.npz -o new.npz --rate 1e9", "this gives 2e+09 frames"),
        ("keys a.npz -o new.npz --keys new.npz", "give them different names"),
        ("retarget a.npz a.npz -o new.npz --names none.txt", "jaxcap: none.txt: there is no such file"),
        ("retarget a.npz a.npz -o new.npz --source human:low", "--source human:low is not the body"),
        ("glue cloud.obj human:low still.npz -o glued2", "still.npz: this motion has no frames"),
        ("resample a.npz -o new.npz --rate 0", "above 0 frames per second"),
        ("join a.npz other.npz -o new.npz", "the skeleton of this motion differs from that of"),
        ("join a.npz b.bvh -o new.npz --blend 9", "give a shorter blend"),
        ("loop a.npz -o new.npz --frames 2 30", "takes the 6 frames before it"),
        ("loop a.npz -o new.npz --min-seconds 5", "does not fit into a motion"),
        ("mirror other.npz -o new.npz", "No joint has a counterpart"),
        ("keys a.npz -o new.npz --degrees 0", "--degrees is 0"),
        ("keys a.npz", "nothing to write"),
        ("keys a.npz --keys keys.txt", "written as .json or .npz"),
        ("gaze a.npz -o new.npz", "either --target or --direction"),
        ("gaze a.npz -o new.npz --target 0 1.6 0.05", "from the point between the eyes"),
        ("gaze a.npz -o new.npz --target 0 1.6 3 --joints Head,Neck,Chest", "is not a descendant of"),
        ("gaze a.npz -o new.npz --target 0 1.6 3 --frames 0 9", "do not fit into frames 0 to 9"),
        ("gaze other.npz -o new.npz --target 0 1.6 3", "name chest, neck and head"),
        ("retarget a.npz other.npz -o new.npz", "give a table of names"),
        ("retarget a.npz a.npz -o new.npz --by surface", "give it with --source"),
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


def test_a_skeleton_is_retargeted_to_itself(capsys, folder):
    runs(capsys, "edit", "retarget", folder / "a.npz", folder / "b.bvh", "-o", folder / "same.bvh")
    skeleton, moved = read_motion(folder / "same.bvh")
    names = [skeleton.names.index(name) for name in SKELETON.names]
    here = np.asarray(joint_paths(skeleton, moved.poses))[:, names]
    np.testing.assert_allclose(here, joint_paths(SKELETON, gait().poses), atol=2e-4)
