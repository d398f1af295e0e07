"""Fitting of one person whose coefficients of some groups, such as an expression, change from mesh to mesh."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...arguments import checked
from ...body.body_model import BodyModel, shape_body
from ...body.shape_modes import ShapeModes
from ...energy.check_energies import UserTerms
from ...errors import InputError
from ...geometry.linear import inverse_symmetric, solve_symmetric
from ...observe.meshes import MeshSequence
from ..fit_model import ModelFit, fit_model
from .model_uncertainty import mesh_equations
from .region_covariance import MIN_CURVATURE, eliminate_pose


@checked
def fit_varying_model(
    model: BodyModel,
    sequence: MeshSequence,
    varying: Sequence[str] = ("expression",),
    *,
    max_steps: int = 40,
    terms: UserTerms = (),
) -> ModelFit:
    """Fit the coefficients of one person to registered meshes, where some groups of coefficients change from mesh to mesh.

    Each mesh is fitted alone first (`fit_model`). The coefficients of the person are the mean of those of the meshes, weighted by the
    normal equations without pose and varying coefficients: one Gauss-Newton step of all meshes together. The others and the poses are
    then fitted again, with this person.

    **Arguments:** `varying`, names of groups of the model; others as in `fit_model`.

    **Raises:** `InputError` if the model has no group of a name, or as `fit_model` does.
    """
    known = [name for name, _ in model.groups]
    missing = [name for name in varying if name not in known]
    if missing or not varying:
        raise InputError(
            f"fit_varying_model: the model has no group of coefficients '{(missing or [''])[0]}'; it has {', '.join(known) or 'none'}."
        )
    changes = np.repeat([name in varying for name in known], [size for _, size in model.groups])
    first = fit_model(model, sequence, same_person=False, max_steps=max_steps, terms=terms)
    shared = _weighted_mean(model, sequence, first, changes)
    person = _person_model(model, shared, changes, varying)
    again = fit_model(
        person, sequence, same_person=False, start=first.motion.poses, max_steps=max_steps, terms=terms
    )
    coefficients = jnp.tile(jnp.asarray(shared, again.coefficients.dtype), (len(sequence), 1))
    return ModelFit(
        motion=again.motion,
        coefficients=coefficients.at[:, np.flatnonzero(changes)].set(again.coefficients),
        rmse=again.rmse,
        num_steps=first.num_steps + again.num_steps,
        converged=first.converged & again.converged,
    )


def _weighted_mean(
    model: BodyModel, sequence: MeshSequence, fit: ModelFit, changes: Bool[np.ndarray, "K"]
) -> Float[np.ndarray, "K"]:
    """Compute the coefficients that all meshes share; those that change are the template's."""
    kept, count = ~changes, len(changes)
    total, sides = np.zeros((kept.sum(), kept.sum())), np.zeros(kept.sum())
    for k, equations in mesh_equations(model, sequence, fit).items():
        matrix = eliminate_pose(equations, count).matrix
        own = matrix[np.ix_(changes, changes)]
        own = own + np.diag(np.where(np.diagonal(own) > 0, MIN_CURVATURE * np.diagonal(own), 1.0))
        coupling = matrix[np.ix_(changes, kept)]
        information = matrix[np.ix_(kept, kept)] - coupling.T @ inverse_symmetric(own) @ coupling
        total += information
        sides += (
            information
            @ (np.asarray(fit.coefficients[k], float) - np.asarray(model.template_coefficients))[kept]
        )
    found = np.array(model.template_coefficients, float)
    diagonal = np.diagonal(total)
    found[kept] += solve_symmetric(
        total + np.diag(np.where(diagonal > 0, MIN_CURVATURE * diagonal, 1.0)), sides
    )
    return found


def _person_model(
    model: BodyModel,
    coefficients: Float[np.ndarray, "K"],
    changes: Bool[np.ndarray, "K"],
    varying: Sequence[str],
) -> BodyModel:
    """Make the model of one person, whose coefficients are those that change."""
    rows = np.flatnonzero(changes)
    return BodyModel(
        template=shape_body(model, jnp.asarray(coefficients)),
        modes=ShapeModes(model.modes.centres[rows], model.modes.vertices[rows]),
        template_coefficients=model.template_coefficients[rows],
        groups=tuple(group for group in model.groups if group[0] in varying),
        family=model.family,
        lowest=None if model.lowest is None else model.lowest[rows],
        highest=None if model.highest is None else model.highest[rows],
    )
