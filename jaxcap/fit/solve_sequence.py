"""Solve for all frames of a sequence and what they share, and differentiate through the solution."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from ..arguments import checked
from ..body.body import Body
from ..body.pose import Motion, Pose
from ..energy.check import check_numbers, explained
from ..energy.stacked import join_frame, num_frames_of, split_frames
from ..errors import InputError
from .sequence_problem import SequenceEstimate, SequenceProblem, SequenceTangent
from .solvers.implicit import information, minimum
from .solvers.levenberg_marquardt import LevenbergMarquardt
from .solvers.minimise import AnySolver

#: the share of the energy that a Newton step may still gain at a solution whose derivative is trusted
STATIONARY = 1e-6


class SequenceSolution(eqx.Module):
    """The outcome of `solve_sequence`."""

    body: Body
    poses: Pose
    #: value of each shared unknown by its name
    values: dict[str, Any]
    #: `|r|^2` at the solution
    energy: Float[Array, ""]
    #: `|r|^2` after each step, NaN beyond the last
    history: Float[Array, "H"]
    num_steps: Int[Array, ""]
    #: `RESULTS.successful`, or why the solver stopped before it converged
    result: optx.RESULTS
    #: whether the solver converged and hardly anything is left to gain, so that derivatives by the implicit function theorem hold
    trustworthy: Bool[Array, ""]


@checked
def solve_sequence(
    problem: SequenceProblem,
    start: Pose | Motion | SequenceEstimate,
    solver: AnySolver | None = None,
    max_steps: int = 64,
) -> SequenceSolution:
    """Find the poses of all frames, and the shared unknowns, that make the energies of a problem least.

    **Arguments:** `start` poses stacked over frames, from which shared unknowns start at the body as it is, or an estimate;
    `solver` is `LevenbergMarquardt()` where not given, or any of optimistix's; `max_steps` bounds its steps.

    `jax.grad` and `jax.jvp` go through the solution by the implicit function theorem, to every array of the problem: data,
    weights, priors and the body. Nothing is raised where the solver fails: see `SequenceSolution.result`, and `trustworthy`
    before a derivative is used.

    **Raises:** `InputError` for frames that do not go together, and for energies whose arrays do not fit the body.
    """
    # data may be of another precision than the body
    dtype = problem.body.vertices.dtype
    problem, start = jax.tree.map(
        lambda leaf: leaf.astype(dtype) if eqx.is_inexact_array(leaf) else leaf, (problem, start)
    )
    poses = start if isinstance(start, Pose) else start.poses
    _check(problem, poses)
    solver = LevenbergMarquardt() if solver is None else solver
    start = start if isinstance(start, SequenceEstimate) else problem.start(poses)
    estimate, (history, num_steps, result) = minimum(problem, start, solver, max_steps, _moved)
    energy, trustworthy = _quality(problem, estimate, result)
    body = problem.body_at(estimate.values)
    return SequenceSolution(
        body, estimate.poses, estimate.values, energy, history, num_steps, result, trustworthy
    )


def _check(problem: SequenceProblem, poses: Pose) -> None:
    given = {"poses": poses.scale.shape[0] if poses.scale.ndim else 1, "times": problem.num_frames}
    counts = num_frames_of(problem.frames)
    if len({*given.values(), *counts}) > 1:
        words = ", ".join(f"`{name}` are of {count}" for name, count in given.items())
        stacked = " and ".join(map(str, sorted(counts))) or "no"
        raise InputError(
            f"SequenceProblem: {words} frames, and stacked energies of {stacked}; expected is one number."
        )
    widest = max([1, *(term.frames for term in problem.between)])
    if widest > problem.num_frames:
        raise InputError(
            f"SequenceProblem: {problem.num_frames} frames were given, and an energy between frames sees {widest}; "
            "give more frames, or leave that energy out."
        )
    own, same = split_frames(problem.frames)
    first = join_frame(jax.tree.map(lambda leaf: leaf[0], own), same)
    check_numbers(first, problem.body)
    with explained(first, problem.body):
        jax.eval_shape(problem.value, problem.start(poses))


def _quality(
    problem: SequenceProblem, y: SequenceEstimate, result
) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """The energy, and whether what a Newton step would gain is a small share of it."""
    arrays, rest = eqx.partition((problem, y), eqx.is_array)
    info = information(*eqx.combine(jax.lax.stop_gradient(arrays), rest))
    hessian: Any = info.hessian
    step = hessian.factorise().solve(info.grad)
    left = 0.5 * sum(jnp.vdot(a, b) for a, b in zip(info.grad, step, strict=True))
    value = info.as_min()
    small = left <= STATIONARY * value + jnp.finfo(value.dtype).eps ** 1.5
    return 2.0 * problem.value(y), small & (result == optx.RESULTS.successful)


def _moved(problem: SequenceProblem, y: SequenceEstimate, d: SequenceTangent) -> SequenceEstimate:
    """Along `d` on the manifold that the joints' own axes span, which may be parameters."""
    return problem.retract(SequenceEstimate(problem.start(y.poses).poses, y.values), d)
