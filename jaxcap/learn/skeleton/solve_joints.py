"""Differentiable optimisation of joints and poses for fixed weights and rest vertices."""

import equinox as eqx
import jax
import optimistix as optx
from jaxtyping import Array, Bool, Float

from ...arguments import checked
from ...body.body import Body
from ...body.pose import Pose
from ...fit.solvers.implicit import implicit_minimum, is_trustworthy
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ...geometry.laplacian import Conformance
from .joints import Curvature, JointProblem, JointState


class JointSolution(eqx.Module):
    """The result of `solve_joints`."""

    body: Body
    poses: Pose
    #: `RESULTS.successful`, or the reason for a stop before convergence; derivatives are valid after
    #: convergence only
    result: optx.RESULTS
    #: true if the solver converged and hardly any decrease is left, so that derivatives are valid
    trustworthy: Bool[Array, ""]


@checked
def solve_joints(
    body: Body,
    poses: Pose,
    targets: Float[Array, "F V 3"],
    metric: Conformance,
    curvature: Curvature,
    max_steps: int = 64,
) -> JointSolution:
    """Minimise Q over joints and poses to convergence, for the weights and rest vertices of a body.

    `jax.grad` and `jax.jvp` differentiate the solution by the implicit function theorem, with respect to
    weights, rest vertices, targets and metric. No such derivative exists where the motion does not determine
    a joint. Left and right bones may differ in length.
    """
    start = JointState(*jax.lax.stop_gradient((body.skeleton.centres, body.skeleton.orientations, poses)))
    problem = JointProblem(body, targets, metric, curvature)
    solver = LevenbergMarquardt(rtol=0.0, atol=1e-12, damping=1e-3, relative=True)
    found = implicit_minimum(problem, start, solver, max_steps)
    trustworthy = is_trustworthy(problem, found)
    return JointSolution(problem.body_at(found.y), found.y.poses, found.result, trustworthy)
