"""What the solvers of this wing have in common, so that one can be put in another's place."""

from typing import Any, ClassVar

import equinox as eqx
import optimistix as optx
from jaxtyping import Array, Float, Int

from ...arguments import check_fields
from .problem import AbstractProblem

#: longest history of energies that a solver keeps
HISTORY = 256


class AbstractManifoldSolver(optx.AbstractLeastSquaresSolver):
    """A least-squares solver that moves by `AbstractProblem.retract`.

    It takes an `AbstractProblem` as `args`, ignores `fn`, and leaves the energy after each step in
    `stats["history"]`, `(HISTORY,)`, NaN beyond the last. optimistix's own solvers add a step
    to the unknown, which leaves the manifold.
    """

    #: steps of optimistix's loop that only linearise at the start
    starting_steps: ClassVar[int] = 0

    def __check_init__(self):
        check_fields(self)


class Minimum(eqx.Module):
    """Where a solver ended."""

    y: Any
    #: `|r|^2` after each step, NaN beyond the last
    history: Float[Array, "H"]
    num_steps: Int[Array, ""]
    #: `RESULTS.successful`, or why the solver stopped before it converged
    result: optx.RESULTS
    #: the problem linearised there
    info: Any


def minimise(problem: AbstractProblem, start, solver: AbstractManifoldSolver, max_steps: int) -> Minimum:
    """Minimise `|r|^2` from a start near the minimum. Derivatives through it are not defined; those of the minimum are
    the callers' to define."""
    extra = solver.starting_steps
    found = optx.least_squares(
        lambda y, problem: problem.value(y),
        solver,
        start,
        args=problem,
        max_steps=max_steps + extra,
        throw=False,
    )
    stats = found.stats
    info = stats["info"] if "info" in stats else problem.information(found.value)
    return Minimum(found.value, stats["history"], stats["num_steps"] - extra, found.result, info)
