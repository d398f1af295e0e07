"""Visibility of a surface's vertices in cameras (Adaptation, 4.1.2, visibility constraint)."""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..arguments import checked
from ..geometry.camera import Camera, is_in_image, project_points
from ..geometry.mesh import vertex_normals

#: depth below which triangles occlude nothing, metres
MIN_DEPTH = 0.01
#: largest change of a surface's depth from pixel to pixel of the buffer, metres
MAX_DEPTH_CHANGE = 0.03


@checked
def visible_vertices(
    cameras: Camera | Sequence[Camera],
    vertices: Float[Array, "V 3"],
    faces: Int[Array, "F 3"],
    tolerance: float = 0.005,
    *,
    pixels: int = 320,
) -> Bool[Array, "V"]:
    """Find the vertices seen by at least one camera: in its image, facing it, and not occluded.

    A vertex is occluded where a depth buffer of the triangles is nearer than the surface around it by more
    than `tolerance`, metres, at most of the adjacent pixels, weighted bilinearly. The buffer has `pixels`
    rows and columns, spread over the part of the image that contains the surface. Within one pixel of an
    occluding edge a vertex may be classified wrongly. Triangles that extend behind the camera occlude
    nothing. Shapes are fixed, so this may be called under `jit` and `vmap`.
    """
    cameras = [cameras] if isinstance(cameras, Camera) else list(cameras)
    normals = vertex_normals(vertices, faces)
    seen = jnp.zeros(len(vertices), bool)
    for camera in cameras:
        seen = seen | _visible_from(camera, vertices, normals, faces, tolerance, pixels)
    return seen


@partial(jax.jit, static_argnums=5)
def _visible_from(camera: Camera, vertices, normals, faces, tolerance, pixels: int) -> Bool[Array, "V"]:
    turned = jnp.sum(normals * (camera.eye - vertices), -1) > 0
    positions, depth = project_points(camera, vertices)
    front = depth > MIN_DEPTH
    # the buffer covers the box around the vertices in the image
    inside = is_in_image(camera, vertices)
    first = jnp.min(jnp.where(inside[:, None], positions, jnp.inf), 0)
    last = jnp.max(jnp.where(inside[:, None], positions, -jnp.inf), 0)
    scale = (pixels - 1) / jnp.maximum(last - first, 1e-3)
    positions = jnp.where(inside.any(), (positions - first) * scale, 0.0)
    nearest = _depth_buffer(
        positions, jnp.where(front, 1.0 / jnp.where(front, depth, 1.0), 0.0), faces, pixels
    )
    # slopes of the inverse depth of the plane at each vertex, by column and row
    normal = normals @ camera.rotation.T
    away = jnp.sum(normals * (vertices - camera.eye), -1)
    slopes = normal[:, :2] / (camera.focal * scale * jnp.where(turned, away, -1.0)[:, None])
    corner = jnp.clip(jnp.floor(positions), 0, pixels - 2)
    clear = jnp.zeros(len(vertices))
    for step in ((0, 0), (0, 1), (1, 0), (1, 1)):
        at = corner + jnp.array(step)
        offsets = at - positions
        inverse_depth = nearest[at[:, 1].astype(int), at[:, 0].astype(int)]
        # for a plane seen edge-on the prediction is useless
        change = jnp.clip(jnp.sum(slopes * offsets, -1) * depth**2, -MAX_DEPTH_CHANGE, MAX_DEPTH_CHANGE)
        share = jnp.prod(1 - jnp.abs(offsets), -1)
        clear = clear + share * (inverse_depth * (depth - change - tolerance) < 1.0)
    return inside & front & turned & (clear > 0.5)


def _depth_buffer(
    positions: Float[Array, "V 2"], inverse: Float[Array, "V"], faces: Int[Array, "F 3"], pixels: int
) -> Float[Array, "P P"]:
    """Compute the greatest inverse depth of all triangles at each pixel; zero where there is none.

    Every triangle is tested at the pixels of a window at its corner. Windows have fixed sizes: a small one
    for all triangles, and doubled ones for ever fewer, the largest of which cover the image. In a mesh with
    many triangles much larger than its mean the last ones are clipped to their windows.
    """
    corners, depths = positions[faces], inverse[faces]
    low = jnp.clip(jnp.ceil(corners.min(1)), 0, pixels)
    high = jnp.clip(jnp.floor(corners.max(1)), -1, pixels - 1)
    whole = jnp.all(depths > 0, 1) & jnp.all(high >= low, 1)
    extent = jnp.where(whole, jnp.max(high - low, 1) + 1, 0)
    order = jnp.argsort(-extent)
    buffer = jnp.zeros(pixels * pixels, positions.dtype)
    # the size of triangles that cover the buffer evenly, and twice, from both sides
    side, count = int(min(pixels, 2 + (4 * pixels * pixels / len(faces)) ** 0.5)), len(faces)
    while True:
        chosen = order[:count]
        buffer = _rasterise(buffer, corners[chosen], depths[chosen], low[chosen], whole[chosen], side, pixels)
        if side == pixels:
            return buffer.reshape(pixels, pixels)
        side, count = min(2 * side, pixels), max(count // 6, 1)


def _rasterise(buffer, corners, depths, low, whole, side: int, pixels: int) -> Float[Array, "Q"]:
    """Add triangles to the buffer at the `side x side` pixels from `low` on."""
    steps = jnp.arange(side)
    column, row = (low[:, axis, None].astype(int) + steps for axis in (0, 1))
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    safe = jnp.where(area == 0, 1.0, area)[:, None, None]
    x, y = (column - a[:, :1])[:, None, :], (row - a[:, 1:])[:, :, None]
    second = (x * ac[:, 1, None, None] - y * ac[:, 0, None, None]) / safe
    third = (y * ab[:, 0, None, None] - x * ab[:, 1, None, None]) / safe
    within = (second >= -1e-6) & (third >= -1e-6) & (second + third <= 1 + 1e-6)
    good = within & (whole & (area != 0))[:, None, None]
    good = good & (column < pixels)[:, None, :] & (row < pixels)[:, :, None]
    # the inverse depth of a plane is linear in image coordinates
    rises = depths - depths[:, :1]
    value = depths[:, :1, None] + second * rises[:, 1, None, None] + third * rises[:, 2, None, None]
    index = jnp.where(good, row[:, :, None] * pixels + column[:, None, :], pixels * pixels)
    return buffer.at[index.reshape(-1)].max(value.reshape(-1), mode="drop")
