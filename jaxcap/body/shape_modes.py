"""Ways in which a body at rest may change, joints and surface together, by a few numbers."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .body import Body
from .skeleton import Skeleton


class Modes(eqx.Module):
    """Directions at rest: a body by the amounts `z` has its joints at `c + z . centres`, its vertices at
    `x + z . vertices`, metres."""

    centres: Float[Array, "K J 3"]
    vertices: Float[Array, "K V 3"]


def moved(body: Body, modes: Modes, amounts: Float[Array, "K"]) -> Body:
    """The body with its joints and surface moved by so much of each mode."""
    return eqx.tree_at(
        lambda b: (b.skeleton.centres, b.vertices),
        body,
        (
            body.skeleton.centres + jnp.tensordot(amounts, modes.centres, 1),
            body.vertices + jnp.tensordot(amounts, modes.vertices, 1),
        ),
    )


def joint_modes(body: Body, follow: bool = True) -> Modes:
    """Every joint along every axis, `3 J` modes. Where the surface is to follow, a bone that grows takes its skin with
    it: a vertex beside its start moves with the start, one at its end with the joint there; behind joints
    without children with the joint."""
    count = body.skeleton.num_joints
    axes = np.eye(3)
    centres = np.einsum("ij,ab->iajb", np.eye(count), axes).reshape(-1, count, 3)
    shares = _shares(body) if follow else np.zeros((len(body.vertices), count))
    vertices = np.einsum("vj,ab->javb", shares, axes).reshape(-1, len(shares), 3)
    dtype = body.vertices.dtype
    return Modes(jnp.asarray(centres, dtype), jnp.asarray(vertices, dtype))


def _shares(body: Body) -> Float[np.ndarray, "V J"]:
    """Each vertex's shares of the joints' shifts: those of the two ends of the bones that move it, by where it lies
    between them."""
    skeleton: Skeleton = body.skeleton
    influence = np.asarray(body.skin.influence(skeleton.num_joints), float)
    vertices, centres = np.asarray(body.vertices, float), np.asarray(skeleton.centres, float)
    shares = np.zeros_like(influence)
    for joint in range(skeleton.num_joints):
        children = [child for child, parent in enumerate(skeleton.parents) if parent == joint]
        held = influence[:, joint]
        if not children:
            shares[:, joint] += held
            continue
        # towards each child by how far along the way to it, the rest stays with the joint
        ways = centres[children] - centres[joint]
        lengths = np.maximum(np.sum(ways**2, 1), 1e-12)
        along = np.clip((vertices - centres[joint]) @ ways.T / lengths, 0.0, 1.0)
        along /= np.maximum(along.sum(1, keepdims=True), 1.0)
        for column, child in enumerate(children):
            shares[:, child] += held * along[:, column]
        shares[:, joint] += held * (1.0 - along.sum(1))
    return shares
