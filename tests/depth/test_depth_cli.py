"""`jaxcap track --depth`: what it asks for, and what it writes."""

import json
import shutil

import jax
import numpy as np
import pytest
from command_line import fails, runs
from depth_room import CAMERA, LOW, VERTICES, see

from jaxcap.body.body import pose_body
from jaxcap.body.people.human import human
from jaxcap.body.pose import rest_pose
from jaxcap.cli.depth.sources import open_depth_sources
from jaxcap.cli.track import depth as depth_clouds
from jaxcap.depth import cloud_of_depths
from jaxcap.geometry.camera import look_at
from jaxcap.io.archives.npz import load_motion, save_body
from jaxcap.io.cameras import write_cameras
from jaxcap.observe import missing_cloud
from jaxcap.scanner.ray_casting import make_ray_mesh, render_depth


@pytest.fixture(scope="module")
def captured(tmp_path_factory):
    """A person who stands in front of a camera, seen to the knees: two frames, and three of which the second is empty."""
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
    wall, nobody = np.full_like(room, 3.0), np.zeros(depth.shape, bool)
    np.savez(
        folder / "leaves.npz",
        depth=(1000 * np.stack([room, wall, room])).astype(np.uint16),
        mask=np.stack([depth > 0, nobody, depth > 0]),
    )
    np.savez(folder / "wall.npz", depth=(1000 * np.stack([wall] * 3)).astype(np.uint16))
    np.savez(folder / "other.npz", depth=(1000 * np.stack([wall[1:]] * 3)).astype(np.uint16))
    write_cameras(folder / "cameras.json", [camera])
    write_cameras(folder / "two.json", [camera, camera])
    save_body(folder / "body.npz", body)
    return folder


def test_a_standing_person_is_tracked_in_depth_images(captured, tmp_path, capsys, monkeypatch):
    loaded, cloud_of_depths = [], depth_clouds.cloud_of_depths

    def counted(*images, name, **options):
        loaded.append(name)
        return cloud_of_depths(*images, name=name, **options)

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


def test_a_person_at_the_lens_is_doubted():
    depth, mask = see([VERTICES])
    cloud = cloud_of_depths([CAMERA], [depth], [mask])
    assert not depth_clouds.describe_distance(cloud)
    (near,) = depth_clouds.describe_distance(cloud_of_depths([CAMERA], [depth / 12], [mask], voxel=0.001))
    assert near.startswith("the person is 0.2") and near.endswith("check --depth-scale")
    assert not depth_clouds.describe_distance(missing_cloud("nobody", ()))


def test_a_resumed_run_keeps_its_floor(captured, tmp_path, capsys, monkeypatch):
    """The first frame shows nobody, and the frames that are added another floor."""
    # the first and the last frame are searched for a person
    monkeypatch.setattr(depth_clouds, "MAX_FRAMES", 2)
    depth, mask = see([VERTICES], things=False)
    images = np.stack([see([], things=False)[0], depth, depth, 1.02 * depth])
    masks = np.stack([np.zeros_like(mask), mask, mask, mask])
    write_cameras(tmp_path / "cameras.json", [CAMERA])
    words = [
        "track", captured / "body.npz", "--depth", tmp_path / "depth.npz", "--cameras", tmp_path / "cameras.json",
        "--initialise", "never", "-o", tmp_path / "out",
    ]  # fmt: skip
    printed = []
    for count, more in ((3, ()), (4, ("--resume",))):
        np.savez(tmp_path / "depth.npz", depth=(1000 * images[:count]).astype(np.uint16), mask=masks[:count])
        printed.append(runs(capsys, *words, *more))
    assert all(f"a floor was found at the height {LOW:.2f} m" in text for text in printed)


def test_the_floor_that_the_images_show_is_found_and_printed(captured, tmp_path, capsys):
    depth, mask = see([VERTICES], things=False)
    np.savez(tmp_path / "depth.npz", depth=(1000 * depth[None]).astype(np.uint16), mask=mask[None])
    write_cameras(tmp_path / "cameras.json", [CAMERA])
    words = [
        "track", captured / "body.npz", "--depth", tmp_path / "depth.npz", "--cameras", tmp_path / "cameras.json",
        "--initialise", "never",
    ]  # fmt: skip
    printed = runs(capsys, *words, "-o", tmp_path / "found")
    assert f"a floor was found at the height {LOW:.2f} m, tilted by 0 degrees" in printed
    assert "a floor was found" not in runs(capsys, *words, "--floor", -100, "-o", tmp_path / "off")


def test_a_frame_without_the_person_is_lost_and_the_others_are_kept(captured, tmp_path, capsys):
    """The second of three frames has an empty mask; a run that stops before it goes on to the same bits."""
    words = ["--cameras", captured / "cameras.json", "--initialise", "never"]
    folders = [tmp_path / name for name in ("whole", "stopped")]
    runs(capsys, "track", captured / "body.npz", "--depth", captured / "leaves.npz", *words, "-o", folders[0])
    # frames are added to a sequence of one frame, after a run
    with np.load(captured / "leaves.npz") as images:
        first = {name: images[name][:1] for name in images}
    np.savez(tmp_path / "leaves.npz", **first)
    runs(capsys, "track", captured / "body.npz", "--depth", tmp_path / "leaves.npz", *words, "-o", folders[1])
    shutil.copy(captured / "leaves.npz", tmp_path / "leaves.npz")
    runs(
        capsys,
        "track",
        captured / "body.npz",
        "--depth",
        tmp_path / "leaves.npz",
        *words,
        "-o",
        folders[1],
        "--resume",
    )
    with pytest.warns(UserWarning, match="lost"):
        whole, resumed = (load_motion(folder / "motion.npz") for folder in folders)
    for one, other in zip(jax.tree.leaves(whole.poses), jax.tree.leaves(resumed.poses), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(whole.poses.rotations[1], whole.poses.rotations[0])
    with open(folders[0] / "statistics.json") as file:
        frames = json.load(file)["frames"]
    assert [frame["verdict"] for frame in frames] == ["good", "lost", "good"]
    assert frames[1]["reasons"] == "no person in the frame" and frames[1]["mean_distance"] is None


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
            "give a depth scale that is 1000 times larger",
        ),
        (
            ["--depth", "depth.npz", "--cameras", "cameras.json", "--depth-scale", "1e6"],
            "Depths seem to be 1000 times too small; give a depth scale that is 1000 times smaller",
        ),
        (
            ["--depth", "wall.npz", "--cameras", "cameras.json"],
            "The same holds for all of the 3 frames that were tried.",
        ),
        (
            ["--depth", "other.npz", "--cameras", "cameras.json"],
            "other.npz[0]: the image has 160 x 119 pixels; expected 160 x 120, as the camera. Give images of this size, or the "
            "intrinsics for 160 x 119 pixels.",
        ),
        (
            ["--depth", "depth.npz", "--cameras", "cameras.json", "--empty", "other.npz"],
            "other.npz[0]: the image has 160 x 119 pixels",
        ),
        (
            ["--depth", "wall.npz", "other.npz", "--cameras", "two.json"],
            "other.npz[0]: the image has 160 x 119 pixels",
        ),
        (
            ["--depth", "wall.npz", "--cameras", "cameras.json", "--people", "2"],
            "wall.npz[0]: no surface has the size of a person; if one is there, check the unit of depth and the intrinsics. "
            "The same holds for all of the 3 frames",
        ),
        (
            ["--depth", "depth.npz", "--cameras", "cameras.json", "--empty", "wall.npz", "wall.npz"],
            "--empty names 2 sequences of images, but there are 1 cameras",
        ),
        (["depth.npz", "--empty", "wall.npz"], "--empty is for depth images"),
    ],
)
def test_what_does_not_fit_is_told(captured, tmp_path, capsys, monkeypatch, words, sentence):
    monkeypatch.chdir(captured)
    assert sentence in fails(capsys, "track", "body.npz", *words, "-o", tmp_path)


def test_a_camera_that_looks_away_is_named(captured, capsys):
    """Of two cameras the second one sees a wall alone, in three frames of which one shows nobody."""
    sources = open_depth_sources(
        [str(captured / "leaves.npz"), str(captured / "wall.npz")], captured / "two.json", (), 1000.0
    )
    clouds = depth_clouds.depth_clouds(
        sources, [None, None], human(resolution="low", joints="tracking"), set()
    )
    announced = depth_clouds.announce_blind(depth_clouds.announce_missing(iter(clouds)))
    shown = list(announced)
    assert [bool(cloud.missing) for cloud in shown] == [False, True, False]
    first, last = capsys.readouterr().err.strip().splitlines()
    assert "the mask has no pixel with a depth" in first and "The frame is lost" in first
    assert "camera 1 saw no person in 2 frames in which other cameras saw one" in last
