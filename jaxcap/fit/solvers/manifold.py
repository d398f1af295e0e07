"""What the solvers of this wing have in common, so that one can be put in another's place."""

import optimistix as optx

from ...arguments import check_fields

#: longest history of energies that a solver keeps
HISTORY = 256


class AbstractManifoldSolver(optx.AbstractLeastSquaresSolver):
    """A least-squares solver that moves by `AbstractProblem.retract`.

    It takes an `AbstractProblem` as `args`, ignores `fn`, and leaves the energy after each step in
    `stats["history"]`, `(HISTORY,)`, NaN beyond the last. optimistix's own solvers add a step
    to the unknown, which leaves the manifold.
    """

    def __check_init__(self):
        check_fields(self)
