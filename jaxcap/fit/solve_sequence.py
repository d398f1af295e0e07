"""Solve for all frames of a sequence and what they share, and differentiate through the solution."""

from typing import Any

import equinox as eqx
import jax
import numpy as np
import optimistix as optx
from jax.core import Tracer
from jax.interpreters.partial_eval import dce_jaxpr
from jaxtyping import Array, Bool, Float, Int

from ..arguments import checked
from ..body.body import Body
from ..body.pose import Motion, Pose
from ..energy.check import check_numbers, explained
from ..energy.stacked import join_frame, num_frames_of, split_frames
from ..errors import InputError
from .sequence_problem import SequenceEstimate, SequenceProblem
from .solvers.implicit import implicit_minimum, is_trustworthy
from .solvers.levenberg_marquardt import LevenbergMarquardt
from .solvers.minimise import AnySolver


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
    found = implicit_minimum(problem, start, solver, max_steps, _onto)
    trustworthy = is_trustworthy(problem, found)
    estimate, energy = found.y, 2.0 * problem.value(found.y)
    return SequenceSolution(
        problem.body_at(estimate.values),
        estimate.poses,
        estimate.values,
        energy,
        found.history,
        found.num_steps,
        found.result,
        trustworthy,
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
    start = problem.start(poses)
    with explained(first, problem.body):
        _check_seen(problem, start)
    _check_bounds(problem, start)


def _check_seen(problem: SequenceProblem, start: SequenceEstimate) -> None:
    """That every shared unknown has a part in the energy."""
    shapes = jax.eval_shape(lambda: start)
    traced = jax.make_jaxpr(lambda values: problem.value(SequenceEstimate(start.poses, values)))(
        shapes.values
    )
    _, used = dce_jaxpr(traced.jaxpr, [True])
    for name, parts in jax.tree.unflatten(jax.tree.structure(shapes.values), used).items():
        if not any(jax.tree.leaves(parts)):
            raise InputError(
                f"SequenceProblem: no energy depends on the unknown '{name}'; give one that does, or leave it out of `unknowns`."
            )


def _check_bounds(problem: SequenceProblem, start: SequenceEstimate) -> None:
    for name, unknown in problem.unknowns.items():
        ends = unknown.bounds(start.values[name])
        if ends is None or any(isinstance(end, Tracer) for end in ends):
            continue
        crossed = np.flatnonzero(np.asarray(ends[0]) > np.asarray(ends[1]))
        if len(crossed):
            low, high = (float(end[crossed[0]]) for end in ends)
            raise InputError(
                f"SequenceProblem: bounds of the unknown '{name}' cross: number {crossed[0]} is at least {low:g} and at most "
                f"{high:g} from its start; give the smaller one first."
            )


def _onto(problem: SequenceProblem, y: SequenceEstimate) -> SequenceEstimate:
    """Onto the manifold that the joints' own axes span, which may be parameters."""
    return SequenceEstimate(problem.start(y.poses).poses, y.values)
