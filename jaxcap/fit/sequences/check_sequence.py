"""Checks before the first step that a problem of a sequence can be solved, with explanatory errors."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.interpreters.partial_eval import dce_jaxpr

from ...body.pose import Motion, Pose
from ...energy.check_energies import check_energy_arrays, check_indices, explain_errors
from ...energy.stacked import NormalPrior, frame_counts, join_frame, split_frames
from ...errors import InputError
from .sequence_problem import SequenceEstimate, SequenceProblem
from .unknowns import AbstractUnknown

#: fields of unknowns that are indices of joints or of vertices
_INDEX_FIELDS = {"joints": "joints", "bones": "joints", "vertices": "vertices"}


def check_sequence(problem: SequenceProblem, poses: Pose) -> None:
    """Check that a problem can be solved from a start.

    **Raises:** `InputError` for inconsistent frames, unknowns that do not fit the body or that no energy
    depends on, crossed bounds, and energies that cannot be evaluated.
    """
    _check_unknowns(problem)
    _check_frames(problem, poses)
    _check_constraints(problem)
    own, same = split_frames(problem.frames)
    check_energy_arrays(join_frame(own, same), problem.body)
    first = join_frame(jax.tree.map(lambda leaf: leaf[0], own), same)
    start = problem.start(poses)
    with explain_errors(first, problem.body):
        _check_dependence(problem, start)
    _check_bounds(problem, start)


def checked_start(problem: SequenceProblem, start: Pose | Motion | SequenceEstimate) -> SequenceEstimate:
    """Return the estimate from which a problem is solved, from poses or an estimate, after the checks of `check_sequence` and
    of its values. Raises `InputError`.
    """
    poses = start if isinstance(start, Pose) else start.poses
    check_sequence(problem, poses)
    if isinstance(start, SequenceEstimate):
        _check_values(problem, start)
        return start
    return problem.start(poses)


def _check_values(problem: SequenceProblem, start: SequenceEstimate) -> None:
    """Check that an estimate has a value for each unknown."""
    if set(start.values) != set(problem.unknowns):
        raise InputError(
            f"SequenceEstimate: the values are of {', '.join(sorted(start.values)) or 'nothing'}; expected those of the unknowns "
            f"{', '.join(sorted(problem.unknowns)) or 'none'}."
        )
    for name, unknown in problem.unknowns.items():
        given, needed = (
            jax.tree.map(jnp.shape, each) for each in (start.values[name], unknown.start(problem.body))
        )
        if given != needed:
            raise InputError(
                f"SequenceEstimate: the value of '{name}' has the shape {given}; expected {needed}."
            )


def _check_unknowns(problem: SequenceProblem) -> None:
    given, body = problem.unknowns, problem.body
    for name, unknown in given.items() if isinstance(given, dict) else ():
        if isinstance(unknown, type):
            raise InputError(
                f"SequenceProblem: `unknowns[{name!r}]` is the class {unknown.__name__} itself; make one, as by {unknown.__name__}(...)."
            )
    if not isinstance(given, dict) or not all(isinstance(each, AbstractUnknown) for each in given.values()):
        raise InputError(
            f"SequenceProblem: `unknowns` is {type(given).__name__} of {', '.join(type(each).__name__ for each in (given.values() if isinstance(given, dict) else given)) or 'nothing'}; "
            "expected a dict of unknowns by name, such as {'size': Size()}."
        )
    counts: dict[str, int] = {"joints": body.skeleton.num_joints, "vertices": len(body.vertices)}
    for name, unknown in given.items():
        for field, what in _INDEX_FIELDS.items():
            numbers = getattr(unknown, field, ())
            owner = f"{type(unknown).__name__} '{name}'"
            check_indices(owner, field, numbers, what, counts[what])
            twice = sorted({number for number in numbers if numbers.count(number) > 1})
            if twice:
                raise InputError(f"{owner}: `{field}` has {twice[0]} twice; expected unique indices.")
    for prior in problem.shared:
        if isinstance(prior, NormalPrior) and prior.name not in given:
            raise InputError(
                f"NormalPrior: there is no unknown '{prior.name}'; expected one of "
                f"{', '.join(sorted(given)) or 'none'}."
            )


def _check_frames(problem: SequenceProblem, poses: Pose) -> None:
    given = {"poses": poses.scale.shape[0] if poses.scale.ndim else 1, "times": problem.num_frames}
    if problem.fixed is not None:
        given["fixed"] = len(problem.fixed)
    counts = frame_counts(problem.frames)
    if len({*given.values(), *counts}) > 1:
        words = ", ".join(f"{count} in `{name}`" for name, count in given.items())
        stacked = " and ".join(map(str, sorted(counts))) or "none"
        raise InputError(
            f"SequenceProblem: the numbers of frames are {words}, and {stacked} in stacked energies; "
            "expected equal numbers."
        )
    widest = max([1, *(term.frames for term in problem.between)])
    if widest > problem.num_frames:
        raise InputError(
            f"SequenceProblem: {problem.num_frames} frames were given, but an energy between frames needs "
            f"{widest}; give more frames, or leave out that energy."
        )
    if problem.between and not isinstance(problem.times, Tracer):
        wrong = np.flatnonzero(~(np.diff(np.asarray(problem.times)) > 0))
        if len(wrong):
            frame = int(wrong[0])
            raise InputError(
                f"SequenceProblem: `times` changes from {float(problem.times[frame]):g} to "
                f"{float(problem.times[frame + 1]):g} at frame {frame + 1}; expected strictly increasing "
                "times."
            )


def _check_constraints(problem: SequenceProblem) -> None:
    if not problem.left_right_pairs:
        return
    check_indices(
        "SequenceProblem",
        "left_right_pairs",
        problem.left_right_pairs,
        "joints",
        problem.body.skeleton.num_joints,
    )
    if not problem.unknowns:
        raise InputError(
            "SequenceProblem: `left_right_pairs` needs unknown lengths of bones, but there are no `unknowns`; give "
            "some, or leave out `left_right_pairs`."
        )
    bounded = [
        name for name, each in problem.unknowns.items() if each.bounds(each.start(problem.body)) is not None
    ]
    if bounded:
        raise InputError(
            f"SequenceProblem: `left_right_pairs` and bounds of the unknown '{bounded[0]}' cannot be combined; "
            "leave out one of them."
        )


def _check_dependence(problem: SequenceProblem, start: SequenceEstimate) -> None:
    """Check that the energy depends on every shared unknown."""
    shapes = jax.eval_shape(lambda: start)
    traced = jax.make_jaxpr(lambda values: problem.value(SequenceEstimate(start.poses, values)))(
        shapes.values
    )
    _, used = dce_jaxpr(traced.jaxpr, [True])
    for name, parts in jax.tree.unflatten(jax.tree.structure(shapes.values), used).items():
        if not any(jax.tree.leaves(parts)):
            raise InputError(
                f"SequenceProblem: no energy depends on the unknown '{name}'; add one that does, or leave "
                "the unknown out of `unknowns`."
            )


def _check_bounds(problem: SequenceProblem, start: SequenceEstimate) -> None:
    for name, unknown in problem.unknowns.items():
        ends: Any = unknown.bounds(unknown.start(problem.body))
        if ends is None or any(isinstance(end, Tracer) for end in ends):
            continue
        crossed = np.flatnonzero(~(np.asarray(ends[0]) <= np.asarray(ends[1])))
        if len(crossed):
            low, high = (float(end[crossed[0]]) for end in ends)
            raise InputError(
                f"SequenceProblem: the bounds of the unknown '{name}' are crossed: relative to its start, "
                f"component {crossed[0]} is at least {low:g} and at most {high:g}; give the smaller bound "
                "first."
            )
