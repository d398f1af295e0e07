"""Given joint centres that move with the surface around them, as a body may rest in any pose."""

from typing import TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...adapt.shape.joint_regressor import make_joint_regressor, regress_joints
from ...body.body import Body
from .joint_centre_prior import GivenCentres, replace_centres

Given = TypeVar("Given", GivenCentres, GivenCentres | None)


def carry_given(given: Given, before: Body, rest: Float[Array, "V 3"]) -> Given:
    """Move given centres as the surface around them moves from the rest vertices of a body to others.

    Poses make up for another rest pose, so that bones at rest rotate and shift freely while a body is learned, by some
    centimetres. A centre that stayed where it was would leave its place on the body. Centres on the middle of the body move
    sideways by the same distance. Fixed centres stay.
    """
    if given is None or given.is_fixed:
        return given
    around = make_joint_regressor(eqx.tree_at(lambda b: b.skeleton.centres, before, given.centres))
    moved = jnp.asarray(regress_joints(around, np.asarray(rest, float)), before.vertices.dtype)
    return replace_centres(given, moved)
