"""Find the pose that makes an energy least, and differentiate through the finding."""

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float, Int

from ..arguments import checked
from ..body.body import Body, pose_body
from ..body.pose import Pose, project, retract
from ..energy.check import check_numbers, explained
from ..energy.term import AbstractEnergy, energies
from .problem import PoseProblem
from .solvers.levenberg_marquardt import LevenbergMarquardt
from .solvers.minimise import AnySolver, minimise


class Solution(eqx.Module):
    """The outcome of `solve`."""

    pose: Pose
    #: `|r|^2` of every term at the solution, by the term's name
    energies: dict[str, Float[Array, ""]]
    #: `|r|^2` after each step, NaN beyond the last
    history: Float[Array, "H"]
    num_steps: Int[Array, ""]
    #: `RESULTS.successful`, or why the solver stopped before it converged
    result: optx.RESULTS


@checked
def solve(
    energy: AbstractEnergy,
    body: Body,
    start: Pose,
    solver: AnySolver | None = None,
    max_steps: int = 64,
) -> Solution:
    """The pose of a body that makes an energy least, from a start near it.

    **Arguments:** `solver` is `LevenbergMarquardt()` where not given, or `GaussNewton()`, or any least-squares solver or minimiser of optimistix;
    `max_steps` bounds its steps. A start that the joints' kinds do not allow is projected.

    `jax.grad` and `jax.jvp` go through the solution by the implicit function theorem, to
    every array of the energy and of the body; not to the start, on which a minimum does
    not depend. What no term holds stays where it is, in the derivative too. Nothing is raised where the solver fails: see `Solution.result`.

    **Raises:** `InputError` for what is no solver, and for an energy whose arrays do not go together or
    name vertices or joints that the body has not.
    """
    check_numbers(energy, body)
    problem = PoseProblem(energy, body)
    solver = LevenbergMarquardt() if solver is None else solver
    with explained(energy, body, start):
        pose, (history, num_steps, result) = _minimum(
            problem, project(body.skeleton, start), solver, max_steps
        )
    return Solution(pose, energies(energy, pose_body(body, pose)), history, num_steps, result)


@eqx.filter_custom_jvp
def _minimum(problem, start, solver, max_steps):
    found = minimise(problem, start, solver, max_steps)
    return found.y, (found.history, found.num_steps, found.result)


@_minimum.def_jvp
def _implicit(primals, tangents):
    """At a minimum the gradient `g(d; p)` by the pose's tangent vanishes for every value of
    the parameters `p`, so that `d' = -(dg/dd)^-1 (dg/dp) p'`, with the whole Hessian."""
    problem, start, solver, max_steps = primals
    pose, stats = _minimum(problem, start, solver, max_steps)
    zero = jnp.zeros(problem.body.skeleton.num_dofs, pose.rotations.dtype)
    hessian = jax.jacfwd(lambda d: _gradient(problem, pose, d))(zero)
    _, change = eqx.filter_jvp(lambda p: _gradient(p, pose, zero), (problem,), (tangents[0],))
    step = -_pseudo_solve(hessian, change)
    _, pose_tangent = eqx.filter_jvp(lambda p, d: _moved(p, pose, d), (problem, zero), (tangents[0], step))
    return (pose, stats), (pose_tangent, jax.tree.map(lambda _: None, stats))


def _pseudo_solve(matrix: Float[Array, "D D"], vector: Float[Array, "D"]) -> Float[Array, "D"]:
    """The smallest solution: along directions that the energy does not hold nothing moves."""
    values, vectors = jnp.linalg.eigh((matrix + matrix.T) / 2)
    held = jnp.abs(values) > len(values) * jnp.finfo(values.dtype).eps * jnp.max(jnp.abs(values))
    return vectors @ (jnp.where(held, 1.0 / jnp.where(held, values, 1.0), 0.0) * (vectors.T @ vector))


def _moved(problem: PoseProblem, pose: Pose, d: Float[Array, "D"]) -> Pose:
    """Along `d` on the manifold that the joints' own axes span, which may be parameters."""
    skeleton = problem.body.skeleton
    return retract(skeleton, project(skeleton, pose), d)


def _gradient(problem: PoseProblem, pose: Pose, d: Float[Array, "D"]) -> Float[Array, "D"]:
    def half_energy(d):
        r = problem.residual(_moved(problem, pose, d))
        return 0.5 * (r @ r)

    return jax.grad(half_energy)(d)
