"""Several people in a depth image of a room."""

import numpy as np
import pytest

import jaxcap as jc
from jaxcap.cli.depth.sources import open_depth_sources
from jaxcap.cli.track.depth import depth_clouds, people_clouds
from jaxcap.depth import find_people, find_person
from jaxcap.errors import InputError
from jaxcap.geometry.camera import look_at
from jaxcap.io.cameras import write_cameras
from jaxcap.scanner.scan import scan_scene

BODY = jc.human(resolution="low")
CAMERA = look_at([0.0, 0.4, 3.4], [0.0, 0.0, 0.0], 160, 120, 60)


def scene(*shifts):
    """People and a table before a wall, on a floor: the depths, and the surface of each pixel."""
    vertices, faces = np.asarray(BODY.vertices, float), np.asarray(BODY.faces)
    low = vertices[:, 1].min()
    people = [(vertices + shift, faces) for shift in shifts]
    room = np.array([[-4, low, -2], [4, low, -2], [4, low, 3], [-4, low, 3], [-4, 3, -2], [4, 3, -2]], float)
    table = np.array(
        [[1.3, low + 0.1, -1.0], [2.0, low + 0.1, -1.0], [2.0, low + 0.8, -1.0], [1.3, low + 0.8, -1.0]]
    )
    square = np.array([[0, 1, 2], [0, 2, 3]])
    walls = (room, np.concatenate([square, [[0, 1, 5], [0, 5, 4]]]))
    (image,) = scan_scene(jc.scanner.Scanner(noise=0.0), [CAMERA], [*people, walls, (table, square)])
    return image.depth, image.labels


def overlap(one, other) -> float:
    return float(np.sum(one & other) / np.sum(one | other))


def test_people_are_found_nearest_first():
    depth, labels = scene([-0.7, 0.0, 0.0], [0.7, 0.0, 0.6])
    found = find_people(CAMERA, depth, 3)
    # the table is too low for a person
    assert len(found) == 2
    assert overlap(found[0], labels == 1) > 0.9
    assert overlap(found[1], labels == 0) > 0.9
    (nearest,) = find_people(CAMERA, depth, 1)
    assert (nearest == find_person(CAMERA, depth)).all()


def test_people_who_touch_are_one_mask():
    depth, labels = scene([-0.5, 0.0, 0.0], [0.5, 0.0, 0.0])
    (both,) = find_people(CAMERA, depth, 2)
    assert overlap(both, (labels == 0) | (labels == 1)) > 0.9


def test_images_without_people_are_refused():
    depth, _ = scene([0.0, 50.0, 0.0])
    with pytest.raises(InputError, match="nothing was measured"):
        find_people(CAMERA, np.zeros_like(depth))
    with pytest.raises(InputError, match="no surface has the size of a person"):
        find_people(CAMERA, depth / 3.0)
    with pytest.raises(InputError, match="`count` is 0"):
        find_people(CAMERA, depth, 0)


def test_frames_of_the_command_line_have_all_people_or_name_the_frame(tmp_path):
    pair, _ = scene([-0.7, 0.0, 0.0], [0.7, 0.0, 0.6])
    alone, _ = scene([-0.7, 0.0, 0.0])
    np.savez(tmp_path / "depth.npz", depth=(1000 * np.stack([alone, pair])).astype(np.uint16))
    write_cameras(tmp_path / "cameras.json", [CAMERA])
    inputs = ([str(tmp_path / "depth.npz")], tmp_path / "cameras.json", [], 1000.0, (None, None), "y")
    sources, others = open_depth_sources(*inputs), set[int]()
    one = depth_clouds(sources, [None], BODY, others)
    widths = [float(np.ptp(np.asarray(cloud.points)[:, 0])) for cloud in one]
    assert max(widths) < 1.3
    assert others == {1}
    several = people_clouds(sources, [None], BODY, 2)
    widths = [float(np.ptp(np.asarray(cloud.points)[:, 0])) for cloud in several]
    assert widths[0] < 1.3
    assert 2.0 < widths[1] < 2.8
