"""Checks that an energy can be evaluated for a body, with explanatory errors."""

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ..arguments import describe
from ..body.body import Body, pose_body
from ..body.pose import Pose, rest_pose
from ..errors import InputError
from ..value_checks import check_values, concrete_values
from .energy import AbstractEnergy, Weighted, energy_name, sum_energies, terms_of, unweighted

#: energies of a user's own: one or several
UserTerms = AbstractEnergy | Sequence[AbstractEnergy]

#: fields of energies that are indices of vertices or of joints
_INDEX_FIELDS = {"vertices": "vertices", "bones": "joints", "joints": "joints"}


def flat_terms(energy: AbstractEnergy) -> list[AbstractEnergy]:
    """List the terms of an energy, including those of nested sums."""
    terms = terms_of(energy)
    return (
        [energy]
        if len(terms) == 1 and terms[0] is energy
        else [part for term in terms for part in flat_terms(term)]
    )


def check_energy_arrays(energy: AbstractEnergy, body: Body) -> None:
    """Check the vertex and joint indices, weights and data of an energy against a body.

    Indices have to exist in the body, because JAX would clamp those beyond the last. Weights have to be at
    least zero, because negative ones would count as zero. The data of the library's own energies may be NaN
    only where the weight is zero. Traced arrays, whose values are unknown, are not checked.

    **Raises:** `InputError` with the energy, the field, the value and the expectation.
    """
    counts = {"vertices": len(body.vertices), "joints": body.skeleton.num_joints}
    for term in flat_terms(energy):
        _check_weight(term)
        _check_data(unweighted(term))
        for field, what in _INDEX_FIELDS.items():
            numbers = getattr(unweighted(term), field, None)
            if isinstance(numbers, (jax.Array, np.ndarray)) and np.issubdtype(numbers.dtype, np.integer):
                check_indices(energy_name(term), field, numbers, what, counts[what])


def check_indices(owner: str, field: str, indices: Any, item: str, count: int) -> None:
    """Check that indices of vertices or joints exist in a body.

    **Raises:** `InputError` with the first that does not.
    """
    if isinstance(indices, Tracer):
        return
    values = np.asarray(indices, int)
    wrong = (values < 0) | (values >= count)
    if wrong.any():
        raise InputError(
            f"{owner}: `{field}` has {int(values[wrong][0])}, and the body has {count} {item}; "
            f"expected 0 to {count - 1}."
        )


def _check_weight(term: AbstractEnergy) -> None:
    while isinstance(term, Weighted):
        if not isinstance(term.weight, Tracer):
            weight = np.asarray(term.weight)
            # written so that NaN counts as wrong
            if not (weight >= 0).all():
                raise InputError(
                    f"{energy_name(term)}: its weight is {float(weight.min()):g}; expected a number of at least 0."
                )
        term = term.energy


def _check_data(term: AbstractEnergy) -> None:
    """Check weights and data of an energy of the library; other energies define their own valid data."""
    if type(term).__module__.partition(".")[0] != __name__.partition(".")[0]:
        return
    weights = getattr(term, "weights", None)
    if not isinstance(weights, Tracer) and eqx.is_inexact_array_like(weights):
        check_values(energy_name(term), lambda w: w >= 0, "a weight of at least 0", weights=weights)
    _check_finite(term)


def sum_user_terms(where: str, terms: UserTerms, body: Body) -> AbstractEnergy | None:
    """Add up a user's own energies, after a check that they can be evaluated for a body; None where there are
    none.

    **Raises:** `InputError` with the term for an object that is not an energy, for arrays that do not fit the
    body or have NaN, for weights below zero and for a residual that is not one row.
    """
    given = (terms,) if isinstance(terms, AbstractEnergy) else tuple(terms)
    for term in given:
        if not isinstance(term, AbstractEnergy):
            raise InputError(
                f"{where}: `terms` has a {type(term).__name__}; expected energies, such as make_floor(body)."
            )
        check_energy_arrays(term, body)
        for part in flat_terms(term):
            _check_finite(part)
            _check_residual(part, body, rest_pose(body.skeleton))
    return sum_energies(given)


def check_finite_residuals(where: str, terms: AbstractEnergy, body: Body, pose: Pose) -> None:
    """Check that the residual of each of a user's terms is finite in a pose; nothing is checked where arrays are traced.

    **Raises:** `InputError` with the term and the number of its rows that are not finite.
    """
    for term in flat_terms(terms):
        rows = concrete_values(_residual_in(term, body, pose))
        if rows is not None and not np.isfinite(rows).all():
            bad = int((~np.isfinite(rows)).sum())
            raise InputError(
                f"{where}: the residual of {energy_name(term)} is not finite in {bad} of {len(rows)} rows, in a pose of this fit; "
                "guard its square roots and divisions, and give missing data the weight zero."
            )


@eqx.filter_jit
def _residual_in(term: AbstractEnergy, body: Body, pose: Pose) -> Float[Array, "R"]:
    return term.residual(pose_body(body, pose))


def _check_finite(term: AbstractEnergy) -> None:
    """Check that there is no NaN, except in rows of weight zero."""
    term = unweighted(term)
    if isinstance(getattr(term, "weights", None), Tracer):
        # unknown weights do not show which rows count
        return
    weights = concrete_values(getattr(term, "weights", None))
    for field in dataclasses.fields(term):
        for leaf in jax.tree.leaves(getattr(term, field.name)):
            if not isinstance(leaf, Tracer) and eqx.is_inexact_array_like(leaf):
                missing = np.isnan(np.asarray(leaf))
                if missing.any() and weights is not None and missing.shape[: weights.ndim] == weights.shape:
                    missing = missing[weights != 0]
                if missing.any():
                    raise InputError(
                        f"{type(term).__name__}: `{field.name}` has NaN; expected numbers; give missing data the "
                        "weight zero."
                    )


def _check_residual(term: AbstractEnergy, body: Body, pose: Pose) -> None:
    """Check that a residual is one row, of the same length in each call."""
    lengths = []
    for _ in range(2):
        try:
            shape = jax.eval_shape(lambda: term.residual(pose_body(body, pose)))
        except Exception as found:
            raise InputError(_residual_message(term, body, str(found).splitlines()[0])) from found
        if len(getattr(shape, "shape", ())) != 1:
            given = getattr(shape, "shape", type(shape).__name__)
            raise InputError(_residual_message(term, body, f"it is {given}; expected one row (R,)"))
        lengths.append(shape.shape[0])
    if lengths[0] != lengths[1]:
        raise InputError(
            _residual_message(
                term, body, f"its length changes from call to call, from {lengths[0]} to {lengths[1]}"
            )
        )
    plain = unweighted(term)
    for method, width in (("vertex_jacobian", 3), ("bone_jacobian", 6)):
        if hasattr(plain, method):
            _check_closed_form(plain, method, width, lengths[0], body, pose)


def _check_closed_form(
    term: AbstractEnergy, method: str, width: int, length: int, body: Body, pose: Pose
) -> None:
    """Check that a closed-form derivative has the shape of the residual."""
    try:
        _, rows = jax.eval_shape(lambda: getattr(term, method)(pose_body(body, pose)))
    except Exception as found:
        raise InputError(
            f"{energy_name(term)}: `{method}` cannot be evaluated ({str(found).splitlines()[0][:200].rstrip('.')})."
        ) from found
    shape = rows.shape
    if len(shape) < 3 or shape[-1] != width or shape[0] * shape[-2] != length:
        raise InputError(
            f"{energy_name(term)}: `{method}` returns derivatives {shape} of a residual of {length}; expected "
            f"(C, K, R, {width}) with C R = {length}."
        )


@contextlib.contextmanager
def explain_errors(energy: AbstractEnergy, body: Body, pose: Pose | None = None) -> Iterator[None]:
    """Explain an error that the arrays of a residual cause in the block; do nothing without an error.

    **Raises:** `InputError` with the first term whose residual cannot be evaluated, its fields and the error.
    """
    try:
        yield
    except InputError:
        raise
    except (TypeError, ValueError, IndexError, AttributeError):
        for term in flat_terms(energy):
            _check_residual(term, body, rest_pose(body.skeleton) if pose is None else pose)
        raise


def _residual_message(term: AbstractEnergy, body: Body, reason: str) -> str:
    term = unweighted(term)
    fields = [f"`{field.name}` {describe(getattr(term, field.name))}" for field in dataclasses.fields(term)]
    return (
        f"{type(term).__name__}: its residual cannot be evaluated for a body of {body.skeleton.num_joints} joints and "
        f"{len(body.vertices)} vertices ({reason[:200].rstrip('.')}); {', '.join(fields) or 'it has no fields'}."
    )
