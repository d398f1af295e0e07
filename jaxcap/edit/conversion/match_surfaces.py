"""A map from the vertices of one body to the surface of another one."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...arguments import checked
from ...body.body import Body
from ...body.body_model import BodyModel
from ...errors import InputError
from ...geometry.attachment import Attachment, attach_to_triangles
from ...geometry.closest import positions_on_surface
from ...geometry.mesh import area_normals
from .free_vertices import find_counterparts, register_vertices
from .rest_fit import RestSurface, fit_at_rest

#: largest distances of nearest points while vertices move, and of counterparts, as shares of the body's size
REACH, MAX_DISTANCE = 0.03, 0.003
#: least share of vertices with a counterpart
MIN_SHARE = 0.5


class SurfaceMatch(NamedTuple):
    """A map from the vertices of a target to points of a source's surface."""

    #: each vertex of the target on a triangle of the source, with a height above it if it has no counterpart
    attachment: Attachment
    #: (W,) true where the vertex has a counterpart
    matched: Bool[np.ndarray, "W"]
    #: (W,) distance of the fitted target from the source's surface before its vertices moved freely, metres
    distances: Float[np.ndarray, "W"]


@checked
def match_surfaces(source: Body, target: BodyModel | Body) -> SurfaceMatch:
    """Match each vertex of a target with a point of a source's surface at rest.

    Pose and shape of the target are first fitted to that surface: they start from the directions of the source's bones, if the
    joints of both match (`match_joints`), and pairs of nearest points with similar normals are renewed in each step. Then all
    vertices move freely and smoothly onto the surface. A vertex that stays away from it, or faces another way, has no
    counterpart, such as eyeballs and the inside of the mouth. Bodies of the same triangles are matched vertex by vertex.

    The match holds for all shapes and poses of bodies with these triangles.

    **Raises:** `InputError` if a body has no surface, or less than half of the target's vertices find a counterpart.
    """
    body = target.template if isinstance(target, BodyModel) else target
    for name, one in (("source", source), ("target", body)):
        if not len(one.faces):
            raise InputError(
                f"match_surfaces: the {name} has no triangles, and without a surface there is nothing to match; retarget by the names "
                "of joints."
            )
    if len(source.vertices) == len(body.vertices) and np.array_equal(source.faces, body.faces):
        return _match_vertices(body)
    surface = _rest_surface(source)
    faces = np.asarray(body.faces)
    vertices = fit_at_rest(target, source, surface)
    length = surface.size
    before = find_counterparts(vertices, faces, *surface, np.inf)[0].distances
    moved = register_vertices(vertices, faces, *surface, REACH * length)
    nearest, matched = find_counterparts(moved, faces, *surface, np.inf)
    matched &= nearest.distances < MAX_DISTANCE * length
    used = np.zeros(len(moved), bool)
    used[faces] = True
    matched &= used
    if matched[used].mean() < MIN_SHARE:
        raise InputError(
            f"match_surfaces: only {matched[used].mean():.0%} of the target's vertices match a point of the source's surface, and the "
            f"mean distance of the fitted target is {1000 * before.mean():.0f} mm; give two upright bodies of the same kind, with y up "
            "and triangles that face outwards."
        )
    points = np.where(matched[:, None], positions_on_surface(nearest, *surface), moved)
    held = attach_to_triangles(points, surface.vertices, surface.faces[nearest.triangles])
    heights = np.where(matched, 0.0, held.heights)
    return SurfaceMatch(Attachment(held.corners, held.barycentric, heights), matched, before)


def _rest_surface(body: Body) -> RestSurface:
    """Take the surface of a body at rest, without triangles that have no area."""
    vertices, faces = np.asarray(body.vertices, float), np.asarray(body.faces)
    return RestSurface(vertices, faces[np.linalg.norm(area_normals(vertices[faces]), axis=1) > 0])


def _match_vertices(body: Body) -> SurfaceMatch:
    """Match every vertex with itself, at a corner of one of its triangles."""
    faces, count = np.asarray(body.faces), len(body.vertices)
    corners = np.tile(np.arange(count)[:, None], (1, 3))
    barycentric = np.tile([1.0, 0.0, 0.0], (count, 1))
    for corner in range(3):
        corners[faces[:, corner]] = np.roll(faces, -corner, axis=1)
    matched = np.zeros(count, bool)
    matched[faces] = True
    return SurfaceMatch(Attachment(corners, barycentric, np.zeros(count)), matched, np.zeros(count))
