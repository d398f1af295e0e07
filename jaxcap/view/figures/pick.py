"""Picking: the point of a posed body that a click selects."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

#: radius of a click around a joint, or around a vertex without triangles, as a share of the body's size
PICK_RADIUS = 0.02


def pick_point(
    origin: Float[np.ndarray, "3"],
    direction: Float[np.ndarray, "3"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    joints: Float[np.ndarray, "J 3"] | None = None,
    names: Sequence[str] = (),
) -> int | str | None:
    """Pick the point that a ray from `origin` along `direction` hits: a joint's name, a vertex index, or
    None.

    A joint near the ray is preferred, even behind the surface; joints that are not shown are not passed.
    Otherwise it is the corner nearest to the ray's hit on the first triangle, or without triangles the vertex
    nearest to the ray.
    """
    direction = np.asarray(direction, float) / np.linalg.norm(direction)
    size = float(np.ptp(vertices, axis=0).max()) if len(vertices) else 0.0
    if joints is not None and len(joints):
        near = PICK_RADIUS * max(size, float(np.ptp(joints, axis=0).max()))
        joint = _nearest_to_ray(joints, origin, direction, near)
        if joint is not None:
            return names[joint]
    if not len(vertices):
        return None
    if not len(faces):
        return _nearest_to_ray(vertices, origin, direction, PICK_RADIUS * size)
    return _nearest_corner(vertices, faces, origin, direction)


def pick_sphere(
    centres: Float[np.ndarray, "N 3"],
    origin: Float[np.ndarray, "3"],
    direction: Float[np.ndarray, "3"],
    radius: float,
) -> int | None:
    """Find the first sphere of `radius` metres around `centres` that a ray hits; None if it hits none."""
    direction = np.asarray(direction, float) / np.linalg.norm(direction)
    along = (centres - origin) @ direction
    beside = np.linalg.norm(centres - origin - along[:, None] * direction, axis=1)
    hits = np.flatnonzero((beside <= radius) & (along > 0))
    return int(hits[np.argmin(along[hits])]) if len(hits) else None


def _nearest_to_ray(
    points: np.ndarray, origin: np.ndarray, direction: np.ndarray, max_distance: float
) -> int | None:
    along = (points - origin) @ direction
    beside = np.linalg.norm(points - origin - along[:, None] * direction, axis=1)
    beside = np.where(along > 0, beside, np.inf)
    best = int(np.argmin(beside))
    return best if beside[best] <= max_distance else None


def _nearest_corner(
    vertices: np.ndarray, faces: np.ndarray, origin: np.ndarray, direction: np.ndarray
) -> int | None:
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    triangle = int(mesh.ray.intersects_first([origin], [direction])[0])
    if triangle < 0:
        return None
    corners = np.asarray(vertices[faces[triangle]], float)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    steep = float(normal @ direction)
    # Embree gives the triangle; the intersection with its plane is one division
    along = (
        float(normal @ (corners[0] - origin)) / steep
        if steep
        else float((corners.mean(0) - origin) @ direction)
    )
    position = origin + along * direction
    return int(faces[triangle][np.argmin(np.linalg.norm(corners - position, axis=1))])
