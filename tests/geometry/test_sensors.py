"""Simulated depth cameras of named models, and rooms: closed forms of their errors."""

import numpy as np
import pytest
import trimesh

from jaxcap.depth.shadows import fill_shadows
from jaxcap.errors import InputError
from jaxcap.geometry.camera import Camera, look_at
from jaxcap.scanner.noise import continuous_jump, lose_edges, noise_deviation, remove_shadow
from jaxcap.scanner.ray_casting import DepthImage
from jaxcap.scanner.rooms import BACK_DISTANCE, make_room
from jaxcap.scanner.scan import scan_scene
from jaxcap.scanner.sensors import SENSORS
from jaxcap.scanner.settings import Scanner

LOW, HIGH = np.array([-0.5, 0.0, -0.4]), np.array([0.5, 1.8, 0.4])
FOCAL, NEAR, FAR = 200.0, 1.0, 3.0


def in_front_of_wall(columns: slice) -> np.ndarray:
    """A surface 1 m away in some columns, and a wall at 3 m."""
    depth = np.full((4, 100), FAR)
    depth[:, columns] = NEAR
    return depth


def test_a_shadow_is_as_wide_as_the_difference_of_disparities():
    baseline = 0.06
    depth = in_front_of_wall(slice(50, 70))
    seen = remove_shadow(depth, FOCAL * baseline)
    width = FOCAL * baseline * (1 / NEAR - 1 / FAR)
    for row in seen:
        (hidden,) = np.nonzero(row == 0)
        assert hidden.max() == 49 and abs(len(hidden) - width) <= 1
    person = depth == NEAR
    np.testing.assert_array_equal(fill_shadows(seen, person, FOCAL), depth)
    np.testing.assert_array_equal(remove_shadow(depth, 0.0), depth)


def test_only_pixels_on_both_sides_of_a_jump_are_lost(rng):
    depth = in_front_of_wall(slice(50, 70))
    depth[0, 0], gap = 0.0, np.full(depth.shape, 0.03)
    lost = (lose_edges(depth, 1.0, gap, rng) == 0) & (depth > 0)
    np.testing.assert_array_equal(np.flatnonzero(lost.any(0)), [49, 50, 69, 70])
    assert 0.3 < np.mean(lose_edges(depth, 0.5, gap, rng)[:, [49, 50, 69, 70]] == 0) < 0.7


def test_a_floor_at_a_grazing_angle_has_no_edges(rng):
    """Neighbouring rows of a floor 1.2 m below the camera differ by 10 cm at 5 m."""
    errors, focal = SENSORS["azure-kinect"].errors, 209.0
    rows = np.arange(50.0, 120.0)
    floor = np.repeat((1.2 * focal / rows)[:, None], 20, axis=1)
    assert np.abs(np.diff(floor, axis=0)).max() > 2 * errors.gap
    jump = continuous_jump(floor, errors.max_grazing_angle, focal)
    np.testing.assert_array_equal(lose_edges(floor, 1.0, jump, rng), floor)


def test_noise_grows_with_distance_and_angle_as_published():
    """Kinect v1 at 3 m, straight and at 70 degrees (Nguyen et al. 2012, equation 2)."""
    angles = np.radians([[0.0, 70.0]])
    image = DepthImage(np.full((1, 2), 3.0), np.cos(angles), np.zeros((1, 2), int))
    straight = 0.0012 + 0.0019 * (3.0 - 0.4) ** 2
    oblique = straight + 0.0001 / np.sqrt(3.0) * (70.0 / 20.0) ** 2
    deviations = noise_deviation(SENSORS["kinect-v1"].errors, image)
    np.testing.assert_allclose(deviations, [[straight, oblique]], rtol=1e-9)


def test_a_room_is_closed_boxes_that_leave_the_person_free():
    room = make_room(LOW, HIGH)
    mesh = trimesh.Trimesh(room.vertices, room.faces, process=False)
    boxes = mesh.split(only_watertight=True)
    assert len(boxes) == 4 + 5 + 6 and sum(len(box.faces) for box in boxes) == len(room.faces)
    for box in boxes:
        assert box.volume > 0
        apart = np.maximum(box.bounds[0] - HIGH, LOW - box.bounds[1])
        assert apart.max() >= -1e-9, "a piece of furniture stands in the person's box"
    assert len(make_room(LOW, HIGH, furnished=False).faces) == 4 * 12
    with pytest.raises(InputError, match="expected larger values last"):
        make_room(HIGH, LOW)


@pytest.mark.parametrize("name", SENSORS)
def test_a_sensor_sees_a_ball_in_a_room(name):
    sensor, room = SENSORS[name], make_room(LOW, HIGH)
    ball = trimesh.creation.icosphere(4, 0.3)
    ball.apply_translation([0, 1.0, 0])
    camera = look_at([0, 1.0, 2.0], [0, 1.0, 0], *sensor.resolution, sensor.field_of_view)
    surfaces = [(room.vertices, room.faces), (np.asarray(ball.vertices), np.asarray(ball.faces))]
    (image,) = scan_scene(sensor.errors, [camera], surfaces, seed=1)
    (again,) = scan_scene(sensor.errors, [camera], surfaces, seed=1)
    np.testing.assert_array_equal(image.depth, again.depth)
    np.testing.assert_array_equal(image.depth > 0, image.labels >= 0)
    # the middle of the ball, and the wall next to it, within five deviations and half a step of depth
    rows, columns = np.nonzero(image.labels == 1)
    centre = int(camera.height / 2), int(camera.width / 2)
    assert abs(rows.mean() - centre[0]) < 3 and abs(columns.mean() - centre[1]) < 8
    errors = sensor.errors
    for of, depth in ((1, 1.7), (0, 2.0 + BACK_DISTANCE + 0.4)):
        found = image.depth[image.labels == of]
        found = found[np.abs(found - depth) < 0.1]
        size = (
            errors.noise + errors.noise_growth * depth**2 + errors.depth_step * depth**2 + errors.depth_unit
        )
        assert len(found) > 100 and np.min(np.abs(found - depth)) < 5 * size
    measured = image.depth[image.depth > 0]
    assert measured.min() >= errors.min_range and measured.max() <= errors.max_range


def test_a_surface_beyond_the_range_is_not_measured():
    camera: Camera = look_at([0, 0, 5.0], [0, 0, 0], 32, 24, 60)
    wall = np.array([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], float), np.array([[0, 1, 2], [0, 2, 3]])
    for errors, share in (
        (Scanner(max_range=4.0), 0),
        (Scanner(min_range=6.0), 0),
        (Scanner(max_range=6.0), 1),
    ):
        (image,) = scan_scene(errors, [camera], [wall])
        assert np.mean(image.depth > 0) == share
    with pytest.raises(InputError, match="max-range of the scanner is 1"):
        scan_scene(Scanner(min_range=2.0, max_range=1.0), [camera], [wall])
