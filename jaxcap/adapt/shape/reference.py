"""The reference body of an actor, and its shape prior."""

import jax.numpy as jnp

from ...body.body import Body
from ..task import AdaptState, AdaptTask
from .scale import resized
from .shape_prior import ShapePrior, own_shape_prior, scaled
from .shape_space import person


def reference(task: AdaptTask, state: AdaptState) -> Body:
    """Return the person with the actor's shape coefficients, or else the template at the actor's size."""
    dtype = task.template.vertices.dtype
    if task.people is not None and state.traits:
        return person(task.people, jnp.asarray(state.traits, dtype))
    return resized(task.template, jnp.asarray(state.size, dtype))


def shape_prior_of(task: AdaptTask, state: AdaptState) -> ShapePrior:
    """Return the shape prior of training meshes at the actor's size, or else that of the reference body."""
    return own_shape_prior(reference(task, state)) if task.shape is None else scaled(task.shape, state.size)
