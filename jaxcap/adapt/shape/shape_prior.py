"""Shape priors: Laplacian vectors of training meshes (Adaptation, 4.1.1 and 4.1.3)."""

from typing import NamedTuple

import equinox as eqx
import numpy as np
import scipy.sparse
from jaxtyping import Float, Int

from ...arguments import checked
from ...body.body import Body, posed_vertices
from ...body.people.sample import sample_poses
from ...body.pose import Pose
from ...geometry.laplacian import laplacian_matrix, vertex_adjacency

_deform_all = eqx.filter_jit(posed_vertices)


class ShapePrior(NamedTuple):
    """The expected Laplacian vectors of a body (eq. 4.12) in each of several poses."""

    #: (V, V) the uniform Laplacian of the mesh
    laplacian: scipy.sparse.csr_matrix
    #: the body's pose in each mesh, stacked
    poses: Pose
    #: from the mean of its neighbours to each vertex (eq. 4.2), in the world, metres
    vectors: Float[np.ndarray, "M V 3"]


@checked
def make_shape_prior(body: Body, poses: Pose, meshes: Float[np.ndarray, "M V 3"]) -> ShapePrior:
    """Compute the Laplacian vectors of meshes registered to a body.

    The Laplacian is `L(v) = v - mean of its neighbours` (eq. 4.2).

    **Arguments:** `poses`, the body's pose in each mesh, stacked; `meshes`, metres.

    **Raises:** `ValueError` if there are no poses, if the numbers of joints, meshes or vertices do not match,
    or if a mesh is not finite.
    """
    count = len(poses.rotations) if poses.rotations.ndim == 3 else 0
    if not count:
        raise ValueError("There are no poses of training meshes; give poses stacked over meshes.")
    joints = poses.rotations.shape[1]
    if joints != body.skeleton.num_joints:
        raise ValueError(
            f"The poses have {joints} joints; expected {body.skeleton.num_joints}, as in the body."
        )
    if meshes.shape[:2] != (count, len(body.vertices)):
        raise ValueError(
            f"There are {meshes.shape[0]} meshes of {meshes.shape[1]} vertices; expected {count}, one for each pose, of "
            f"{len(body.vertices)}, as in the body; register the meshes to the body."
        )
    whole = np.isfinite(meshes).all((1, 2))
    if not whole.all():
        raise ValueError(f"Mesh {whole.argmin()} is not finite; leave it out.")
    matrix = uniform_laplacian(body)
    return ShapePrior(matrix, poses, np.stack([matrix @ np.asarray(mesh, float) for mesh in meshes]))


def body_shape_prior(body: Body, count: int = 5) -> ShapePrior:
    """Make the shape prior of a body itself, at rest and in sampled poses."""
    poses = sample_poses(body.skeleton, count)
    return make_shape_prior(body, poses, np.asarray(_deform_all(body, poses), float))


def uniform_laplacian(body: Body) -> scipy.sparse.csr_matrix:
    """Build the uniform Laplacian (V, V) (eq. 4.2); rows of isolated vertices are zero."""
    adjacency = vertex_adjacency(np.asarray(body.faces), len(body.vertices))
    return scipy.sparse.csr_matrix(laplacian_matrix(adjacency))


def prior_edges(prior: ShapePrior) -> Int[np.ndarray, "E 2"]:
    """List the edges of a prior's mesh, each once, the smaller index first, in ascending order."""
    upper = scipy.sparse.triu(prior.laplacian, 1, format="coo")
    edges = np.stack([upper.row, upper.col], 1).astype(np.int64)
    return edges[np.lexsort((edges[:, 1], edges[:, 0]))]


def shape_energy(prior: ShapePrior, body: Body) -> float:
    """Compute the mean squared change of a body's Laplacian vectors from the prior's, metres squared.

    `Q = 1/(M V) sum |L(v_m) - L(T_m(v))|^2`, the mean over meshes and vertices (eqs. 4.11 and 4.12).
    """
    meshes = np.asarray(_deform_all(body, prior.poses), float)
    differences = np.stack([prior.laplacian @ mesh for mesh in meshes]) - prior.vectors
    return float(np.mean(np.sum(differences**2, -1)))


def scale_shape_prior(prior: ShapePrior, size: float) -> ShapePrior:
    """Scale a prior by `size` about the origin.

    **Raises:** `ValueError` if the size is not above zero.
    """
    if not 0 < size < np.inf:
        raise ValueError(f"The size is {size:g}; expected a finite number above 0.")
    poses = Pose(prior.poses.translations * size, prior.poses.rotations, prior.poses.scale)
    return ShapePrior(prior.laplacian, poses, prior.vectors * size)
