"""Pinhole cameras, rings of them, and their calibrations as files."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxcap.errors import InputError
from jaxcap.geometry.camera import (
    Camera,
    check_views,
    is_in_image,
    look_at,
    project_points,
    ring_of_cameras,
    unproject,
)  # fmt: skip
from jaxcap.io.cameras import read_cameras, write_cameras


def some_camera(seed: int = 1) -> Camera:
    turn = Rotation.random(random_state=seed).as_matrix()
    return Camera(turn, np.array([0.1, -0.2, 2.0]), np.array([300.0, 290]), np.array([150.0, 110]), 320, 240)


def test_unproject_is_project_backwards(rng):
    camera = some_camera()
    pixels = jnp.asarray(rng.uniform([0, 0], [319, 239], (50, 2)))
    depth = jnp.asarray(rng.uniform(0.5, 4, 50))
    points = unproject(camera, pixels, depth)
    again, deep = project_points(camera, points)
    np.testing.assert_allclose(again, pixels, atol=1e-9)
    np.testing.assert_allclose(deep, depth, atol=1e-12)
    assert np.asarray(is_in_image(camera, points)).all()


def test_a_camera_looks_at_its_target_upright():
    camera = look_at([0, 1, 3], [0, 1, 0], 320, 240, 60)
    np.testing.assert_allclose(camera.eye, [0, 1, 3], atol=1e-12)
    pixels, depth = project_points(camera, jnp.array([[0.0, 1, 0], [0, 2, 0], [1, 1, 0], [0, 1, 5]]))
    np.testing.assert_allclose(depth, [3, 3, 3, -2])
    np.testing.assert_allclose(pixels[0], [159.5, 119.5])
    focal = 160 / np.tan(np.radians(30))
    # up is towards row 0, and its left hand, at +x, to the right
    np.testing.assert_allclose(pixels[1], [159.5, 119.5 - focal / 3])
    np.testing.assert_allclose(pixels[2], [159.5 + focal / 3, 119.5])
    assert not np.asarray(is_in_image(camera, jnp.array([0.0, 1, 5])))


def test_looking_straight_down_is_a_rotation():
    turn = np.asarray(look_at([0, 3, 0], [0, 0, 0], 64, 48, 50).rotation)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1.0)


def test_a_ring_is_even_and_an_arc_has_its_ends():
    whole = np.array([np.asarray(c.eye) for c in ring_of_cameras(4, 360, 2.5, 1.2, [0.5, 0.9, -1])])
    want = np.array([[0, 0, 2.5], [2.5, 0, 0], [0, 0, -2.5], [-2.5, 0, 0]]) + [0.5, 1.2, -1]
    np.testing.assert_allclose(whole, want, atol=1e-9)
    arc = [np.asarray(c.eye) for c in ring_of_cameras(3, 90, 2, 1, [0, 1, 0])]
    half = 2 * np.sqrt(0.5)
    np.testing.assert_allclose(arc, [[-half, 1, half], [0, 1, 2], [half, 1, half]], atol=1e-9)
    (alone,) = ring_of_cameras(1, 90, 2, 1, [0, 1, 0])
    np.testing.assert_allclose(alone.eye, [0, 1, 2], atol=1e-9)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"count": 0}, "0 views"),
        ({"arc": 0.0}, "arc of cameras is 0"),
        ({"arc": 400.0}, "arc of cameras is 400"),
        ({"distance": 0.0}, "0 m from the body"),
        ({"height": float("nan")}, "height of the cameras is nan m"),
        ({"resolution": (4, 240)}, "4 x 240 pixels are too small"),
        ({"field_of_view": 190.0}, "190 degrees"),
    ],
)
def test_rings_that_cannot_be_are_refused(change, told):
    good = {"count": 2, "arc": 90.0, "distance": 2.0, "height": 1.0, "target": [0.0, 1, 0]}
    with pytest.raises(InputError, match=told):
        ring_of_cameras(**(good | change))
    with pytest.raises(InputError, match="cannot look at"):
        look_at([0, 1, 0], [0, 1, 0], 32, 32, 60)


def test_cameras_that_see_nothing_are_told_by_number():
    ring = ring_of_cameras(2, 360, 2, 1, [0, 1, 0])
    points = np.array([[0.0, 1, 0]])
    check_views(ring, points, "ring")
    with pytest.raises(InputError, match=r"ring: camera 1 at \(0, 1, 4\) points away from the body"):
        check_views([ring[0], look_at([0, 1, 4], [0, 1, 8], 64, 48, 60)], points, "ring")
    with pytest.raises(InputError, match="camera 0 at .* has the body outside of its image"):
        check_views(ring, points + [0, 5, 0], "ring")


def test_calibrations_come_in_again(tmp_path):
    cameras = [some_camera(1), some_camera(2)]
    write_cameras(tmp_path / "c.json", cameras)
    for one, two in zip(cameras, read_cameras(tmp_path / "c.json"), strict=True):
        for name in ("rotation", "translation", "focal", "principal_point"):
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
        assert (one.width, one.height) == (two.width, two.height)


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("rotation", None, "camera 1 has no 'rotation'"),
        ("height", None, "camera 1 has no 'height'"),
        ("translation", [0, float("nan"), 1], "'translation' contains a number that is not finite"),
        ("rotation", [[1, 0, 0], [0, 1, 0], [0, 0, -1]], "'rotation' is not a rotation matrix"),
        ("rotation", [[2, 0, 0], [0, 1, 0], [0, 0, 1]], "'rotation' is not a rotation matrix"),
        ("translation", [0, 1], r"'translation' has the shape \(2,\); expected 3"),
        ("principal_point", "middle", "'principal_point' is not an array of numbers"),
        ("focal", [-300, 300], "'focal' is not above zero"),
        ("width", 3, "'width' is 3"),
        ("width", 320.5, "'width' is 320.5"),
    ],
)
def test_wrong_calibrations_are_told(tmp_path, key, value, told):
    write_cameras(tmp_path / "c.json", [some_camera(), some_camera()])
    content = json.loads((tmp_path / "c.json").read_text())
    content["cameras"][1].pop(key) if value is None else content["cameras"][1].update({key: value})
    (tmp_path / "c.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=told):
        read_cameras(tmp_path / "c.json")


def test_files_that_are_no_calibrations_are_told(tmp_path):
    for text, told in (("{", "not JSON"), ("[]", "no list 'cameras'"), ('{"cameras": []}', "no list"),
                       ('{"cameras": [3]}', "camera 0 is not an object")):  # fmt: skip
        (tmp_path / "c.json").write_text(text)
        with pytest.raises(InputError, match=told):
            read_cameras(tmp_path / "c.json")
    with pytest.raises(InputError, match="no such file"):
        read_cameras(tmp_path / "none.json")
