"""Problems of the poses of many frames and of unknowns that all frames share: what their uncertainty needs."""

import abc
from typing import Any, Protocol, TypeVar, runtime_checkable

from jaxtyping import Array, Bool, Float

from ...body.skeleton import Skeleton
from ..solvers.descent import ConstrainedInfo
from ..solvers.least_squares_problem import AbstractProblem

Unknown = TypeVar("Unknown")


class AbstractPosesAndShared(AbstractProblem[Unknown]):
    """A problem whose Hessian is a `BlockArrow` over the tangents of F poses and of S shared unknowns."""

    @abc.abstractmethod
    def skeleton_of_poses(self) -> Skeleton:
        """Return the skeleton whose poses are unknown."""

    @abc.abstractmethod
    def shared_names(self) -> tuple[str, ...]:
        """Name each of the S shared scalar unknowns."""

    @abc.abstractmethod
    def residual_variance(self, y: Unknown, energy: Float[Array, ""]) -> Float[Array, ""]:
        """Estimate the variance of one component of the residual from the energy of a solution."""

    def information_of_data(self, y: Unknown) -> ConstrainedInfo:
        """Linearise as `information` does, without what only keeps the steps of a solver short."""
        return self.information(y)

    def variance_inflation(self) -> Float[Array, ""] | float:
        """Return the number of frames that have the information of one on shared unknowns, as errors of neighbouring frames
        are not independent.
        """
        return 1.0

    def pose_bases(self, y: Unknown) -> Float[Array, "F D D"] | None:
        """Compute the directions of the poses' tangents, as columns, where these are not the coordinates of poses."""
        del y
        return None


@runtime_checkable
class PosesAndSharedSolution(Protocol):
    """A solution of an `AbstractPosesAndShared`: its unknowns, its energy, and if it has converged."""

    @property
    def estimate(self) -> Any: ...

    @property
    def energy(self) -> Float[Array, ""]: ...

    @property
    def trustworthy(self) -> Bool[Array, ""]: ...
