"""`jaxcap live`: replayed images, a pipe, what it writes, and what does not fit."""

import io
import itertools
import json
import sys
import threading
import time
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from command_line import fails, runs
from PIL import Image

from jaxcap.body.body import pose_body
from jaxcap.body.people.human import human
from jaxcap.body.pose import Pose, rest_pose
from jaxcap.cli import main
from jaxcap.cli.live import sources
from jaxcap.cli.live.slots import fill_slots, frame_slots
from jaxcap.cli.track.frame_records import Results
from jaxcap.errors import InputError
from jaxcap.geometry.camera import look_at
from jaxcap.io.archives.npz import load_motion, save_body
from jaxcap.io.cameras import write_cameras
from jaxcap.io.live.arrivals import replay
from jaxcap.io.live.growing_folder import PNG_END, watch_depth_folders
from jaxcap.scanner.ray_casting import make_ray_mesh, render_depth
from jaxcap.tracking.expectation_maximisation.em_step import FrameStatistics
from jaxcap.view.live import follow_run


@pytest.fixture(scope="module")
def captured(tmp_path_factory):
    """Four frames of a person who moves sideways on a floor in front of a camera."""
    folder = tmp_path_factory.mktemp("live")
    body = human(resolution="low", joints="tracking")
    camera = look_at([0.0, 0.7, 2.4], [0.0, -0.05, 0.0], 160, 120, 75)
    vertices, faces = (
        np.asarray(pose_body(body, rest_pose(body.skeleton)).vertices, float),
        np.asarray(body.faces),
    )
    floor = [[3.0 * x, vertices[:, 1].min(), 3.0 * z] for x, z in ((-1, -1), (-1, 1), (1, 1), (1, -1))]
    sides = np.array([[0, 1, 2], [0, 2, 3]])

    def image(moved):
        mesh = make_ray_mesh(np.concatenate([floor, moved]), np.concatenate([sides, 4 + faces]))
        depth = render_depth(camera, mesh).depth
        return np.round(1000 * np.where(depth > 0, depth, 4.0)).astype(np.uint16)

    np.savez(folder / "depth.npz", depth=[image(vertices + [0.01 * step, 0.0, 0.0]) for step in range(4)])
    # the person is far outside of the image
    np.savez(folder / "empty.npz", depth=[image(vertices + [50.0, 0.0, 0.0])] * 3)
    write_cameras(folder / "cameras.json", [camera])
    save_body(folder / "body.npz", body)
    return folder


def test_a_replay_and_a_pipe_are_tracked(captured, tmp_path, capsys, monkeypatch):
    words = (
        captured / "body.npz",
        "--cameras",
        captured / "cameras.json",
        "--num-points",
        "512",
        "--no-search",
    )
    printed = runs(
        capsys,
        "live",
        *words,
        "--watch",
        captured / "depth.npz",
        "--replay",
        "0.5",
        "-o",
        tmp_path / "replay",
    )
    assert "latency" in printed and "4 tracked, 0 dropped" in printed
    assert "a floor was found at the height -0.82 m, tilted by 0 degrees" in printed
    motion = load_motion(tmp_path / "replay" / "motion.npz")
    assert len(motion) == 4 and motion.rate == 0.5
    # the person has moved by three centimetres
    moved = np.asarray(motion[3].translations)[0] - np.asarray(motion[0].translations)[0]
    assert abs(moved[0] - 0.03) < 0.01
    with open(tmp_path / "replay" / "statistics.json") as file:
        statistics = json.load(file)
    assert statistics["live"]["tracked"] == 4 and len(statistics["frames"]) == 4
    take = follow_run(tmp_path / "replay", human(resolution="low", joints="tracking"))
    assert len(take.motion) == 4

    def stopped(*arguments):
        yield from itertools.islice(replay(*arguments), 2)
        raise KeyboardInterrupt

    monkeypatch.setattr(sources, "replay", stopped)
    runs(
        capsys,
        "live",
        *words,
        "--watch",
        captured / "depth.npz",
        "--replay",
        "0.5",
        "-o",
        tmp_path / "stopped",
    )
    assert len(load_motion(tmp_path / "stopped" / "motion.npz")) in (1, 2)

    data = io.BytesIO()
    with np.load(captured / "depth.npz") as file:
        for number, image in enumerate(file["depth"][:2]):
            np.save(data, np.float64(number))
            np.save(data, image)
    data.seek(0)
    monkeypatch.setattr(sys, "stdin", types.SimpleNamespace(buffer=data))
    empty = ("--empty", captured / "empty.npz")
    runs(capsys, "live", *words, *empty, "--watch", "-", "--rate", "2", "-o", tmp_path / "pipe")
    # the frames arrive at once, so that the first one may be dropped; times are one second apart
    assert len(load_motion(tmp_path / "pipe" / "motion.npz")) in (1, 3)
    assert "give --overwrite" in fails(
        capsys, "live", *words, "--watch", captured / "depth.npz", "--replay", "9", "-o", tmp_path / "pipe"
    )


def png(image: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(image).save(file, format="PNG")
    return file.getvalue()


def test_a_damaged_first_image_is_skipped_and_frames_during_compilation_are_counted(
    captured, tmp_path, capsys, monkeypatch
):
    (tmp_path / "images").mkdir()
    with np.load(captured / "depth.npz") as file:
        image = png(file["depth"][0])
    data = [image[:400] + PNG_END, *[image] * 30]

    def write():
        for number, content in enumerate(data):
            (tmp_path / "images" / f"{number}.png").write_bytes(content)
            # the damaged one is seen alone
            time.sleep(0 if number else 0.5)

    def watch(*arguments):
        threading.Timer(0.2, write).start()
        yield from watch_depth_folders(*arguments)

    monkeypatch.setattr(sources, "watch_depth_folders", watch)
    words = ("--cameras", captured / "cameras.json", "--num-points", "512", "--no-search", "--timeout", "1")
    main(
        [
            *("live", str(captured / "body.npz"), "--watch", str(tmp_path / "images")),
            *(*map(str, words), "-o", str(tmp_path / "out")),
        ]
    )
    found = capsys.readouterr()
    assert found.err.count("0.png: the image cannot be read") == 1
    assert found.out.count("ready after ") == 1
    assert "that arrived during compilation were dropped" in found.out
    with open(tmp_path / "out" / "statistics.json") as file:
        counts = json.load(file)["live"]
    assert counts["failed"] == 1 and counts["tracked"] > 0
    assert counts["tracked"] + counts["dropped"] == 30
    assert counts["dropped_before_ready"] == counts["dropped"]


def test_images_of_another_size_than_the_camera_are_named(captured, tmp_path, capsys):
    camera = look_at([0.0, 0.2, 2.4], [0.0, 0.1, 0.0], 80, 60, 60)
    write_cameras(tmp_path / "small.json", [camera])
    words = ("--cameras", tmp_path / "small.json", "--watch", captured / "depth.npz", "--replay", "50")
    with pytest.raises(SystemExit):
        runs(capsys, "live", captured / "body.npz", *words, "-o", tmp_path / "out")
    assert (
        "depth.npz[0]: the image has 160 x 120 pixels; expected 80 x 60, as the camera. Give images of this size, or the "
        "intrinsics for 160 x 120 pixels." in capsys.readouterr().err
    )


def test_a_run_in_which_the_body_was_never_found_fails(captured, tmp_path, capsys):
    words = ("--cameras", captured / "cameras.json", "--num-points", "512", "--no-search", "--up", "z")
    with pytest.raises(SystemExit) as stop:
        runs(
            capsys, "live", captured / "body.npz", *words, "--watch", captured / "depth.npz", "--replay", "2", "--rate", "4",
            "-o", tmp_path / "out"
        )  # fmt: skip
    assert stop.value.code == 2
    printed = capsys.readouterr().err
    assert (
        "the body was found in none of the 4 frames, so the written results are useless. Check the unit, the up axis"
        in printed
    )
    # frames of the written motion, which has one between every two
    assert "4 of 7 frames are lost: 0, 2, 4, 6, counted from 0" in printed
    assert (tmp_path / "out" / "motion.npz").is_file()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--watch", "nowhere"], "this is no folder to watch"),
        (["--watch", "-", "realsense"], "is a source by itself; remove realsense"),
        (["--watch", "-", "--replay", "30"], "--replay is for recorded files"),
        (["--watch", "depth.npz", "--replay", "0"], "--replay is 0; it must be above 0 frames per second"),
        (["--watch", "a", "b"], "--watch names 2 sources of clouds"),
        (
            ["--watch", "a", "b", "--cameras", "cameras.json"],
            "there are 1 cameras, but --watch names 2 sources",
        ),
        (["--watch", "-", "--empty", "depth.npz"], "--empty is for depth images; give --cameras"),
        (
            ["--watch", "-", "--cameras", "cameras.json", "--empty", "depth.npz", "depth.npz"],
            "--empty names 2 sequences of images, but there are 1 cameras",
        ),
        (["--watch", "realsense"], "the package pyrealsense2 of this camera is not installed"),
        (["--watch", "-", "--num-points", "0"], "--num-points is 0; it must be at least 1"),
    ],
)
def test_what_does_not_fit_is_told(captured, tmp_path, capsys, monkeypatch, words, sentence):
    monkeypatch.chdir(captured)
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    assert sentence in fails(capsys, "live", "body.npz", *words, "-o", tmp_path)


def results_of(count: int) -> Results:
    """Frames whose root is at their number."""
    places = jnp.broadcast_to(jnp.arange(count, dtype=float)[:, None, None], (count, 1, 3))
    rotations = jnp.tile(jnp.array([1.0, 0, 0, 0]), (count, 1, 1))
    poses = Pose(places, rotations, jnp.ones(count))
    numbers = jnp.arange(count, dtype=float)
    one = jnp.zeros(())
    statistics = jax.tree.map(lambda _: numbers, FrameStatistics(one, one, one, one, one))
    return Results(
        np.asarray(numbers), poses, statistics, [("good", ())] * count, [()] * count, [False] * count
    )


def test_dropped_frames_are_interpolated():
    slots = frame_slots(np.array([10.0, 10.034, 10.131, 10.133]), 30.0)
    assert slots.tolist() == [0, 1, 4, 4]
    filled, names = fill_slots(results_of(4), ["a", "b", "c", "d"], slots)
    assert names == ["a", "b", "", "", "d"]
    assert [verdict for verdict, _ in filled.verdicts] == ["good", "good", "dropped", "dropped", "good"]
    # from frame 1 to frame 3 in three steps
    np.testing.assert_allclose(
        np.asarray(filled.poses.translations)[:, 0, 0], [0, 1, 1 + 2 / 3, 1 + 4 / 3, 3], atol=1e-6
    )
    with pytest.raises(InputError, match="check the clock of the source"):
        frame_slots(np.array([0.0, 1e6]), 30.0)
