"""The rest pose of the human for a person whose skeleton was placed in a mesh in another pose."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...body.body import Body
from ...body.pose import Pose, rest_pose
from ...geometry import rotation
from ...rigging.template import load_template
from ..people.person import Person
from ..people.rest_alignment import rotate_at_rest
from ..skeleton.given_centres import GivenCentres


def rest_as_template(
    body: Body, poses: Pose, targets: Float[Array, "F V 3"], given: GivenCentres
) -> tuple[Body, Pose, GivenCentres]:
    """Rotate the bones of a placed person to the rest pose of the human, and keep all poses of the bones in the meshes.

    Skinning depends on the rest pose: a limb that rests bent cannot be blended as one that rests straight. The trunk keeps
    its direction.
    """
    skeleton = body.skeleton
    turned = rotation.multiply(
        skeleton.orientations, rotation.conjugate(load_template().body.skeleton.orientations)
    )
    parents = np.array(skeleton.parents)
    root = jnp.broadcast_to(turned[int(np.flatnonzero(parents < 0)[0])], turned.shape)
    world = rotation.multiply(turned, rotation.conjugate(root))
    above = jnp.where((parents < 0)[:, None], rotation.identity(world.dtype), world[np.maximum(parents, 0)])
    pose = eqx.tree_at(
        lambda p: p.rotations, rest_pose(skeleton), rotation.multiply(rotation.conjugate(above), world)
    )
    person = rotate_at_rest(Person(body, poses, targets, given, 0.0), pose)
    back = rotation.conjugate(world)
    orientations = rotation.multiply(back, skeleton.orientations)
    axes = jnp.einsum("jab,jkb->jka", rotation.to_matrix(back), skeleton.axes)
    body = eqx.tree_at(
        lambda b: (b.skeleton.orientations, b.skeleton.axes), person.body, (orientations, axes)
    )
    return body, person.poses, person.given
