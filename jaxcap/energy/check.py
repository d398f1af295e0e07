"""Whether an energy can be evaluated for a body at all, and in words why not."""

import contextlib
import dataclasses
from collections.abc import Iterator

import jax
import numpy as np
from jax.core import Tracer

from ..arguments import describe
from ..body.body import Body, pose_body
from ..body.pose import Pose, rest_pose
from ..errors import InputError
from .term import AbstractEnergy, bare, name_of, terms_of

#: fields of energies that are numbers of vertices or of joints
_NUMBERS = {"vertices": "vertices", "bones": "joints", "joints": "joints"}


def flat_terms(energy: AbstractEnergy) -> list[AbstractEnergy]:
    """The summands of an energy, of sums within sums as well."""
    terms = terms_of(energy)
    return (
        [energy]
        if len(terms) == 1 and terms[0] is energy
        else [part for term in terms for part in flat_terms(term)]
    )


def check_numbers(energy: AbstractEnergy, body: Body) -> None:
    """That an energy is of vertices and joints that the body has: JAX would take the last one for any beyond.

    Traced arrays, whose values are not known, are not looked at.

    **Raises:** `InputError` with the energy, the field, the number and how many there are.
    """
    counts = {"vertices": len(body.vertices), "joints": body.skeleton.num_joints}
    for term in map(bare, flat_terms(energy)):
        for field, what in _NUMBERS.items():
            numbers = getattr(term, field, None)
            if isinstance(numbers, Tracer) or not isinstance(numbers, (jax.Array, np.ndarray)):
                continue
            if not np.issubdtype(numbers.dtype, np.integer) or not numbers.size:
                continue
            values = np.asarray(numbers)
            wrong = (values < 0) | (values >= counts[what])
            if wrong.any():
                raise InputError(
                    f"{name_of(term)}: `{field}` has {int(values[wrong][0])}, and the body has {counts[what]} {what}; "
                    f"expected are 0 to {counts[what] - 1}."
                )


@contextlib.contextmanager
def explained(energy: AbstractEnergy, body: Body, pose: Pose | None = None) -> Iterator[None]:
    """Turn an error of a residual's own arrays in the block into a sentence; nothing is done where there is none.

    **Raises:** `InputError` with the first term whose residual cannot be evaluated, its fields and the error.
    """
    try:
        yield
    except InputError:
        raise
    except (TypeError, ValueError, IndexError, AttributeError) as error:
        pose = rest_pose(body.skeleton) if pose is None else pose
        for term in flat_terms(energy):
            try:
                shape = jax.eval_shape(lambda term=term: term.residual(pose_body(body, pose)))
            except Exception as found:
                raise InputError(_words(term, body, str(found).splitlines()[0])) from error
            if len(getattr(shape, "shape", ())) != 1:
                given = getattr(shape, "shape", type(shape).__name__)
                raise InputError(_words(term, body, f"it is {given}, not one row (R,)")) from error
        raise


def _words(term: AbstractEnergy, body: Body, reason: str) -> str:
    term = bare(term)
    fields = [f"`{field.name}` {describe(getattr(term, field.name))}" for field in dataclasses.fields(term)]
    return (
        f"{type(term).__name__}: its residual cannot be evaluated for a body of {body.skeleton.num_joints} joints and "
        f"{len(body.vertices)} vertices ({reason[:200].rstrip('.')}); {', '.join(fields) or 'it has no fields'}."
    )
