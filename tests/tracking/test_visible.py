"""Visibility of a body's vertices, held to rays."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from jaxcap.adapt.poses.fit_frame import DEPTH_BUFFER_SIZE
from jaxcap.body.body import pose_body
from jaxcap.body.people.human import human
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.geometry.camera import is_in_image, look_at, ring_of_cameras
from jaxcap.observe.visibility import visible_vertices

TOLERANCE = 0.005
_pose_body = eqx.filter_jit(pose_body)


def seen_by_rays(camera, vertices, normals, faces):
    """Vertices that a ray from the camera meets first, but for surface nearer by less than the tolerance."""
    eye = np.asarray(camera.eye, float)
    away = vertices - eye
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    hit = mesh.ray.intersects_first(np.tile(eye, (len(vertices), 1)), away)
    plane, corner = mesh.face_normals[hit], mesh.triangles[hit, 0]
    share = np.sum((corner - eye) * plane, 1) / (np.sum(away * plane, 1) + 1e-30)
    own = (faces[hit] == np.arange(len(vertices))[:, None]).any(1)
    hidden = (hit >= 0) & ~own & ((1 - share) * np.linalg.norm(away, axis=1) > TOLERANCE)
    turned = np.sum(normals * away, 1) < 0
    return ~hidden & turned & np.asarray(is_in_image(camera, jnp.asarray(vertices)))


@pytest.mark.parametrize(
    ("resolution", "pixels"), [("full", 320), ("low", 320), ("medium", DEPTH_BUFFER_SIZE)]
)
def test_a_human_is_as_visible_as_rays_say(resolution, pixels):
    body = human(resolution=resolution)
    posed = _pose_body(body, walk_and_wave(body.skeleton, 1.5)[40])
    vertices, normals, faces = (np.asarray(a) for a in (posed.vertices, posed.normals, body.faces))
    cameras = ring_of_cameras(4, 360, 2.5, 0.4, [0, 0.05, 0])
    # one so near that head and feet are out of its picture
    cameras += ring_of_cameras(1, 30, 1.2, 0.6, [0.0, 0.05, 0])
    rays = np.array([seen_by_rays(camera, vertices, normals, faces) for camera in cameras])
    for camera, truth in zip(cameras, rays, strict=True):
        got = np.asarray(visible_vertices(camera, posed.vertices, body.faces, TOLERANCE, pixels=pixels))
        assert 0.1 < truth.mean() < 0.6
        assert (got == truth).mean() >= 0.98
    together = np.asarray(visible_vertices(cameras, posed.vertices, body.faces, TOLERANCE, pixels=pixels))
    assert (together == rays.any(0)).mean() >= 0.98


def blocks():
    """A small plate, cut into small triangles, behind a large one of two triangles."""
    side = np.linspace(-0.3, 0.3, 21)
    x, y = (a.reshape(-1) for a in np.meshgrid(side, side))
    small = np.stack([x, y, np.zeros(441)], 1)
    corner = (np.arange(20)[:, None] * 21 + np.arange(20)).reshape(-1)
    faces = np.concatenate([
        np.stack([corner, corner + 1, corner + 22], 1), np.stack([corner, corner + 22, corner + 21], 1)
    ])  # fmt: skip
    large = np.array([[-1, -1, 0.5], [0.1, -1, 0.5], [0.1, 1, 0.5], [-1, 1, 0.5]])
    return jnp.asarray(np.concatenate([small, large])), jnp.asarray(
        np.concatenate([faces, np.array([[441, 442, 443], [441, 443, 444]])])
    )


def test_what_is_behind_a_large_triangle_is_hidden():
    vertices, faces = blocks()
    camera = look_at([0, 0, 3], [0, 0, 0], 320, 240, 60)
    seen = np.asarray(visible_vertices(camera, vertices, faces))
    # the edge at 0.1, 2.5 m away, hides what is left of 0.12 at 3 m
    x = np.asarray(vertices)[:441, 0]
    np.testing.assert_array_equal(seen[:441][np.abs(x - 0.12) > 0.01], (x > 0.12)[np.abs(x - 0.12) > 0.01])
    assert seen[441:].all()


def test_behind_the_camera_turned_away_and_outside_is_not_seen():
    vertices, faces = blocks()
    for eye, target in (([0, 0, -3], [0, 0, 0]), ([0, 0, 3], [0, 0, 6]), ([0, 0, 3], [3, 0, 3])):
        camera = look_at(eye, target, 320, 240, 60)
        assert not np.asarray(visible_vertices(camera, vertices, faces)).any()
    # half of it is out of a narrow picture
    camera = look_at([0.4, 0, 3], [0.4, 0, 0], 320, 240, 12)
    seen = np.asarray(visible_vertices(camera, vertices, faces))[:441]
    x = np.asarray(vertices)[:441, 0]
    middle = np.abs(np.asarray(vertices)[:441, 1]) < 0.2
    assert not seen[x < 0.08].any()
    assert seen[middle & (x > 0.13)].all()


def test_it_is_the_same_under_jit_and_vmap():
    vertices, faces = blocks()
    camera = look_at([0, 0, 3], [0, 0, 0], 320, 240, 60)
    stacked = jnp.stack([vertices, vertices + jnp.array([0.2, 0, 0])])
    got = jax.jit(jax.vmap(lambda v: visible_vertices([camera], v, faces, pixels=128)))(stacked)
    for one, moved in zip(got, stacked, strict=True):
        np.testing.assert_array_equal(one, visible_vertices(camera, moved, faces, pixels=128))
