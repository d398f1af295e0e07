"""Background that is hidden from one eye of a sensor."""

import numpy as np
import pytest

from jaxcap.depth.shadows import MAX_BASELINE, fill_shadows
from jaxcap.depth.views import make_depth_view
from jaxcap.geometry.camera import Camera

FOCAL, NEAR, FAR = 300.0, 1.0, 3.0
#: difference of both surfaces' disparities, pixels
WIDEST = int(FOCAL * MAX_BASELINE * (1 / NEAR - 1 / FAR))


def scene(width: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw a person of 20 columns before a wall, with a strip of `width` columns without depth on its right."""
    depth = np.full((8, 120), FAR)
    depth[:, 30:50] = NEAR
    depth[:, 50 : 50 + width] = 0.0
    person = np.zeros(depth.shape, bool)
    person[:, 30:50] = True
    return depth, person


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_strip_as_wide_as_the_disparity_is_background(mirrored):
    depth, person = scene(WIDEST)
    if mirrored:
        depth, person = depth[:, ::-1].copy(), person[:, ::-1].copy()
    assert np.array_equal(fill_shadows(depth, person, FOCAL), np.where(person, NEAR, FAR))


def test_a_wider_strip_stays_unknown():
    depth, person = scene(WIDEST + 3)
    assert np.array_equal(fill_shadows(depth, person, FOCAL), depth)


def test_holes_inside_of_the_person_and_of_the_wall_stay_unknown():
    depth, person = scene(0)
    depth[:, 38:41] = depth[:, 80:83] = 0.0
    depth[0] = 0.0
    assert np.array_equal(fill_shadows(depth, person, FOCAL), depth)


def test_a_strip_before_nearer_background_stays_unknown():
    # a table before the person hides the person: the strip may be either
    depth, person = scene(4)
    depth[:, 54:] = 0.5 * NEAR
    assert np.array_equal(fill_shadows(depth, person, FOCAL), depth)


def test_a_view_tests_free_space_in_the_shadow():
    depth, person = scene(WIDEST)
    height, width = depth.shape
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    camera = Camera(np.diag([1.0, -1.0, -1.0]), np.zeros(3), np.full(2, FOCAL), middle, width, height)
    view = make_depth_view(camera, depth, person)
    assert np.array_equal(np.asarray(view.distances)[-1, :, 50:53], np.tile([1.0, 2.0, 3.0], (height, 1)))
    assert np.all(np.asarray(view.depth)[:, 50 : 50 + WIDEST] == FAR)
