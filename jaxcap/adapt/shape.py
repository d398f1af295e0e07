"""Rest vertices from the pairs of many frames, held to the shape that people have (Adaptation, 4.1.3)."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from jaxtyping import Array, Float

from ..body.body import Body, deform_all
from ..body.pose import Pose
from ..edit.sample import sample_poses
from ..fit.correspond import Pairs
from ..geometry.laplacian import laplacian_matrix, vertex_adjacency
from .equations import pair_rows, vertex_maps


class ShapePrior(NamedTuple):
    """Laplacian vectors that a body is to keep (eq. 4.12), in each of some poses."""

    #: (V, V) the uniform Laplacian of the mesh
    laplacian: scipy.sparse.csr_matrix
    poses: Pose
    vectors: Float[np.ndarray, "M V 3"]


def make_shape_prior(body: Body, poses: Pose, meshes: Float[np.ndarray, "M V 3"]) -> ShapePrior:
    """The Laplacian vectors (eq. 4.2) of registered meshes of the template in known poses."""
    count = len(body.vertices)
    adjacency = vertex_adjacency(np.asarray(body.faces), count)
    matrix = scipy.sparse.csr_matrix(laplacian_matrix(adjacency))
    return ShapePrior(matrix, poses, np.stack([matrix @ np.asarray(mesh, float) for mesh in meshes]))


def own_shape_prior(body: Body, count: int = 5) -> ShapePrior:
    """The Laplacian vectors of a body itself, at rest and in some poses that it may take."""
    poses = sample_poses(body.skeleton, count)
    return make_shape_prior(body, poses, np.asarray(deform_all(body, poses), float))


def adapt_shape(
    body: Body, poses: Pose, pairs: Pairs, prior: ShapePrior, weight: float, hold: float = 1e-4
) -> Body:
    """The rest vertices that make least of the pairs' squared distances, summed over frames, plus `weight`
    times the squared change of the Laplacian vectors, mean over the prior's poses: one sparse system.

    `hold` ties every vertex weakly to where it is, as a part that no scan shows is only known by its shape.
    """
    blocks, sides = (np.asarray(part, float) for part in _data(body, poses, pairs))
    count = len(body.vertices)
    # a pair's weight is one at most, so a vertex weighs about as many as frames show it
    matrix = _block_diagonal(blocks + hold * np.eye(3))
    side = sides.reshape(-1)
    maps, places = (np.asarray(part, float) for part in _maps(body, prior.poses))
    wide = scipy.sparse.kron(prior.laplacian, scipy.sparse.identity(3), format="csr")
    share = weight / len(prior.vectors)
    for number in range(len(prior.vectors)):
        rough = wide @ _block_diagonal(maps[number])
        missing = (prior.vectors[number] - prior.laplacian @ places[number]).reshape(-1)
        matrix = matrix + share * (rough.T @ rough)
        side = side + share * (rough.T @ missing)
    step = scipy.sparse.linalg.spsolve(matrix.tocsc(), side).reshape(count, 3)
    vertices = body.vertices + jnp.asarray(step, body.vertices.dtype)
    return eqx.tree_at(lambda b: b.vertices, body, vertices)


@eqx.filter_jit
def _data(body: Body, poses: Pose, pairs: Pairs) -> tuple[Float[Array, "V 3 3"], Float[Array, "V 3"]]:
    """Each vertex's own normal equations, summed over frames."""

    def of_frame(frame):
        pose, pairs = frame
        maps, places = vertex_maps(body, pose)
        directions = pair_rows(pairs)
        rows = jnp.einsum("cra,cab->crb", directions, maps[pairs.vertices])
        apart = jnp.einsum("cra,ca->cr", directions, pairs.points - places[pairs.vertices])
        zero = jnp.zeros((len(body.vertices), 3, 3), rows.dtype)
        matrices = zero.at[pairs.vertices].add(jnp.einsum("cra,crb->cab", rows, rows))
        sides = zero[:, 0].at[pairs.vertices].add(jnp.einsum("cra,cr->ca", rows, apart))
        return matrices, sides

    matrices, sides = jax.lax.map(of_frame, (poses, pairs))
    return jnp.sum(matrices, 0), jnp.sum(sides, 0)


@eqx.filter_jit
def _maps(body: Body, poses: Pose):
    return jax.lax.map(lambda pose: vertex_maps(body, pose), poses)


def _block_diagonal(blocks: Float[np.ndarray, "V 3 3"]) -> scipy.sparse.csr_matrix:
    count = len(blocks)
    where = np.arange(count)
    wide = scipy.sparse.bsr_matrix((blocks, where, np.arange(count + 1)), shape=(3 * count, 3 * count))
    return scipy.sparse.csr_matrix(wide)
