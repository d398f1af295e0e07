"""Depth images: files, the person in a room, and clouds that know what their cameras saw."""

import json

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

import jaxcap as jc
from jaxcap.depth import cloud_of_depths, estimate_background, find_person, make_depth_view, search_person
from jaxcap.errors import InputError, NoPersonError
from jaxcap.geometry.camera import look_at, project_points
from jaxcap.io.cameras import read_cameras, write_cameras
from jaxcap.io.depth.sequence import read_depths
from jaxcap.metrics import scan_to_surface
from jaxcap.scanner.ray_casting import make_ray_mesh, render_depth
from jaxcap.tracking.track import track_frames

BODY = jc.human(resolution="low")
CAMERA = look_at([0.0, 0.4, 2.6], [0.0, 0.1, 0.0], 160, 120, 60)


def room(shift=(0.0, 0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """A person on a floor before a wall: depths, and the person's pixels."""
    vertices, faces = np.asarray(BODY.vertices, float) + shift, np.asarray(BODY.faces)
    low = vertices[:, 1].min()
    floor = [[-4, low, -2], [4, low, -2], [4, low, 3], [-4, low, 3]]
    wall = [[-4, low, -2], [4, low, -2], [4, 3, -2], [-4, 3, -2]]
    both = np.concatenate([vertices, floor, wall])
    count = len(vertices)
    squares = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]) + count
    depth = render_depth(CAMERA, make_ray_mesh(both, np.concatenate([faces, squares]))).depth
    alone = render_depth(CAMERA, make_ray_mesh(vertices, faces)).depth
    return depth, (alone > 0) & (np.abs(alone - depth) < 1e-6)


def test_a_person_is_found_before_floor_and_wall():
    depth, person = room()
    found = find_person(CAMERA, depth)
    assert np.sum(found & person) / np.sum(found | person) > 0.9


def test_a_person_in_small_pieces_is_found():
    """Gaps of two pixels divide the person into surfaces that are all smaller than a person."""
    depth, person = room()
    divided = depth.copy()
    lines = np.arange(120)[:, None] % 12 < 2, np.arange(160)[None] % 12 < 2
    divided[person & (lines[0] | lines[1])] = 0.0
    background = estimate_background(CAMERA, [room((0.0, 50.0, 0.0))[0]], empty=True)
    search = search_person(CAMERA, divided, background)
    assert search.person[person & (divided > 0)].mean() > 0.9
    # a single piece is no person, and small things in a room with an unknown background are not joined
    alone = np.where(person, 0.0, depth)
    alone[50:60, 74:84] = divided[50:60, 74:84]
    for image, known in ((alone, background), (divided, None)):
        with pytest.raises(NoPersonError, match="no surface has the size of a person"):
            find_person(CAMERA, image, background=known)


def test_a_hand_that_hides_its_arm_is_of_the_person():
    """A surface of a hand's size 0.4 m in front of the trunk; one next to the edge of a table is none."""
    depth, _ = room()
    hand, table = np.s_[55:60, 78:83], np.s_[61:62, 60:100]
    stretched = depth.copy()
    stretched[hand] = depth[hand] - 0.4
    assert find_person(CAMERA, stretched)[hand].mean() > 0.9
    # a lamp next to the head
    lamp, hung = np.s_[25:30, 112:117], depth.copy()
    hung[lamp] = depth[hand].mean()
    assert not find_person(CAMERA, hung)[lamp].any()
    stretched[table] = stretched[hand].mean()
    assert find_person(CAMERA, stretched)[hand].mean() < 0.1


def test_a_room_without_a_person_is_refused():
    depth, _ = room((0.0, 50.0, 0.0))
    empty, sentence = (
        np.where(depth > 0, depth, 3.0),
        "no surface has the size of a person; if one is there, check the unit of depth and ",
    )
    with pytest.raises(NoPersonError, match=f"{sentence}the intrinsics.$"):
        find_person(CAMERA, empty)
    with pytest.raises(NoPersonError, match=f"{sentence}the intrinsics, or give masks.$"):
        cloud_of_depths([CAMERA], [empty])
    with pytest.raises(InputError, match="nothing was measured"):
        find_person(CAMERA, np.zeros_like(depth))


def test_a_cloud_of_depths_is_on_the_surface_and_keeps_the_view():
    depth, person = room()
    cloud = cloud_of_depths([CAMERA], [depth], [person])
    points = np.asarray(cloud.points)[np.asarray(cloud.weights) > 0]
    off = scan_to_surface(points, np.asarray(BODY.vertices, float), np.asarray(BODY.faces))
    assert np.median(off) < 0.004
    (view,) = cloud.views
    assert (np.asarray(view.depth) > 0).sum() > 0
    found = cloud_of_depths([CAMERA], [depth])
    assert abs(len(found.points) - len(cloud.points)) < 0.3 * len(cloud.points)


def test_images_that_do_not_fit_their_camera_are_refused():
    depth, person = room()
    with pytest.raises(
        InputError,
        match="the image has 159 x 120 pixels; expected 160 x 120, as the camera. .* the intrinsics for 159 x 120",
    ):
        cloud_of_depths([CAMERA], [depth[:, 1:]])
    with pytest.raises(InputError, match="2 depth images of 1 cameras"):
        cloud_of_depths([CAMERA], [depth, depth])
    with pytest.raises(InputError, match="no pixel of the person was measured"):
        make_depth_view(CAMERA, depth, np.zeros_like(person))


@pytest.mark.parametrize(("scale", "word"), [(1e-3, "small"), (1e3, "large")])
def test_people_of_3_mm_and_of_3_km_are_refused(scale, word):
    """A wrong scale of depths, with the person found or given by a mask."""
    depth, person = room()
    for masks in (None, [person]):
        with pytest.raises(InputError, match=f"1000 times too {word}; give a depth scale"):
            cloud_of_depths([CAMERA], [scale * depth], masks, keep_missing=True)


def test_a_frame_without_a_person_is_missing_and_a_camera_without_one_adds_nothing():
    depth, person = room()
    wall, _ = room((50.0, 0.0, 0.0))
    with pytest.raises(NoPersonError, match="no surface has the size of a person"):
        cloud_of_depths([CAMERA], [wall])
    with pytest.raises(NoPersonError, match="the mask has no pixel with a depth"):
        cloud_of_depths([CAMERA], [depth], [person & False])
    away = cloud_of_depths([CAMERA, CAMERA], [wall, wall], keep_missing=True)
    assert "camera 0: no surface" in away.missing and not np.asarray(away.weights).any()
    one, both = cloud_of_depths([CAMERA], [depth]), cloud_of_depths([CAMERA, CAMERA], [depth, wall])
    np.testing.assert_array_equal(both.points, one.points)
    # the second camera looks at the wall alone: it measures nothing, so that nothing is excluded
    assert len(both.views) == len(away.views) == 2 and not np.asarray(both.views[1].depth).any()


def test_cameras_that_see_people_at_different_places_are_named():
    depth, person = room()
    other = look_at([0.0, 0.4, 2.6], [0.0, 0.1, 5.0], 160, 120, 60)
    with pytest.raises(
        NoPersonError, match=r"people that cameras 0 and 1 see are 5\.. m apart; check the positions"
    ):
        cloud_of_depths([CAMERA, other], [depth, depth], [person, person])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("nothing", [np.nan, np.inf, -np.inf, np.finfo(np.float32).max])
def test_depths_that_are_not_finite_were_not_measured(nothing, tmp_path):
    depth, person = room()
    depth[50:55, 70:90] = depth[:10] = 0.0
    bad = np.where(depth > 0, depth, nothing)
    for masks in (None, [person]):
        right, found = (cloud_of_depths([CAMERA], [image], masks) for image in (depth, bad))
        np.testing.assert_array_equal(found.points, right.points)
    right, found = (estimate_background(CAMERA, [image] * 10) for image in (depth, bad))
    np.testing.assert_array_equal(found.depth, right.depth)
    np.savez(tmp_path / "depth.npz", depth=bad[None].astype(np.float32))
    Image.fromarray(bad.astype(np.float32)).save(tmp_path / "depth.tiff")
    for name in ("depth.npz", "depth.tiff"):
        np.testing.assert_array_equal(read_depths(tmp_path / name)[0].depths[0], depth.astype(np.float32))


def test_large_images_are_reduced_to_the_nearest_surface():
    camera = look_at([0.0, 0.0, 2.0], [0.0, 0.0, 0.0], 640, 480, 60)
    depth = np.full((480, 640), 3.0)
    depth[100:301, 200:401] = 2.0
    view = make_depth_view(camera, depth, depth < 2.5)
    assert np.asarray(view.depth).shape == (240, 320)
    assert (view.camera.height, view.camera.width) == (240, 320)
    # a block with one pixel of the person is the person's
    assert np.asarray(view.depth)[150, 200] == 2.0 and np.asarray(view.distances)[-1, 150, 200] == 0.0
    assert np.asarray(view.distances)[-1, 150, 210] == 10.0
    # a point projects to the same place
    point = jnp.array([[0.2, 0.1, 0.3]])

    (large,), _ = project_points(camera, point)
    (small,), _ = project_points(view.camera, point)
    np.testing.assert_allclose(np.asarray(small), (np.asarray(large) - 0.5) / 2, atol=1e-4)


def test_images_are_read_as_they_were_written(tmp_path):
    rng = np.random.default_rng(0)
    stack = rng.integers(500, 4000, (11, 12, 16)).astype(np.uint16)
    stack[:, 0] = 0
    for number, image in enumerate(stack):
        Image.fromarray(image).save(tmp_path / f"d{number}.png")
        Image.fromarray(((image > 2000) * 255).astype(np.uint8)).save(tmp_path / f"m{number}.tif")
    np.savez(tmp_path / "stack.npz", depth=stack / np.float32(1000), mask=stack > 2000)
    files = read_depths(str(tmp_path / "d*.png"), str(tmp_path / "m*.tif"))
    array = read_depths(tmp_path / "stack.npz")
    assert len(files) == len(array) == 11
    for number in (0, 2, 10):
        for frames in (files, array):
            np.testing.assert_allclose(frames[number].depths[0], stack[number] / 1000, atol=1e-6)
            np.testing.assert_array_equal(frames[number].masks[0], stack[number] > 2000)
    assert files[10].name.endswith("d10.png")
    assert len(read_depths(str(tmp_path / "d*.png"), first=3, last=5)) == 3


def test_pictures_and_missing_images_are_refused(tmp_path):
    Image.fromarray(np.zeros((12, 16, 3), np.uint8)).save(tmp_path / "photo.png")
    with pytest.raises(InputError, match="3 channels, so it is a picture and no depth image"):
        read_depths(str(tmp_path / "photo.png"))[0]
    Image.fromarray(np.zeros((12, 16), np.uint8)).save(tmp_path / "grey.png")
    with pytest.raises(InputError, match=r"8 bits: 256 numbers are too few .* Give the 16-bit images"):
        read_depths(str(tmp_path / "grey.png"))[0]
    Image.fromarray(np.arange(192, dtype=np.uint16).reshape(12, 16)).save(tmp_path / "broken.png")
    whole = (tmp_path / "broken.png").read_bytes()
    (tmp_path / "broken.png").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(
        InputError, match=r"broken.png: the image cannot be read: .*\. .* copy it again, or leave out"
    ):
        read_depths(str(tmp_path / "broken.png"))[0]
    with pytest.raises(InputError, match="there are no images"):
        read_depths(str(tmp_path / "none*.png"))
    np.savez(tmp_path / "other.npz", points=np.zeros((3, 3)))
    with pytest.raises(InputError, match=r"no array 'depth' among its arrays \(points\)"):
        read_depths(tmp_path / "other.npz")
    np.savez(tmp_path / "flat.npz", depth=np.zeros((12, 16)))
    with pytest.raises(
        InputError, match=r"the depths have the shape \(12, 16\) .* \(F, H, W\), also a single one"
    ):
        read_depths(tmp_path / "flat.npz")
    Image.fromarray(np.zeros((12, 16), np.uint16)).save(tmp_path / "one.png")
    with pytest.raises(InputError, match="masks of 2 cameras"):
        read_depths(str(tmp_path / "one.png"), [str(tmp_path / "one.png")] * 2)
    with pytest.raises(InputError, match="has 3 images, but"):
        read_depths([str(tmp_path / "one.png"), str(tmp_path / "*o*.png")])
    with pytest.raises(InputError, match=r"has 3 images, but .* has 1; give as many masks as depth images\."):
        read_depths(str(tmp_path / "one.png"), [str(tmp_path / "*o*.png")])
    with pytest.raises(InputError, match="depth_scale"):
        read_depths(str(tmp_path / "one.png"), depth_scale=0.0)


@pytest.mark.parametrize(
    "content",
    [
        {"width": 640, "height": 480, "intrinsic_matrix": [525, 0, 0, 0, 520, 0, 319.5, 239.5, 1]},
        {
            "width": 640,
            "height": 480,
            "fx": 525,
            "fy": 520,
            "ppx": 319.5,
            "ppy": 239.5,
            "coeffs": [0, 0, 0, 0, 0],
        },
        {
            "image_width": 640,
            "image_height": 480,
            "camera_matrix": {"rows": 3, "cols": 3, "data": [525, 0, 319.5, 0, 520, 239.5, 0, 0, 1]},
        },
        {
            "cameraMatrix": [[525, 0, 319.5], [0, 520, 239.5], [0, 0, 1]],
            "distCoeffs": [[0, 0, 0, 0, 0]],
            "image_size": [640, 480],
        },
        {"K": [525, 0, 319.5, 0, 520, 239.5, 0, 0, 1], "width": 640, "height": 480},
        {
            "color": {"fx": 1, "fy": 1, "ppx": 1, "ppy": 1, "width": 64, "height": 48},
            "depth": {"fx": 525, "fy": 520, "ppx": 319.5, "ppy": 239.5, "width": 640, "height": 480},
        },
    ],
    ids=["Open3D", "RealSense", "OpenCV", "OpenCV in camel case", "K", "both sensors"],
)
def test_intrinsics_of_other_programs(content, tmp_path):
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(content))
    (camera,) = read_cameras(path)
    np.testing.assert_allclose(camera.focal, [525, 520])
    np.testing.assert_allclose(camera.principal_point, [319.5, 239.5])
    assert (camera.width, camera.height) == (640, 480)
    # a point before the camera, above its axis, is high in the image
    pixel, depth = project_points(camera, jnp.array([0.0, 0.5, -2.0]))
    assert float(depth) == pytest.approx(2.0) and float(pixel[1]) < 239.5


def test_extrinsics_of_open3d(tmp_path):
    """Column by column, from the world to the camera; the identity is that of files without extrinsics."""
    path = tmp_path / "camera.json"
    inner = {"width": 640, "height": 480, "intrinsic_matrix": [525, 0, 0, 0, 525, 0, 319.5, 239.5, 1]}
    true = look_at([0.5, 1.2, 2.0], [0.0, 1.0, 0.0], 640, 480, 60)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = true.rotation, true.translation
    for given in (matrix.T.reshape(-1), matrix):
        path.write_text(json.dumps({"intrinsic": inner, "extrinsic": given.tolist()}))
        (camera,) = read_cameras(path)
        np.testing.assert_allclose(camera.rotation, true.rotation, atol=1e-6)
        np.testing.assert_allclose(camera.translation, true.translation, atol=1e-6)
    path.write_text(json.dumps({"intrinsic": inner, "extrinsic": np.eye(4).reshape(-1).tolist()}))
    np.testing.assert_array_equal(read_cameras(path)[0].rotation, np.diag([1.0, -1.0, -1.0]))
    path.write_text(json.dumps({"intrinsic": inner, "extrinsic": (2 * np.eye(4)).reshape(-1).tolist()}))
    with pytest.raises(InputError, match="'extrinsic' is no rotation and translation"):
        read_cameras(path)


@pytest.mark.parametrize("wrap", [list, lambda rows: {"parameters": rows}], ids=["list", "trajectory"])
def test_several_cameras_of_open3d(wrap, tmp_path):
    """If the first camera is the identity, the relative poses of all cameras stay the same, and y is up."""
    path = tmp_path / "cameras.json"
    inner = {"width": 640, "height": 480, "intrinsic_matrix": [525, 0, 0, 0, 525, 0, 319.5, 239.5, 1]}
    other = np.eye(4)
    other[:3, :3] = look_at([0.5, 1.2, 2.0], [0.0, 1.0, 0.0], 640, 480, 60).rotation
    other[:3, 3] = [0.1, 0.2, 0.3]
    rows = [{"intrinsic": inner, "extrinsic": one.T.reshape(-1).tolist()} for one in (np.eye(4), other)]
    path.write_text(json.dumps(wrap(rows)))
    first, second = read_cameras(path)
    np.testing.assert_allclose(first.rotation, np.diag([1.0, -1.0, -1.0]))
    np.testing.assert_allclose(second.rotation @ first.rotation.T, other[:3, :3], atol=1e-6)
    np.testing.assert_allclose(second.translation, other[:3, 3])
    path.write_text(json.dumps(wrap([inner, inner])))
    with pytest.raises(InputError, match="camera 0 has no 'extrinsic'"):
        read_cameras(path)


@pytest.mark.parametrize("suffix", [".yml", ".yaml", ".xml"])
def test_files_of_opencv_are_named_with_what_to_write(suffix, tmp_path):
    path = tmp_path / f"cv{suffix}"
    path.write_text("%YAML:1.0\n---\nimage_width: 640\n")
    with pytest.raises(
        InputError, match=rf"cv{suffix}: this is an? \w+ file.* write it as .json with camera_matrix"
    ):
        read_cameras(path)


def test_translations_in_millimetres_are_refused(tmp_path):
    path = tmp_path / "camera.json"
    write_cameras(path, [eqx.tree_at(lambda c: c.translation, CAMERA, jnp.array([0.0, 1000.0, 0.0]))])
    with pytest.raises(InputError, match="camera 0 is 1000 m from the origin; .* divide millimetres by 1000"):
        read_cameras(path)


def test_incomplete_intrinsics_are_refused(tmp_path):
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({"fx": 525, "fy": 525, "width": 640, "height": 480}))
    with pytest.raises(InputError, match="intrinsics of the camera are incomplete"):
        read_cameras(path)
    good = {"width": 640, "height": 480, "fx": 525, "fy": 520, "ppx": 319.5, "ppy": 239.5}
    path.write_text(json.dumps({"width": 640, "height": 480, "P": [525, 0, 319.5, 0, 525, 239.5, 0, 0, 1]}))
    with pytest.raises(
        InputError, match=r"incomplete \('fx' is missing\); expected fx, .*docs/files.md#cameras"
    ):
        read_cameras(path)
    path.write_text(json.dumps(good | {"fx": -1}))
    with pytest.raises(InputError, match="focal lengths"):
        read_cameras(path)


def test_a_half_seen_body_keeps_its_arms_out_of_the_trunk_and_its_hidden_legs_straight():
    """One camera sees a person from the hips up: what it sees is met, and what it does not see stays as people are."""
    camera = look_at([0.0, 0.35, 1.5], [0.0, 0.35, 0.0], 160, 120, 60)
    body = jc.human(resolution="low", joints="tracking")
    vertices = np.asarray(body.vertices, float)
    depth = render_depth(camera, make_ray_mesh(vertices, np.asarray(body.faces))).depth
    cloud = cloud_of_depths([camera], [np.where(depth > 0, depth, 3.0)], [depth > 0])
    tracker = jc.make_tracker(body, partial=True)
    shifted = jc.rest_pose(body.skeleton)
    shifted = jc.Pose(
        shifted.translations.at[0].add(np.array([0.05, 0.03, 0.0])), shifted.rotations, shifted.scale
    )
    (frame,) = track_frames(tracker, [cloud], shifted, search=False)
    posed, truth = (jc.pose_body(body, pose) for pose in (frame.pose, jc.rest_pose(body.skeleton)))
    names = body.skeleton.names
    seen = [names.index(name) for name in ("Head", "LeftArm", "RightArm", "Spine1")]
    apart = np.linalg.norm(np.asarray(posed.joints) - np.asarray(truth.joints), axis=1)
    assert apart[seen].max() < 0.03
    legs = [names.index(name) for name in ("LeftFoot", "RightFoot")]
    assert np.asarray(posed.joints)[legs, 1].max() < np.asarray(posed.joints)[0, 1] - 0.5
    assert "LeftFoot" in frame.unseen
