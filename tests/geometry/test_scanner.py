"""The simulated depth scanner: closed forms, the size of its errors, what views together cover."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from jaxcap.body.body import pose_body
from jaxcap.body.people.human import human
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.depth.back_projection import camera_rays
from jaxcap.depth.fuse import fuse_cloud, grid_faces
from jaxcap.errors import InputError
from jaxcap.geometry.camera import look_at, project_points, ring_of_cameras, unproject
from jaxcap.io.meshes.mesh import read_mesh
from jaxcap.io.meshes.ply import write_ply
from jaxcap.metrics import scan_to_surface
from jaxcap.scanner.noise import (
    add_flying_pixels,
    add_noise,
    discontinuities,
    lose_holes,
    quantise,
    remove_grazing,
)  # fmt: skip
from jaxcap.scanner.ray_casting import make_ray_mesh, render_depth
from jaxcap.scanner.scan import sample_dropped_views, scan_frame, scan_scene
from jaxcap.scanner.settings import Scanner

CLEAN = Scanner(noise=0.0, max_grazing_angle=90.0)
_pose_body = eqx.filter_jit(pose_body)


@pytest.fixture(scope="module")
def person():
    """Vertices and faces of a human in a step."""
    body = human(resolution="medium")
    posed = _pose_body(body, walk_and_wave(body.skeleton, 1.0)[20])
    return np.asarray(posed.vertices, float), np.asarray(body.faces)


def wall(z: float, side: float = 10.0):
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float) * side / 2
    return corners + [0, 0, z], np.array([[0, 1, 2], [0, 2, 3]])


def front(width: int = 64, height: int = 48, away: float = 3.0):
    return look_at([0, 0, away], [0, 0, 0], width, height, 60)


def test_depth_of_a_plane_is_exact():
    """A plane that leans: inverse depth is linear, and depth is known for every ray."""
    vertices, faces = wall(0.0)
    lean = np.array([[1, 0, 0], [0, np.cos(0.4), -np.sin(0.4)], [0, np.sin(0.4), np.cos(0.4)]])
    camera = front()
    image = render_depth(camera, make_ray_mesh(vertices @ lean.T, faces))
    normal = lean @ [0, 0, 1]
    rays = camera_rays(camera) @ np.asarray(camera.rotation)
    np.testing.assert_allclose(image.depth, -(normal @ [0, 0, 3.0]) / (rays @ normal), rtol=1e-12)
    np.testing.assert_allclose(
        image.incidence_cosines, -(rays @ normal) / np.linalg.norm(rays, axis=-1), rtol=1e-12
    )


def test_depth_of_a_sphere():
    ball = trimesh.creation.icosphere(5, 0.5)
    camera = front(160, 120)
    image = render_depth(camera, make_ray_mesh(np.asarray(ball.vertices), np.asarray(ball.faces)))
    rays = camera_rays(camera)
    # |t r - c|^2 = 1/4 with the middle 3 m before the camera
    half, square = 3 * rays[..., 2], np.sum(rays**2, -1)
    inside = half**2 - square * (9 - 0.25)
    depth = (half - np.sqrt(np.maximum(inside, 0))) / square
    middle = inside > 0.1 * inside.max()
    np.testing.assert_allclose(image.depth[middle], depth[middle], atol=1e-3)
    assert not image.depth[inside < 0].any()
    # the sphere's outline is a few pixels of 160
    assert np.count_nonzero((inside > 0) != (image.depth > 0)) < 0.05 * np.count_nonzero(inside > 0)


def test_a_pixel_sees_what_is_first_and_nothing_behind_the_camera():
    near, faces = wall(1.0, 0.5)
    far, _ = wall(0.0)
    behind, _ = wall(5.0)
    image = render_depth(
        front(),
        make_ray_mesh(np.concatenate([near, far, behind]), np.concatenate([faces, faces + 4, faces + 8])),
    )
    assert set(np.round(image.depth, 9).reshape(-1)) == {2.0, 3.0}
    assert image.depth[24, 32] == pytest.approx(2.0)
    nothing = render_depth(front(), make_ray_mesh(behind, faces))
    assert not nothing.depth.any()


def test_noise_has_the_deviation_that_was_asked(rng):
    for z in (1.0, 3.0):
        noisy = add_noise(np.full((200, 200), z), np.full((200, 200), 0.002 + 0.0015 * z**2), rng)
        assert np.std(noisy - z) == pytest.approx(0.002 + 0.0015 * z**2, rel=0.02)
        assert np.mean(noisy) == pytest.approx(z, abs=1e-3)
    assert not add_noise(np.zeros((5, 5)), np.full((5, 5), 0.1), rng).any()


def test_quantised_depths_are_whole_disparities():
    for z in (1.0, 2.0):
        fine = np.linspace(z - 0.05, z + 0.05, 4000)[None]
        steps = np.unique(quantise(fine, 0.003))
        np.testing.assert_allclose(1 / (steps * 0.003), np.round(1 / (steps * 0.003)), atol=1e-6)
        assert np.median(np.diff(steps)) == pytest.approx(0.003 * z**2, rel=0.05)
        assert np.abs(quantise(fine, 0.003) - fine).max() < 0.52 * 0.003 * (z + 0.05) ** 2
    np.testing.assert_array_equal(quantise(np.array([[0.0, 1.3]]), 0.0), [[0.0, 1.3]])
    assert not quantise(np.zeros((2, 2)), 0.01).any()


def test_holes_take_their_share_in_blobs(rng):
    depth = np.zeros((120, 160))
    depth[10:110, 20:140] = 2.0
    for share in (0.05, 0.3):
        lost = (lose_holes(depth, share, 4.0, rng) == 0) & (depth > 0)
        assert lost.sum() == round(share * 100 * 120)
        # pixels of a hole have neighbours in it, which random ones would have by their share
        assert lost[:, 1:][lost[:, :-1]].mean() > 0.6


def test_flying_pixels_are_before_edges_and_behind_the_surface(rng):
    depth = np.full((60, 80), 3.0)
    depth[20:40, 30:50] = 2.0
    edge = discontinuities(depth, 0.3) > 0.03
    assert edge.sum() == 4 * 19
    flown = add_flying_pixels(depth, 0.5, 0.03, 0.3, rng)
    moved = flown != depth
    assert moved.sum() == 38
    assert edge[moved].all()
    assert (flown[moved] > 2.0).all()
    assert (flown[moved] <= 2.3).all()
    # before nothing at all
    alone = np.where(depth == 2.0, depth, 0.0)
    flown = add_flying_pixels(alone, 1.0, 0.03, 0.3, rng)
    assert (flown != alone).sum() == 76
    assert not flown[alone == 0].any()


def test_grazing_surfaces_are_lost():
    ball = trimesh.creation.icosphere(4, 0.5)
    image = render_depth(front(160, 120), make_ray_mesh(np.asarray(ball.vertices), np.asarray(ball.faces)))
    kept = remove_grazing(image, 60.0) > 0
    assert (image.incidence_cosines[kept] >= 0.5).all()
    assert (image.incidence_cosines[(image.depth > 0) & ~kept] < 0.5).all()
    np.testing.assert_array_equal(remove_grazing(image, 90.0), image.depth)


def test_views_are_dropped_by_chance_but_never_all():
    lost = np.array([sample_dropped_views(0.3, 5, 7, frame) for frame in range(400)])
    assert lost.mean() == pytest.approx(0.3, abs=0.04)
    assert not lost.all(1).any()
    assert not sample_dropped_views(0.99, 3, 0, 0).all()


def test_scans_are_the_same_in_any_order(person):
    vertices, faces = person
    bad = Scanner(noise_growth=0.001, flying=0.3, holes=0.1, drop=0.3, depth_step=0.001, points=500)
    ring = ring_of_cameras(3, 360, 2.5, 0.4, [0, 0.05, 0], (96, 72))
    forth = [scan_frame(bad, ring, vertices, faces, 3, frame) for frame in (0, 1, 2)]
    back = [scan_frame(bad, ring, vertices, faces, 3, frame) for frame in (2, 1, 0)][::-1]
    for one, two in zip(forth, back, strict=True):
        for a, b in zip(one, two, strict=True):
            np.testing.assert_array_equal(a, b)
    assert not np.array_equal(forth[0].points, forth[1].points)
    assert not np.array_equal(forth[0].points, scan_frame(bad, ring, vertices, faces, 4, 0).points)
    # a view's picture does not depend on the others
    still = bad._replace(drop=0.0)
    np.testing.assert_array_equal(
        scan_scene(still, ring, [(vertices, faces)], 3, 5)[0].depth,
        scan_scene(still, ring[:1], [(vertices, faces)], 3, 5)[0].depth,
    )


def test_a_human_is_scanned_within_noise(person):
    vertices, faces = person
    ring = ring_of_cameras(4, 360, 2.5, 0.4, [0, 0.05, 0], (160, 120))
    clean = scan_frame(CLEAN, ring, vertices, faces)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert trimesh.proximity.closest_point(mesh, clean.points)[1].max() < 1e-9
    noisy = scan_frame(Scanner(noise=0.004, points=3000), ring, vertices, faces)
    distances = scan_to_surface(noisy.points, vertices, faces)
    # along the line of sight 4 mm, so less from the surface
    assert len(distances) == 3000
    assert 0.0015 < np.sqrt(np.mean(distances**2)) < 0.0041
    assert distances.max() < 5 * 0.004


def test_four_views_on_145_degrees_cover_one_side(person):
    vertices, faces = person

    def covered(arc):
        ring = ring_of_cameras(4, arc, 2.5, 0.4, [0, 0.05, 0], (160, 120))
        scan = scan_frame(CLEAN, ring, vertices, faces)
        near = KDTree(scan.points).query(vertices)[0] < 0.015
        across = trimesh.Trimesh(vertices, faces, process=False).vertex_normals[:, 2]
        return near[across > 0.7].mean(), near[across < -0.95].mean()

    before, behind = covered(145.0)
    assert before > 0.85
    assert behind < 0.15
    assert covered(360.0)[1] > 0.7


def test_normals_are_those_of_the_surface_and_look_to_the_camera(person):
    vertices, faces = wall(0.0)
    camera = look_at([1, 0.5, 3], [0, 0, 0], 80, 60, 50)
    scan = fuse_cloud([camera], [scan_scene(CLEAN, [camera], [(vertices, faces)])[0].depth])
    np.testing.assert_allclose(scan.normals, np.tile([0.0, 0, 1], (len(scan.points), 1)), atol=1e-9)
    ball = trimesh.creation.icosphere(5, 0.5)
    vertices, faces = np.asarray(ball.vertices), np.asarray(ball.faces)
    ring = ring_of_cameras(2, 360, 2.5, 0.0, [0, 0, 0], (320, 240))
    scan = scan_frame(Scanner(noise=0.001, max_grazing_angle=60.0), ring, vertices, faces)
    cosine = np.sum(scan.normals * scan.points, 1) / np.linalg.norm(scan.points, axis=1)
    assert np.median(np.degrees(np.arccos(np.clip(cosine, -1, 1)))) < 4
    assert np.quantile(cosine, 0.01) > 0.9
    np.testing.assert_allclose(np.linalg.norm(scan.normals, axis=1), 1.0, atol=1e-9)


def test_a_lonely_pixel_has_no_normal():
    depth = np.zeros((48, 64))
    depth[10, 10], depth[30, 20:25] = 2.0, 2.0
    scan = fuse_cloud([front()], [depth])
    assert len(scan.points) == 6
    assert not scan.normals.any()


def test_points_come_from_their_pixels(rng):
    depth = np.zeros((48, 64))
    depth[5, 7], depth[30, 60] = 1.5, 2.5
    camera = look_at([0.4, 1, 2], [0, 0.8, 0], 64, 48, 70)
    scan = fuse_cloud([front(), camera], [np.zeros((48, 64)), depth])
    want = unproject(camera, jnp.array([[7.0, 5], [60, 30]]), jnp.array([1.5, 2.5]))
    np.testing.assert_allclose(scan.points, want, atol=1e-12)
    assert scan.views.tolist() == [1, 1]
    np.testing.assert_allclose(
        project_points(camera, jnp.asarray(scan.points))[0], [[7, 5], [60, 30]], atol=1e-9
    )


def test_voxels_keep_one_point_each(person):
    vertices, faces = person
    ring = ring_of_cameras(4, 360, 2.5, 0.4, [0, 0.05, 0], (160, 120))
    scan = scan_frame(CLEAN._replace(voxel=0.03), ring, vertices, faces)
    cells = np.floor(scan.points / 0.03)
    assert len(np.unique(cells, axis=0)) == len(cells)
    assert len(scan.points) < len(scan_frame(CLEAN, ring, vertices, faces).points) / 2
    lengths = np.linalg.norm(scan.normals, axis=1)
    np.testing.assert_allclose(lengths[lengths > 0.5], 1.0, atol=1e-9)


def test_a_mesh_has_no_triangle_across_a_discontinuity(person):
    vertices, faces = person
    ring = ring_of_cameras(3, 145, 2.5, 0.4, [0, 0.05, 0], (160, 120))
    setting = Scanner(noise=0.001, gap=0.03, mesh=True)
    scan = scan_frame(setting, ring, vertices, faces)
    views = scan.views[scan.faces]
    assert (views == views[:, :1]).all()
    eyes = np.array([np.asarray(camera.eye) for camera in ring])
    for number, camera in enumerate(ring):
        own = scan.faces[views[:, 0] == number]
        depth = np.asarray(project_points(camera, jnp.asarray(scan.points))[1])[own]
        assert np.ptp(depth, axis=1).max() <= 0.03 + 1e-9
    # counter-clockwise towards the camera, and every vertex in a triangle
    corners = scan.points[scan.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.sum(across * (eyes[views[:, 0]] - corners[:, 0]), 1) > 0).all()
    assert len(np.unique(scan.faces)) == len(scan.points)
    assert np.abs(scan_to_surface(scan.points, vertices, faces)).max() < 0.006


def test_grids_of_pixels_become_triangles():
    depth = np.ones((3, 3))
    assert len(grid_faces(depth, 0.1)) == 8
    for corner in ((0, 0), (0, 2), (2, 0), (2, 2)):
        depth = np.ones((3, 3))
        depth[corner] = 0
        assert len(grid_faces(depth, 0.1)) == 7
        depth[corner] = 1.5
        assert len(grid_faces(depth, 0.1)) == 7
    assert len(grid_faces(np.array([[1.0, 1.0], [2.0, 2.0]]), 0.1)) == 0


def test_ply_files_come_in_again(tmp_path, rng):
    points, normals = rng.normal(size=(20, 3)), rng.normal(size=(20, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    faces = np.array([[0, 1, 2], [3, 4, 19]])
    write_ply(tmp_path / "mesh.ply", points, normals, np.arange(20), faces)
    write_ply(tmp_path / "cloud.ply", points, normals)
    mesh, cloud = read_mesh(tmp_path / "mesh.ply"), read_mesh(tmp_path / "cloud.ply")
    for read in (mesh, cloud):
        np.testing.assert_allclose(read.vertices, points, atol=1e-6)
        assert read.normals is not None
        np.testing.assert_allclose(read.normals, normals, atol=1e-6)
    np.testing.assert_array_equal(mesh.faces, faces)
    assert len(cloud.faces) == 0


def test_outliers_are_a_share_of_the_points_anywhere_in_the_box():
    ball = trimesh.creation.icosphere(3, 0.5)
    vertices, faces = np.asarray(ball.vertices), np.asarray(ball.faces)
    cameras = ring_of_cameras(6, 360, 2.5, 0.5, [0.0, 0.0, 0.0])
    scanner = Scanner(noise=0.01, points=4000, outliers=0.25)
    scan = scan_frame(scanner, cameras, vertices, faces)
    distances = scan_to_surface(scan.points, vertices, faces)
    assert len(scan.points) == 4000
    # a pixel with fewer than two neighbours has no normal
    assert (np.abs(np.linalg.norm(scan.normals, axis=1) - 1.0) < 1e-9).mean() > 0.99
    # outliers lie anywhere in a box of 1.2 m; noise goes 4 cm at most
    assert 0.12 < (distances > 0.04).mean() < 0.25
    assert np.abs(scan.points).max() < 0.6 + 0.04


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"noise": -0.1}, "noise of the scanner is -0.1; it must be at least 0"),
        ({"noise_growth": float("nan")}, "noise-growth of the scanner is nan"),
        ({"drop": 1.0}, "drop of the scanner is 1; it must be at least 0 and below 1"),
        ({"holes": 1.5}, "holes of the scanner is 1.5"),
        ({"flying": -1.0}, "flying of the scanner is -1"),
        ({"max_grazing_angle": 0.0}, "max-grazing-angle of the scanner is 0"),
        ({"points": 0}, "points of the scanner is 0"),
        ({"outliers": 1.0}, "outliers of the scanner is 1"),
        ({"mesh": True, "points": 9}, "remove the settings points, voxel and outliers"),
    ],
)
def test_settings_that_cannot_be_are_refused(change, told):
    with pytest.raises(InputError, match=told):
        scan_frame(Scanner(**change), [front()], *wall(0.0))


def test_no_cameras_and_seeds_below_zero_are_refused():
    with pytest.raises(InputError, match="no cameras"):
        scan_frame(CLEAN, [], *wall(0.0))
    with pytest.raises(InputError, match="seed is -1"):
        scan_frame(CLEAN, [front()], *wall(0.0), seed=-1)
