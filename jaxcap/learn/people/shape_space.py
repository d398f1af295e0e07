"""The shape space of several people in one rest pose: principal components of joints and vertices."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...adapt.shape.shape_space import learn_shape_space
from ...body.body import Body
from ...body.body_model import BodyModel, shape_body
from ...body.pose import Motion
from ...fit.fit_meshes import fit_meshes
from ...observe.meshes import MeshSequence

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
    return PeopleShapes(model, *principal_scores(model, bodies))


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


def person_body(model: BodyModel, coefficients: Float[np.ndarray, "K"]) -> Body:
    """Make the body of a person from the coefficients."""
    return shape_body(model, jnp.asarray(coefficients, model.template_coefficients.dtype))


def refit_poses(
    space: PeopleShapes, motions: Sequence[Motion], people: Sequence[MeshSequence]
) -> tuple[Motion, ...]:
    """Fit the poses of people to their meshes again, for bodies that fewer components than people have changed."""
    return tuple(
        fit_meshes(person_body(space.model, row), meshes, start=motion.poses).motion
        for row, motion, meshes in zip(space.coefficients, motions, people, strict=True)
    )


def principal_scores(
    model: BodyModel, bodies: Sequence[Body]
) -> tuple[Float[np.ndarray, "N K"], Float[np.ndarray, "K"]]:
    """Compute the coefficients of bodies in their principal components, and the share of each component in the variance."""
    rows = np.stack([np.concatenate([body.skeleton.centres, body.vertices]).ravel() for body in bodies])
    rows = rows.astype(float) - rows.astype(float).mean(0)
    modes = np.concatenate([model.modes.centres, model.modes.vertices], 1).astype(float)
    modes = modes.reshape(len(modes), -1)
    # components are orthogonal, and their lengths are the standard deviations
    variances = np.sum(modes**2, 1)
    return rows @ modes.T / variances, variances * (len(rows) - 1) / np.sum(rows**2)
