"""The shape space of several people in one rest pose: principal components of joints and vertices."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...adapt.shape.shape_space import learn_shape_space
from ...body.body import Body
from ...body.body_model import BodyModel, body_coefficients

#: the name of the coefficients, as in SMPL's family, and of the family of learned models
GROUP, FAMILY = "betas", "learned"


class PeopleShapes(NamedTuple):
    """A shape space with the coefficients of the people from whom it was learned."""

    model: BodyModel
    coefficients: Float[np.ndarray, "N K"]
    #: share of each component in the variance
    explained: Float[np.ndarray, "K"]


def make_shape_space(bodies: Sequence[Body], components: int | None = None) -> PeopleShapes:
    """Compute the principal components of people over joint centres and rest vertices together; zeros are the mean.

    **Arguments:** `bodies`, at least two, in one rest pose, with the same skin; `components`, their largest number, one less
    than bodies if not given.
    """
    mean = mean_body(bodies)
    most = len(bodies) - 1 if components is None else min(components, len(bodies) - 1)
    space = learn_shape_space(mean, bodies, most)
    count = len(space.template_coefficients)
    model = BodyModel(
        template=mean,
        modes=space.modes,
        template_coefficients=jnp.zeros_like(space.template_coefficients),
        groups=((GROUP, count),),
        family=FAMILY,
    )
    own = np.stack([np.asarray(body_coefficients(model, body), float) for body in bodies])
    return PeopleShapes(model, own, explained_variance(model, bodies))


def mean_body(bodies: Sequence[Body]) -> Body:
    """Average the joint centres and the vertices of bodies in one rest pose."""
    return eqx.tree_at(
        lambda b: (b.skeleton.centres, b.vertices),
        bodies[0],
        (
            jnp.mean(jnp.stack([body.skeleton.centres for body in bodies]), 0),
            jnp.mean(jnp.stack([body.vertices for body in bodies]), 0),
        ),
    )


def explained_variance(model: BodyModel, bodies: Sequence[Body]) -> Float[np.ndarray, "K"]:
    """Compute the share of each component in the variance of joints and vertices over bodies."""
    rows = np.stack([np.concatenate([body.skeleton.centres, body.vertices]) for body in bodies]).astype(float)
    total = np.sum((rows - rows.mean(0)) ** 2) / (len(rows) - 1)
    modes = np.concatenate([model.modes.centres, model.modes.vertices], 1).astype(float)
    # a component has a coefficient with a standard deviation of one
    return np.sum(modes**2, (1, 2)) / total
