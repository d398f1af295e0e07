"""Ideal depth images of a triangle mesh by ray casting."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..depth.back_projection import camera_rays
from ..geometry.camera import Camera
from ..geometry.mesh import area_normals, unit_vectors


class RayMesh(NamedTuple):
    """A mesh prepared for ray casting; see `make_ray_mesh`."""

    #: of trimesh; its `ray` uses Embree if that is installed
    mesh: Any
    #: corners of the triangles, metres
    corners: Float[np.ndarray, "F 3 3"]
    #: unit normals; zero for triangles without area
    normals: Float[np.ndarray, "F 3"]


class DepthImage(NamedTuple):
    """A depth image: metres along the optical axis, zero for pixels without measurement."""

    depth: Float[np.ndarray, "H W"]
    #: cosine of the angle between the surface's normal and the ray, zero for pixels without measurement
    incidence_cosines: Float[np.ndarray, "H W"]
    #: the triangle that a pixel shows, -1 for pixels without measurement
    triangles: Int[np.ndarray, "H W"]


def make_ray_mesh(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> RayMesh:
    """Prepare a mesh for ray casting from several cameras, once for a frame."""
    import trimesh

    vertices, faces = np.asarray(vertices, float), np.asarray(faces)
    corners = vertices[faces]
    mesh = trimesh.Trimesh(vertices, faces, process=False, validate=False)
    return RayMesh(mesh, corners, unit_vectors(area_normals(corners)))


def render_depth(camera: Camera, surface: RayMesh) -> DepthImage:
    """Render the depth of the first surface, front or back, at each pixel's centre."""
    rotation, translation = (np.asarray(a, float) for a in (camera.rotation, camera.translation))
    rays = camera_rays(camera)
    shape = rays.shape[:2]
    depth, facing, shown = np.zeros(shape), np.zeros(shape), np.full(shape, -1)
    corners = surface.corners @ rotation.T + translation
    window = _window(camera, corners)
    directions = rays[window].reshape(-1, 3) @ rotation
    if len(directions) == 0:
        return DepthImage(depth, facing, shown)
    eye = -translation @ rotation
    hit = surface.mesh.ray.intersects_first(np.tile(eye, (len(directions), 1)), directions)
    seen = np.flatnonzero(hit >= 0)
    triangle, along = hit[seen], directions[seen]
    normal = surface.normals[triangle]
    # Embree finds triangles in single precision; their intersections are computed in double precision.
    # Rays have a depth of one, so that the ray parameter is the depth
    approach = np.sum(normal * along, 1)
    reach = np.sum(normal * (surface.corners[triangle, 0] - eye), 1)
    depths = reach / np.where(np.abs(approach) > 1e-12, approach, 1.0)
    shares = _barycentric(eye + depths[:, None] * along, surface.corners[triangle], normal)
    depths = np.sum(shares * corners[triangle, :, 2], 1)
    values, cosines = np.zeros((2, len(directions)))
    values[seen] = np.where(depths > 0, depths, 0.0)
    cosines[seen] = np.where(depths > 0, np.abs(approach) / np.linalg.norm(along, axis=1), 0.0)
    numbers = np.full(len(directions), -1)
    numbers[seen] = np.where(depths > 0, triangle, -1)
    for image, of_window in zip((depth, facing, shown), (values, cosines, numbers), strict=True):
        image[window] = of_window.reshape(image[window].shape)
    return DepthImage(depth, facing, shown)


def _barycentric(
    points: Float[np.ndarray, "N 3"], corners: Float[np.ndarray, "N 3 3"], normals: Float[np.ndarray, "N 3"]
) -> Float[np.ndarray, "N 3"]:
    """Compute barycentric coordinates of points in their planes, clipped to the triangle.

    A ray that misses an edge by rounding could intersect the plane of a grazing triangle far away.
    """
    across = [
        np.cross(corners[:, (i + 2) % 3] - corners[:, (i + 1) % 3], points - corners[:, (i + 1) % 3])
        for i in range(3)
    ]
    shares = np.maximum(np.stack([np.sum(normals * a, 1) for a in across], 1), 0.0)
    total = shares.sum(1, keepdims=True)
    return np.where(total > 0, shares / np.where(total > 0, total, 1.0), 1 / 3)


def _window(camera: Camera, corners: Float[np.ndarray, "F 3 3"]) -> tuple[slice, slice]:
    """Find the rows and columns outside of which no ray can hit the surface."""
    depth = corners[..., 2]
    if depth.size == 0 or depth.max() <= 0:
        return slice(0, 0), slice(0, 0)
    if depth.min() < 0.01:
        # points next to or behind the camera can project anywhere
        return slice(0, camera.height), slice(0, camera.width)
    pixels = np.asarray(camera.focal, float) * corners[..., :2] / depth[..., None]
    pixels = (pixels + np.asarray(camera.principal_point, float)).reshape(-1, 2)
    first = np.maximum(np.floor(pixels.min(0)).astype(int) - 1, 0)
    last = np.maximum(np.minimum(np.ceil(pixels.max(0)).astype(int) + 2, [camera.width, camera.height]), 0)
    first = np.minimum(first, last)
    return slice(int(first[1]), int(last[1])), slice(int(first[0]), int(last[0]))
