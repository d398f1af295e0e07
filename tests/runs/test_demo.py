"""The demo's performance, its virtual cameras, its picture; and the whole of it."""

import json

import equinox as eqx
import numpy as np
import pytest
from command_line import fails, runs

from jaxcap.body.body import pose_body
from jaxcap.body.people.human import human
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.geometry.mesh import sample_surface
from jaxcap.io.skeletons.bvh import read_bvh
from jaxcap.report.distance_pictures import FrameView, draw_views

_pose_body = eqx.filter_jit(pose_body)


@pytest.fixture(scope="module")
def body():
    return human(resolution="low")


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


def test_picture_shows_body_and_cloud(body, tmp_path, rng):
    vertices, faces = np.asarray(body.vertices), np.asarray(body.faces)
    points, _ = sample_surface(vertices, faces, 500, rng)
    view = FrameView("a view", vertices, points, np.zeros(500))
    draw_views(tmp_path / "with.png", [view], faces, "title")
    draw_views(
        tmp_path / "without.png", [view._replace(points=points[:1], distances=np.zeros(1))], faces, "title"
    )
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
        "clouds.npz", "motion.bvh", "motion.npz", "statistics.csv", "statistics.json", "demo.png", ".gitignore",
    }  # fmt: skip
    assert read_bvh(tmp_path / "demo" / "motion.bvh")[1].num_frames == 15
    frames = json.loads((tmp_path / "demo" / "statistics.json").read_text())["frames"]
    assert [frame["verdict"] for frame in frames] == ["good"] * 15
    # and again: an earlier demo is replaced where that is asked for
    again = ["demo", "-o", tmp_path / "demo", "--seconds", "0.2", "--points", "1500", "--vertices", "1500"]
    assert "give --overwrite to replace them" in fails(capsys, *again)
    runs(capsys, *again, "--overwrite")
    assert read_bvh(tmp_path / "demo" / "motion.bvh")[1].num_frames == 6
