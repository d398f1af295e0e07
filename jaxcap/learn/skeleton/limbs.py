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


class TreeTopology(eqx.Module):
    """Parent indices; roots and padding bones are their own parents."""

    parents: Int[Array, "J"]
    #: one if bone `b` is joint `j` or a descendant of it
    descendants: Float[Array, "J J"]
    roots: Int[Array, "R"]


class BoneState(eqx.Module):
    """World rotations of bones, positions of roots, and joint centres."""

    rotations: Float[Array, "F J 4"]
    root_positions: Float[Array, "F R 3"]
    centres: Float[Array, "J 3"]


class PosedTree(NamedTuple):
    """A skeleton in its poses as arrays."""

    tree: TreeTopology
    bone_state: BoneState


def has_only_ball_joints(skeleton: Skeleton) -> bool:
    """Test whether a skeleton has only "free" roots, and "ball" joints below, as this format requires."""
    pairs = zip(skeleton.kinds, skeleton.parents, strict=True)
    return all(kind == ("free" if parent < 0 else "ball") for kind, parent in pairs)


def make_bone_state(skeleton: Skeleton, poses: Pose) -> PosedTree:
    """Convert a skeleton and F poses with scale one to arrays."""
    count, dtype = skeleton.num_joints, skeleton.centres.dtype
    width = next((width for width in WIDTHS if width >= count), -(-count // WIDTHS[-1]) * WIDTHS[-1])
    room = width - count
    parents = np.array(skeleton.parents)
    roots = np.flatnonzero(parents < 0)
    whole = np.concatenate([np.where(parents < 0, np.arange(count), parents), np.arange(count, width)])
    below = np.pad(skeleton.descendants, (0, room)) | np.eye(width, dtype=bool)
    tree = TreeTopology(
        jnp.asarray(whole, jnp.int32), jnp.asarray(below, dtype), jnp.asarray(roots, jnp.int32)
    )
    turns = [poses.rotations[:, joint] for joint in range(count)]
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            turns[joint] = rotation.multiply(turns[parent], turns[joint])
    still = jnp.broadcast_to(rotation.identity(dtype), (len(turns[0]), 4))
    turns = rotation.normalise(jnp.stack([*turns, *[still] * room], 1))
    centres = np.asarray(skeleton.centres, float)
    positions = np.asarray(poses.translations, float)[:, roots] + centres[roots]
    centres = np.pad(centres, ((0, room), (0, 0)))
    limbs = BoneState(*(jnp.asarray(part, dtype) for part in (turns, positions, centres)))
    return PosedTree(tree, limbs)


def read_bone_state(skeleton: Skeleton, bone_state: BoneState) -> tuple[Skeleton, Pose]:
    """Convert arrays back to the skeleton with its centres, and its poses."""
    dtype, count = skeleton.centres.dtype, skeleton.num_joints
    parents = np.array(skeleton.parents)
    turns = bone_state.rotations[:, :count]
    above = jnp.where((parents < 0)[:, None], rotation.identity(dtype), turns[:, np.maximum(parents, 0)])
    local = rotation.normalise(rotation.multiply(rotation.conjugate(above), turns))
    centres = bone_state.centres[:count]
    roots = np.flatnonzero(parents < 0)
    shifts = np.zeros((len(turns), count, 3))
    shifts[:, roots] = np.asarray(bone_state.root_positions, float) - np.asarray(centres, float)[roots]
    poses = Pose(jnp.asarray(shifts, dtype), local, jnp.ones(len(turns), dtype))
    return eqx.tree_at(lambda s: s.centres, skeleton, centres), poses


def bone_transforms(tree: TreeTopology, bone_state: BoneState) -> Float[Array, "F J 3 4"]:
    """Compute the transforms `(R, t)` of all bones in all frames."""
    turns = rotation.to_matrix(bone_state.rotations)
    arms = bone_state.centres - bone_state.centres[tree.parents]
    joints = _sum_down(tree, _carry(turns[:, tree.parents], arms), bone_state.root_positions)
    return jnp.concatenate([turns, (joints - _carry(turns, bone_state.centres))[..., None]], -1)


def move_bones(tree: TreeTopology, bone_state: BoneState, d: Tangent) -> BoneState:
    """Move along a tangent."""
    turns, shifts, centres = _parts(tree, d)
    moved = rotation.normalise(rotation.multiply(rotation.exp(turns), bone_state.rotations))
    return BoneState(moved, bone_state.root_positions + shifts, bone_state.centres + centres)


def bone_derivatives(tree: TreeTopology, bone_state: BoneState, d: Tangent) -> Float[Array, "F J 3 4"]:
    """Compute the derivatives of the bone transforms `(R, t)` along a tangent."""
    rates, shifts, slides = _parts(tree, d)
    turns, parents = rotation.to_matrix(bone_state.rotations), tree.parents
    above = turns[:, parents]
    arms = _carry(above, bone_state.centres - bone_state.centres[parents])
    steps = jnp.cross(rates[:, parents], arms) + _carry(above, slides - slides[parents])
    linear = jnp.swapaxes(jnp.cross(rates[..., None, :], jnp.swapaxes(turns, 2, 3)), 2, 3)
    joints = _sum_down(tree, steps, shifts)
    constant = joints - _carry(turns, slides) - jnp.cross(rates, _carry(turns, bone_state.centres))
    return jnp.concatenate([linear, constant[..., None]], -1)


def _carry(turns, points):
    return jnp.einsum("fjab,jb->fja", turns, points, precision="highest")


def _sum_down(tree: TreeTopology, steps, roots):
    """Accumulate offsets from each root, where they are zero, down to every joint."""
    return jnp.einsum(
        "jb,fja->fba", tree.descendants, steps.at[:, tree.roots].add(roots), precision="highest"
    )


def _parts(tree: TreeTopology, d: Tangent):
    x, s = d
    count = len(tree.parents)
    centres = jnp.where((tree.parents == jnp.arange(count))[:, None], 0.0, s.reshape(count, 3))
    return x[:, : 3 * count].reshape(-1, count, 3), x[:, 3 * count :].reshape(len(x), -1, 3), centres
