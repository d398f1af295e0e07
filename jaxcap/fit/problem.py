"""What is minimised, and how it is linearised on the manifold of poses."""

import abc
from typing import Any, Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Float

from ..body.body import Body, Posed, pose_body
from ..body.jacobian import vertex_rows
from ..body.pose import Pose, retract
from ..body.skeleton import dof_layout
from ..energy.term import AbstractEnergy, Weighted, bare, root, terms_of
from ..energy.vertices import AbstractVertexEnergy

Unknown = TypeVar("Unknown")
#: what `retract` takes: an array `(D,)`, or a pytree of arrays
Tangent = Any


class AbstractProblem(eqx.Module, Generic[Unknown]):
    """A sum of squares over a manifold, for the solvers of this wing.

    A solver sees a point of the manifold only through these verbs: tangents `d` are flat arrays, or pytrees of
    arrays where the unknowns have a structure, and `y + d` is `retract(y, d)`.
    """

    @abc.abstractmethod
    def residual(self, y: Unknown) -> Float[Array, "R"]:
        """The residual at `y`; what is minimised is the sum of its squares."""

    @abc.abstractmethod
    def linearise(self, y: Unknown) -> tuple[Float[Array, "R"], Float[Array, "R D"]]:
        """The residual at `y`, and its Jacobian by `d` of `residual(retract(y, d))` at 0."""

    @abc.abstractmethod
    def retract(self, y: Unknown, d: Tangent) -> Unknown:
        """Move from `y` along the tangent `d`."""

    @abc.abstractmethod
    def scales(self) -> Tangent:
        """How much of each number of a tangent counts as one unit: brings metres and
        radians to one measure, for dampings that are isotropic."""

    # optimistix nests these classes by assignment, which pyright does not follow
    def information(self, y: Unknown) -> Any:
        """Linearise at `y` by scaled tangents, as optimistix's searches and descents take it: residual and Jacobian, or
        value, gradient and a structured Hessian."""
        residual, jacobian = self.linearise(y)
        return optx.FunctionInfo.ResidualJac(residual, lx.MatrixLinearOperator(jacobian * self.scales()))  # pyright: ignore[reportReturnType]


#: a joint turned by a radian moves what hangs on it by about as many metres
LEVER = 0.3


class PoseProblem(AbstractProblem[Pose]):
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
