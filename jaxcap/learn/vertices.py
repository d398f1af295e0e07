"""The rest vertices that fit best, everything else given: sparse linear least squares."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.sparse.linalg import LinearOperator, cg, splu

from ..body.body import Body, deform_all
from ..body.kinematics import forward_kinematics
from ..body.pose import Pose
from ..geometry.laplacian import Conformance, apply, matrix


class VertexSolver:
    """Solves for rest vertices under one metric; its factor of the metric is made once.

    A posed vertex is affine in its rest place, `x_m = B_m p + t_m` (Adaptation, eq. 3.21), and
    the normal equations are `sum_m B_m^T A B_m p = sum_m B_m^T A (x_m - t_m)`. The `B_m` are
    nearly rotations that neighbours share, so `F A` is nearly the matrix: conjugate gradients
    with its sparse factor need a handful of steps.
    """

    def __init__(self, metric: Conformance):
        self._metric = metric
        self._factor = splu(matrix(metric).tocsc())

    def solve(
        self, body: Body, poses: Pose, targets: Float[Array, "F V 3"], tolerance: float = 1e-3
    ) -> Float[Array, "V 3"]:
        """The rest vertices `(V, 3)`, metres, found from those of `body`; every step of the
        conjugate gradients lowers Q, so that stopping at `tolerance` of the gradient is safe."""
        slopes = _slopes(body, poses)
        errors = targets - deform_all(body, poses)
        side = np.asarray(_pull(self._metric, slopes, errors), float)
        count, frames = len(body.vertices), len(targets)

        def product(step):
            moved = jnp.asarray(step.reshape(count, 3), body.vertices.dtype)
            return np.asarray(_curvature(self._metric, slopes, moved), float).ravel()

        def precondition(rest):
            return self._factor.solve(rest.reshape(count, 3)).ravel() / frames

        step, _ = cg(
            _Operator(product, 3 * count),
            side.ravel(),
            rtol=tolerance,
            maxiter=30,
            M=_Operator(precondition, 3 * count),
        )
        return body.vertices + jnp.asarray(step.reshape(count, 3), body.vertices.dtype)


class _Operator(LinearOperator):
    """A symmetric operator by its products."""

    def __init__(self, product: Callable[[np.ndarray], np.ndarray], size: int):
        super().__init__(np.dtype(float), (size, size))
        self._product = product

    def _matvec(self, x):
        return self._product(x)


@eqx.filter_jit
def carry_back(body: Body, poses: Pose, targets: Float[Array, "F V 3"]) -> Float[Array, "V 3"]:
    """Each vertex by itself where it has to rest to come nearest to its targets, metres."""
    slopes = _slopes(body, poses)
    errors = targets - deform_all(body, poses)
    normal = jnp.einsum("fvab,fvac->vbc", slopes, slopes)
    side = jnp.einsum("fvab,fva->vb", slopes, errors)
    return body.vertices + jnp.linalg.solve(normal, side[:, :, None])[:, :, 0]


@eqx.filter_jit
def _slopes(body: Body, poses: Pose) -> Float[Array, "F V 3 3"]:
    """How each posed vertex moves with its rest place; constant, as skins are affine in it."""

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


@eqx.filter_jit
def _pull(metric, slopes, errors) -> Float[Array, "V 3"]:
    """`sum_m B_m^T A e_m`."""

    def add(total, frame):
        slope, error = frame
        return total + jnp.einsum("vab,va->vb", slope, apply(metric, error)), None

    return jax.lax.scan(add, jnp.zeros_like(errors[0]), (slopes, errors))[0]


@eqx.filter_jit
def _curvature(metric, slopes, step) -> Float[Array, "V 3"]:
    """`sum_m B_m^T A B_m p`."""

    def add(total, slope):
        moved = jnp.einsum("vab,vb->va", slope, step)
        return total + jnp.einsum("vab,va->vb", slope, apply(metric, moved)), None

    return jax.lax.scan(add, jnp.zeros_like(step), slopes)[0]
