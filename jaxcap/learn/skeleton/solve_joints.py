"""Joints and poses of a body whose surface is known, with derivatives."""

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
from .joints import Curvature, JointProblem, Standing


class JointSolution(eqx.Module):
    """The outcome of `solve_joints`."""

    body: Body
    poses: Pose
    #: `RESULTS.successful`, or why the solver stopped before it converged: derivatives hold where it did
    result: optx.RESULTS
    #: whether the solver converged and hardly anything is left to gain, so that derivatives hold
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
    """Find the joints and the poses that make Q least at the weights and rest vertices of a body, to convergence.

    `jax.grad` and `jax.jvp` go through the solution by the implicit function theorem, to weights, rest vertices, targets and the
    metric. Where motion tells nothing of a joint there is no such derivative. Bones of the left and the right may differ.
    """
    start = Standing(*jax.lax.stop_gradient((body.skeleton.centres, body.skeleton.orientations, poses)))
    problem = JointProblem(body, targets, metric, curvature)
    solver = LevenbergMarquardt(rtol=0.0, atol=1e-12, damping=1e-3, relative=True)
    found = implicit_minimum(problem, start, solver, max_steps)
    trustworthy = is_trustworthy(problem, found)
    return JointSolution(problem.body_at(found.y), found.y.poses, found.result, trustworthy)
