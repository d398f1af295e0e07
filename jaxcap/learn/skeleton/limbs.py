"""Bones of a tree as arrays. Trees of any shape share compiled code.

A bone maps `v` to `G (v - c) + p`, with its rotation `G` in the world, the centre `c` of its joint at rest,
and the position `p` of that joint. The unknowns are the world rotations of all bones, the positions of the
roots, and the centres.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...body.pose import Pose
from ...body.skeleton import Skeleton
from ...geometry import rotation

#: bone arrays are padded to one of these sizes, or to a multiple of the last, so that added or removed joints
#: need no compilation
WIDTHS = (16, 40, 64)
#: tangents of each frame, rotations of the bones and translations of the roots, `(F, 3 J + 3 R)`;
#: translations of the centres `(3 J,)`
Tangent = tuple[Float[Array, "F D"], Float[Array, "S"]]


class Tree(eqx.Module):
    """Parent indices; roots and padding bones are their own parents."""

    parents: Int[Array, "J"]
    #: one if bone `b` is joint `j` or a descendant of it
    below: Float[Array, "J J"]
    roots: Int[Array, "R"]


class Limbs(eqx.Module):
    """World rotations of bones, positions of roots, and joint centres."""

    turns: Float[Array, "F J 4"]
    places: Float[Array, "F R 3"]
    centres: Float[Array, "J 3"]


class Grown(NamedTuple):
    """A skeleton in its poses as arrays."""

    tree: Tree
    limbs: Limbs


def is_simple(skeleton: Skeleton) -> bool:
    """Test whether a skeleton has only "free" roots, and "ball" joints below, as this format requires."""
    pairs = zip(skeleton.kinds, skeleton.parents, strict=True)
    return all(kind == ("free" if parent < 0 else "ball") for kind, parent in pairs)


def make_limbs(skeleton: Skeleton, poses: Pose) -> Grown:
    """Convert a skeleton and F poses with scale one to arrays."""
    count, dtype = skeleton.num_joints, skeleton.centres.dtype
    width = next((width for width in WIDTHS if width >= count), -(-count // WIDTHS[-1]) * WIDTHS[-1])
    room = width - count
    parents = np.array(skeleton.parents)
    roots = np.flatnonzero(parents < 0)
    whole = np.concatenate([np.where(parents < 0, np.arange(count), parents), np.arange(count, width)])
    below = np.pad(skeleton.descent, (0, room)) | np.eye(width, dtype=bool)
    tree = Tree(jnp.asarray(whole, jnp.int32), jnp.asarray(below, dtype), jnp.asarray(roots, jnp.int32))
    turns = [poses.rotations[:, joint] for joint in range(count)]
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            turns[joint] = rotation.multiply(turns[parent], turns[joint])
    still = jnp.broadcast_to(rotation.identity(dtype), (len(turns[0]), 4))
    turns = rotation.normalise(jnp.stack([*turns, *[still] * room], 1))
    centres = np.asarray(skeleton.centres, float)
    places = np.asarray(poses.translations, float)[:, roots] + centres[roots]
    centres = np.pad(centres, ((0, room), (0, 0)))
    limbs = Limbs(*(jnp.asarray(part, dtype) for part in (turns, places, centres)))
    return Grown(tree, limbs)


def read_limbs(skeleton: Skeleton, limbs: Limbs) -> tuple[Skeleton, Pose]:
    """Convert arrays back to the skeleton with its centres, and its poses."""
    dtype, count = skeleton.centres.dtype, skeleton.num_joints
    parents = np.array(skeleton.parents)
    turns = limbs.turns[:, :count]
    above = jnp.where((parents < 0)[:, None], rotation.identity(dtype), turns[:, np.maximum(parents, 0)])
    local = rotation.normalise(rotation.multiply(rotation.conjugate(above), turns))
    centres = limbs.centres[:count]
    roots = np.flatnonzero(parents < 0)
    shifts = np.zeros((len(turns), count, 3))
    shifts[:, roots] = np.asarray(limbs.places, float) - np.asarray(centres, float)[roots]
    poses = Pose(jnp.asarray(shifts, dtype), local, jnp.ones(len(turns), dtype))
    return eqx.tree_at(lambda s: s.centres, skeleton, centres), poses


def bones_of(tree: Tree, limbs: Limbs) -> Float[Array, "F J 3 4"]:
    """Compute the transforms `(R, t)` of all bones in all frames."""
    turns = rotation.to_matrix(limbs.turns)
    arms = limbs.centres - limbs.centres[tree.parents]
    joints = _sum_down(tree, _carry(turns[:, tree.parents], arms), limbs.places)
    return jnp.concatenate([turns, (joints - _carry(turns, limbs.centres))[..., None]], -1)


def move_limbs(tree: Tree, limbs: Limbs, d: Tangent) -> Limbs:
    """Move along a tangent."""
    turns, shifts, centres = _parts(tree, d)
    moved = rotation.normalise(rotation.multiply(rotation.exp(turns), limbs.turns))
    return Limbs(moved, limbs.places + shifts, limbs.centres + centres)


def bone_rates(tree: Tree, limbs: Limbs, d: Tangent) -> Float[Array, "F J 3 4"]:
    """Compute the derivatives of the bone transforms `(R, t)` along a tangent."""
    rates, shifts, slides = _parts(tree, d)
    turns, parents = rotation.to_matrix(limbs.turns), tree.parents
    above = turns[:, parents]
    arms = _carry(above, limbs.centres - limbs.centres[parents])
    steps = jnp.cross(rates[:, parents], arms) + _carry(above, slides - slides[parents])
    linear = jnp.swapaxes(jnp.cross(rates[..., None, :], jnp.swapaxes(turns, 2, 3)), 2, 3)
    joints = _sum_down(tree, steps, shifts)
    constant = joints - _carry(turns, slides) - jnp.cross(rates, _carry(turns, limbs.centres))
    return jnp.concatenate([linear, constant[..., None]], -1)


def _carry(turns, points):
    return jnp.einsum("fjab,jb->fja", turns, points, precision="highest")


def _sum_down(tree: Tree, steps, roots):
    """Accumulate offsets from each root, where they are zero, down to every joint."""
    return jnp.einsum("jb,fja->fba", tree.below, steps.at[:, tree.roots].add(roots), precision="highest")


def _parts(tree: Tree, d: Tangent):
    x, s = d
    count = len(tree.parents)
    centres = jnp.where((tree.parents == jnp.arange(count))[:, None], 0.0, s.reshape(count, 3))
    return x[:, : 3 * count].reshape(-1, count, 3), x[:, 3 * count :].reshape(len(x), -1, 3), centres
