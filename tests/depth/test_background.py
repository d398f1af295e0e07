"""The background behind a person: empty frames, what never moves, and a person who stands on one spot."""

import numpy as np
import pytest
from depth_room import CAMERA, LOW, VERTICES, see

from jaxcap.depth import (
    cloud_of_depths,
    estimate_background,
    find_floor_of_person,
    find_person,
    search_person,
)
from jaxcap.depth.back_projection import world_points
from jaxcap.depth.background import MIN_FRAMES, MIN_TOLERANCE, farthest_depths, is_background
from jaxcap.depth.candidates import PERSON, TOO_LARGE
from jaxcap.errors import InputError, NoPersonError
from jaxcap.observe import find_floor, find_planes, is_floor_of, missing_cloud, refine_plane

#: where a person walks, metres
STEPS = np.linspace(-0.5, 0.7, 12)


def raised_arm(angle: float) -> np.ndarray:
    """Rotate what is left of the shoulder about it, towards the camera's up."""
    points, pivot = VERTICES.copy(), np.array([0.18, 0.45, 0.0])
    arm = points[:, 0] > pivot[0]
    sine, cosine = np.sin(angle), np.cos(angle)
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1.0]])
    points[arm] = (points[arm] - pivot) @ turn.T + pivot
    return points


def overlap(found: np.ndarray, person: np.ndarray) -> float:
    return float(np.sum(found & person) / np.sum(found | person))


@pytest.fixture(scope="module")
def walk():
    """A person who walks behind the box."""
    return [see([VERTICES + [step, 0.0, 0.0]]) for step in STEPS]


def test_the_farthest_depth_with_enough_support_is_the_background():
    """A wall at 3 m that six of ten frames show, one outlier behind it, and a pixel that one frame alone measures."""
    images = np.full((10, 1, 3), 2.0)
    images[2:8, 0, 0] = 3.0 + 0.005 * np.arange(-3, 3)
    images[0, 0, 0] = 3.9
    images[:, 0, 2] = 0.0
    images[4, 0, 2] = 1.0
    depth, support = farthest_depths(images, 3)
    np.testing.assert_allclose(depth[0], [3.0, 2.0, 0.0], atol=0.006)
    np.testing.assert_array_equal(support[0], [6, 10, 0])


def test_a_box_in_front_of_a_person_is_taken_for_the_person_but_not_with_a_background(walk):
    depth, person = walk[6]
    empty = estimate_background(CAMERA, [see([])[0]], empty=True)
    own = estimate_background(CAMERA, [depth for depth, _ in walk])
    assert own.doubt == "" and overlap(find_person(CAMERA, depth), person) < 0.1
    for background in (empty, own):
        assert overlap(find_person(CAMERA, depth, background=background), person) > 0.9
        # an empty room has nobody, although the box has a person's size
        with pytest.raises(NoPersonError, match="no surface has the size of a person"):
            find_person(CAMERA, see([])[0], background=background)


def test_a_pixel_is_in_front_if_it_is_nearer_by_more_than_the_noise(rng):
    """Frames of a wall with noise of 15 mm, and one without noise."""
    wall = np.full((120, 160), 3.0)
    noisy = estimate_background(
        CAMERA, [wall + 0.015 * rng.normal(size=wall.shape) for _ in range(20)], empty=True
    )
    exact = estimate_background(CAMERA, [wall] * 20, empty=True)
    assert 0.05 < np.median(noisy.tolerance) < 0.1
    np.testing.assert_allclose(exact.tolerance, MIN_TOLERANCE)
    assert is_background(exact, wall - 0.015).all() and not is_background(exact, wall - 0.03).any()
    assert is_background(noisy, wall - 0.03).all() and not is_background(noisy, wall - 0.12).any()


@pytest.mark.parametrize("angles", [0.8 * np.sin(np.linspace(0.0, 6.0, 12)) ** 2, [0.0] * 9 + [0.8] * 3])
def test_the_trunk_of_a_person_who_only_moves_an_arm_is_not_background(angles):
    """The arm moves all the time, or for a short time."""
    frames = [see([raised_arm(angle)]) for angle in angles]
    background = estimate_background(CAMERA, [depth for depth, _ in frames])
    for depth, person in frames[::4]:
        assert np.mean(is_background(background, depth)[person]) < 0.02
        assert overlap(find_person(CAMERA, depth, background=background), person) > 0.9


def test_a_person_who_does_not_move_is_not_background_and_this_is_stated():
    depth, person = see([VERTICES], things=False)
    background = estimate_background(CAMERA, [depth] * MIN_FRAMES)
    assert "a person who stands still cannot be distinguished from furniture" in background.doubt
    assert not is_background(background, depth)[person].mean() > 0.02
    assert overlap(find_person(CAMERA, depth, background=background), person) > 0.9
    few = estimate_background(CAMERA, [depth] * (MIN_FRAMES - 1))
    assert "too few" in few.doubt and not few.depth.any()


def test_images_that_are_no_background_are_refused():
    wall = np.full((120, 160), 3.0)
    with pytest.raises(InputError, match="there are no images"):
        estimate_background(CAMERA, [])
    with pytest.raises(InputError, match=r"image 1: the image has 159 x 120 pixels; expected 160 x 120"):
        estimate_background(CAMERA, [wall, wall[:, 1:]], empty=True)
    with pytest.raises(InputError, match="1000 times too large"):
        estimate_background(CAMERA, [1000 * wall], empty=True)


def test_the_floor_is_the_lowest_level_plane(walk):
    depth = walk[0][0]
    points = world_points(CAMERA, depth)[depth > 0]
    planes = find_planes(points, np.asarray(CAMERA.eye, float))
    floor = find_floor(planes)
    assert floor is not None and floor.normal[1] > 0.999 and abs(floor.offset - LOW) < 0.01
    refined = refine_plane(floor, points)
    assert refined.normal[1] > 0.99999 and abs(refined.offset - LOW) < 2e-3
    # a shelf above it, and a wall, are none
    shelf = floor._replace(offset=LOW + 0.8)
    wall = floor._replace(normal=np.array([0.0, 0.0, 1.0]))
    assert find_floor([shelf, wall, floor]) is floor
    assert find_floor([wall]) is None
    # in a world with z up
    turned = floor._replace(normal=np.array([0.0, 0.0, 1.0]))
    assert find_floor([floor, turned], (0.0, 0.0, 1.0)) is turned


def test_the_floor_below_a_person_is_no_table_in_front_of_one(walk):
    depth, mask = walk[0]
    floor = find_floor_of_person([CAMERA], [depth], cloud_of_depths([CAMERA], [depth], [mask]))
    assert floor is not None and floor.normal[1] > 0.9999 and abs(floor.offset - LOW) < 2e-3
    points = world_points(CAMERA, depth)
    person, room = points[mask], points[depth > 0]
    assert is_floor_of(floor, room, person)
    # feet that the camera does not see; a level plane through the person; a person who lies
    assert is_floor_of(floor, room, person[person[:, 1] > LOW + 0.3])
    assert not is_floor_of(floor._replace(offset=LOW + 0.2), room, person)
    assert not is_floor_of(floor, room, person[:, [1, 0, 2]] + [0.0, LOW + 0.3, 0.0])
    # a bed in front of the person
    bed = room[(np.abs(room[:, 1] - LOW) < 0.01) & (room[:, 2] > person[:, 2].max())] + [0.0, 0.45, 0.0]
    above = person[person[:, 1] > LOW + 0.45]
    assert len(bed) > 100 and not is_floor_of(floor._replace(offset=LOW + 0.45), bed, above)
    with pytest.raises(InputError, match="find_floor_of_person: the image has 159 x 120 pixels"):
        find_floor_of_person([CAMERA], [depth[:, 1:]], cloud_of_depths([CAMERA], [depth], [mask]))
    empty = missing_cloud("nobody", ())
    assert find_floor_of_person([CAMERA], [depth], empty) is None


def test_each_step_of_the_search_can_be_looked_at(walk):
    depth, _ = walk[6]
    empty = estimate_background(CAMERA, [see([])[0]], empty=True)
    steps = search_person(CAMERA, depth, empty)
    pixels = [steps.on_planes, steps.on_background, steps.person]
    assert not np.any(np.sum(pixels, 0) > 1)
    assert np.mean(np.any(pixels, 0)[depth > 0]) > 0.95
    (found,) = [one for one in steps.candidates if one.found == PERSON]
    assert 1.0 < found.extent < 2.0 and 0.2 < found.area < 1.2 and 2.8 < found.distance < 3.8
    # a wall that is no plane, as it is bent, is too large
    columns = np.arange(160)
    bent = np.tile(2.5 + 0.8 * np.abs(np.sin(columns / 12.0)), (120, 1))
    assert TOO_LARGE in [one.found for one in search_person(CAMERA, bent).candidates]
