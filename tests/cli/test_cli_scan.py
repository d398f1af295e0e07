"""`jaxcap scan` as a user types it: what it writes, that it goes on, and what it refuses."""

import json

import equinox as eqx
import numpy as np
import pytest
from command_line import fails, runs, tree

from jaxcap.body.body import pose_body
from jaxcap.body.people.human import human
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.body.pose import Motion
from jaxcap.cli import main
from jaxcap.cli.adapt.adapt import Adapt
from jaxcap.cli.scan import scan as scan_module
from jaxcap.cli.scan.rate import find_rate
from jaxcap.depth.back_projection import measured_points
from jaxcap.errors import InputError
from jaxcap.geometry.camera import look_at, ring_of_cameras
from jaxcap.geometry.closest import nearest_on_surface
from jaxcap.io.archives.npz import load_body, load_motion, save_body, save_motion
from jaxcap.io.cameras import read_cameras, write_cameras
from jaxcap.io.depth.sequence import read_depths
from jaxcap.io.meshes.clouds import read_clouds
from jaxcap.io.meshes.mesh import read_mesh
from jaxcap.io.skeletons.bvh import write_bvh

FRAMES = 4
SMALL = ("--views", 3, "--resolution", 80, 60)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inputs")
    body = human(joints="tracking", resolution="low")
    motion = walk_and_wave(body.skeleton, seconds=FRAMES / 30)
    save_body(folder / "body.npz", body)
    save_motion(folder / "motion.npz", motion, body.skeleton)
    write_bvh(folder / "motion.bvh", body.skeleton, motion)
    return folder


def command(inputs, out, *more):
    small = () if "--cameras" in more else SMALL
    return ["scan", inputs / "body.npz", inputs / "motion.npz", "-o", out, *small, *more]


def test_scans_are_written_read_and_lie_on_the_truth(inputs, tmp_path, capsys):
    out = tmp_path / "scans"
    told = runs(capsys, *command(inputs, out, "--noise", 0.002, "--npz"))
    assert f"{FRAMES} scans from 3 views" in told
    assert {path.name for path in out.iterdir()} == {
        "scan.json", "cameras.json", "truth.npz", "clouds.npz", *(f"scan_{i:04d}.ply" for i in range(FRAMES)),
    }  # fmt: skip
    assert len(read_cameras(out / "cameras.json")) == 3
    assert load_motion(out / "truth.npz").num_frames == FRAMES
    files, one = read_clouds(out), read_clouds(out / "clouds.npz")
    assert len(files) == len(one) == FRAMES
    for a, b in zip(files, one, strict=True):
        assert len(a.points) > 500
        np.testing.assert_allclose(a.points, b.points, atol=1e-6)
        np.testing.assert_allclose(a.normals, b.normals, atol=1e-6)
    runs(capsys, "evaluate", inputs / "body.npz", out / "truth.npz", out, "-o", tmp_path / "report.json")
    surface = json.loads((tmp_path / "report.json").read_text())["scan_to_surface"]
    assert 0.0005 < surface["mean"] < 0.002


def test_meshes_points_rates_and_bvh(inputs, tmp_path, capsys):
    runs(capsys, *command(inputs, tmp_path / "mesh", "--as", "mesh", "--rate", 15))
    assert load_motion(tmp_path / "mesh" / "truth.npz").rate == 15
    assert len(read_clouds(tmp_path / "mesh")) == FRAMES / 2
    assert len(read_mesh(tmp_path / "mesh" / "scan_0000.ply").faces) > 500
    runs(
        capsys, "scan", inputs / "body.npz", inputs / "motion.bvh", "-o", tmp_path / "few", *SMALL,
        "--points", 200, "--arc", 145,
    )  # fmt: skip
    assert [len(scan.points) for scan in read_clouds(tmp_path / "few")] == [200] * FRAMES


def test_scans_say_their_rate_and_track_and_adapt_take_it(inputs, tmp_path, capsys):
    """Of the motion, or of those that are taken of it; what a user says comes first."""
    motion = load_motion(inputs / "motion.npz")
    save_motion(tmp_path / "fast.npz", Motion(motion.poses, 120.0), load_body(inputs / "body.npz").skeleton)
    fast, half = tmp_path / "fast", tmp_path / "half"
    runs(capsys, "scan", inputs / "body.npz", tmp_path / "fast.npz", "-o", fast, *SMALL, "--npz")
    runs(capsys, "scan", inputs / "body.npz", tmp_path / "fast.npz", "-o", half, *SMALL, "--rate", 60)
    assert json.loads((fast / "scan.json").read_text())["rate"] == 120
    assert json.loads((half / "scan.json").read_text())["rate"] == 60
    for clouds in (fast, fast / "clouds.npz", fast / "scan_*.ply", fast / "scan_%04d.ply"):
        assert find_rate(None, [str(clouds)]) == (120.0, fast / "scan.json")
    assert find_rate(25.0, [str(fast)]) == (25.0, None)
    assert find_rate(None, [str(inputs)]) == (30.0, None)
    with pytest.raises(
        InputError, match="these scans is 60, and that of .* is 120 frames per second; .* --rate"
    ):
        find_rate(None, [str(fast / "scan_0000.ply"), str(half / "scan_0000.ply")])
    told = runs(capsys, "track", inputs / "body.npz", fast, "-o", tmp_path / "out", "--last", 1)
    assert f"120 frames per second, from {fast / 'scan.json'}" in told
    assert load_motion(tmp_path / "out" / "motion.npz").rate == 120
    asked = Adapt(str(inputs / "body.npz"), (str(fast),), tmp_path / "a.npz")
    assert asked.settings()["rate"] == 120


@pytest.mark.parametrize(("rate", "said"), [('"a"', "is 'a'; expected a number"), ("true", "is True"), ("0", "0.0 frames per second; expected"),
                                            ("1" + "0" * 400, "too many digits"), ("NaN", "nan frames per second; expected")])  # fmt: skip
def test_a_rate_of_scans_that_is_none_is_told(tmp_path, rate, said):
    (tmp_path / "scan.json").write_text(f'{{"body arrays": "a", "rate": {rate}}}')
    with pytest.raises(InputError, match=rf"scan\.json: .*{said}"):
        find_rate(None, [str(tmp_path)])
    # a file of another program's
    (tmp_path / "scan.json").write_text('{"rate": "fast"}')
    assert find_rate(None, [str(tmp_path)]).file is None


def test_a_stopped_run_goes_on_to_the_same_end(inputs, tmp_path, capsys, monkeypatch):
    bad = ("--drop", 0.3, "--holes", 0.1, "--flying", 0.2)
    runs(capsys, *command(inputs, tmp_path / "whole", *bad))
    made, scan_frame = [], scan_module.scan_frame

    def stopping(*arguments):
        made.append(arguments[-1])
        if len(made) > 2:
            raise KeyboardInterrupt
        return scan_frame(*arguments)

    monkeypatch.setattr(scan_module, "scan_frame", stopping)
    with pytest.raises(SystemExit) as stop:
        runs(capsys, *command(inputs, tmp_path / "half", *bad))
    assert stop.value.code == 130
    told = capsys.readouterr().err
    assert f"stopped after 2 of {FRAMES} scans, which are written; --resume continues" in told
    monkeypatch.setattr(scan_module, "scan_frame", scan_frame)
    # what a run leaves that is killed while it writes
    torn = tmp_path / "half" / ".scan_0002.ply.abcdefgh.unfinished" / "scan_0002.ply"
    torn.parent.mkdir()
    torn.write_text("ply")
    assert "give --resume" in fails(capsys, *command(inputs, tmp_path / "half", *bad))
    told = fails(capsys, *command(inputs, tmp_path / "half", "--resume", "--drop", 0.2))
    assert "scan.json: the scans were made with another" in told
    before = (tmp_path / "half" / "scan_0000.ply").stat().st_mtime_ns
    assert "2 of 4 scans already exist" in runs(capsys, *command(inputs, tmp_path / "half", *bad, "--resume"))
    assert (tmp_path / "half" / "scan_0000.ply").stat().st_mtime_ns == before
    whole, half = (
        {name: data for name, data in tree(tmp_path / name).items() if name.endswith((".ply", ".json"))}
        for name in ("whole", "half")
    )
    assert whole == half


def test_earlier_scans_are_kept_or_replaced_as_a_whole(inputs, tmp_path, capsys):
    out = tmp_path / "scans"
    runs(capsys, *command(inputs, out))
    kept = tree(out)
    assert "--overwrite" in fails(capsys, *command(inputs, out))
    assert tree(out) == kept
    (out / "mine.txt").write_text("mine")
    runs(capsys, *command(inputs, out, "--rate", 10, "--overwrite", "--seed", 1))
    assert len(list(out.glob("scan_*.ply"))) == 2
    assert (out / "mine.txt").is_file()


def test_a_calibration_takes_the_place_of_the_ring(inputs, tmp_path, capsys):
    cameras = ring_of_cameras(2, 90, 2.0, 0.5, [0.0, 0.1, 0], (96, 72))
    write_cameras(tmp_path / "c.json", cameras)
    runs(capsys, *command(inputs, tmp_path / "scans", "--cameras", tmp_path / "c.json"))
    for one, two in zip(cameras, read_cameras(tmp_path / "scans" / "cameras.json"), strict=True):
        np.testing.assert_allclose(one.rotation, two.rotation, atol=1e-12)
        assert (one.width, one.height) == (two.width, two.height)
    away = look_at([0, 0, 2.0], [0, 0, 5.0], 96, 72, 60)
    write_cameras(tmp_path / "away.json", [*cameras, away])
    told = fails(capsys, *command(inputs, tmp_path / "no", "--cameras", tmp_path / "away.json"))
    assert "away.json: camera 2 at (0, 0, 2) points away from the body" in told
    write_cameras(tmp_path / "past.json", [look_at([0, 0, 2.0], [2, 0, 1.0], 96, 72, 30)])
    told = fails(capsys, *command(inputs, tmp_path / "no", "--cameras", tmp_path / "past.json"))
    assert "camera 0 at (0, 0, 2) has the body outside of its image" in told
    assert not (tmp_path / "no").exists()


def test_empty_views_and_frames_are_told_by_number(inputs, tmp_path, capsys):
    """A body that walks out of a picture."""
    motion = load_motion(inputs / "motion.npz")
    moved = motion.poses.translations.at[2:, 0, 0].add(30.0)
    poses = eqx.tree_at(lambda p: p.translations, motion.poses, moved)
    save_motion(
        tmp_path / "gone.npz", Motion(poses, 30.0), human(joints="tracking", resolution="low").skeleton
    )
    here = ring_of_cameras(1, 90, 2.5, 0.5, [0.0, 0.1, 0], (96, 72))
    there = ring_of_cameras(1, 90, 2.5, 0.5, [30.0, 0.1, 0], (96, 72))
    write_cameras(tmp_path / "both.json", here + there)
    write_cameras(tmp_path / "one.json", here)
    words = ["scan", inputs / "body.npz", tmp_path / "gone.npz", "--cameras"]
    capsys.readouterr()
    main([str(word) for word in (*words, tmp_path / "both.json", "-o", tmp_path / "both")])
    told = capsys.readouterr().err
    assert "view 0 is empty in 2 of 4 frames, the first is frame 2" in told
    assert "view 1 is empty in 2 of 4 frames, the first is frame 0" in told
    told = fails(capsys, *words, tmp_path / "one.json", "-o", tmp_path / "one")
    assert "frame 2: all 1 views are empty" in told
    assert (tmp_path / "one" / "scan_0001.ply").is_file()


@pytest.mark.parametrize(
    ("more", "told"),
    [
        (("--views", 0), "0 views were requested"),
        (("--views", 10**9), "1000000000 views were requested; expected 1 to 1000"),
        (("--arc", 500), "arc of cameras is 500 degrees"),
        (("--resolution", 4, 4), "4 x 4 pixels are too small"),
        (("--distance", -1), "-1 m from the body"),
        (("--noise", -1), "--noise of the scanner is -1"),
        (("--drop", 1), "--drop of the scanner is 1"),
        (("--noise-growth", "nan"), "--noise-growth of the scanner is nan"),
        (("--points", 0), "--points of the scanner is 0"),
        (("--rate", 0), "--rate is 0"),
        (("--rate", 90), "--rate is 90, and the motion has 30"),
        (("--seed", -1), "--seed is -1"),
        (("--resume", "--overwrite"), "give one of them"),
        (("--as", "mesh", "--npz"), "omit one of them"),
        (("--as", "mesh", "--points", 10), "remove the settings points, voxel and outliers"),
        (("--cameras", "none.json"), "none.json: there is no such file"),
    ],
)
def test_what_is_refused(inputs, tmp_path, capsys, more, told):
    assert told in fails(capsys, *command(inputs, tmp_path / "out", *more))
    assert not (tmp_path / "out").exists()


def test_help_tells_every_option(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["scan", "--help"])
    assert not stop.value.code
    told = capsys.readouterr().out
    assert all(f"--{word}" in told for word in ("views", "arc", "resolution", "noise-growth", "as", "resume"))


def test_missing_files_and_folders(inputs, tmp_path, capsys):
    assert "no such file" in fails(
        capsys, "scan", inputs / "body.npz", tmp_path / "no.npz", "-o", tmp_path / "o"
    )
    assert "no such file" in fails(
        capsys, "scan", tmp_path / "no.npz", inputs / "motion.npz", "-o", tmp_path / "o"
    )
    (tmp_path / "file").write_text("")
    assert "cannot be written to" in fails(capsys, *command(inputs, tmp_path / "file" / "folder"))


def test_depth_images_of_a_room_are_written_and_read(inputs, tmp_path, capsys):
    """The written images show the person in front of the wall, and the masks are the person's pixels."""
    out = tmp_path / "depth"
    source = ["scan", inputs / "body.npz", inputs / "motion.npz", "-o", out, "--rate", 15, "--views", 1]
    printed = runs(capsys, *source, "--as", "depth", "--room", "--sensor", "azure-kinect")
    assert "2 scans from 1 views" in printed and "pixels of the body" in printed
    (camera,) = read_cameras(out / "cameras.json")
    assert (camera.width, camera.height) == (320, 288)
    assert (
        find_rate(None, (), [str(out / "depth0")]).frames
        == find_rate(None, (), [str(out / "depth0" / "*.png")]).frames
        == 15
    )
    frames = read_depths(out / "depth0", out / "mask0")
    body, motion = load_body(inputs / "body.npz"), load_motion(out / "truth.npz")
    for number in range(2):
        depth, mask = frames[number].depths[0], frames[number].masks[0]
        points = measured_points(camera, np.where(mask, depth, 0.0))
        vertices = np.asarray(pose_body(body, motion[number]).vertices)
        distances = nearest_on_surface(points, vertices, np.asarray(body.faces)).distances
        assert len(points) > 500 and np.median(distances) < 0.003
        assert np.mean(depth > 0) > 0.5 and np.mean(mask) < 0.1
    described = runs(capsys, "info", out)
    assert "2 depth images of 320 x 288 pixels" in described
    assert f"track human --depth {out}/depth0 --cameras {out}/cameras.json" in described
    said = fails(capsys, *source, "--as", "depth", "--room", "--sensor", "azure-kinect")
    assert "this folder contains scans" in said
    runs(capsys, *source, "--as", "depth", "--room", "--sensor", "azure-kinect", "--resume")


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (("--sensor", "azure-kinect", "--noise", 0.01), "--noise has no effect with --sensor"),
        (("--cameras", "cameras.json", "--views", 3), "--views has no effect with --cameras"),
        (("--as", "depth", "--points", 100), "--points has no effect with --as depth"),
        (("--as", "depth", "--npz"), "--npz is for clouds, and --as depth was given"),
    ],
)
def test_options_that_another_one_replaces_are_refused(inputs, tmp_path, capsys, options, why):
    source = inputs / "body.npz", inputs / "motion.npz"
    assert why in fails(capsys, "scan", *source, "-o", tmp_path / "out", *options)
