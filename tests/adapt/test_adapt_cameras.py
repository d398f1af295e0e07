"""Cameras that an adaptation is given: those that cannot have taken the scans, and what the others do not see."""

import json

import equinox as eqx
import numpy as np
import pytest
from adapt_scene import FRAMES, RING, make_scene, task_of, words, write_folder, write_scan
from command_line import fails

import jaxcap as jc
from jaxcap.adapt.check_scans import check_cameras
from jaxcap.adapt.poses.pair_cache import make_pair_cache
from jaxcap.cli.adapt.input import check_scan_cameras, load_cameras
from jaxcap.cli.sources import up_rotation
from jaxcap.geometry.camera import look_at
from jaxcap.io.cameras import write_cameras
from jaxcap.io.meshes.clouds import read_clouds

_posed = eqx.filter_jit(jc.pose_body)


@pytest.fixture(scope="module")
def scene():
    return make_scene()


@pytest.fixture
def folder(scene, tmp_path):
    return write_folder(tmp_path, scene)


def test_cameras_that_are_none(folder, capsys):
    path = folder / "c.json"
    assert "cannot be read" in fails(capsys, *words(folder, "--cameras", path))
    path.write_text("{")
    assert "this is not JSON" in fails(capsys, *words(folder, "--cameras", path))
    path.write_text(json.dumps({"format": "jaxcap cameras", "cameras": []}))
    # before any scan is read
    for scan in folder.glob("*.ply"):
        scan.write_text("no scan")
    assert "no list 'cameras'" in fails(capsys, *words(folder, "--cameras", path))
    assert not list(folder.glob("a*"))


@pytest.mark.parametrize(
    ("camera", "what"),
    [
        (look_at([0, 0.5, 2.5], [0, 0.5, 5.0], 320, 240, 60), "points away"),
        (look_at([0, 0.5, 2.5], [2.5, 0.5, 2.0], 320, 240, 60), "outside of its image"),
        (look_at([0, 500.0, 2500.0], [0, 0, 0], 320, 240, 60), "Translations are in metres"),
    ],
)
def test_cameras_that_took_other_scans(folder, capsys, camera, what):
    write_cameras(folder / "c.json", [*RING, camera])
    told = fails(capsys, *words(folder, "--cameras", folder / "c.json"))
    assert what in told
    assert "c.json: camera 4" in told
    assert not list(folder.glob("a*"))


def test_cameras_that_see_little_of_the_scans():
    points = np.random.default_rng(0).uniform(-1, 1, (500, 3))
    near = look_at([0.0, 0.0, 1.3], [0, 0, 0], 320, 240, 30)
    with pytest.raises(jc.InputError, match="% of the scans' points are outside the images of all cameras"):
        check_cameras([near], [points], "c.json")
    far = look_at([0.0, 500.0, 2500.0], [0, 0, 0], 320, 240, 60)
    with pytest.raises(jc.InputError, match="give translations in metres"):
        check_cameras([far], [points], "c.json")
    check_cameras(RING, [points], "c.json")


def test_cameras_are_turned_with_the_scans(scene, folder):
    """Scans and cameras whose vertical is z come to lie as those whose vertical is y."""
    points, turn = scene[3][0][0], up_rotation("z")
    turned = [eqx.tree_at(lambda c: c.rotation, camera, camera.rotation @ turn) for camera in RING]
    write_cameras(folder / "z.json", turned)
    for number in range(FRAMES):
        write_scan(folder, number, points @ turn, points @ turn)
    loaded = load_cameras(folder / "z.json", "z")
    check_scan_cameras(loaded, read_clouds(str(folder / "*.ply")), range(FRAMES), "z", folder / "z.json")
    for camera, other in zip(loaded, RING, strict=True):
        np.testing.assert_allclose(camera.rotation, other.rotation, atol=1e-9)
        np.testing.assert_allclose(camera.eye, other.eye, atol=1e-9)


def test_what_no_camera_sees_is_in_no_pair(scene):
    _, actor, poses, _ = scene
    task = task_of(scene)
    posed = _posed(actor, poses[0])
    behind = np.asarray(posed.normals)[:, 2] < -0.3
    front = look_at([0.0, 0.5, 3.0], [0, 0.3, 0], 320, 240, 40)
    for cameras, some in (((), True), ((front,), False)):
        (pairs,) = make_pair_cache(task._replace(cameras=cameras)).pairs(actor, {0: poses[0]})
        paired = np.unique(np.asarray(pairs.vertices[:, 0])[np.asarray(pairs.weights) > 0])
        assert behind[paired].any() == some
        assert len(paired) > 10
