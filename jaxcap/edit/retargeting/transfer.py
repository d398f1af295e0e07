"""Deformation transfer: the pose of one surface on another of the same triangles and another build.

Sumner and Popović, *Deformation Transfer for Triangle Meshes* (2004): each triangle of the target is deformed as the
source's is, by the matrix that leads from its sides at rest to those in the pose; and since triangles
meet, the vertices are those whose sides come nearest to that in least squares (there section 3.1, here in the form of
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

#: what a side that joins two pieces of a surface weighs, beside sides within them
BRIDGE = 1.0


class Transfer(NamedTuple):
    """What does not change over the frames; E sides of triangles and bridges."""

    faces: Int[np.ndarray, "T 3"]
    #: (T, 3, 3) from a side's coordinates in the pose to a triangle's deformation: the inverse of its frame at rest
    frames: Float[np.ndarray, "T 3 3"]
    #: ends of the sides
    ends: Int[np.ndarray, "E 2"]
    #: (E, 2) triangles whose deformations a side takes the mean of
    owners: Int[np.ndarray, "E 2"]
    #: the sides of the target at rest, metres
    sides: Float[np.ndarray, "E 3"]
    weights: Float[np.ndarray, "E"]
    factor: scipy.sparse.linalg.SuperLU
    count: int
    #: (B, 3, 3) for the bridges, the last of the sides: what turns and stretches a source's at rest to the target's
    bridges: Float[np.ndarray, "B 3 3"]


def make_transfer(
    source: Float[np.ndarray, "V 3"], target: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "T 3"]
) -> Transfer:
    """Prepare the transfer from one surface at rest to another, metres; the system is factorised once.

    Pieces of a surface that hang together by nothing are joined where they are nearest to each other.

    **Raises:** `ValueError` where there are no faces, or a vertex is in none.
    """
    source, target, faces = np.asarray(source, float), np.asarray(target, float), np.asarray(faces)
    count = len(source)
    used = np.zeros(count, bool)
    used[faces] = True
    if not used.all():
        raise ValueError(
            f"{int((~used).sum())} of {count} vertices are in no face, so no triangle tells where they go; remove them."
        )
    sides = faces[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2)
    corners = target[faces]
    # half the cotangent of the angle across each side, in the order of `sides`
    u, v = corners[:, [1, 2, 0]] - corners, corners[:, [2, 0, 1]] - corners
    across = np.linalg.norm(np.cross(u, v), axis=2)
    weights = 0.5 * np.sum(u * v, 2) / np.maximum(across, 1e-12 * max(float(across.max()), 1e-300))
    # needles would weigh more than all else
    weights = np.clip(weights, 1e-3, 10.0).reshape(-1)
    owners = np.repeat(np.arange(len(faces)), 3)
    bridges = _bridges(target, faces)
    if len(bridges):
        some = np.zeros(count, int)
        some[faces] = np.arange(len(faces))[:, None]
        sides = np.concatenate([sides, bridges])
        weights = np.concatenate([weights, np.full(len(bridges), BRIDGE)])
        owners = np.concatenate([np.stack([owners, owners], 1), some[bridges]])
    else:
        owners = np.stack([owners, owners], 1)
    rows = np.arange(len(sides))
    ones = np.ones(len(sides))
    incidence = scipy.sparse.csr_array(
        (np.concatenate([ones, -ones]), (np.tile(rows, 2), sides.T.reshape(-1))), shape=(len(sides), count)
    )
    matrix = incidence.T @ scipy.sparse.diags_array(weights) @ incidence
    # one vertex is held, as the surface may be anywhere
    matrix = matrix + scipy.sparse.csr_array(([1.0], ([0], [0])), shape=matrix.shape)
    return Transfer(
        faces,
        inverse(_frames(source, faces)),
        sides,
        owners,
        target[sides[:, 0]] - target[sides[:, 1]],
        weights,
        factor_sparse(matrix),
        count,
        _similarities(source, target, bridges),
    )


def transfer_pose(
    transfer: Transfer, posed: Float[np.ndarray, "V 3"], scale: float = 1.0
) -> Float[np.ndarray, "V 3"]:
    """The target's vertices as the source's are `posed`, about their mean; `scale` is what the source is larger
    by than at rest, and the target is not."""
    deformations = _frames(np.asarray(posed, float), transfer.faces) @ transfer.frames / scale
    each = 0.5 * (deformations[transfer.owners[:, 0]] + deformations[transfer.owners[:, 1]])
    wanted = np.einsum("eab,eb->ea", each, transfer.sides)
    count = len(transfer.bridges)
    if count:
        # between pieces nothing is deformed: the source's own way, as much longer and elsewhere as at rest
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


def _frames(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(T, 3, 3) two sides and the normal of each triangle as columns; the normal is as long as the root of the
    area, so that it grows with the sides (Sumner and Popović, section 3)."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    first, second = b - a, c - a
    normal = np.cross(first, second)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.sqrt(np.maximum(length, 1e-12 * max(float(length.max()), 1e-300)))
    return np.stack([first, second, normal], 2)


def _similarities(source: np.ndarray, target: np.ndarray, bridges: np.ndarray) -> np.ndarray:
    """(B, 3, 3) the shortest turn of a way at rest onto another, times the ratio of their lengths."""
    found = np.tile(np.eye(3), (len(bridges), 1, 1))
    for row, (end, start) in enumerate(bridges):
        here, there = source[end] - source[start], target[end] - target[start]
        lengths = np.linalg.norm(here), np.linalg.norm(there)
        if min(lengths) > 1e-9:
            turn = Rotation.align_vectors(there[None], here[None])[0].as_matrix()
            found[row] = lengths[1] / lengths[0] * turn
    return found


def _bridges(vertices: np.ndarray, faces: np.ndarray) -> Int[np.ndarray, "B 2"]:
    """Pairs of vertices that join all pieces to one, the largest piece first and then each where it is nearest."""
    edges = mesh_edges(faces)
    graph = scipy.sparse.csr_array((np.ones(len(edges)), edges.T), shape=(len(vertices), len(vertices)))
    pieces, labels = connected_components(graph, directed=False)
    labels = np.asarray(labels).reshape(-1)
    joined = labels == np.argmax(np.bincount(labels, minlength=pieces))
    found = []
    while not joined.all():
        inside, outside = np.flatnonzero(joined), np.flatnonzero(~joined)
        apart, nearest = KDTree(vertices[inside]).query(vertices[outside])
        best = int(np.argmin(apart))
        found.append([outside[best], inside[np.asarray(nearest)[best]]])
        joined |= labels == labels[outside[best]]
    return np.array(found, int).reshape(-1, 2)
