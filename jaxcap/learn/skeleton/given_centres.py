"""Joint centres of a given skeleton, which move with the surface around them, as a body may rest in any pose."""

from typing import NamedTuple, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...adapt.shape.joint_regressor import make_joint_regressor, regress_joints
from ...body.body import Body


class GivenCentres(NamedTuple):
    """Joint centres of a given skeleton; with `is_fixed` they are fixed."""

    centres: Float[Array, "J 3"]
    is_fixed: bool = False
    #: unit normals of the planes through joints on the middle of the body, in which their centres stay; zero for other
    #: joints; None if there are no such planes
    normals: Float[Array, "J 3"] | None = None


Given = TypeVar("Given", bound=GivenCentres)
MaybeGiven = TypeVar("MaybeGiven", GivenCentres, GivenCentres | None)


def onto_middle(centres: Float[Array, "J 3"], given: GivenCentres) -> Float[Array, "J 3"]:
    """Move the joints on the middle of the body sideways, so that all are as far from the given planes."""
    assert given.normals is not None
    away = jnp.sum((centres - given.centres) * given.normals, 1)
    members = jnp.any(given.normals != 0, 1)
    mean = jnp.sum(away * members) / jnp.maximum(members.sum(), 1)
    return centres + jnp.where(members, mean - away, 0.0)[:, None] * given.normals


def replace_centres(given: Given, centres: Float[Array, "J 3"]) -> Given:
    """Give new centres; those on the middle of the body all move sideways by the same distance."""
    return given._replace(centres=centres if given.normals is None else onto_middle(centres, given))


def carry_given(given: MaybeGiven, before: Body, rest: Float[Array, "V 3"]) -> MaybeGiven:
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
