"""`jaxcap limits` as a user types it: learned, checked, projected, compared, and what is refused."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
from command_line import fails, runs
from matplotlib.image import imread
from scipy.spatial.transform import Rotation

import jaxcap as jc

SKELETON = jc.make_skeleton(
    ("hips", "shoulder", "elbow"),
    (-1, 0, 1),
    ("free", "ball", "ball"),
    [[0.0, 1, 0], [0.2, 1.4, 0], [0.5, 1.4, 0]],
)


def write_motion(path, seed: int, size: float = 40.0, bend: float = 80.0, frames: int = 900):
    rng = np.random.default_rng(seed)
    rotations = np.tile([1.0, 0, 0, 0], (frames, 3, 1))
    turns = np.radians(size) * np.sin(
        np.arange(frames)[:, None] * rng.uniform(0.02, 0.2, 3) + rng.uniform(0, 6, 3)
    )
    rotations[:, 1] = Rotation.from_rotvec(0.55 * turns).as_quat(scalar_first=True)
    angles = np.radians(bend) * (0.5 + 0.5 * np.sin(0.11 * np.arange(frames)))
    rotations[:, 2] = Rotation.from_rotvec(angles[:, None] * [0.0, 0, 1]).as_quat(scalar_first=True)
    poses = jc.Pose(jnp.zeros((frames, 3, 3)), jnp.asarray(rotations), jnp.ones(frames))
    jc.save_motion(path, jc.Motion(poses, 30.0), SKELETON)
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("limits")
    for seed in range(3):
        write_motion(folder / f"m{seed}.npz", seed)
    write_motion(folder / "wild.npz", 7, 110.0, 150.0, 200)
    return folder


@pytest.fixture(scope="module")
def learned(folder):
    from jaxcap.cli import main

    motions = [str(folder / f"m{seed}.npz") for seed in range(3)]
    out = folder / "limits.npz"
    main(["limits", "learn", *motions, "--joints", "shoulder:elbow", "-o", str(out), "--report", str(folder / "pics"),
          "--voxel", "6", "--keyframe-width", "12"])  # fmt: skip
    return out


def test_learned_limits_come_in_again_and_have_pictures(folder, learned):
    limits = jc.io.load_limits(learned)
    assert [(s.joint, s.parent) for s in limits.surfaces] == [("shoulder", None), ("elbow", "shoulder")]
    # an elbow that could turn freely is found to be a hinge
    assert limits.surfaces[1].chart.kind == "hinge"
    jc.io.save_limits(folder / "again.npz", limits)
    again = jc.io.load_limits(folder / "again.npz")
    for one, two in zip(limits.surfaces, again.surfaces, strict=True):
        np.testing.assert_array_equal(one.centres, two.centres)
        np.testing.assert_array_equal(one.densities, two.densities)
    for name in ("shoulder", "elbow"):
        assert imread(folder / "pics" / f"{name}.png").std() > 0.05


def test_check_tells_joints_frames_and_comfort(capsys, folder, learned):
    report = folder / "check.json"
    told = runs(capsys, "limits", "check", folder / "m1.npz", "-l", learned, "-o", report)
    assert "900 frames, 0 with a joint beyond its limits" in told
    told = runs(capsys, "limits", "check", folder / "wild.npz", "-l", learned, "-o", report, "--overwrite")
    assert "200 frames, 0 with" not in told
    rows = [line.split() for line in told.splitlines()]
    assert [row[0] for row in rows if row[0] in ("shoulder", "elbow")] == ["shoulder", "elbow"]
    joints = json.loads(report.read_text())["joints"]
    beyond = joints["elbow"]["frames_beyond"]
    assert joints["elbow"]["beyond_share"] == pytest.approx(len(beyond) / 200)
    assert max(joints["elbow"]["degrees"]) > 40
    assert 0 <= min(joints["shoulder"]["comfort"]) <= max(joints["shoulder"]["comfort"]) <= 1


def test_project_writes_a_motion_that_is_allowed(capsys, folder, learned):
    out, picture = folder / "fixed.bvh", folder / "strip.png"
    told = runs(
        capsys, "limits", "project", folder / "wild.npz", "-l", learned, "-o", out, "--picture", picture
    )
    assert "joints are rotated by" in told
    assert imread(picture).std() > 0.05
    skeleton, motion = jc.read_bvh(out)
    limits = jc.io.read_limits(learned, skeleton)
    # a file has a few digits only
    beyond = np.asarray(jc.limits.residual_frames(limits, skeleton, motion))
    assert np.abs(beyond).max() < 1e-3


def test_info_tells_what_is_limited(capsys, learned):
    told = runs(capsys, "info", learned).splitlines()
    assert told[0].startswith("limits of shoulder: 3 angles, ")
    assert told[1].startswith("limits of elbow: 1 angles, ")
    assert told[1].endswith("keyframes of shoulder")


def test_compare_tells_a_distance_for_each_joint(capsys, folder):
    told = runs(
        capsys, "limits", "compare", folder / "m0.npz", folder / "wild.npz", "--joints", "shoulder,elbow"
    )
    same = runs(capsys, "limits", "compare", folder / "m0.npz", folder / "m0.npz", "--joints", "shoulder")
    rows = {line.split()[0]: line.split() for line in told.splitlines()}
    assert float(rows["elbow"][1]) > 0.03
    assert float(same.splitlines()[-1].split()[1]) == 0.0


def test_what_is_refused(capsys, folder, learned, tmp_path):
    m = folder / "m0.npz"
    learn = ("limits", "learn", m, "-o", tmp_path / "l.npz", "--joints")
    assert "there is no joint 'knee'; it has hips, shoulder, elbow" in fails(capsys, *learn, "knee")
    assert "No voxel has 100000 samples" in fails(
        capsys, *learn, "shoulder", "--min-samples", 100000, "--voxel", 5
    )
    assert "already exists" in fails(capsys, "limits", "learn", m, "-o", learned, "--joints", "elbow")
    assert "--coverage is 2" in fails(capsys, *learn, "elbow", "--coverage", 2)
    assert "written as .npz" in fails(
        capsys, "limits", "learn", m, "-o", tmp_path / "l.txt", "--joints", "elbow"
    )
    assert "need files of markers" in fails(capsys, *learn, "elbow", "--markers", "a,b,c,d")
    assert "no such file" in fails(capsys, "limits", "check", m, "-l", tmp_path / "none.npz")
    other = jc.make_skeleton(("a", "b"), (-1, 0), ("free", "ball"), [[0.0, 1, 0], [0.2, 1.4, 0]])
    jc.save_motion(tmp_path / "other.npz", jc.stack_poses([jc.rest_pose(other)]), other)
    told = fails(capsys, "limits", "check", tmp_path / "other.npz", "-l", learned)
    assert "limits belong to another skeleton: 'shoulder' is not among the joints a, b" in told
    assert "not written as '.fbx'" in fails(
        capsys, "limits", "project", m, "-l", learned, "-o", tmp_path / "x.fbx"
    )
    assert not (tmp_path / "l.npz").exists()


def test_a_joint_that_only_turns_through_full_turns_has_no_limits(capsys, tmp_path):
    turns = Rotation.random(4000, random_state=1).as_quat(scalar_first=True)
    rotations = np.tile([1.0, 0, 0, 0], (4000, 3, 1))
    rotations[:, 1] = turns
    poses = jc.Pose(jnp.zeros((4000, 3, 3)), jnp.asarray(rotations), jnp.ones(4000))
    jc.save_motion(tmp_path / "round.npz", jc.Motion(poses, 30.0), SKELETON)
    told = fails(
        capsys, "limits", "learn", tmp_path / "round.npz", "--joints", "shoulder", "-o", tmp_path / "l.npz"
    )
    assert "shoulder rotate through a full turn each, so there are no limits to learn" in told


def test_a_damaged_file_is_told(capsys, folder, learned, tmp_path):
    arrays = dict(np.load(learned))
    arrays["1.centres"] = arrays["1.centres"][:, :3]
    np.savez(tmp_path / "damaged.npz", **arrays)
    told = fails(capsys, "limits", "check", folder / "m0.npz", "-l", tmp_path / "damaged.npz")
    assert "the limits of 'elbow' have inconsistent shapes" in told


@pytest.mark.shared
def test_acclaim_limits_are_checked_with_their_motions(capsys, shared):
    motion = shared / "data" / "motion" / "02_03.amc"
    told = runs(capsys, "limits", "check", motion, "-l", motion.with_name("02.asf"))
    assert "173 frames" in told
    assert any(line.split()[:1] == ["lfemur"] for line in told.splitlines())
    assert "another skeleton" in fails(
        capsys, "limits", "check", motion.with_name("01_01.bvh"), "-l", motion.with_name("02.asf")
    )
