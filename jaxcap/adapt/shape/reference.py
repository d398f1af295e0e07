"""The reference body of an actor, and its shape prior."""

import jax.numpy as jnp

from ...body.body import Body, scale_body
from ...body.body_model import shape_from_template
from ..task import AdaptState, AdaptTask
from .shape_prior import ShapePrior, body_shape_prior, scale_shape_prior


def reference_body(task: AdaptTask, state: AdaptState) -> Body:
    """Return the person with the actor's shape coefficients, or else the template at the actor's size."""
    dtype = task.template.vertices.dtype
    if task.shape_space is not None and state.coefficients:
        return shape_from_template(task.shape_space, jnp.asarray(state.coefficients, dtype))
    return scale_body(task.template, jnp.asarray(state.size, dtype))


def shape_prior_of(task: AdaptTask, state: AdaptState) -> ShapePrior:
    """Return the shape prior of training meshes at the actor's size, or else that of the reference body."""
    return (
        body_shape_prior(reference_body(task, state))
        if task.shape_prior is None
        else scale_shape_prior(task.shape_prior, state.size)
    )
