"""The pose of one frame as a least-squares problem, linearised on the manifold of poses."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..body.body import Body, Posed, pose_body
from ..body.jacobian import vertex_rows
from ..body.pose import Pose, retract
from ..body.skeleton import dof_layout
from ..energy.term import AbstractEnergy, Weighted, bare, root, terms_of
from ..energy.vertices import AbstractVertexEnergy
from .solvers.problem import AbstractDenseProblem

#: a joint turned by a radian moves what hangs on it by about as many metres
LEVER = 0.3


class PoseProblem(AbstractDenseProblem[Pose]):
    """Find the pose of a body that makes an energy least."""

    energy: AbstractEnergy
    body: Body

    def residual(self, y: Pose):
        return self.energy.residual(pose_body(self.body, y))

    def linearise(self, y: Pose):
        return linearise(self.energy, self.body, y)

    def retract(self, y: Pose, d: Float[Array, "D"]):
        return retract(self.body.skeleton, y, d)

    def scales(self):
        layout = dof_layout(self.body.skeleton)
        scales = jnp.ones(self.body.skeleton.num_dofs + 1, self.body.vertices.dtype)
        return scales.at[layout.translations].set(LEVER)[:-1]


def linearise(
    energy: AbstractEnergy, body: Body, pose: Pose
) -> tuple[Float[Array, "R"], Float[Array, "R D"]]:
    """Residual and Jacobian of an energy at a pose, by tangents of `retract`, rows in the order
    of `energy.residual`.

    Terms over vertices use the skin's own Jacobian (Kineben, eqs. 8 to 13), which costs one
    sum down the tree for each joint; forward autodiff, which all other terms use, pushes
    each of the D tangents through the whole skin.
    """
    posed = pose_body(body, pose)
    terms = terms_of(energy)
    others = tuple(term for term in terms if not isinstance(bare(term), AbstractVertexEnergy))
    zero = jnp.zeros(body.skeleton.num_dofs, body.vertices.dtype)

    def moved(d):
        there = pose_body(body, retract(body.skeleton, pose, d))
        residuals = tuple(term.residual(there) for term in others)
        return residuals, residuals

    # all in one pass: what the terms share is differentiated once
    jacobians, residuals = jax.jacfwd(moved, has_aux=True)(zero) if others else ((), ())
    differentiated = iter(zip(residuals, jacobians, strict=True))
    rows = [
        (term.residual(posed), _vertex_rows(term, posed))
        if isinstance(bare(term), AbstractVertexEnergy)
        else next(differentiated)
        for term in terms
    ]
    return jnp.concatenate([r for r, _ in rows]), jnp.concatenate([j for _, j in rows])


def _vertex_rows(term: AbstractEnergy, posed: Posed) -> Float[Array, "R D"]:
    if isinstance(term, Weighted):
        return root(term.weight) * _vertex_rows(term.energy, posed)
    assert isinstance(term, AbstractVertexEnergy)
    rows = vertex_rows(posed, *term.slopes())
    return rows.reshape(-1, rows.shape[-1])
