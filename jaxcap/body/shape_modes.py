"""Linear shape modes: joint displacements and vertex displacements of a body at rest, with common coefficients."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..errors import InputError
from .body import Body
from .skeleton import Skeleton


class ShapeModes(eqx.Module):
    """Displacements at rest: with coefficients `z` the joints are at `c + z . centres` and the vertices at
    `x + z . vertices`, metres."""

    centres: Float[Array, "K J 3"]
    vertices: Float[Array, "K V 3"]


def apply_modes(body: Body, modes: ShapeModes, coefficients: Float[Array, "K"]) -> Body:
    """Displace the joints and the surface of a body by its modes, with a coefficient for each."""
    return eqx.tree_at(
        lambda b: (b.skeleton.centres, b.vertices),
        body,
        (
            body.skeleton.centres + jnp.tensordot(coefficients, modes.centres, 1),
            body.vertices + jnp.tensordot(coefficients, modes.vertices, 1),
        ),
    )


def joint_modes(body: Body, move_surface: bool = True) -> ShapeModes:
    """Create the `3 J` modes that displace every joint along every axis.

    With `move_surface` the surface moves with its bones, as a bone that grows stretches its skin. A vertex near
    the start of a bone moves with the start, one near the end with the joint there. Vertices of a joint
    without children move with that joint.
    """
    count = body.skeleton.num_joints
    axes = np.eye(3)
    centres = np.einsum("ij,ab->iajb", np.eye(count), axes).reshape(-1, count, 3)
    shares = _displacement_weights(body, move_surface)
    vertices = np.einsum("vj,ab->javb", shares, axes).reshape(-1, len(shares), 3)
    dtype = body.vertices.dtype
    return ShapeModes(jnp.asarray(centres, dtype), jnp.asarray(vertices, dtype))


def bone_length_modes(body: Body, groups: Sequence[Sequence[int]], move_surface: bool = True) -> ShapeModes:
    """Create a mode for each group of joints: its coefficient is the relative change of the lengths of the bones from their
    parents to them.

    Bones keep their directions at rest, and all that is below moves along. Lengths are linear in the coefficients, also those
    of nested bones. `move_surface` as of `joint_modes`.

    **Raises:** `InputError` for a joint that does not exist, that has no parent, or that is at the same position as it.
    """
    skeleton = body.skeleton
    centres, parents = np.asarray(skeleton.centres, float), skeleton.parents
    shifts = np.zeros((len(groups), skeleton.num_joints, 3))
    for group, joints in enumerate(groups):
        for joint in joints:
            _check_bone(skeleton, joint)
            bone = centres[joint] - centres[parents[joint]]
            shifts[group] += np.outer(skeleton.descendants[joint], bone)
    shares = _displacement_weights(body, move_surface)
    dtype = body.vertices.dtype
    return ShapeModes(
        jnp.asarray(shifts, dtype), jnp.asarray(np.einsum("vj,kja->kva", shares, shifts), dtype)
    )


def _check_bone(skeleton: Skeleton, joint: int) -> None:
    if not 0 <= joint < skeleton.num_joints:
        raise InputError(
            f"bone lengths: there is no joint {joint}; the body has {skeleton.num_joints}, from 0."
        )
    parent = skeleton.parents[joint]
    if parent < 0:
        raise InputError(f"bone lengths: {skeleton.names[joint]} has no parent, so no bone ends there.")
    if not np.linalg.norm(np.asarray(skeleton.centres[joint] - skeleton.centres[parent])) > 0:
        raise InputError(
            f"bone lengths: {skeleton.names[joint]} is at the same position as its parent {skeleton.names[parent]}; leave it out."
        )


def _displacement_weights(body: Body, move_surface: bool) -> Float[np.ndarray, "V J"]:
    """Compute the weight of each joint's displacement for each vertex; zero if the surface does not move.

    A bone's influence is interpolated between the joints at its two ends, by the position of the vertex
    along the bone.
    """
    skeleton: Skeleton = body.skeleton
    if not move_surface:
        return np.zeros((len(body.vertices), skeleton.num_joints))
    influence = np.asarray(body.skin.bone_weights(skeleton.num_joints), float)
    vertices, centres = np.asarray(body.vertices, float), np.asarray(skeleton.centres, float)
    shares = np.zeros_like(influence)
    for joint in range(skeleton.num_joints):
        children = [child for child, parent in enumerate(skeleton.parents) if parent == joint]
        influence_of_joint = influence[:, joint]
        if not children:
            shares[:, joint] += influence_of_joint
            continue
        # weight of each child by the position along the bone; the joint has the rest
        ways = centres[children] - centres[joint]
        lengths = np.maximum(np.sum(ways**2, 1), 1e-12)
        along = np.clip((vertices - centres[joint]) @ ways.T / lengths, 0.0, 1.0)
        along /= np.maximum(along.sum(1, keepdims=True), 1.0)
        for column, child in enumerate(children):
            shares[:, child] += influence_of_joint * along[:, column]
        shares[:, joint] += influence_of_joint * (1.0 - along.sum(1))
    return shares
