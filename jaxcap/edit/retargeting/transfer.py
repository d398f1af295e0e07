"""Deformation transfer: apply the pose of one surface to another of the same triangles and another shape.

Sumner and Popović, *Deformation Transfer for Triangle Meshes* (2004): each triangle of the target is deformed
as the source's is, by the matrix that maps its sides at rest to those in the pose. As triangles share
vertices, the vertices are fitted to these sides by least squares (there section 3.1, here in the form of
Botsch et al. 2006, a Poisson equation whose matrix is the target's own).
"""

from typing import NamedTuple

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from jaxtyping import Float, Int
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from ...geometry.linear import factor_sparse, inverse
from ...geometry.mesh import mesh_edges
from ...geometry.procrustes import nearest_rotation

#: weight of a side that joins two pieces of a surface, relative to sides within them
BRIDGE_WEIGHT = 1.0


class PoseTransfer(NamedTuple):
    """The constant part of a transfer; E sides of triangles and bridges."""

    faces: Int[np.ndarray, "T 3"]
    #: (T, 3, 3) inverse of a triangle's frame at rest, which maps its frame in the pose to its deformation
    frames: Float[np.ndarray, "T 3 3"]
    #: ends of the sides
    ends: Int[np.ndarray, "E 2"]
    #: (E, 2) triangles whose deformations are averaged for a side
    owners: Int[np.ndarray, "E 2"]
    #: sides of the target at rest, metres
    sides: Float[np.ndarray, "E 3"]
    weights: Float[np.ndarray, "E"]
    factor: scipy.sparse.linalg.SuperLU
    count: int
    #: (B, 3, 3) for the bridges, the last of the sides: rotation and scale from the source's at rest to the
    #: target's
    bridges: Float[np.ndarray, "B 3 3"]


def make_transfer(
    source: Float[np.ndarray, "V 3"], target: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "T 3"]
) -> PoseTransfer:
    """Prepare the transfer from one surface at rest to another, metres; the system is factorised once.

    Disconnected pieces of a surface are joined at their nearest vertices.

    **Raises:** `ValueError` if there are no faces, or a vertex is in none.
    """
    source, target, faces = np.asarray(source, float), np.asarray(target, float), np.asarray(faces)
    count = len(source)
    used = np.zeros(count, bool)
    used[faces] = True
    if not used.all():
        raise ValueError(
            f"{int((~used).sum())} of {count} vertices are in no face, so no triangle deforms them; remove them."
        )
    sides = faces[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2)
    corners = target[faces]
    # half the cotangent of the angle opposite to each side, in the order of `sides`
    u, v = corners[:, [1, 2, 0]] - corners, corners[:, [2, 0, 1]] - corners
    across = np.linalg.norm(np.cross(u, v), axis=2)
    weights = 0.5 * np.sum(u * v, 2) / np.maximum(across, 1e-12 * max(float(across.max()), 1e-300))
    # limit the weights of degenerate triangles
    weights = np.clip(weights, 1e-3, 10.0).reshape(-1)
    owners = np.repeat(np.arange(len(faces)), 3)
    bridges = _connect_components(target, faces)
    if len(bridges):
        some = np.zeros(count, int)
        some[faces] = np.arange(len(faces))[:, None]
        sides = np.concatenate([sides, bridges])
        weights = np.concatenate([weights, np.full(len(bridges), BRIDGE_WEIGHT)])
        owners = np.concatenate([np.stack([owners, owners], 1), some[bridges]])
    else:
        owners = np.stack([owners, owners], 1)
    rows = np.arange(len(sides))
    ones = np.ones(len(sides))
    incidence = scipy.sparse.csr_array(
        (np.concatenate([ones, -ones]), (np.tile(rows, 2), sides.T.reshape(-1))), shape=(len(sides), count)
    )
    matrix = incidence.T @ scipy.sparse.diags_array(weights) @ incidence
    # fix one vertex, as the translation is arbitrary
    matrix = matrix + scipy.sparse.csr_array(([1.0], ([0], [0])), shape=matrix.shape)
    return PoseTransfer(
        faces,
        inverse(_triangle_frames(source, faces)),
        sides,
        owners,
        target[sides[:, 0]] - target[sides[:, 1]],
        weights,
        factor_sparse(matrix),
        count,
        _bridge_similarities(source, target, bridges),
    )


def transfer_pose(
    transfer: PoseTransfer, posed: Float[np.ndarray, "V 3"], scale: float = 1.0
) -> Float[np.ndarray, "V 3"]:
    """Transfer the pose of the source's vertices `posed` to the target; the result is centred at its mean.

    `scale` is the scale of the source relative to rest, which the target does not take over.
    """
    deformations = _triangle_frames(np.asarray(posed, float), transfer.faces) @ transfer.frames / scale
    each = 0.5 * (deformations[transfer.owners[:, 0]] + deformations[transfer.owners[:, 1]])
    wanted = np.einsum("eab,eb->ea", each, transfer.sides)
    count = len(transfer.bridges)
    if count:
        # bridges are not deformed: the source's bridge, with the rotation and scale from source to target at
        # rest
        turns = nearest_rotation(each[-count:])
        ends = np.asarray(posed, float)[transfer.ends[-count:]]
        own = np.einsum("eba,eb->ea", turns, ends[:, 0] - ends[:, 1]) / scale
        wanted[-count:] = np.einsum("eab,ebc,ec->ea", turns, transfer.bridges, own)
    wanted *= transfer.weights[:, None]
    right = np.zeros((transfer.count, 3))
    np.add.at(right, transfer.ends[:, 0], wanted)
    np.subtract.at(right, transfer.ends[:, 1], wanted)
    vertices = transfer.factor.solve(right)
    return vertices - vertices.mean(0)


def _triangle_frames(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Compute the frame of each triangle, with two sides and the normal as columns, (T, 3, 3).

    The length of the normal is the square root of the cross product of the sides, so it scales with them
    (Sumner and Popović, section 3).
    """
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    first, second = b - a, c - a
    normal = np.cross(first, second)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.sqrt(np.maximum(length, 1e-12 * max(float(length.max()), 1e-300)))
    return np.stack([first, second, normal], 2)


def _bridge_similarities(source: np.ndarray, target: np.ndarray, bridges: np.ndarray) -> np.ndarray:
    """Compute the shortest rotation from source to target bridges at rest, times the ratio of their lengths,
    (B, 3, 3)."""
    found = np.tile(np.eye(3), (len(bridges), 1, 1))
    for row, (end, start) in enumerate(bridges):
        here, there = source[end] - source[start], target[end] - target[start]
        lengths = np.linalg.norm(here), np.linalg.norm(there)
        if min(lengths) > 1e-9:
            turn = Rotation.align_vectors(there[None], here[None])[0].as_matrix()
            found[row] = lengths[1] / lengths[0] * turn
    return found


def _connect_components(vertices: np.ndarray, faces: np.ndarray) -> Int[np.ndarray, "B 2"]:
    """Find pairs of vertices that join all pieces to one, from the largest piece on, each at its nearest
    vertices."""
    edges = mesh_edges(faces)
    graph = scipy.sparse.csr_array((np.ones(len(edges)), edges.T), shape=(len(vertices), len(vertices)))
    pieces, labels = connected_components(graph, directed=False)
    labels = np.asarray(labels).reshape(-1)
    joined = labels == np.argmax(np.bincount(labels, minlength=pieces))
    found = []
    while not joined.all():
        inside, outside = np.flatnonzero(joined), np.flatnonzero(~joined)
        distances, nearest = KDTree(vertices[inside]).query(vertices[outside])
        best = int(np.argmin(distances))
        found.append([outside[best], inside[np.asarray(nearest)[best]]])
        joined |= labels == labels[outside[best]]
    return np.array(found, int).reshape(-1, 2)
