"""Sums of squares over a manifold: the interface of the solvers."""

import abc
from typing import Any, Generic, TypeVar

import equinox as eqx
from jaxtyping import Array, Float

from .descent import ConstrainedInfo

Unknown = TypeVar("Unknown")
#: the argument of `retract`: an array `(D,)`, or a pytree of arrays
Tangent = Any


class AbstractProblem(eqx.Module, Generic[Unknown]):
    """A sum of squares over a manifold, for the solvers of this package.

    A solver uses a point of the manifold only through these methods. Tangents `d` are flat arrays, or pytrees
    of arrays where the unknowns have a structure, and `y + d` is `retract(y, d)`.
    """

    @abc.abstractmethod
    def value(self, y: Unknown) -> Float[Array, ""]:
        """Compute `|r|^2 / 2` at `y`."""

    @abc.abstractmethod
    def information(self, y: Unknown) -> ConstrainedInfo:
        """Linearise at `y` in scaled tangents, for optimistix's searches and descents.

        Value, gradient and a structured Hessian (`optx.FunctionInfo.EvalGradHessian`), with constraints on a
        step.
        """

    @abc.abstractmethod
    def retract(self, y: Unknown, d: Tangent) -> Unknown:
        """Move from `y` along the tangent `d`."""

    @abc.abstractmethod
    def scales(self) -> Tangent:
        """Compute the unit of each component of a tangent, which scales metres and radians to one measure for
        isotropic damping.
        """

    def describe_constraints(self) -> str | None:
        """Name the constraint on steps, for the error message of solvers that ignore it; None where steps are
        free.
        """
        return None


class AbstractNestedProblem(AbstractProblem[Unknown]):
    """A problem in which some unknowns are cheap to improve separately, such as poses for given shared
    parameters.

    A solver does so after each trial step, before it judges the step by its energy.
    """

    @abc.abstractmethod
    def improve_nested(self, y: Unknown) -> Unknown:
        """Improve the cheap unknowns at `y`; the energy must not rise."""


class AbstractDenseProblem(AbstractProblem[Unknown]):
    """A problem small enough for all rows of its Jacobian at once."""

    @abc.abstractmethod
    def residual(self, y: Unknown) -> Float[Array, "R"]:
        """Compute the residual at `y`; the objective is the sum of its squares."""

    @abc.abstractmethod
    def linearise(self, y: Unknown) -> tuple[Float[Array, "R"], Float[Array, "R D"]]:
        """Compute the residual at `y`, and its Jacobian by `d` of `residual(retract(y, d))` at 0."""

    def value(self, y: Unknown):
        r = self.residual(y)
        return 0.5 * (r @ r)
