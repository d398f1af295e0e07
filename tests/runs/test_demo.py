"""The demo's performance, its virtual cameras, its picture; and the whole of it."""

import json

import equinox as eqx
import numpy as np
import pytest
import trimesh
from command_line import fails, runs

from jaxcap.body.body import pose_body
from jaxcap.body.people.human import human
from jaxcap.demo.performance import walk_and_wave
from jaxcap.demo.picture import View, draw
from jaxcap.demo.scanner import Scanner, sample_surface, scan
from jaxcap.io.skeletons.bvh import read_bvh
from jaxcap.metrics import scan_to_surface

_pose_body = eqx.filter_jit(pose_body)


@pytest.fixture(scope="module")
def body():
    return human(resolution="low")


def sphere():
    ball = trimesh.creation.icosphere(3, 0.5)
    return np.asarray(ball.vertices), np.asarray(ball.faces)


def test_performance_walks_and_waves(body):
    motion = walk_and_wave(body.skeleton, 2.0)
    names = body.skeleton.names
    joints = np.array([np.asarray(_pose_body(body, motion[frame]).joints) for frame in range(60)])
    at = {name: joints[:, names.index(name)] for name in names}
    assert motion.num_frames == 60
    # the first frame is rest, the right hand goes over the shoulder, the left one does not
    np.testing.assert_allclose(joints[0], np.asarray(body.skeleton.centres), atol=1e-9)
    assert at["RightHand"][40:, 1].min() > at["RightArm"][40:, 1].max()
    assert at["LeftHand"][:, 1].max() < at["LeftArm"][:, 1].min()
    # both feet leave the floor by 10 cm, each while the other stands
    left, right = (at[f"{side}Foot"][:, 1] - at[f"{side}Foot"][0, 1] for side in ("Left", "Right"))
    assert left.max() > 0.1
    assert right.max() > 0.1
    assert np.minimum(left, right).max() < 0.05
    # knees bend back, not forth
    assert (at["LeftFoot"][np.argmax(left), 2] - at["LeftLeg"][np.argmax(left), 2]) < 0
    # nothing jumps: under 20 cm from frame to frame, 6 m/s at a hand
    assert np.linalg.norm(np.diff(joints, axis=0), axis=-1).max() < 0.2


def test_sampling_is_by_area(rng):
    """A square of two triangles, one of them cut into three."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.6, 0.3, 0]])
    faces = np.array([[0, 2, 3], [0, 1, 4], [1, 2, 4], [0, 4, 2]])
    points, normals = sample_surface(vertices, faces, 40_000, rng)
    counts = np.histogram2d(points[:, 0], points[:, 1], bins=4, range=[[0, 1], [0, 1]])[0]
    # 2,500 in each of 16 fields; five deviations
    assert np.abs(counts - 2500).max() < 5 * 50
    np.testing.assert_allclose(normals, np.tile([0.0, 0.0, 1.0], (len(points), 1)), atol=1e-12)


def test_one_camera_sees_one_side(rng):
    scanner = Scanner(cameras=1, height=0.0, points=2000, noise=0.0, normal_noise=0.0, outliers=0.0)
    points, normals = scan(scanner, *sphere(), rng)
    assert len(points) == 2000
    # from 2.5 m the horizon of a ball of 0.5 m lies at z = 0.1
    assert points[:, 2].min() > 0.1
    np.testing.assert_allclose(np.sum(points * normals, 1), 0.5, atol=0.01)


def test_what_is_behind_is_hidden(rng):
    """A small sheet behind a large one, both facing the camera."""
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    vertices = np.concatenate([square, 0.5 * square - [0, 0, 0.3]])
    scanner = Scanner(cameras=1, height=0.0, points=1000, pixel=0.05, noise=0.0, outliers=0.0)
    points, _ = scan(scanner, vertices, np.concatenate([faces, faces + 4]), rng)
    assert (points[:, 2] > -0.1).mean() > 0.99


def test_noise_and_outliers_are_as_asked(rng):
    vertices, faces = sphere()
    scanner = Scanner(points=4000, noise=0.01, outliers=0.25)
    points, normals = scan(scanner, vertices, faces, rng)
    distances = scan_to_surface(points, vertices, faces)
    assert len(points) == 4000
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)
    # outliers lie anywhere in a box of 1.2 m; noise goes 3 cm at most
    assert 0.15 < (distances > 0.03).mean() < 0.25
    near = distances[distances < 0.03]
    assert 0.004 < np.sqrt(np.mean(near**2)) < 0.012


def test_picture_shows_body_and_cloud(body, tmp_path, rng):
    vertices, faces = np.asarray(body.vertices), np.asarray(body.faces)
    points, _ = sample_surface(vertices, faces, 500, rng)
    view = View("a view", vertices, points, np.zeros(500))
    draw(tmp_path / "with.png", [view], faces, "title")
    draw(tmp_path / "without.png", [view._replace(points=points[:1], distances=np.zeros(1))], faces, "title")
    from matplotlib.image import imread

    shown, bare = imread(tmp_path / "with.png")[..., :3], imread(tmp_path / "without.png")[..., :3]
    assert shown.shape == bare.shape
    assert min(shown.shape[:2]) > 500
    # the body covers a good part of the page, and some hundred points a part of the body
    assert 0.05 < (bare < 0.9).any(-1).mean() < 0.6
    assert 0.001 < (np.abs(shown - bare) > 0.1).any(-1).mean() < 0.1


@pytest.mark.slow
def test_demo_leaves_all_it_promises(tmp_path, capsys):
    out = runs(
        capsys, "demo", "-o", tmp_path / "demo", "--seconds", "0.5", "--points", "1500", "--vertices", "1500"
    )
    assert "joint centres" in out
    assert {path.name for path in (tmp_path / "demo").iterdir()} == {
        "motion.bvh", "motion.npz", "statistics.csv", "statistics.json", "demo.png", ".gitignore",
    }  # fmt: skip
    assert read_bvh(tmp_path / "demo" / "motion.bvh")[1].num_frames == 15
    frames = json.loads((tmp_path / "demo" / "statistics.json").read_text())["frames"]
    assert [frame["state"] for frame in frames] == ["good"] * 15
    # and again: an earlier demo is replaced where that is asked for
    again = ["demo", "-o", tmp_path / "demo", "--seconds", "0.2", "--points", "1500", "--vertices", "1500"]
    assert "give --overwrite to replace them" in fails(capsys, *again)
    runs(capsys, *again, "--overwrite")
    assert read_bvh(tmp_path / "demo" / "motion.bvh")[1].num_frames == 6
