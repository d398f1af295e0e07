"""Normal equations of one frame, by its pose and by the shared unknowns."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..body.body import Body, Posed, pose_body
from ..body.pose import Pose
from ..energy.data.bones import AbstractBoneEnergy
from ..energy.data.vertices import AbstractVertexEnergy
from ..energy.energy import AbstractEnergy, Sum, terms_of, unweighted
from .linearise import (
    BodyTangent,
    bone_velocities,
    posed_jacobian,
    vertex_jacobian,
    weighted_bone_derivatives,
    weighted_derivatives,
)

#: number of points between vertices whose rows are summed together
POINTS = 512
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

    A term with more rows than the vertices have coordinates is first summed over each vertex, or over a few points between
    vertices, and one of the pose over single bones over each bone, without writing out its rows.
    """
    return posed_equations(energy, pose_body(body, pose), body_at, tangent)


def posed_equations(
    energy: AbstractEnergy,
    posed: Posed,
    body_at: Callable[[Float[Array, "S"]], Body] | None = None,
    tangent: BodyTangent | None = None,
) -> NormalEquations:
    """Compute the `frame_equations` of a body that is posed already."""
    terms = terms_of(energy)
    between = [term for term in terms if _is_between_vertices(term, posed)]
    by_vertex = [_vertex_equations(term, posed) for term in terms]
    by_bone = [None if tangent is not None else _bone_equations(term, posed) for term in terms]
    others = tuple(
        term
        for term, *sums in zip(terms, by_vertex, by_bone, strict=True)
        if all(part is None for part in sums) and term not in between
    )
    parts = [_equations_between(term, posed, vertex_jacobian(posed, tangent)) for term in between]
    if others:
        residual, rows = posed_jacobian(Sum(others), posed, body_at, tangent)
        parts.append((0.5 * (residual @ residual), rows.T @ residual, rows.T @ rows))
    if summed := [part for part in by_vertex if part is not None]:
        parts.append(_pull_back(sum_equations(summed), vertex_jacobian(posed, tangent)))
    if summed := [part for part in by_bone if part is not None]:
        parts.append(_pull_back(sum_equations(summed), bone_velocities(posed)))
    return sum_equations(parts)


def sum_equations(parts: Sequence[NormalEquations]) -> NormalEquations:
    """Add up normal equations of the same unknowns."""
    return jax.tree.map(lambda *some: sum(some[1:], some[0]), *parts)


def _pull_back(equations: NormalEquations, jacobian: Float[Array, "V C N"]) -> NormalEquations:
    """Transform equations of vertices or bones with C coordinates into equations of the unknowns, by the Jacobian of these
    coordinates.
    """
    value, sides, matrices = equations
    # written out, because batched products are slow on a CPU
    across = [
        sum(
            (matrices[:, a, b, None] * jacobian[:, b] for b in range(1, matrices.shape[2])),
            matrices[:, a, 0, None] * jacobian[:, 0],
        )
        for a in range(matrices.shape[1])
    ]
    flat = jacobian.reshape(-1, jacobian.shape[2])
    return value, flat.T @ sides.reshape(-1), flat.T @ jnp.stack(across, 1).reshape(flat.shape)


def _bone_equations(term: AbstractEnergy, posed: Posed) -> NormalEquations | None:
    """Compute the equations of a term by the velocity of each bone, `(J, 6)` and `(J, 6, 6)`.

    None if it is not a term over bones, or has rows that depend on several bones.
    """
    if not isinstance(unweighted(term), AbstractBoneEnergy):
        return None
    bones, rows = weighted_bone_derivatives(term, posed)
    if bones is None or bones.shape[1] > 1:
        return None
    return _equations_at(bones[:, 0], rows[:, 0], term.residual(posed), len(posed.joints))


def _vertex_equations(term: AbstractEnergy, posed: Posed) -> NormalEquations | None:
    """Compute the equations of a term by each vertex, `(V, 3)` and `(V, 3, 3)`.

    None if it is not a term over vertices, has fewer rows, or has rows that depend on several vertices.
    """
    if not isinstance(unweighted(term), AbstractVertexEnergy):
        return None
    vertices, directions = weighted_derivatives(term, posed)
    if vertices.shape[1] > 1 or directions.size // 3 <= posed.vertices.size:
        return None
    return _equations_at(vertices[:, 0], directions[:, 0], term.residual(posed), len(posed.vertices))


def _is_between_vertices(term: AbstractEnergy, posed: Posed) -> bool:
    """Test if a term has more rows than the vertices have coordinates, of points between several vertices."""
    if not isinstance(unweighted(term), AbstractVertexEnergy):
        return False
    vertices, directions = weighted_derivatives(term, posed)
    return vertices.shape[1] > 1 and directions.size // 3 > posed.vertices.size


def _equations_between(
    term: AbstractEnergy, posed: Posed, jacobian: Float[Array, "V 3 N"]
) -> NormalEquations:
    """Sum the equations of the points of a term between vertices, a few points at a time, whose rows stay in a core's cache."""
    vertices, directions = weighted_derivatives(term, posed)
    residual = term.residual(posed).reshape(len(vertices), -1)
    extra = -len(vertices) % POINTS
    batches = [
        jnp.pad(part, ((0, extra), *[(0, 0)] * (part.ndim - 1))).reshape(-1, POINTS, *part.shape[1:])
        for part in (vertices, directions, residual)
    ]

    def add(total, batch):
        corners, along, missing = batch
        moved = jacobian[corners]
        # written out, because batched products are slow on a CPU
        rows = sum(
            along[:, k, :, a, None] * moved[:, k, a, None]
            for k in range(moved.shape[1])
            for a in range(moved.shape[2])
        )
        rows = jnp.concatenate([rows, missing[:, :, None]], 2).reshape(-1, jacobian.shape[2] + 1)
        return total + rows.T @ rows, None

    count = jacobian.shape[2]
    sums, _ = jax.lax.scan(add, jnp.zeros((count + 1, count + 1), jacobian.dtype), tuple(batches))
    return 0.5 * sums[count, count], sums[:count, count], sums[:count, :count]


def _equations_at(
    places: Int[Array, "K"], rows: Float[Array, "K R C"], residual: Float[Array, "KR"], count: int
) -> NormalEquations:
    """Sum the equations of K groups of rows over their places, `count` vertices or bones."""
    sides = jnp.sum(rows * residual.reshape(rows.shape[:2])[:, :, None], 1)
    matrices = jnp.sum(rows[:, :, :, None] * rows[:, :, None, :], 1)
    width, dtype = rows.shape[2], rows.dtype
    return (
        0.5 * (residual @ residual),
        jnp.zeros((count, width), dtype).at[places].add(sides),
        jnp.zeros((count, width, width), dtype).at[places].add(matrices),
    )
