"""Sweeps of block coordinate descent over the vertices of a body, one colour at a time."""

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...body.body import Body, posed_vertices
from ...body.pose import Pose
from ...geometry.laplacian import Conformance, laplacian
from .linear_weights import LinearWeightSolver, RigidWeightSolver
from .swing_twist_weights import NUM_NEIGHBOURS, SwingTwistWeightSolver


class ErrorField(NamedTuple):
    """Errors of all vertices, and the Laplacians of the errors, metres, frames last."""

    errors: Float[Array, "V 3 F"]
    laplacians: Float[Array, "V 3 F"]


class SweepResult(NamedTuple):
    """Weights after a sweep, the matching error field, and the vertices that changed."""

    rows: Any
    field: ErrorField
    changed: Bool[Array, "V"]


@eqx.filter_jit
def error_field(body: Body, poses: Pose, targets: Float[Array, "F V 3"], metric: Conformance) -> ErrorField:
    """Compute the errors of a body in its poses, and their Laplacians."""
    errors = jnp.transpose(targets - posed_vertices(body, poses), (1, 2, 0))
    return ErrorField(errors, laplacian(metric, errors.reshape(len(errors), -1)).reshape(errors.shape))


@jax.jit
def field_energy(field: ErrorField, metric: Conformance) -> Float[Array, ""]:
    """Compute Q (Adaptation, eq. 3.19), squared metres."""
    return jnp.sum(field.errors**2) + metric.alpha * jnp.sum(field.laplacians**2)


def scale_alpha(metric: Conformance, share: float) -> Conformance:
    """Scale the weight of the Laplacian term in the metric."""
    softer = share * metric.alpha, 1.0 + share * (metric.diagonal - 1.0)
    return eqx.tree_at(lambda m: (m.alpha, m.diagonal), metric, softer)


@functools.partial(jax.jit, donate_argnames="field")
def sweep(
    solver: SwingTwistWeightSolver | LinearWeightSolver | RigidWeightSolver,
    rows,
    field: ErrorField,
    rest: Float[Array, "V 3 N"],
    metric: Conformance,
    blocks: Int[Array, "B C"],
    slide_length: Float[Array, ""],
    relaxation: Float[Array, ""],
    num_candidates: Int[Array, ""],
    neighbour_offset: Int[Array, ""],
) -> SweepResult:
    """Update the weights of the vertices of every block, block after block.

    **Arguments:** `rows` are the weights of all vertices in the format of the `solver`; `rest` are the vertices at rest,
    one column for all frames or one for each; `blocks` are
    vertices of which no two are coupled by the metric, padded with V; `slide_length`, `relaxation`,
    `num_candidates` as in `SwingTwistWeightSolver.solve`; `neighbour_offset` selects the neighbours whose
    weights are tried. The buffer of `field` is donated.
    """
    total = len(rest)
    real = metric.neighbours != jnp.arange(total)[:, None]
    shares = metric.inverse_degrees[:, None, None]
    slots = range(metric.neighbours.shape[1])
    # gains below this are rounding errors
    least = 100 * jnp.finfo(rest.dtype).eps

    def visit(carry, block):
        rows, field, changed = carry
        vertices = jnp.minimum(block, total - 1)
        ring, adjacent = metric.neighbours[vertices], real[vertices]
        inside = jnp.where(shares[vertices] > 0, 1.0, 0.0).astype(rest.dtype)
        back = inside * field.laplacians[vertices]
        for i in slots:
            near = ring[:, i]
            back = back - jnp.where(adjacent[:, i, None, None], shares[near] * field.laplacians[near], 0.0)
        weight = metric.diagonal[vertices][:, None, None]
        aims = (field.errors[vertices] + metric.alpha * back) / weight
        take = lambda at: jax.tree.map(lambda row: row[at], rows)  # noqa: E731
        lent = [
            take(jnp.take(ring, (neighbour_offset + i) % len(slots), axis=1)) for i in range(NUM_NEIGHBOURS)
        ]
        new, shift, gain = solver.solve(
            take(vertices), lent, rest[vertices], aims, slide_length, relaxation, num_candidates
        )
        better = (block < total) & (gain > least * jnp.sum(aims**2, (1, 2)))
        put = jnp.where(better, block, total)
        rows = jax.tree.map(lambda row, fresh: row.at[put].set(fresh, mode="drop"), rows, new)
        errors = field.errors.at[put].add(-shift, mode="drop")
        rough = field.laplacians.at[put].add(-inside * shift, mode="drop")
        for i in slots:
            near = jnp.where(better & adjacent[:, i], ring[:, i], total)
            rough = rough.at[near].add(shares[ring[:, i]] * shift, mode="drop")
        return (rows, ErrorField(errors, rough), changed.at[put].set(True, mode="drop")), None

    return SweepResult(*jax.lax.scan(visit, (rows, field, jnp.zeros(total, bool)), blocks)[0])


def make_blocks(
    colours: Int[np.ndarray, "V"], active: Bool[np.ndarray, "V"], order: Int[np.ndarray, "V"]
) -> Int[np.ndarray, "B C"]:
    """Group the active vertices by colour, one row each, padded with V to one of a few widths."""
    order = order[active[order]]
    order = order[np.argsort(colours[order], kind="stable")]
    number = int(colours.max()) + 1
    sizes = np.bincount(colours[order], minlength=number)
    width = int(np.bincount(colours).max())
    while width // 4 >= max(int(sizes.max()), 8):
        width //= 4
    blocks = np.full((number, width), len(colours), np.int32)
    starts = np.cumsum(sizes) - sizes
    blocks[colours[order], np.arange(len(order)) - starts[colours[order]]] = order
    return blocks
