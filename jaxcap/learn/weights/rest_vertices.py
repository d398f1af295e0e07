"""Optimisation of rest vertices with everything else fixed: sparse linear least squares."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...body.body import Body, posed_vertices
from ...body.kinematics import forward_kinematics
from ...body.pose import Pose
from ...fit.linear_solvers.chebyshev import chebyshev
from ...fit.linear_solvers.conjugate_gradients import conjugate_gradients
from ...fit.linear_solvers.gauss_jordan import gauss_jordan_solve
from ...geometry.laplacian import Conformance, apply_conformance

#: the most steps of conjugate gradients, the degree of the preconditioner in each, and the least gap between
#: the bounds of its eigenvalues
STEPS, DEGREE, MIN_GAP = 30, 16, 1e-3


@eqx.filter_jit
def solve_rest_vertices(
    body: Body,
    poses: Pose,
    targets: Float[Array, "F V 3"],
    metric: Conformance,
    tolerance: float | Float[Array, ""] = 1e-3,
    frame_weights: Float[Array, "F"] | None = None,
) -> Float[Array, "V 3"]:
    """Solve for the rest vertices, metres, starting from those of a body.

    A posed vertex is affine in its rest position, `x_m = B_m p + t_m` (Adaptation, eq. 3.21), and the normal
    equations are `sum_m B_m^T A B_m p = sum_m B_m^T A (x_m - t_m)`. The `B_m` are nearly rotations that
    neighbours share, so that `F A` approximates the matrix. With a polynomial of `A` as preconditioner, few
    products over all frames are needed. Every step of the conjugate gradients lowers Q, so that it is safe to
    stop at `tolerance` of the gradient. `frame_weights` as of `objective`.
    """
    slopes, errors = _weighted_equations(body, poses, targets, frame_weights)
    side = _pull(metric, slopes, errors)

    def precondition(rest):
        # the eigenvalues of a uniform Laplacian are at most two
        return chebyshev(
            lambda x: apply_conformance(metric, x), rest, 1.0, 1.0 + 4.0 * metric.alpha + MIN_GAP, DEGREE
        )

    step = conjugate_gradients(
        lambda rest: _curvature(metric, slopes, rest),
        side,
        precondition,
        tolerance=jnp.asarray(tolerance, side.dtype),
        max_steps=STEPS,
    )
    return body.vertices + step


@eqx.filter_jit
def fit_rest_vertices(
    body: Body,
    poses: Pose,
    targets: Float[Array, "F V 3"],
    frame_weights: Float[Array, "F"] | None = None,
) -> Float[Array, "V 3"]:
    """Solve for the rest position of each vertex independently, by least squares to its targets, metres; weights as of
    `objective`."""
    slopes, errors = _weighted_equations(body, poses, targets, frame_weights)
    normal = jnp.einsum("fvab,fvac->bcv", slopes, slopes)
    side = jnp.einsum("fvab,fva->bv", slopes, errors)
    return body.vertices + gauss_jordan_solve(normal, side[:, None])[:, 0].T


def _weighted_equations(
    body: Body, poses: Pose, targets: Float[Array, "F V 3"], frame_weights: Float[Array, "F"] | None
) -> tuple[Float[Array, "F V 3 3"], Float[Array, "F V 3"]]:
    """Compute the slopes and the errors of all frames, each times the square root of the frame's weight."""
    slopes, errors = rest_slopes(body, poses), targets - posed_vertices(body, poses)
    if frame_weights is None:
        return slopes, errors
    roots = jnp.sqrt(frame_weights)[:, None, None]
    return slopes * roots[..., None], errors * roots


def rest_slopes(body: Body, poses: Pose) -> Float[Array, "F V 3 3"]:
    """Compute the derivatives of posed vertices by rest positions; constant, as skins are affine in these."""

    def of_frame(pose):
        transforms = forward_kinematics(body.skeleton, pose)

        def posed(vertices):
            return body.skin.deform(vertices, body.skeleton, pose, transforms)

        columns = [
            jax.jvp(posed, (body.vertices,), (jnp.broadcast_to(unit, body.vertices.shape),))[1]
            for unit in jnp.eye(3, dtype=body.vertices.dtype)
        ]
        return jnp.stack(columns, -1)

    return jax.lax.map(of_frame, poses)


def _pull(metric, slopes, errors) -> Float[Array, "V 3"]:
    """Compute `sum_m B_m^T A e_m`."""

    def add(total, frame):
        slope, error = frame
        return total + jnp.einsum("vab,va->vb", slope, apply_conformance(metric, error)), None

    return jax.lax.scan(add, jnp.zeros_like(errors[0]), (slopes, errors))[0]


def _curvature(metric, slopes, step) -> Float[Array, "V 3"]:
    """Compute `sum_m B_m^T A B_m p`."""

    def add(total, slope):
        moved = jnp.einsum("vab,vb->va", slope, step)
        return total + jnp.einsum("vab,va->vb", slope, apply_conformance(metric, moved)), None

    return jax.lax.scan(add, jnp.zeros_like(step), slopes)[0]
