"""Joints of the left and of the right: which are twins, and bones that are as long as their twins."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .skeleton import Skeleton

#: of joints, the left one first
Pairs = Sequence[tuple[int, int]] | Int[np.ndarray, "P 2"]


def twin_joints(names: Sequence[str]) -> list[tuple[int, int]]:
    """Joints of the left with those of the right that are called alike but for the side."""
    places = {name: joint for joint, name in enumerate(names)}
    found = []
    for left, right in (("Left", "Right"), ("left", "right"), ("L", "R"), ("l", "r")):
        for joint, name in enumerate(names):
            start = name.find(left)
            while start >= 0:
                twin = name[:start] + right + name[start + len(left) :]
                if twin in places:
                    found.append((joint, places[twin]))
                start = name.find(left, start + 1)
    return found


def mirrored_joints(skeleton: Skeleton) -> tuple[tuple[int, int], ...]:
    """Pairs of joints of the left and the right, by their names; each joint in one of them at most."""
    found: list[tuple[int, int]] = []
    for pair in twin_joints(skeleton.names):
        if not any(joint in other for other in found for joint in pair):
            found.append(pair)
    return tuple(found)


def length_differences(skeleton: Skeleton, pairs: Pairs) -> tuple[Float[Array, "B"], Float[Array, "B J 3"]]:
    """By how much the bone from its parent to the left joint is longer than to the right one,
    metres, and how that changes with the centres of the joints.

    It is the residual of the paper's symmetry (Adaptation, eqs. 3.23 to 3.26): there the right
    bone is turned into the left one's direction by `R_lr`, and what is left of their difference
    is along that direction, as long as the bones differ. A joint that hangs on a root ends no
    bone, as a root's own centre may be anywhere: such pairs are left out.
    """
    count = skeleton.num_joints
    parents = np.array(skeleton.parents)
    pairs = bones_of(skeleton, pairs)
    total = jnp.zeros(len(pairs), skeleton.centres.dtype)
    slopes = jnp.zeros((len(pairs), count, 3), skeleton.centres.dtype)
    rows = np.arange(len(pairs))
    for side, sign in ((0, 1.0), (1, -1.0)):
        ends, starts = pairs[:, side], parents[pairs[:, side]]
        bones = skeleton.centres[ends] - skeleton.centres[starts]
        lengths = jnp.linalg.norm(bones, axis=1)
        directions = bones / jnp.maximum(lengths, jnp.finfo(lengths.dtype).tiny)[:, None]
        total = total + sign * lengths
        slopes = slopes.at[rows, ends].add(sign * directions).at[rows, starts].add(-sign * directions)
    return total, slopes


def bones_of(skeleton: Skeleton, pairs: Pairs) -> Int[np.ndarray, "B 2"]:
    """The pairs that end bones: those whose parents have parents."""
    pairs = np.asarray(pairs, int).reshape(-1, 2)
    grand = np.array([-1 if parent < 0 else skeleton.parents[parent] for parent in skeleton.parents], int)
    return pairs[(grand[pairs] >= 0).all(1) if len(pairs) else slice(0)]


def symmetrise(skeleton: Skeleton, pairs: Pairs, steps: int = 20) -> Skeleton:
    """The skeleton with paired bones equally long, by the smallest shifts of its centres."""
    if len(bones_of(skeleton, pairs)) == 0:
        return skeleton
    for _ in range(steps):
        differences, slopes = length_differences(skeleton, pairs)
        shift = -jnp.linalg.lstsq(slopes.reshape(len(differences), -1), differences)[0]
        skeleton = eqx.tree_at(lambda s: s.centres, skeleton, skeleton.centres + shift.reshape(-1, 3))
    return skeleton
