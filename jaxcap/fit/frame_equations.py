"""Normal equations of one frame, by its pose and by the shared unknowns."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..body.body import Body, Posed, pose_body
from ..body.pose import Pose
from ..energy.data.vertices import AbstractVertexEnergy
from ..energy.energy import AbstractEnergy, Sum, terms_of, unweighted
from .linearise import BodyTangent, frame_jacobian, vertex_jacobian, weighted_derivatives

#: `|r|^2 / 2`, its gradient `J^T r` and its Gauss-Newton Hessian `J^T J`
NormalEquations = tuple[Float[Array, ""], Float[Array, "..."], Float[Array, "..."]]


def frame_equations(
    energy: AbstractEnergy,
    body: Body,
    pose: Pose,
    body_at: Callable[[Float[Array, "S"]], Body] | None = None,
    tangent: BodyTangent | None = None,
) -> NormalEquations:
    """Compute `|r|^2 / 2`, `J^T r` and `J^T J` of a frame by `[d, s]`; arguments as of `frame_jacobian`.

    A term with more rows than the vertices have coordinates is first summed over each vertex, without writing
    out its rows.
    """
    posed, terms = pose_body(body, pose), terms_of(energy)
    sums = [_vertex_equations(term, posed) for term in terms]
    others = tuple(term for term, part in zip(terms, sums, strict=True) if part is None)
    summed = [part for part in sums if part is not None]
    parts = []
    if others:
        residual, rows = frame_jacobian(Sum(others), body, pose, body_at, tangent)
        parts.append((0.5 * (residual @ residual), rows.T @ residual, rows.T @ rows))
    if summed:
        parts.append(_pull_back(_sum_equations(summed), vertex_jacobian(posed, tangent)))
    return _sum_equations(parts)


def _sum_equations(parts: Sequence[NormalEquations]) -> NormalEquations:
    return jax.tree.map(lambda *some: sum(some[1:], some[0]), *parts)


def _pull_back(equations: NormalEquations, jacobian: Float[Array, "V 3 N"]) -> NormalEquations:
    """Transform equations of the vertices into equations of the unknowns, by the vertices' Jacobian."""
    value, sides, matrices = equations
    # written out, because batched products per vertex are slow on a CPU
    across = [
        sum(
            (matrices[:, a, b, None] * jacobian[:, b] for b in (1, 2)),
            matrices[:, a, 0, None] * jacobian[:, 0],
        )
        for a in range(3)
    ]
    flat = jacobian.reshape(-1, jacobian.shape[2])
    return value, flat.T @ sides.reshape(-1), flat.T @ jnp.stack(across, 1).reshape(flat.shape)


def _vertex_equations(term: AbstractEnergy, posed: Posed) -> NormalEquations | None:
    """Compute the equations of a term by each vertex, `(V, 3)` and `(V, 3, 3)`.

    None if it is not a term over vertices, has fewer rows, or has rows that depend on several vertices.
    """
    if not isinstance(unweighted(term), AbstractVertexEnergy):
        return None
    vertices, directions = weighted_derivatives(term, posed)
    if vertices.shape[1] > 1 or directions.size // 3 <= posed.vertices.size:
        return None
    vertices, directions = vertices[:, 0], directions[:, 0]
    residual = term.residual(posed)
    sides = jnp.sum(directions * residual.reshape(directions.shape[:2])[:, :, None], 1)
    matrices = jnp.sum(directions[:, :, :, None] * directions[:, :, None, :], 1)
    count, dtype = len(posed.vertices), directions.dtype
    return (
        0.5 * (residual @ residual),
        jnp.zeros((count, 3), dtype).at[vertices].add(sides),
        jnp.zeros((count, 3, 3), dtype).at[vertices].add(matrices),
    )
