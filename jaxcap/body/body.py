"""Bodies: a skeleton, a surface, and a skin that binds the surface to the skeleton."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from ..arguments import check_fields, check_length, checked, dimension_lengths
from ..errors import InputError
from ..geometry.mesh import vertex_normals
from ..value_checks import check_faces
from .kinematics import Transforms, forward_kinematics, joint_positions
from .pose import Pose
from .skeleton import Skeleton
from .skin import AbstractSkin


class Body(eqx.Module):
    """An articulated surface at rest; `vertices` in metres, `faces` counter-clockwise as seen from outside."""

    skeleton: Skeleton
    skin: AbstractSkin
    vertices: Float[Array, "V 3"]
    faces: Int[Array, "F 3"]

    def __check_init__(self):
        lengths = {**check_fields(self), "J": (self.skeleton.num_joints, "skeleton")}
        of_skin = dimension_lengths(self.skin)
        for dim in ("V", "J"):
            if dim in of_skin:
                check_length(self, "skin", of_skin[dim][0], lengths, dim)
        check_faces("Body", self.faces, len(self.vertices))
        check_skin_weights(self.skin)


def check_skin_weights(skin: AbstractSkin) -> None:
    """Check that every vertex of a skin has a positive sum of weights; traced weights and skins without
    weights pass.

    **Raises:** `InputError` with the first vertex that has none.
    """
    weights = getattr(skin, "weights", None)
    if weights is None or isinstance(weights, Tracer):
        return
    # negated so that NaN counts as wrong
    loose = ~(np.asarray(weights).sum(1) > 0)
    if loose.any():
        raise InputError(
            f"{type(skin).__name__}: `weights` of vertex {int(loose.argmax())} sum to "
            f"{np.asarray(weights)[loose.argmax()].sum():g}; expected 1, so that at least one bone moves the vertex."
        )


class Posed(eqx.Module):
    """A body in a pose, computed once per evaluation and passed to every energy."""

    body: Body
    pose: Pose
    transforms: Transforms
    #: world positions of the joint centres
    joints: Float[Array, "J 3"]
    vertices: Float[Array, "V 3"]
    normals: Float[Array, "V 3"]


@checked
@partial(jax.jit, inline=True)
def pose_body(body: Body, pose: Pose) -> Posed:
    """Pose a body. Outputs that the caller does not use are not computed under `jit`."""
    transforms = forward_kinematics(body.skeleton, pose)
    vertices = body.skin.deform(body.vertices, body.skeleton, pose, transforms)
    return Posed(
        body=body,
        pose=pose,
        transforms=transforms,
        joints=joint_positions(body.skeleton, transforms),
        vertices=vertices,
        normals=vertex_normals(vertices, body.faces),
    )


def take_vertices(body: Body, rows: Int[Array, "R"], faces: Int[Array, "F 3"] | None = None) -> Body:
    """Restrict a body to `rows` of its vertices, in this order. `faces` index the new rows; without them
    the body has none."""
    faces = jnp.zeros((0, 3), body.faces.dtype) if faces is None else faces
    return Body(body.skeleton, body.skin.take(rows), body.vertices[rows], faces)


@checked
@eqx.filter_jit
def posed_vertices(body: Body, poses: Pose) -> Float[Array, "*frames V 3"]:
    """Compute the vertices of a body in one pose, or in every pose of a stack, metres."""
    if poses.scale.ndim == 0:
        return pose_body(body, poses).vertices
    return jax.lax.map(lambda pose: pose_body(body, pose).vertices, poses)


def scale_body(body: Body, factor: Float[Array, ""]) -> Body:
    """Scale a body at rest about the origin."""
    return eqx.tree_at(
        lambda b: (b.vertices, b.skeleton.centres, b.skin),
        body,
        (body.vertices * factor, body.skeleton.centres * factor, body.skin.scaled(factor)),
    )


def body_height(body: Body) -> Float[Array, ""]:
    """Compute the longest side of the bounding box of a body at rest, metres."""
    return jnp.max(jnp.max(body.vertices, 0) - jnp.min(body.vertices, 0))
