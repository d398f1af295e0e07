"""Poses, joints and rest vertices in one step (Adaptation, 4.1.4: "a huge sparse equation system").

The unknowns are the numbers `d` of every frame's pose, the amounts `z` of modes, which move joints, and the shifts `e` of all
rest vertices. Frames meet only through `z` and `e`. Cholesky eliminates each frame's pose, and then the amounts:

    [ P_1              ]          P_f = L_f L_f^T        W_f = L_f^-1 Q_f
    [      P_2    Q_f  ]
    [                  ]          S = A - sum_f W_f^T W_f
    [      Q_f^T    A  ]

What is left, `S` on the vertices, is never formed. `A` is sparse, in 3 x 3 blocks of vertices that share a pair or lie within
two edges; `W` has as many rows as there are numbers that are eliminated; conjugate gradients take products with both.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jax.scipy.linalg import solve_triangular
from jax.scipy.sparse.linalg import cg
from jaxtyping import Array, Float, Int

from ..arguments import checked
from ..body.body import Body
from ..body.pose import Pose, retract
from ..body.shape_modes import Modes, bone_differences, moved
from ..energy.term import AbstractEnergy
from ..fit.correspond import Pairs
from ..geometry.mesh import mesh_edges
from .shape import pair_blocks, pair_slots
from .shape_prior import ShapePrior
from .shared import ALIKE, Belief
from .summed import Rest, ShapeArrays, Sparse, Weights, add_frame, add_mesh

#: steps of conjugate gradients at most
STEPS = 2000


@checked
def adapt_together(
    body: Body,
    poses: Pose,
    pairs: Pairs,
    prior: AbstractEnergy,
    shape: ShapePrior,
    modes: Modes,
    belief: Belief,
    mirrored: tuple[tuple[int, int], ...],
    weights: Weights,
    *,
    tolerance: float = 1e-5,
) -> tuple[Body, Pose]:
    """One Gauss-Newton step on all poses, the amounts of the modes and all rest vertices, with the terms and weights of
    `adapt_shared` and `adapt_shape`, of which it takes the place.

    As in these, beliefs and the pose prior are of modes and poses alone, and paired bones end equally long to first
    order (eq. 4.13 as a constraint): the amounts are the least that make them so, and what lies in the constraints' null
    space. Other than in these, the shape of the posed training meshes also depends on the joints (4.1.3).

    **Arguments:** `poses` and `pairs` stacked over frames; `modes`, as a rule `joint_modes(body, follow=False)`, as vertices
    move by themselves; `mirrored` pairs of joints of the left and the right; `tolerance`, the share of the right side at
    which conjugate gradients end.

    Differentiable by every array of numbers, in either mode: the iteration by the implicit function theorem, to its
    tolerance. Which vertices are in a pair must be known when it is called, so not under `jit`; it is jitted within.

    **Raises:** `ValueError` where two vertices of a pair share no edge.
    """
    count, dtype = len(body.vertices), body.vertices.dtype
    # vertices of one triangle are coupled by the pairs within it; those at vertices couple nothing
    edges = mesh_edges(np.asarray(body.faces)) if pairs.vertices.shape[-1] > 1 else np.zeros((0, 2), int)
    slots = jnp.asarray(pair_slots(pairs, edges, count), jnp.int32)

    def arrays(matrix) -> Sparse:
        known = scipy.sparse.coo_matrix(matrix)
        rows, columns = (jnp.asarray(part, jnp.int32) for part in (known.row, known.col))
        return Sparse(rows, columns, jnp.asarray(known.data, dtype))

    squared = shape.laplacian.T @ shape.laplacian
    # scans may be of another precision than the body
    poses, pairs, prior, modes, belief, shaped = jax.tree.map(
        lambda leaf: leaf.astype(dtype) if eqx.is_inexact_array(leaf) else leaf,
        (poses, pairs, prior, modes, belief, shape.poses),
    )
    known = ShapeArrays(arrays(shape.laplacian), arrays(squared), shaped, jnp.asarray(shape.vectors, dtype))
    amounts = Weights(*(jnp.asarray(part, dtype) for part in weights))
    coupled = jnp.asarray(edges, jnp.int32), slots
    limit = jnp.asarray(tolerance, dtype)
    return _step(body, poses, pairs, coupled, prior, known, modes, belief, mirrored, amounts, limit)


@eqx.filter_jit
def _step(
    body: Body,
    poses: Pose,
    pairs: Pairs,
    coupled: tuple[Int[Array, "E 2"], Int[Array, "F C P"]],
    prior: AbstractEnergy,
    shape: ShapeArrays,
    modes: Modes,
    belief: Belief,
    mirrored: tuple[tuple[int, int], ...],
    weights: Weights,
    tolerance: Float[Array, ""],
) -> tuple[Body, Pose]:
    # what is left is a difference of large numbers
    with jax.default_matmul_precision("highest"):
        left, side, back = _eliminated(
            body, poses, pairs, coupled, prior, shape, modes, belief, mirrored, weights
        )
        by_vertex = jnp.linalg.inv(jax.lax.stop_gradient(left.blocks()))
        found, _ = cg(
            left.product,
            side,
            tol=tolerance,  # pyright: ignore[reportArgumentType]
            maxiter=STEPS,
            M=lambda x: jnp.einsum("vab,vb->va", by_vertex, x),
        )
        by_frame, amounts = back(found)
    body = moved(body, modes, amounts)
    body = eqx.tree_at(lambda b: b.vertices, body, body.vertices + found)
    return body, jax.vmap(retract, (None, 0, 0))(body.skeleton, poses, by_frame)


class _Left(eqx.Module):
    """`A - W^T W`, with the rows of frames and of amounts."""

    matrix: Sparse
    frames: Float[Array, "F D V 3"]
    amounts: Float[Array, "K V 3"]

    def product(self, x: Float[Array, "V 3"]) -> Float[Array, "V 3"]:
        total = self.matrix @ x
        for rows in (self.frames.reshape(-1, x.size), self.amounts.reshape(-1, x.size)):
            total = total - ((rows @ x.reshape(-1)) @ rows).reshape(x.shape)
        return total

    def blocks(self) -> Float[Array, "V 3 3"]:
        """Those of `A` on the diagonal."""
        known = self.matrix
        own = (known.rows == known.columns)[:, None, None]
        return jax.ops.segment_sum(jnp.where(own, known.values, 0.0), known.rows, self.amounts.shape[1])


def _eliminated(body, poses, pairs, coupled, prior, shape, modes, belief, mirrored, weights):
    """What is left on the vertices, its right side, and what tells poses and amounts from its solution."""
    edges, slots = coupled
    blocks, side = pair_blocks(body, poses, pairs, slots, len(edges))
    hold = ALIKE * (weights.deviation / belief.deviation) ** 2
    start = Rest(
        jnp.diag(hold), jnp.zeros((*side.shape, len(hold)), side.dtype), hold * belief.expected, side
    )
    rest, by_shape = jax.lax.scan(
        lambda rest, mesh: add_mesh(body, shape, modes, weights, rest, *mesh),
        start,
        (shape.poses, shape.vectors),
    )
    # made again in reverse mode: the rows of all pairs are too much to keep
    add = jax.checkpoint(lambda rest, frame: add_frame(body, prior, modes, weights, rest, *frame))
    rest, frames = jax.lax.scan(add, rest, (poses, pairs))

    every = jnp.arange(len(side))
    tied = blocks[: len(side)] + weights.hold * jnp.eye(3, dtype=side.dtype)
    matrix = Sparse(
        jnp.concatenate([every, edges[:, 0], edges[:, 1], shape.squared.rows]),
        jnp.concatenate([every, edges[:, 1], edges[:, 0], shape.squared.columns]),
        jnp.concatenate(
            [tied, blocks[len(side) :], jnp.swapaxes(blocks[len(side) :], 1, 2), jnp.sum(by_shape, 0)]
        ),
    )
    free, least = _equal_bones(body, modes, mirrored)
    within = free @ rest.matrix @ free
    # outside of the null space, where nothing is asked, as large as within it
    outside = (jnp.trace(within) / len(free)) * (jnp.eye(len(free), dtype=free.dtype) - free)
    factor = _factor(within + outside)
    wide = (rest.coupling @ free).reshape(-1, len(free)).T
    amounts = solve_triangular(factor, wide, lower=True).reshape(-1, *side.shape)
    amount_side = solve_triangular(factor, free @ (rest.side - rest.matrix @ least), lower=True)
    side = rest.vertex_side - rest.coupling @ least - jnp.tensordot(amount_side, amounts, 1)

    def back(found: Float[Array, "V 3"]) -> tuple[Float[Array, "F D"], Float[Array, "K"]]:
        inner = amount_side - jnp.tensordot(amounts, found, 2)
        z = least + free @ solve_triangular(factor, inner, trans=1, lower=True)
        known = frames.side - frames.amounts @ z - jnp.tensordot(frames.vertices, found, 2)
        return jax.vmap(lambda f, x: solve_triangular(f, x, trans=1, lower=True))(frames.factor, known), z

    return _Left(matrix, frames.vertices, amounts), side, back


def _factor(matrix: Float[Array, "K K"]) -> Float[Array, "K K"]:
    """Of Cholesky, with as much on the diagonal as rounding may have taken."""
    given = len(matrix) * jnp.finfo(matrix.dtype).eps
    return jnp.linalg.cholesky(matrix + jnp.diag(given * jnp.diag(matrix)))


def _equal_bones(
    body: Body, modes: Modes, mirrored: tuple[tuple[int, int], ...]
) -> tuple[Float[Array, "K K"], Float[Array, "K"]]:
    """The projection of amounts that leaves the differences of paired bones as they are, and the least amounts that
    take them away."""
    differences, rows = bone_differences(body, modes, mirrored)
    every = jnp.eye(len(modes.centres), dtype=rows.dtype)
    if len(rows) == 0:
        return every, jnp.zeros(len(every), rows.dtype)
    inverse = jnp.linalg.pinv(rows)
    return every - inverse @ rows, -inverse @ differences
