"""What a body would lose without one of its joints."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..body.body import Body
from ..body.pose import Pose
from ..geometry.laplacian import vertex_adjacency
from .graft import Removal
from .hang import Bones, bone_motions, hang_children
from .simplex import simplex_least_squares

#: share of a bone in a vertex from which it counts
TOUCHED = 0.02


def find_removals(body: Body, poses: Pose, targets: Float[Array, "F V 3"]) -> list[Removal]:
    """Every joint but the root dissolved into the bones around it, the cheapest first.

    A vertex that the bone moved is blended of the bones around instead, linearly, by least squares
    over the simplex; the cost is what that leaves more than the same blend with the bone. Where children then hang with a gap, their own vertices pay for it.
    """
    skeleton = body.skeleton
    influence = np.asarray(body.skin.influence(skeleton.num_joints), float)
    rest, goals = np.asarray(body.vertices, float), np.asarray(targets, float)
    bones = bone_motions(skeleton, poses)
    joints = [joint for joint, parent in enumerate(skeleton.parents) if parent >= 0]
    around = _around(body, joints)
    chosen = [np.flatnonzero(influence[:, joint] > TOUCHED) for joint in joints]
    width = max((len(row) for row in around), default=0) + 1
    grams = np.concatenate(
        [np.zeros((0, width, width))]
        + [
            _gram(bones, [joint, *others], rest[own], goals[:, own], width)
            for joint, others, own in zip(joints, around, chosen, strict=True)
        ]
    )
    if len(grams) == 0:
        return []
    owner = np.repeat(np.arange(len(joints)), [len(own) for own in chosen])
    real = np.arange(width) <= np.array([len(row) for row in around])[owner, None]
    whole, _ = _fit(grams, real)
    real[:, 0] = False
    lost, weights = _fit(grams, real)
    rise = np.bincount(owner, np.maximum(lost - whole, 0.0), len(joints))
    return sorted(
        (
            _removal(body, bones, rest, joint, others, own, weights[owner == row], float(rise[row]))
            for row, (joint, others, own) in enumerate(zip(joints, around, chosen, strict=True))
        ),
        key=lambda removal: removal.cost,
    )


def _removal(body: Body, bones: Bones, rest, joint, others, own, weights, rise: float) -> Removal:
    skeleton = body.skeleton
    shares = np.zeros((len(own), skeleton.num_joints))
    shares[:, others] = weights[:, 1 : 1 + len(others)]
    hung = hang_children(skeleton, bones, joint, rest)
    counts = np.bincount(np.asarray(body.skin.parts()), minlength=skeleton.num_joints)
    frames = len(bones.rotations)
    gaps = sum(frames * float(counts[child]) * gap**2 for child, (_, _, gap) in hung.items())
    return Removal(joint, rise + gaps, own, shares)


def _around(body: Body, joints: list[int]) -> list[list[int]]:
    """For each joint the bones near it in the tree, up to two joints away, and on the surface."""
    parents, labels = np.array(body.skeleton.parents), np.asarray(body.skin.parts())
    near = np.eye(len(parents), dtype=bool)
    below = np.flatnonzero(parents >= 0)
    near[below, parents[below]] = near[parents[below], below] = True
    near = near @ near
    first, second = vertex_adjacency(np.asarray(body.faces), len(labels)).tocoo().coords
    near[labels[first], labels[second]] = True
    np.fill_diagonal(near, False)
    return [np.flatnonzero(near[joint]).tolist() for joint in joints]


def _gram(bones: Bones, columns: list[int], rest, goals, width: int) -> Float[np.ndarray, "C K K"]:
    """Products of the vertices' distances from their goals, bone by bone; columns filled up to `width`."""
    images = np.einsum("fkab,vb->vkfa", bones.rotations[:, columns], rest)
    images += bones.translations[:, columns].swapaxes(0, 1)
    apart = (images - goals.swapaxes(0, 1)[:, None]).reshape(len(rest), len(columns), -1)
    room = width - len(columns)
    return np.pad(apart @ apart.swapaxes(1, 2), ((0, 0), (0, room), (0, room)))


def _fit(grams: np.ndarray, real: np.ndarray) -> tuple[Float[np.ndarray, "C"], Float[np.ndarray, "C K"]]:
    """The least squares over the simplex, and the weights, of the real columns."""
    own = np.where(real, np.einsum("ckk->ck", grams), np.inf)
    start = np.eye(grams.shape[1])[np.argmin(own, 1)]
    size = np.maximum(own.min(1), 1e-12)[:, None, None]
    weights = simplex_least_squares(
        jnp.asarray(grams / size), jnp.zeros(real.shape), jnp.asarray(start), jnp.asarray(real)
    )
    weights = np.asarray(weights, float)
    return np.einsum("ck,ckl,cl->c", weights, grams, weights), weights
