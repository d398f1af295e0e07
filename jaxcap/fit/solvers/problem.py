"""Sums of squares over a manifold, as the solvers see them."""

import abc
from typing import Any, Generic, TypeVar

import equinox as eqx
from jaxtyping import Array, Float

from .descent import ConstrainedInfo

Unknown = TypeVar("Unknown")
#: what `retract` takes: an array `(D,)`, or a pytree of arrays
Tangent = Any


class AbstractProblem(eqx.Module, Generic[Unknown]):
    """A sum of squares over a manifold, for the solvers of this wing.

    A solver sees a point of the manifold only through these verbs: tangents `d` are flat arrays, or pytrees of
    arrays where the unknowns have a structure, and `y + d` is `retract(y, d)`.
    """

    @abc.abstractmethod
    def value(self, y: Unknown) -> Float[Array, ""]:
        """Compute `|r|^2 / 2` at `y`."""

    @abc.abstractmethod
    def information(self, y: Unknown) -> ConstrainedInfo:
        """Linearise at `y` by scaled tangents, as optimistix's searches and descents take it: value, gradient and a structured
        Hessian (`optx.FunctionInfo.EvalGradHessian`), with constraints on a step."""

    @abc.abstractmethod
    def retract(self, y: Unknown, d: Tangent) -> Unknown:
        """Move from `y` along the tangent `d`."""

    @abc.abstractmethod
    def scales(self) -> Tangent:
        """How much of each number of a tangent counts as one unit: brings metres and
        radians to one measure, for dampings that are isotropic."""

    def constraint(self) -> str | None:
        """Name what a step has to keep, for a sentence that refuses solvers that would not; None where steps are free."""
        return None


class AbstractNestedProblem(AbstractProblem[Unknown]):
    """A problem some of whose unknowns are cheap to improve by themselves, such as poses where what frames share is given.

    A solver does so after each step that it tries, before it judges the step by its energy.
    """

    @abc.abstractmethod
    def nested(self, y: Unknown) -> Unknown:
        """Improve the cheap unknowns at `y`; the energy must not rise."""


class AbstractDenseProblem(AbstractProblem[Unknown]):
    """A problem small enough for all rows of its Jacobian at once."""

    @abc.abstractmethod
    def residual(self, y: Unknown) -> Float[Array, "R"]:
        """The residual at `y`; what is minimised is the sum of its squares."""

    @abc.abstractmethod
    def linearise(self, y: Unknown) -> tuple[Float[Array, "R"], Float[Array, "R D"]]:
        """The residual at `y`, and its Jacobian by `d` of `residual(retract(y, d))` at 0."""

    def value(self, y: Unknown):
        r = self.residual(y)
        return 0.5 * (r @ r)
