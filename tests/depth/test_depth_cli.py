"""`jaxcap track --depth`: what it asks for, and what it writes."""

import json

import numpy as np
import pytest
from command_line import fails, runs

from jaxcap.body.body import pose_body
from jaxcap.body.people.human import human
from jaxcap.body.pose import rest_pose
from jaxcap.cli.track import depth as depth_clouds
from jaxcap.geometry.camera import look_at
from jaxcap.io.archives.npz import load_motion, save_body
from jaxcap.io.cameras import write_cameras
from jaxcap.scanner.ray_casting import make_ray_mesh, render_depth


@pytest.fixture(scope="module")
def captured(tmp_path_factory):
    """Two frames of a person who stands in front of a camera, seen to the knees."""
    folder = tmp_path_factory.mktemp("depth")
    body = human(resolution="low", joints="tracking")
    camera = look_at([0.0, 0.35, 1.9], [0.0, 0.35, 0.0], 160, 120, 60)
    vertices = np.asarray(pose_body(body, rest_pose(body.skeleton)).vertices, float)
    depth = render_depth(camera, make_ray_mesh(vertices, np.asarray(body.faces))).depth
    room = np.where(depth > 0, depth, 3.0)
    np.savez(
        folder / "depth.npz",
        depth=(1000 * np.stack([room, room])).astype(np.uint16),
        mask=np.stack([depth > 0] * 2),
    )
    write_cameras(folder / "cameras.json", [camera])
    write_cameras(folder / "two.json", [camera, camera])
    save_body(folder / "body.npz", body)
    return folder


def test_a_standing_person_is_tracked_in_depth_images(captured, tmp_path, capsys, monkeypatch):
    loaded, cloud_of_depths = [], depth_clouds.cloud_of_depths

    def counted(*images, name):
        loaded.append(name)
        return cloud_of_depths(*images, name=name)

    monkeypatch.setattr(depth_clouds, "cloud_of_depths", counted)
    printed = runs(
        capsys, "track", captured / "body.npz", "--depth", captured / "depth.npz", "--cameras", captured / "cameras.json",
        "-o", tmp_path, "--initialise", "never",
    )  # fmt: skip
    assert "2 frames" in printed
    # every frame once, also the first one, which is checked before any file is written
    assert len(loaded) == len(set(loaded)) == 2
    motion = load_motion(tmp_path / "motion.npz")
    with open(tmp_path / "statistics.json") as file:
        frames = json.load(file)["frames"]
    assert [frame["verdict"] for frame in frames] == ["good", "good"]
    assert "LeftFoot" in frames[0]["unseen"]
    assert np.abs(np.asarray(motion[1].translations)[0]).max() < 0.03


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--depth", "depth.npz"], "--depth needs the intrinsics of the camera; give them with --cameras"),
        (
            ["--depth", "depth.npz", "--cameras", "two.json"],
            "there are 2 cameras, but --depth names 1 sequences",
        ),
        (["--depth", "none*.png", "--cameras", "cameras.json"], "there are no images"),
        (
            ["depth.npz", "--depth", "depth.npz", "--cameras", "cameras.json"],
            "CLOUDS and --depth were both given",
        ),
        ([], "No clouds were given; give CLOUDS, or depth images with --depth"),
        (["depth.npz", "--cameras", "cameras.json"], "--cameras is for depth images"),
        (
            ["--depth", "depth.npz", "--cameras", "cameras.json", "--depth-scale", "1"],
            "it looks like millimetres",
        ),
    ],
)
def test_what_does_not_fit_is_told(captured, tmp_path, capsys, monkeypatch, words, sentence):
    monkeypatch.chdir(captured)
    assert sentence in fails(capsys, "track", "body.npz", *words, "-o", tmp_path)
