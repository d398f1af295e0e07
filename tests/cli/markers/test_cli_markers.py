"""`jaxcap markers fit` and `solve`: from files of a puppet's markers to its joints, and what they refuse."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
from command_line import fails, runs, tree
from markers_scene import puppet
from matplotlib.image import imread

import jaxcap as jc
from jaxcap.cli import main
from jaxcap.cli.markers.takes import describe_up
from jaxcap.geometry import rotation
from jaxcap.io.markers.up_axis import UpAxis
from jaxcap.markers.segments.gaps import find_runs as runs_of

NAMES = ("trunk", "rarm", "rhand", "larm", "lhand", "head")
LABELS = [f"{name}{number}" for name in NAMES for number in range(4)]
FRAMES = 160
#: a marker that a take does not have, and one that is hidden for some frames
MISSING, HIDDEN, GAP = "head3", "rhand1", slice(40, 70)


def take(places, seen=None, labels=LABELS):
    places = np.array(places)
    if seen is not None:
        places[~seen] = np.nan
    return jc.make_markers(places, labels, 100.0)


@pytest.fixture(scope="module")
def scene():
    # one puppet throughout: equal seeds give equal shapes of its segments
    return puppet(np.random.default_rng(5), frames=3 * FRAMES, noise=2e-4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, scene):
    """`rom.c3d`, `more.trc` with its labels in another order and one less, `trial.c3d` with a gap, and the
    subject of the first two."""
    folder = tmp_path_factory.mktemp("markers")
    rom, more, trial = (scene.places[i * FRAMES : (i + 1) * FRAMES] for i in range(3))
    jc.write_markers(folder / "rom.c3d", take(rom))
    order = [i for i in reversed(range(len(LABELS))) if LABELS[i] != MISSING]
    jc.write_markers(folder / "more.trc", take(more[:, order], labels=[LABELS[i] for i in order]))
    seen = np.ones(trial.shape[:2], bool)
    seen[GAP, LABELS.index(HIDDEN)] = False
    jc.write_markers(folder / "trial.c3d", take(trial, seen))
    main(["markers", "fit", str(folder / "rom.c3d"), str(folder / "more.trc"), "-o", str(folder / "subject.npz"),
          "--frames", "40", "--report", str(folder / "report"), "--joints", str(folder / "fitted.trc")])  # fmt: skip
    return folder


def residual_in(told):
    """The root mean square residual that was told, millimetres; noise has 0.2 along each axis."""
    (line,) = [line for line in told.splitlines() if line.startswith("residuals: ")]
    return float(line.split()[1])


def joint_errors(found, scene, frames):
    """(K,) mean distance, metres, of each of the puppet's joints from the nearest that was found."""
    centres = np.asarray(found.positions, float)
    truth = scene.joints[frames, 1:]
    apart = np.linalg.norm(truth[:, :, None] - centres[:, None], axis=-1).mean(0)
    return apart.min(1)


def test_a_subject_from_two_takes(folder, scene):
    subject = jc.io.load_subject(folder / "subject.npz")
    assert set(subject.labels) == set(LABELS)
    assert subject.skeleton.num_joints == 6
    for name in NAMES:
        bones = {int(subject.bones[subject.labels.index(f"{name}{number}")]) for number in range(4)}
        assert len(bones) == 1, name
    assert joint_errors(jc.read_markers(folder / "fitted.trc"), scene, slice(2 * FRAMES)).max() < 0.002


def test_the_report_has_every_marker(folder):
    report = json.loads((folder / "report" / "report.json").read_text())
    rows = {row["marker"]: row for row in report["markers"]}
    assert set(rows) == set(LABELS)
    assert all(1e-5 < row["rms"] < 1e-3 for row in rows.values())
    assert rows[MISSING]["seen"] == 0.5 and rows["trunk0"]["seen"] == 1.0
    assert all(isinstance(sentence, str) for sentence in report["messages"])
    for name in ("skeleton.png", "residuals.png"):
        picture = imread(folder / "report" / name)[..., :3]
        assert picture.shape[0] > 400 and 0.005 < (picture.mean(2) < 0.8).mean() < 0.9


def test_what_is_told(capsys, folder, tmp_path):
    told = runs(capsys, "markers", "fit", folder / "rom.c3d", "-o", tmp_path / "s.npz", "--local")
    assert "segments: 6, with 24 markers; 0 are loose" in told
    lines = told.splitlines()
    assert sum("trunk0 " in line and "trunk3 " in line for line in lines) == 1
    (head,) = [i for i, line in enumerate(lines) if line.startswith("joint ")]
    for line in lines[head + 1 : head + 6]:
        words = line.split()
        assert words[3] in ("ball", "hinge")
        # residual and precision in millimetres, degrees
        assert float(words[4]) < 2.0 and float(words[6]) < 3.0 and float(words[8].rstrip("°")) > 20
    assert 0.2 < residual_in(told) < 0.4
    assert "24 markers on 6 bones" in told


def test_a_trial_is_solved(capsys, folder, scene, tmp_path):
    told = runs(
        capsys, "markers", "solve", folder / "subject.npz", folder / "trial.c3d", "-o", tmp_path / "trial.bvh",
        "--joints", tmp_path / "joints.trc", tmp_path / "joints.c3d", "--filled", tmp_path / "filled.c3d",
        "--report", tmp_path / "report",
    )  # fmt: skip
    assert 0.2 < residual_in(told) < 0.4
    last = slice(2 * FRAMES, 3 * FRAMES)
    joints = jc.read_markers(tmp_path / "joints.trc")
    assert joint_errors(joints, scene, last).max() < 0.002
    same = jc.read_markers(tmp_path / "joints.c3d")
    np.testing.assert_allclose(same.positions, joints.positions, atol=1e-5)
    # the file of motion has the joints where the tables have them
    skeleton, motion = jc.read_bvh(tmp_path / "trial.bvh")
    centres = jc.markers.joint_frames(skeleton, motion)
    chosen = [centres.labels.index(name) for name in joints.labels]
    np.testing.assert_allclose(np.asarray(centres.positions)[:, chosen], joints.positions, atol=2e-4)
    filled = jc.read_markers(tmp_path / "filled.c3d")
    assert np.asarray(filled.visible).all()
    column = filled.labels.index(HIDDEN)
    off = np.linalg.norm(
        np.asarray(filled.positions)[:, column] - scene.places[last, LABELS.index(HIDDEN)], axis=1
    )
    assert off[GAP].max() < 0.003
    # what was seen stays
    assert np.delete(off, np.arange(GAP.start, GAP.stop)).max() < 1e-6
    assert json.loads((tmp_path / "report" / "report.json").read_text())["lost_frames"] == []


def test_the_up_axis_is_told(capsys, folder, tmp_path):
    """Of the same file the up axis is kept, or converted where it is given; the puppet extends to both sides."""
    command = (
        "markers",
        "solve",
        folder / "subject.npz",
        folder / "trial.c3d",
        "--overwrite",
        "-o",
        tmp_path / "t.npz",
    )
    told = runs(capsys, *command)
    assert "seen; the up axis is unknown and is kept (if it is not y, --up converts it to y)" in told
    assert "seen; y is up by --up\n" in runs(capsys, *command, "--up", "y")
    assert "seen; z is up by --up, converted to y\n" in runs(capsys, *command, "--up", "z")
    stated = UpAxis("z", True)
    assert describe_up(stated, None) == "z is up by the header and is kept (--up z converts it to y)"
    assert describe_up(stated, "x") == "x is up by --up (z is up by the header), converted to y"
    assert describe_up(UpAxis("y", False), None) == "y is probably up"


def test_markers_stay_above_a_floor(capsys, folder, scene, tmp_path):
    places = np.asarray(scene.places[2 * FRAMES : 3 * FRAMES])[..., 1]
    height = float(np.quantile(places.min(1), 0.5)) + 0.02
    plain, above = (tmp_path / name for name in ("plain.trc", "above.trc"))
    for file, more in ((plain, ()), (above, ("--floor", height))):
        runs(capsys, "markers", "solve", folder / "subject.npz", folder / "trial.c3d", "-o", tmp_path / f"{file.stem}.npz", "--joints", file, *more)  # fmt: skip
    joints = [np.asarray(jc.read_markers(file).positions)[..., 1] for file in (plain, above)]
    low = joints[0].min(1) < height - 0.02
    assert (joints[1] - joints[0]).min(1)[low].max() > 0.001
    refused = ("markers", "solve", folder / "subject.npz", folder / "trial.c3d", "-o", tmp_path / "x.npz")
    assert "--floor is nan" in fails(capsys, *refused, "--floor", "nan")
    assert "--floor is 820 m, and the data are between" in fails(capsys, *refused, "--floor", "820")


def test_a_fit_takes_a_prior_of_poses(capsys, folder, tmp_path):
    """A prior of nearly straight joints pulls them from where the markers are."""
    command = ("markers", "fit", folder / "rom.c3d", "--local", "-o")
    plain = residual_in(runs(capsys, *command, tmp_path / "plain.npz"))
    skeleton = jc.io.load_subject(tmp_path / "plain.npz").skeleton
    turns = 0.2 * np.random.default_rng(3).normal(size=(60, skeleton.num_joints, 3))
    straight = jc.Pose(jnp.zeros(turns.shape), rotation.exp(jnp.asarray(turns)), jnp.ones(60))
    prior = tmp_path / "straight.npz"
    jc.io.save_prior(prior, jc.prior.learn_pair_prior(skeleton, straight))
    assert residual_in(runs(capsys, *command, tmp_path / "s.npz", "--prior", prior)) > 1.2 * plain
    other = (folder / "rom.c3d", "-o", tmp_path / "x.npz")
    assert "no such file" in fails(
        capsys, "markers", "fit", *other, "--local", "--limits", tmp_path / "none.cst"
    )
    subject = tmp_path / "plain.npz"
    assert "plain.npz" in fails(capsys, "markers", "fit", *other, "--local", "--prior", subject)


def test_several_trials_go_into_a_folder(capsys, folder, tmp_path):
    command = ["markers", "solve", folder / "subject.npz", folder / "trial.c3d", folder / "more.trc", "-o", tmp_path / "out"]  # fmt: skip
    runs(capsys, *command, "--joints", "joints.trc", "--stream")
    names = {"trial.bvh", "trial.npz", "trial-joints.trc", "more.bvh", "more.npz", "more-joints.trc"}
    assert set(tree(tmp_path / "out")) == names
    assert "give --overwrite" in fails(capsys, *command)
    told = runs(capsys, *command, "--overwrite", "--stream")
    assert told.count("latency: median ") == 2
    jc.load_motion(tmp_path / "out" / "trial.npz", jc.io.load_subject(folder / "subject.npz").skeleton)


def test_streaming_comes_to_the_same_motion(capsys, folder, tmp_path):
    for name, more in (("all.trc", []), ("one.trc", ["--stream"])):
        runs(capsys, "markers", "solve", folder / "subject.npz", folder / "trial.c3d", "-o", tmp_path / f"{name}.npz",
             "--joints", tmp_path / name, *more)  # fmt: skip
    whole, one = (jc.read_markers(tmp_path / name) for name in ("all.trc", "one.trc"))
    np.testing.assert_allclose(whole.positions, one.positions, atol=2e-4)


def test_a_stopped_run_leaves_nothing(capsys, monkeypatch, folder, tmp_path):
    def stop(*_, **__):
        raise KeyboardInterrupt

    (tmp_path / "s.npz").write_bytes(b"old")
    monkeypatch.setattr(np, "savez_compressed", stop)
    fails(
        capsys,
        "markers",
        "fit",
        folder / "rom.c3d",
        "-o",
        tmp_path / "s.npz",
        "--local",
        "--overwrite",
        code=130,
    )
    assert tree(tmp_path) == {"s.npz": b"old"}


def test_corrections_and_a_template(capsys, folder, tmp_path):
    lines = [f"{label} {label[:-1]} 1" for label in LABELS if label != "head3"] + ["head3 - 0"]
    (tmp_path / "segments.txt").write_text("\n".join(lines))
    bones = ["trunk", "rarm", "rhand", "larm", "lhand", "head"]
    skeleton = jc.make_skeleton(
        bones, [-1, 0, 1, 0, 3, 0], ["free", *["ball"] * 5], np.arange(18).reshape(6, 3) / 10
    )
    jc.save_motion(tmp_path / "template.npz", jc.stack_poses([jc.rest_pose(skeleton)]), skeleton)
    command = ["markers", "fit", folder / "rom.c3d", "-o", tmp_path / "s.npz", "--local", "--template", tmp_path / "template.npz"]  # fmt: skip
    told = runs(capsys, *command, "--segments", tmp_path / "segments.txt", "--symmetry", "rhand:lhand")
    assert "loose markers: head3" in told
    subject = jc.io.load_subject(tmp_path / "s.npz")
    above = {
        name: subject.skeleton.names[parent] if parent >= 0 else None
        for name, parent in zip(subject.skeleton.names, subject.skeleton.parents, strict=True)
    }
    assert above == {
        "trunk": None,
        "rarm": "trunk",
        "rhand": "rarm",
        "larm": "trunk",
        "lhand": "larm",
        "head": "trunk",
    }
    assert float(subject.weights[subject.labels.index("head3")]) == 0
    assert "--template needs --segments" in fails(capsys, *command, "--overwrite")


def write(path, places, labels=LABELS, **options):
    jc.write_markers(path, take(places, labels=labels), **options)
    return path


def test_takes_that_tell_nothing(capsys, scene, folder, tmp_path, rng):
    def refused(*paths):
        said = fails(capsys, "markers", "fit", *paths, "-o", tmp_path / "none.npz", "--local")
        assert not (tmp_path / "none.npz").exists()
        return said

    adrift = 1 + 0.4 * rng.normal(size=(50, 8, 3))
    assert "No markers move together" in refused(write(tmp_path / "a.c3d", adrift, LABELS[:8]))
    still = np.repeat(scene.places[:1], 20, 0)
    assert "All 20 frames are equal" in refused(write(tmp_path / "b.c3d", still))
    both = [f"{'Anna' if i < 12 else 'Ben'}:{label}" for i, label in enumerate(LABELS)]
    assert "'Anna' (12 markers) and 'Ben' (12 markers)" in refused(
        write(tmp_path / "c.c3d", scene.places[:20], both)
    )
    jc.write_markers(tmp_path / "d.csv", take(scene.places[:20]), unit="mm")
    assert "looks like millimetres: give --unit mm" in refused(tmp_path / "d.csv")
    (tmp_path / "e.c3d").write_bytes((folder / "rom.c3d").read_bytes()[:-5000])
    assert "cut short" in refused(tmp_path / "e.c3d")
    (tmp_path / "f.c3d").write_text("no markers here")
    assert "not a C3D file" in refused(tmp_path / "f.c3d")
    assert "no such file" in refused(tmp_path / "nowhere.c3d")
    other = write(tmp_path / "g.c3d", scene.places[:20], [f"x{i}" for i in range(24)])
    assert "in common" in refused(folder / "rom.c3d", other)


def test_pieces_are_told_and_joined_when_asked(capsys, scene, tmp_path):
    places = np.concatenate([scene.places[:FRAMES]] + [scene.places[:FRAMES, 3:4]] * 2, 1)
    seen = np.ones(places.shape[:2], bool)
    # one marker under three names, one behind the other
    seen[50:, 3] = seen[:58, 24] = seen[100:, 24] = seen[:109, 25] = False
    jc.write_markers(tmp_path / "pieces.c3d", take(places, seen, [*LABELS, "*41", "*58"]))
    command = ["markers", "fit", tmp_path / "pieces.c3d", "-o", tmp_path / "s.npz", "--local"]
    assert "trunk3, *41, *58 look like one trajectory in 3 pieces" in fails(capsys, *command)
    runs(capsys, *command, "--pieces", "join")
    subject = jc.io.load_subject(tmp_path / "s.npz")
    assert set(subject.labels) == set(LABELS)
    gaps = runs_of(np.sum(seen[:, [3, 24, 25]], axis=1) == 0)
    assert gaps == [(50, 58), (100, 109)]


def test_what_cannot_be_told_is_said(capsys, tmp_path):
    """A marker that never appears, a joint that hardly turns, somebody else without a prefix: no refusal,
    a sentence."""
    stiff = puppet(np.random.default_rng(2), frames=120, noise=5e-4, still=(5,))
    seen = np.ones(stiff.places.shape[:2], bool)
    seen[:, LABELS.index("larm2")] = False
    jc.write_markers(tmp_path / "stiff.c3d", take(stiff.places, seen))
    told = runs(capsys, "markers", "fit", tmp_path / "stiff.c3d", "-o", tmp_path / "s.npz", "--local")
    assert "'larm2' is never visible" in told
    # trunk and head are one where nothing turns between them, or their joint is told
    together = any("trunk0 " in line and "head0 " in line for line in told.splitlines())
    assert together or "degrees, and its centre has a standard deviation of" in told
    rng = np.random.default_rng(3)
    one, two = puppet(rng, frames=120), puppet(rng, frames=120)
    away = two.places[:, :12] + np.array([2.0, 0.5, 0.0])
    labels = [*LABELS, *(f"other{i}" for i in range(12))]
    jc.write_markers(tmp_path / "two.c3d", take(np.concatenate([one.places, away], 1), labels=labels))
    told = runs(capsys, "markers", "fit", tmp_path / "two.c3d", "-o", tmp_path / "t.npz", "--local")
    assert "as if they were on another subject" in told
    assert "24 markers on 6 bones" in told


def test_options_are_checked(capsys, folder, tmp_path):
    fit = ["markers", "fit", folder / "rom.c3d", "-o", tmp_path / "s.npz"]
    assert "ends in .npz" in fails(capsys, "markers", "fit", folder / "rom.c3d", "-o", tmp_path / "s.bvh")
    assert "--threshold is -1" in fails(capsys, *fit, "--threshold", "-1")
    assert "--symmetry has 'arm'" in fails(capsys, *fit, "--symmetry", "arm")
    assert "There are no files" in fails(capsys, "markers", "fit", "-o", tmp_path / "s.npz")
    assert "use .c3d, .trc, .csv" in fails(capsys, *fit, "--joints", tmp_path / "joints.bvh")
    solve = ["markers", "solve", folder / "subject.npz", folder / "trial.c3d"]
    assert "give a folder" in fails(capsys, *solve, folder / "more.trc", "-o", tmp_path / "one.bvh")
    assert "not written as '.fbx'" in fails(capsys, *solve, "-o", tmp_path / "one.fbx")
    assert "no such file" in fails(capsys, "markers", "solve", tmp_path / "s.npz", folder / "trial.c3d", "-o", tmp_path / "o.bvh")  # fmt: skip
    jc.save_motion(
        tmp_path / "m.npz",
        jc.stack_poses([jc.rest_pose(jc.io.load_subject(folder / "subject.npz").skeleton)]),
    )
    assert "this is a motion (1 frame); expected a subject with its markers (from `jaxcap markers fit`)" in fails(capsys, "markers", "solve", tmp_path / "m.npz", folder / "trial.c3d", "-o", tmp_path / "o.bvh")  # fmt: skip
    others = write(tmp_path / "others.c3d", np.random.default_rng(0).random((5, 4, 3)) + 1, list("abcd"))
    assert "None of the frames' markers" in fails(
        capsys, "markers", "solve", folder / "subject.npz", others, "-o", tmp_path / "o.bvh"
    )
    assert not tree(tmp_path).keys() - {"others.c3d", "m.npz"}


def test_raw_markers_are_labelled_and_exchanges_corrected(capsys, folder, scene, tmp_path):
    """Points without names get those of the subject; a file of exchanged names is solved as one of right names."""
    trial = jc.read_markers(folder / "trial.c3d")
    places, seen = np.asarray(trial.positions), np.asarray(trial.visible)
    order = np.random.default_rng(1).permutation(len(LABELS))
    names = tuple(f"*{i + 1}" for i in range(len(LABELS)))
    jc.write_markers(
        tmp_path / "raw.c3d", jc.MarkerFrames(places[:, order], seen[:, order], names, trial.rate)
    )
    command = ("markers", "label", tmp_path / "raw.c3d", "--subject", folder / "subject.npz")
    told = runs(capsys, *command, "-o", tmp_path / "labelled.c3d", "--tracks", tmp_path / "tracks.csv")
    assert "(100.0 %) have labels" in told and "0 tracks with 0 points" in told
    found = jc.read_markers(tmp_path / "labelled.c3d")
    chosen = [found.labels.index(label) for label in trial.labels]
    np.testing.assert_allclose(np.asarray(found.positions)[:, chosen], places, atol=1e-6)
    assert (tmp_path / "tracks.csv").read_text().startswith("name,begin,end,label\n")
    assert "already exists" in fails(capsys, *command, "-o", tmp_path / "labelled.c3d")

    pair = [LABELS.index("rarm0"), LABELS.index("lhand2")]
    mixed = np.array(places)
    mixed[100:130, pair] = mixed[100:130, pair[::-1]]
    jc.write_markers(tmp_path / "mixed.c3d", jc.MarkerFrames(mixed, seen, trial.labels, trial.rate))
    main(["markers", "solve", str(folder / "subject.npz"), str(tmp_path / "mixed.c3d"), "-o", str(tmp_path / "m.npz"),
          "--filled", str(tmp_path / "filled.trc")])  # fmt: skip
    told, warned = capsys.readouterr()
    assert "'rarm0' and 'lhand2' were swapped in 30 frames (100 to 129)" in warned
    assert 0.2 < residual_in(told) < 0.4
    rows = (tmp_path / "filled-deviations.csv").read_text().splitlines()
    column = rows[0].split(",").index(HIDDEN)
    cells = [row.split(",")[column] for row in rows[1:]]
    assert [bool(cell) for cell in cells] == [GAP.start <= i < GAP.stop for i in range(FRAMES)]
    assert all(2e-5 < float(cell) < 3e-3 for cell in cells if cell)
