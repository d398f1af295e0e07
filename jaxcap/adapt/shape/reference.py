"""The body that an actor is held to, and its shape."""

import jax.numpy as jnp

from ...body.body import Body
from ..task import AdaptState, Task
from .scale import resized
from .shape_prior import ShapePrior, own_shape_prior, scaled
from .shape_space import person


def reference(task: Task, state: AdaptState) -> Body:
    """The person with the actor's traits where these are known, else the template at the actor's size."""
    dtype = task.template.vertices.dtype
    if task.people is not None and state.traits:
        return person(task.people, jnp.asarray(state.traits, dtype))
    return resized(task.template, jnp.asarray(state.size, dtype))


def shape_prior_of(task: Task, state: AdaptState) -> ShapePrior:
    """What is known of the actor's shape: that of training meshes at the actor's size, else of the reference
    itself."""
    return own_shape_prior(reference(task, state)) if task.shape is None else scaled(task.shape, state.size)
