"""What frames and training meshes say of the amounts of modes and of rest vertices, summed up (Adaptation, 4.1.3 and 4.1.4).

A pose is of one frame alone, so that Cholesky takes it out of the equations while these are summed.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float, Int

from ..body.body import Body
from ..body.kinematics import forward_kinematics
from ..body.pose import Pose
from ..body.shape_modes import Modes, moved
from ..energy.term import AbstractEnergy
from ..fit.correspond import Pairs
from .equations import frame_rows, num_pairs, pair_rows, vertex_maps, with_prior


class Weights(NamedTuple):
    """What each term counts."""

    #: of the pose prior against the mean squared distance of a pair, metres squared
    pose: float | Float[Array, ""]
    #: of squared changes of Laplacian vectors, mean over meshes, against the sum of the pairs' squared distances
    shape: float | Float[Array, ""]
    #: standard deviation of a pair's distance, metres, against which beliefs count
    deviation: float | Float[Array, ""]
    #: of every vertex's squared shift, as a part that no scan shows is only known by its shape
    hold: float | Float[Array, ""] = 1e-4


class Sparse(eqx.Module):
    """A matrix by its numbers, or blocks of it."""

    rows: Int[Array, "N"]
    columns: Int[Array, "N"]
    values: Float[Array, "N *block"]

    def __matmul__(self, x: Float[Array, "V *k"]) -> Float[Array, "V *k"]:
        if self.values.ndim == 3:
            return jax.ops.segment_sum(
                jnp.einsum("nab,nb->na", self.values, x[self.columns]), self.rows, len(x)
            )
        by = self.values.reshape(-1, *[1] * (x.ndim - 1))
        return jax.ops.segment_sum(by * x[self.columns], self.rows, len(x))

    @property
    def transposed(self) -> "Sparse":
        return Sparse(self.columns, self.rows, self.values)


class ShapeArrays(eqx.Module):
    """A `ShapePrior` as arrays, with what it couples."""

    laplacian: Sparse
    #: `L^T L`
    squared: Sparse
    poses: Pose
    vectors: Float[Array, "M V 3"]


class Rest(NamedTuple):
    """What is left of the equations by the amounts and the vertices, summed up."""

    matrix: Float[Array, "K K"]
    coupling: Float[Array, "V 3 K"]
    side: Float[Array, "K"]
    vertex_side: Float[Array, "V 3"]


class Eliminated(NamedTuple):
    """A frame that is eliminated: the factor of its pose's equations, and its inverse times what stands beside it."""

    factor: Float[Array, "*F D D"]
    amounts: Float[Array, "*F D K"]
    vertices: Float[Array, "*F D V 3"]
    side: Float[Array, "*F D"]


def add_mesh(
    body: Body,
    shape: ShapeArrays,
    modes: Modes,
    weights: Weights,
    rest: Rest,
    pose: Pose,
    vectors: Float[Array, "V 3"],
) -> tuple[Rest, Float[Array, "N 3 3"]]:
    """With what the Laplacian vectors of a training mesh say; and the blocks of its vertices."""
    maps, places = vertex_maps(body, pose)

    def posed(amounts: Float[Array, "K"]) -> Float[Array, "V 3"]:
        there = moved(body, modes, amounts)
        return there.skin.deform(
            there.vertices, there.skeleton, pose, forward_kinematics(there.skeleton, pose)
        )

    share = weights.shape / len(shape.vectors)
    slopes = shape.laplacian @ jax.jacfwd(posed)(jnp.zeros_like(rest.side))
    missing = vectors - shape.laplacian @ places
    pulled = shape.laplacian.transposed @ jnp.concatenate([slopes, missing[..., None]], -1)
    pulled = share * jnp.einsum("vba,vbk->vak", maps, pulled)
    flat = slopes.reshape(-1, len(rest.side))
    rest = Rest(
        rest.matrix + share * flat.T @ flat,
        rest.coupling + pulled[..., :-1],
        rest.side + share * flat.T @ missing.reshape(-1),
        rest.vertex_side + pulled[..., -1],
    )
    both = jnp.einsum("nba,nbc->nac", maps[shape.squared.rows], maps[shape.squared.columns])
    return rest, share * shape.squared.values[:, None, None] * both


def add_frame(
    body: Body, prior: AbstractEnergy, modes: Modes, weights: Weights, rest: Rest, pose: Pose, pairs: Pairs
) -> tuple[Rest, Eliminated]:
    """With what a frame says of amounts and vertices once its pose is eliminated; prior and ridge as in `adapt_shared`."""
    dofs, count = body.skeleton.num_dofs, len(body.vertices)
    rows, apart = frame_rows(body, pose, pairs, modes)
    maps, _ = vertex_maps(body, pose)
    by_vertex = jnp.einsum("ck,cra,ckab->ckrb", pairs.shares, pair_rows(pairs), maps[pairs.vertices])
    pulled = jnp.einsum("ckrb,crn->ckbn", by_vertex, rows.reshape(-1, 3, rows.shape[1]))
    coupling = jnp.zeros((count, 3, rows.shape[1]), rows.dtype).at[pairs.vertices].add(pulled)
    matrix, side = rows.T @ rows, rows.T @ apart

    scale = weights.pose * num_pairs(pairs)
    own, own_side = with_prior(matrix[:dofs, :dofs], side[:dofs], body, pose, prior, scale)
    diagonal = jnp.diag(own)
    factor = jnp.linalg.cholesky(own + jnp.diag(1e-3 * diagonal + 1e-6 * jnp.max(diagonal)))
    beside = [matrix[:dofs, dofs:], coupling[..., :dofs].reshape(-1, dofs).T]
    beside += [own_side[:, None]]
    solved = solve_triangular(factor, jnp.concatenate(beside, 1), lower=True)
    amounts, vertices, known = jnp.split(solved, [matrix.shape[0] - dofs, solved.shape[1] - 1], 1)
    vertices, known = vertices.reshape(dofs, count, 3), known[:, 0]
    rest = Rest(
        rest.matrix + matrix[dofs:, dofs:] - amounts.T @ amounts,
        rest.coupling + coupling[..., dofs:] - jnp.einsum("dva,dk->vak", vertices, amounts),
        rest.side + side[dofs:] - amounts.T @ known,
        rest.vertex_side - jnp.tensordot(known, vertices, 1),
    )
    return rest, Eliminated(factor, amounts, vertices, known)
