"""Lenses against OpenCV's numbers, and depth images without their distortion against rays cast without a lens."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcap as jc
from jaxcap.depth.rectify import make_rectification, rectify_depth, rectify_mask
from jaxcap.errors import InputError
from jaxcap.geometry.camera import Camera, is_in_image, look_at, project_points, unproject
from jaxcap.geometry.lens import Lens, distort, largest_radius
from jaxcap.io.cameras import read_cameras, write_cameras
from jaxcap.io.depth.rectify import rectify_depths
from jaxcap.io.depth.sequence import read_depths
from jaxcap.scanner.ray_casting import RayMesh, make_ray_mesh, render_depth

#: coefficients like those of an Azure Kinect: k1, k2, p1, p2, k3, k4, k5, k6
KINECT = (0.43, 0.068, 6e-4, -9e-4, 0.0044, 0.77, 0.148, 0.02)
FISHEYE = (0.05, -0.02, 0.01, -0.003)
WIDTH, HEIGHT, MORE = 640, 480, 320
CAMERA = look_at([0.0, 0.4, 2.6], [0.0, 0.1, 0.0], WIDTH, HEIGHT, 60)


def slow_distortion(x: float, y: float) -> tuple[float, float]:
    """OpenCV's documented formula, term by term, in double precision."""
    k1, k2, p1, p2, k3, k4, k5, k6 = KINECT
    r = x * x + y * y
    radial = (1 + k1 * r + k2 * r**2 + k3 * r**3) / (1 + k4 * r + k5 * r**2 + k6 * r**3)
    return (
        x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x),
        y * radial + p1 * (r + 2 * y * y) + 2 * p2 * x * y,
    )


def test_rays_are_distorted_as_opencv_documents():
    rays = np.random.default_rng(0).uniform(-0.9, 0.9, (20, 2))
    expected = np.array([slow_distortion(*ray) for ray in rays])
    np.testing.assert_allclose(distort(Lens(jnp.array(KINECT)), jnp.asarray(rays)), expected, atol=1e-6)
    angle = np.arctan(np.linalg.norm(rays, axis=1))
    bent = angle * (1 + sum(k * angle ** (2 * i + 2) for i, k in enumerate(FISHEYE)))
    fisheye = Lens(jnp.array(FISHEYE), "kannala_brandt")
    found = distort(fisheye, jnp.asarray(rays))
    np.testing.assert_allclose(found, rays * (bent / np.tan(angle))[:, None], atol=1e-6)
    # smooth on the axis too
    slope = jax.jacfwd(lambda ray: distort(fisheye, ray))(jnp.zeros(2))
    np.testing.assert_allclose(slope, np.eye(2), atol=1e-6)


def distorted(lens: Lens, scene: RayMesh) -> tuple[Camera, np.ndarray]:
    """Simulate the recorded image: each pixel takes the nearest pixel of a wide image without a lens."""
    wide = dataclasses.replace(
        CAMERA,
        width=WIDTH + 2 * MORE,
        height=HEIGHT + 2 * MORE,
        principal_point=CAMERA.principal_point + MORE,
    )
    depth = render_depth(wide, scene).depth
    focal, middle = (np.asarray(a, float) for a in (CAMERA.focal, CAMERA.principal_point))
    rows, columns = np.indices((HEIGHT, WIDTH))
    wanted = (np.stack([columns, rows], -1) - middle) / focal
    rays = wanted
    for _ in range(50):
        rays = rays + wanted - np.asarray(distort(lens, jnp.asarray(rays)), float)
    across, down = np.moveaxis(np.round(rays * focal + middle + MORE).astype(int), -1, 0)
    inside = (across >= 0) & (across < wide.width) & (down >= 0) & (down < wide.height)
    near = depth[np.clip(down, 0, wide.height - 1), np.clip(across, 0, wide.width - 1)]
    return dataclasses.replace(CAMERA, lens=lens), np.where(inside, near, 0.0)


@pytest.mark.parametrize(
    "lens", [Lens(jnp.array(KINECT)), Lens(jnp.array(FISHEYE), "kannala_brandt")], ids=["kinect", "fisheye"]
)
def test_a_rectified_image_is_that_of_a_camera_without_a_lens(lens):
    body = jc.human(resolution="low")
    scene = make_ray_mesh(np.asarray(body.vertices, float), np.asarray(body.faces))
    recorded, image = distorted(lens, scene)
    rectification = make_rectification(recorded)
    found = rectify_depth(rectification, image)
    mask = rectify_mask(rectification, image > 0)
    assert rectification.camera.lens is None
    expected = render_depth(rectification.camera, scene).depth
    assert found.shape == mask.shape == expected.shape
    seen, there = found > 0, expected > 0
    assert np.median(np.abs(found - expected)[seen & there]) < 0.001
    assert _overlap(seen, there) > 0.95
    # nowhere else by a pixel
    for shift in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        assert _overlap(np.roll(seen, shift, (0, 1)), there) < _overlap(seen, there)


def _overlap(one: np.ndarray, other: np.ndarray) -> float:
    return (one & other).sum() / (one | other).sum()


def test_a_point_is_projected_through_the_lens_and_only_rectified_images_are_back_projected():
    camera = dataclasses.replace(CAMERA, lens=Lens(jnp.array(KINECT)))
    point = jnp.array([0.5, 0.7, 0.2])
    pixel, depth = project_points(camera, point)
    plain, same = project_points(CAMERA, point)
    ray = (plain - CAMERA.principal_point) / CAMERA.focal
    expected = np.array(slow_distortion(*np.asarray(ray, float))) * np.asarray(CAMERA.focal) + np.asarray(
        CAMERA.principal_point
    )
    np.testing.assert_allclose(pixel, expected, atol=1e-3)
    assert float(depth) == pytest.approx(float(same))
    with pytest.raises(InputError, match="rectify them"):
        unproject(camera, pixel, depth)
    with pytest.raises(InputError, match="need no rectification"):
        make_rectification(CAMERA)
    with pytest.raises(InputError, match="whose distortion is not simulated"):
        jc.scanner.scan_scene(jc.scanner.Scanner(), [camera], [(np.eye(3), np.array([[0, 1, 2]]))])


def test_a_lens_of_nearly_zero_keeps_the_image():
    for focal, pixels in ((600.0, (321.7, 238.2)), (2000.0, (300.0, 250.0))):
        lens = Lens(jnp.array([1e-7] + 7 * [0.0]))
        camera = Camera(jnp.eye(3), jnp.zeros(3), jnp.full(2, focal), jnp.array(pixels), 640, 480, lens)
        rectified = make_rectification(camera).camera
        assert abs(rectified.width - 640) <= 1 and abs(rectified.height - 480) <= 1
        np.testing.assert_allclose(rectified.principal_point, pixels, atol=1)


def test_rays_that_the_lens_folds_are_in_no_image():
    lens = Lens(jnp.array([-0.35] + 7 * [0.0]))
    camera = Camera(jnp.eye(3), jnp.zeros(3), jnp.full(2, 500.0), jnp.array([319.5, 239.5]), 640, 480, lens)
    points = jnp.array([[0.3, 0.0, 1.0], [1.5, 0.0, 1.0]])
    # the radius r (1 - 0.35 r²) is largest at 1 / sqrt(1.05)
    assert 0.97 < float(largest_radius(lens)) < 0.98
    pixels, _ = project_points(camera, points)
    assert 0 < float(pixels[1, 0]) < 640
    np.testing.assert_array_equal(jax.jit(is_in_image)(camera, points), [True, False])


def test_lenses_are_read_and_written_and_their_images_rectified(tmp_path):
    content = {
        "width": 160,
        "height": 120,
        "fx": 138.0,
        "fy": 138.0,
        "ppx": 79.5,
        "ppy": 59.5,
        "coeffs": [0.1, 0, 0, 0, 0],
    }
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(content | {"model": "Brown Conrady"}))
    (camera,) = read_cameras(path)
    assert camera.lens is not None
    np.testing.assert_allclose(camera.lens.coefficients, [0.1, 0, 0, 0, 0, 0, 0, 0])
    write_cameras(tmp_path / "again.json", [camera, CAMERA])
    again, plain = read_cameras(tmp_path / "again.json")
    assert again.lens is not None and plain.lens is None
    np.testing.assert_allclose(again.lens.coefficients, camera.lens.coefficients)
    np.savez(tmp_path / "depth.npz", depth=np.full((2, 120, 160), 2.0), mask=np.ones((2, 120, 160), bool))
    images = read_depths(tmp_path / "depth.npz")
    with pytest.raises(InputError, match="rectify them"):
        jc.depth.find_person(camera, images[0].depths[0])
    (rectified,), frames = rectify_depths([camera], images)
    depth, mask = frames[1].depths[0], frames[1].masks[0]
    assert mask is not None and depth.shape == (rectified.height, rectified.width) == mask.shape
    np.testing.assert_allclose(depth[mask], 2.0)
    path.write_text(json.dumps(content | {"width": 80}))
    (other,) = read_cameras(path)
    with pytest.raises(InputError, match="the image has 160 x 120 pixels"):
        rectify_depths([other], images)[1][0]


@pytest.mark.parametrize(
    ("changed", "model", "coefficients"),
    [
        ({"coeffs": [0, 0, 0, 0], "distortion_model": "equidistant"}, "kannala_brandt", [0, 0, 0, 0]),
        ({"coeffs": [0, 0, 0, 0, 0], "model": 4}, None, None),
        ({"coeffs": [0, 0, 0, 0], "model": "Kannala Brandt4"}, None, None),
        ({"dist_coeff": [0.1, 0.2]}, "brown_conrady", [0.1, 0.2, 0, 0, 0, 0, 0, 0]),
        ({"distortion": {"k1": 0.1, "k3": 0.3, "p2": 0.4}}, "brown_conrady", [0.1, 0, 0, 0.4, 0.3, 0, 0, 0]),
        ({"k1": 0.1}, "brown_conrady", [0.1, 0, 0, 0, 0, 0, 0, 0]),
        ({"dist_coeffs": [0.1, 0.2, 0.3, 0.4], "fisheye_model": 1}, "kannala_brandt", [0.1, 0.2, 0.3, 0.4]),
    ],
)
def test_lenses_of_other_programs(changed, model, coefficients, tmp_path):
    path = tmp_path / "camera.json"
    path.write_text(
        json.dumps({"width": 64, "height": 48, "fx": 52, "fy": 52, "ppx": 31, "ppy": 23} | changed)
    )
    (camera,) = read_cameras(path)
    assert (None if camera.lens is None else camera.lens.model) == model
    if camera.lens is not None:
        np.testing.assert_allclose(camera.lens.coefficients, coefficients)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"model": "Inverse Brown Conrady"}, "distortion model 'Inverse Brown Conrady'"),
        ({"model": 2}, "distortion model 'inverse_brown_conrady'"),
        ({"coeffs": {"a": 1}}, "neither 'data' nor k1"),
        ({"model": "fisheye"}, "with 5 coefficients; expected Brown"),
        ({"coeffs": [0.1, "x"]}, "are no numbers"),
        ({"coeffs": [1e9]}, "at most 1000"),
    ],
)
def test_unknown_lenses_are_refused(changed, message, tmp_path):
    path = tmp_path / "camera.json"
    good = {
        "width": 64,
        "height": 48,
        "fx": 52,
        "fy": 52,
        "ppx": 31,
        "ppy": 23,
        "coeffs": [0.1, 0, 0, 0, 0.2],
    }
    path.write_text(json.dumps(good | changed))
    with pytest.raises(InputError, match=message):
        read_cameras(path)
