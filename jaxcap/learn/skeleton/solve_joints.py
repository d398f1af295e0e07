"""Differentiable optimisation of joints and poses for fixed weights and rest vertices."""

import equinox as eqx
import jax
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from ...arguments import checked
from ...body.body import Body
from ...body.pose import Pose
from ...energy.check_energies import UserTerms, sum_user_terms
from ...fit.fit_meshes import poses_of_meshes
from ...fit.solvers.implicit import energy_at, implicit_minimum, is_trustworthy
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ...fit.solvers.minimise import AnySolver
from ...geometry.laplacian import make_conformance
from ...value_checks import check_at_least, concrete_values
from ..objective import in_units_of_vertices
from .joints import JointProblem, JointState, make_curvature


class JointSolution(eqx.Module):
    """The result of `solve_joints`."""

    body: Body
    poses: Pose
    #: Q at the solution, metres squared, with the energies of `terms`
    energy: Float[Array, ""]
    #: `RESULTS.successful`, or the reason for a stop before convergence; derivatives are valid after
    #: convergence only
    result: optx.RESULTS
    #: true if the solver converged and hardly any decrease is left, so that derivatives are valid
    trustworthy: Bool[Array, ""]

    @property
    def estimate(self) -> JointState:
        """The unknowns at the solution."""
        return JointState(self.body.skeleton.centres, self.body.skeleton.orientations, self.poses)


@checked
def make_joint_problem(
    body: Body, targets: Float[Array, "F V 3"], alpha: float = 100.0, terms: UserTerms = ()
) -> JointProblem:
    """Make the problem of joints and poses that `learn_body` solves in each round (Adaptation, 3.2.2), for the weights and
    rest vertices of a body.

    **Arguments:** registered vertices `targets`; `alpha`, the weight of the shape of the surface relative to the positions of
    its vertices, and `terms`, as of `learn_body`.

    **Raises:** `InputError` for other vertices than those of the body, and for vertices that are not finite.
    """
    if targets.shape[1] != len(body.vertices):
        raise ValueError(
            f"`targets` has {targets.shape[1]} vertices; expected the {len(body.vertices)} of the body."
        )
    numbers = concrete_values(targets)
    if numbers is not None and not np.isfinite(numbers).all():
        raise ValueError(
            "`targets` has values that are not finite; leave out the meshes with missing vertices."
        )
    metric = make_conformance(np.asarray(body.faces), len(body.vertices), alpha)
    own = sum_user_terms("make_joint_problem", terms, body)
    scaled = in_units_of_vertices(own, len(body.vertices))
    return JointProblem(body, targets, metric, make_curvature(metric), terms=scaled)


@checked
def solve_joints(
    problem: JointProblem, poses: Pose, solver: AnySolver | None = None, max_steps: int = 64
) -> JointSolution:
    """Minimise Q over joints and poses to convergence, from the joints of the problem's body.

    `jax.grad` and `jax.jvp` differentiate the solution by the implicit function theorem, with respect to
    weights, rest vertices, targets and metric. No such derivative exists where the motion does not determine
    a joint. Left and right bones may differ in length, except the problem's `left_right_pairs`.

    **Arguments:** `poses` stacked over the meshes, to start from; `solver`, `LevenbergMarquardt` where not given;
    `max_steps` bounds its steps.

    **Raises:** `InputError` where there are more or fewer poses than meshes.
    """
    check_at_least("solve_joints", 1, max_steps=max_steps)
    poses = poses_of_meshes(poses, len(problem.targets), "poses")
    start = jax.lax.stop_gradient(problem.start(poses))
    if solver is None:
        solver = LevenbergMarquardt(rtol=0.0, atol=1e-12, damping=1e-3, relative=True)
    found = implicit_minimum(problem, start, solver, max_steps)
    trustworthy = is_trustworthy(problem, found)
    energy = energy_at(problem, found.y)
    return JointSolution(problem.body_at(found.y), found.y.poses, energy, found.result, trustworthy)
