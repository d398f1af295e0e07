"""The shape around every vertex, as training meshes show it (Adaptation, 4.1.1 and 4.1.3): Laplacian
vectors."""

from typing import NamedTuple

import equinox as eqx
import numpy as np
import scipy.sparse
from jaxtyping import Float, Int

from ...arguments import checked
from ...body.body import Body, deform_all
from ...body.people.sample import sample_poses
from ...body.pose import Pose
from ...geometry.laplacian import laplacian_matrix, vertex_adjacency

_deform_all = eqx.filter_jit(deform_all)


class ShapePrior(NamedTuple):
    """Laplacian vectors that a body is to keep (eq. 4.12), in each of some poses."""

    #: (V, V) the uniform Laplacian of the mesh
    laplacian: scipy.sparse.csr_matrix
    #: of the body in each mesh, stacked
    poses: Pose
    #: from the mean of its neighbours to each vertex (eq. 4.2), in the world, metres
    vectors: Float[np.ndarray, "M V 3"]


@checked
def make_shape_prior(body: Body, poses: Pose, meshes: Float[np.ndarray, "M V 3"]) -> ShapePrior:
    """The Laplacian vectors of meshes registered to a body, `L(v) = v - mean of its neighbours` (eq. 4.2).

    **Arguments:** `poses`, those of the body in each mesh, stacked; `meshes`, metres.

    **Raises:** `ValueError` where there are no poses, they are of other joints than the body's, there are
    other numbers of meshes than of poses or of vertices than the body has, or a mesh is not finite.
    """
    count = len(poses.rotations) if poses.rotations.ndim == 3 else 0
    if not count:
        raise ValueError("There are no poses of training meshes; give them stacked over meshes.")
    joints = poses.rotations.shape[1]
    if joints != body.skeleton.num_joints:
        raise ValueError(f"The poses are of {joints} joints, and the body has {body.skeleton.num_joints}.")
    if meshes.shape[:2] != (count, len(body.vertices)):
        raise ValueError(
            f"There are {meshes.shape[0]} meshes of {meshes.shape[1]} vertices for {count} poses of a body of "
            f"{len(body.vertices)}; register them to the body."
        )
    whole = np.isfinite(meshes).all((1, 2))
    if not whole.all():
        raise ValueError(f"Mesh {whole.argmin()} is not finite everywhere; give meshes that are whole.")
    matrix = uniform_laplacian(body)
    return ShapePrior(matrix, poses, np.stack([matrix @ np.asarray(mesh, float) for mesh in meshes]))


def own_shape_prior(body: Body, count: int = 5) -> ShapePrior:
    """The Laplacian vectors of a body itself, at rest and in some poses that it may take."""
    poses = sample_poses(body.skeleton, count)
    return make_shape_prior(body, poses, np.asarray(_deform_all(body, poses), float))


def uniform_laplacian(body: Body) -> scipy.sparse.csr_matrix:
    """(V, V) what takes from each vertex the mean of its neighbours (eq. 4.2); zero for one that has none."""
    adjacency = vertex_adjacency(np.asarray(body.faces), len(body.vertices))
    return scipy.sparse.csr_matrix(laplacian_matrix(adjacency))


def neighbours_in(prior: ShapePrior) -> Int[np.ndarray, "E 2"]:
    """Every two vertices that a prior knows as neighbours, once, the lesser first, in rising order."""
    upper = scipy.sparse.triu(prior.laplacian, 1, format="coo")
    edges = np.stack([upper.row, upper.col], 1).astype(np.int64)
    return edges[np.lexsort((edges[:, 1], edges[:, 0]))]


def shape_energy(prior: ShapePrior, body: Body) -> float:
    """`Q = 1/(M V) sum |L(v_m) - L(T_m(v))|^2`, metres squared: how far the body's Laplacian vectors are from
    the prior's, mean over meshes and vertices (eqs. 4.11 and 4.12)."""
    meshes = np.asarray(_deform_all(body, prior.poses), float)
    apart = np.stack([prior.laplacian @ mesh for mesh in meshes]) - prior.vectors
    return float(np.mean(np.sum(apart**2, -1)))


def scaled(prior: ShapePrior, size: float) -> ShapePrior:
    """The prior of the body and its meshes, `size` times as large about the origin.

    **Raises:** `ValueError` where the size is not above zero.
    """
    if not 0 < size < np.inf:
        raise ValueError(f"The size is {size:g}; it must be above 0.")
    poses = Pose(prior.poses.translations * size, prior.poses.rotations, prior.poses.scale)
    return ShapePrior(prior.laplacian, poses, prior.vectors * size)
