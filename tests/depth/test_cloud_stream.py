"""Clouds of successive depth images: the person is followed, and its points are thinned by what they tell."""

import depth_room
import numpy as np
import pytest
from scipy.spatial import KDTree
from test_depth import BODY, CAMERA, room

from jaxcap.depth import cloud_of_depths, estimate_background, find_person
from jaxcap.depth.back_projection import measured_points
from jaxcap.depth.fuse import image_normals
from jaxcap.depth.person import search_person
from jaxcap.depth.stream.cloud_stream import CloudStream
from jaxcap.depth.stream.fixed_camera import FixedCamera, ImageBox
from jaxcap.depth.stream.follow_person import follow_person
from jaxcap.depth.stream.pixel_surface import pixel_surface
from jaxcap.depth.stream.thin import thin_points
from jaxcap.errors import InputError, NoPersonError
from jaxcap.live.live_tracker import LiveTracker, _Incoming
from jaxcap.metrics import scan_to_surface
from jaxcap.tracking.track_frame import make_tracker

WHOLE = ImageBox(slice(0, 120), slice(0, 160), 0.0, np.inf)


def test_pixels_have_the_points_and_normals_of_the_slow_functions():
    depth, person = room()
    alone = np.where(person, depth, 0.0)
    points, normals = pixel_surface(FixedCamera(CAMERA), WHOLE, alone, 0.03, 2)
    np.testing.assert_allclose(points, measured_points(CAMERA, alone), atol=1e-5)
    expected = image_normals(CAMERA, alone, 0.03, 2) @ np.asarray(CAMERA.rotation)
    # a neighbour at just the largest difference of depths may fall on either side of it by rounding
    assert np.quantile(np.abs(normals - expected).max(1), 0.98) < 1e-3


def test_a_person_is_followed_to_the_next_frame():
    depth, _ = room()
    moved, person = room((0.12, 0.0, 0.05))
    fixed = FixedCamera(CAMERA)
    fixed.set_planes(search_person(CAMERA, depth).planes)
    followed = follow_person(fixed, moved, np.asarray(BODY.vertices, float))
    assert followed is not None
    box, mask = followed
    whole = np.zeros(moved.shape, bool)
    whole[box.rows, box.columns] = mask
    assert np.sum(whole & person) / np.sum(whole | person) > 0.9
    # the same pixels as by a search of the whole image, up to the edge
    found = find_person(CAMERA, moved)
    assert np.sum(whole & found) / np.sum(whole | found) > 0.97


def test_a_person_far_from_the_last_place_is_searched_for():
    depth, _ = room()
    fixed = FixedCamera(CAMERA)
    vertices = np.asarray(BODY.vertices, float)
    assert follow_person(fixed, depth, vertices + [1.5, 0.0, 0.0]) is None
    # and out of view
    assert follow_person(fixed, depth, vertices + [0.0, 0.0, 50.0]) is None
    cloud = CloudStream([CAMERA], 512).make([depth], vertices + [1.5, 0.0, 0.0])
    points = np.asarray(cloud.points)[np.asarray(cloud.weights) > 0]
    assert np.median(scan_to_surface(points, vertices, np.asarray(BODY.faces))) < 0.01


def test_clouds_have_one_size_and_the_weight_of_all_points():
    depth, _ = room()
    whole = cloud_of_depths([CAMERA], [depth])
    vertices, faces = np.asarray(BODY.vertices, float), np.asarray(BODY.faces)
    stream = CloudStream([CAMERA], 512)
    first = stream.make([depth])
    second = stream.make([room((0.05, 0.0, 0.0))[0]], vertices)
    assert first.points.shape == second.points.shape == (512, 3)
    assert float(first.weights.sum()) == pytest.approx(float(whole.weights.sum()), rel=0.02)
    points = np.asarray(first.points)[np.asarray(first.weights) > 0]
    assert 400 < len(points) <= 512
    assert np.quantile(scan_to_surface(points, vertices, faces), 0.9) < 0.01
    # what the view says near the person is that of the whole image
    (view,), (expected,) = first.views, whole.views
    np.testing.assert_array_equal(view.depth, expected.depth)
    np.testing.assert_allclose(second.views[0].camera.focal, expected.camera.focal)


def test_every_second_pixel_gives_the_same_surface():
    depth, person = room()
    vertices, faces = np.asarray(BODY.vertices, float), np.asarray(BODY.faces)
    stream = CloudStream([CAMERA], 512, pixel_step=2)
    cloud = stream.make([depth])
    points = np.asarray(cloud.points)[np.asarray(cloud.weights) > 0]
    assert np.quantile(scan_to_surface(points, vertices, faces), 0.9) < 0.01
    assert 0.2 < len(points) / np.count_nonzero(person) < 0.3
    # the rays of the kept pixels are those of the whole image
    whole = measured_points(CAMERA, np.where(person, depth, 0.0))
    distances = KDTree(whole).query(points)[0]
    assert np.median(distances) < 1e-3
    # floor and walls are looked for in the first image, also near a known surface
    near = CloudStream([CAMERA], 512, pixel_step=2).make([depth], vertices)
    np.testing.assert_array_equal(near.points, cloud.points)


def test_a_live_run_reads_fewer_pixels_while_frames_are_dropped():
    depth, _ = room()
    with LiveTracker(make_tracker(BODY, partial=True), [CAMERA], search=False) as live:
        assert not live.statistics.is_reduced
        whole = live._cloud([depth], "a frame")
        a_frame = _Incoming(0, "a frame", 0.0, 0.0, lambda: [depth])
        # every second frame
        for number in range(10):
            live._finish(a_frame, latency=None if number % 2 else 0.05, dropped=number % 2 == 1)
        assert live.statistics.is_reduced and "half their resolution" in live.statistics.sentence()
        reduced = live._cloud([depth], "a frame")
    # nothing is compiled for it
    assert whole.points.shape == reduced.points.shape
    assert float(reduced.weights.sum()) == pytest.approx(float(whole.weights.sum()) / 4, rel=0.1)


def test_flat_surface_is_thinned_more_than_curved_surface(rng):
    """A wall and a sphere of the same density."""
    wall = np.stack(
        [*np.meshgrid(np.arange(40) * 0.01, np.arange(40) * 0.01), np.zeros((40, 40))], -1
    ).reshape(-1, 3)
    directions = rng.normal(size=(600, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = np.concatenate([wall, [1.0, 0.0, 0.0] + 0.05 * directions])
    normals = np.concatenate([np.tile([0.0, 0.0, 1.0], (len(wall), 1)), directions])
    thinned = thin_points(points, normals, 0.01, 1000)
    assert len(thinned.points) <= 1000
    assert thinned.weights.sum() == pytest.approx(len(points))
    on_sphere = thinned.points[:, 0] > 0.8
    assert on_sphere.sum() > 500 and (~on_sphere).sum() < 500
    # of merged points the mean stays
    np.testing.assert_allclose(thinned.weights @ thinned.points / len(points), points.mean(0), atol=1e-12)
    # in any order
    order = rng.permutation(len(points))
    other = thin_points(points[order], normals[order], 0.01, 1000)
    np.testing.assert_allclose(np.sort(other.points, 0), np.sort(thinned.points, 0), atol=1e-12)
    assert len(thin_points(points, normals, 0.01, 10).points) == 10


def test_images_that_do_not_fit_are_refused():
    depth, _ = room()
    with pytest.raises(InputError, match="There are no cameras"):
        CloudStream([])
    stream = CloudStream([CAMERA])
    with pytest.raises(InputError, match="2 depth images of 1 cameras"):
        stream.make([depth, depth])
    with pytest.raises(InputError, match="the image has 159 x 120 pixels"):
        stream.make([depth[:, 1:]])
    with pytest.raises(InputError, match="pixel_step"):
        CloudStream([CAMERA], pixel_step=0)
    with pytest.raises(InputError, match="2 backgrounds of 1 cameras"):
        CloudStream([CAMERA], backgrounds=[None, None])
    small = estimate_background(CAMERA, [depth], empty=True)
    small = small._replace(depth=small.depth[:, 1:])
    with pytest.raises(InputError, match="camera 0: the background has 159 x 120 pixels"):
        CloudStream([CAMERA], backgrounds=[small])
    with pytest.raises(
        NoPersonError, match="frame.png: nothing was measured; check that the camera is not covered"
    ):
        stream.make([np.zeros_like(depth)], name="frame.png")
    # masks cannot be given here
    with pytest.raises(
        NoPersonError, match="frame.png: no surface has the size of a person; .* the intrinsics.$"
    ):
        stream.make([np.full_like(depth, 3.0)], name="frame.png")


@pytest.mark.parametrize("step", [1, 2])
def test_furniture_of_a_known_background_is_not_the_person(step):
    """A box of a person's size in front of the person, and next to the person in the second image."""
    camera, faces = depth_room.CAMERA, depth_room.FACES
    near = depth_room.VERTICES + [0.1, 0.0, 0.7]
    background = estimate_background(camera, [depth_room.see([])[0]], empty=True)
    # at half the resolution the box is not connected to the person
    for backgrounds, expected in ((None, [False, step == 2]), ([background], [True, True])):
        stream = CloudStream([camera], 512, pixel_step=step, backgrounds=backgrounds)
        first = stream.make([depth_room.see([depth_room.VERTICES])[0]])
        second = stream.make([depth_room.see([near])[0]], near)
        found = []
        for cloud, vertices in ((first, depth_room.VERTICES), (second, near)):
            points = np.asarray(cloud.points)[np.asarray(cloud.weights) > 0]
            found.append(bool(np.mean(scan_to_surface(points, vertices, faces) > 0.03) < 0.02))
        assert found == expected
