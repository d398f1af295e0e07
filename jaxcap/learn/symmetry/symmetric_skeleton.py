"""A skeleton made symmetric: bones of pairs equally long, and joints on the middle in the middle of the surface."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ...body.body import Body
from ...body.skeleton import Skeleton
from ...body.symmetry import symmetrise
from ...geometry.mesh import mesh_edges, vertex_areas
from ..skeleton.centre_constraints import MiddlePlanes
from .mirrored_parts import MirroredParts, middle_joints, mirror_joints, mirror_parts
from .surface_symmetry import SurfaceSymmetry

#: rounds that alternate between equal lengths and the middle
ROUNDS = 4


class SymmetricSkeleton(NamedTuple):
    """A symmetric skeleton, with its pairs of joints."""

    skeleton: Skeleton
    pairs: Int[np.ndarray, "P 2"]


def make_symmetric(
    skeleton: Skeleton,
    labels: Int[np.ndarray, "V"],
    rest: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "T 3"],
    symmetry: SurfaceSymmetry,
) -> SymmetricSkeleton:
    """Pair the joints of a skeleton by the mirrored parts of the surface, and move centres as little as needed.

    **Arguments:** the bones of the vertices, and the mesh at rest.
    """
    parts = mirror_parts(labels, vertex_areas(rest, faces), symmetry.mirrored, skeleton.num_joints)
    joints = mirror_joints(parts, skeleton.parents)
    middle = np.flatnonzero(middle_joints(joints, skeleton.parents))
    planes = _planes(skeleton, middle, labels, rest, faces, symmetry)
    for _ in range(ROUNDS if planes is not None and len(joints.pairs) else 1):
        if planes is not None:
            skeleton = _project(skeleton, planes)
        skeleton = symmetrise(skeleton, joints.pairs)
    return SymmetricSkeleton(skeleton, joints.pairs)


def mirrored_joints(body: Body, symmetry: SurfaceSymmetry) -> MirroredParts:
    """Match the joints of a body with those that mirror them."""
    areas = vertex_areas(np.asarray(body.vertices, float), np.asarray(body.faces))
    labels, skeleton = np.asarray(body.skin.dominant_bones()), body.skeleton
    return mirror_joints(
        mirror_parts(labels, areas, symmetry.mirrored, skeleton.num_joints), skeleton.parents
    )


def middle_directions(body: Body, symmetry: SurfaceSymmetry) -> MiddlePlanes | None:
    """Build planes through the joints on the middle, across the line from one side to the other around each.

    A joint that is in the middle stays there if it stays in its plane.
    """
    labels, rest = np.asarray(body.skin.dominant_bones()), np.asarray(body.vertices, float)
    faces, skeleton = np.asarray(body.faces), body.skeleton
    middle = np.flatnonzero(middle_joints(mirrored_joints(body, symmetry), skeleton.parents))
    planes = _planes(skeleton, middle, labels, rest, faces, symmetry)
    if planes is None:
        return None
    return MiddlePlanes(planes.normals, skeleton.centres[np.array(planes.joints)], planes.joints)


def _planes(
    skeleton: Skeleton, joints: Sequence[int] | np.ndarray, labels, rest, faces, symmetry: SurfaceSymmetry
) -> MiddlePlanes | None:
    """Fit a plane to the mirrored vertices at the cut through the surface at each joint; None without any."""
    first, second = mesh_edges(faces).T
    mirrored = symmetry.mirrored_points(rest)
    steps, middles = (rest - mirrored) * symmetry.sides[:, None], (rest + mirrored) / 2
    found = []
    for joint in np.asarray(joints, int).tolist():
        below = skeleton.descendants[joint][labels]
        cut = below[first] != below[second]
        ring = np.unique(np.concatenate([first[cut], second[cut]]))
        step = steps[ring].sum(0)
        length = np.linalg.norm(step)
        # steps that point everywhere have no direction
        if length > 0.5 * np.linalg.norm(steps[ring], axis=1).sum() > 0:
            found.append((joint, step / length, middles[ring].mean(0)))
    if not found:
        return None
    chosen, normals, points = zip(*found, strict=True)
    dtype = skeleton.centres.dtype
    return MiddlePlanes(jnp.asarray(np.stack(normals), dtype), jnp.asarray(np.stack(points), dtype), chosen)


def _project(skeleton: Skeleton, planes: MiddlePlanes) -> Skeleton:
    """Move the joints of planes into them."""
    rows = np.array(planes.joints)
    away = jnp.sum((skeleton.centres[rows] - planes.points) * planes.normals, 1, keepdims=True)
    centres = skeleton.centres.at[rows].add(-away * planes.normals)
    return eqx.tree_at(lambda s: s.centres, skeleton, centres)
