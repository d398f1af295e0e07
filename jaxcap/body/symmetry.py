"""Left-right symmetry: pairs of joints by their names, and equal lengths of their bones."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Int

from .skeleton import Skeleton

#: pairs of joints, the left one first
LeftRightPairs = Sequence[tuple[int, int]] | Int[np.ndarray, "P 2"]


def left_right_pairs_by_name(names: Sequence[str]) -> list[tuple[int, int]]:
    """Find pairs of left and right joints whose names are equal but for the side."""
    indices = {name: joint for joint, name in enumerate(names)}
    found = []
    for left, right in (("Left", "Right"), ("left", "right"), ("L", "R"), ("l", "r")):
        for joint, name in enumerate(names):
            start = name.find(left)
            while start >= 0:
                twin = name[:start] + right + name[start + len(left) :]
                if twin in indices:
                    found.append((joint, indices[twin]))
                start = name.find(left, start + 1)
    return found


def find_left_right_pairs(skeleton: Skeleton) -> tuple[tuple[int, int], ...]:
    """Find disjoint pairs of left and right joints by their names."""
    found: list[tuple[int, int]] = []
    for pair in left_right_pairs_by_name(skeleton.names):
        if not any(joint in other for other in found for joint in pair):
            found.append(pair)
    return tuple(found)


def length_differences(
    skeleton: Skeleton, pairs: LeftRightPairs
) -> tuple[Float[Array, "B"], Float[Array, "B J 3"]]:
    """Compute the length of the left bone minus that of the right bone of each pair, metres, and its
    derivative by the joint centres.

    It is the residual of the paper's symmetry (Adaptation, eqs. 3.23 to 3.26). There the right bone is
    rotated into the direction of the left one by `R_lr`; the difference then lies along that direction and
    is the difference of lengths. Pairs whose parent is a root are omitted: they end no bone, as a root's
    own centre is arbitrary.
    """
    return bone_length_differences(skeleton.centres, left_right_bones(skeleton, pairs))


def bone_length_differences(
    centres: Float[Array, "J 3"], bones: Int[Array | np.ndarray, "B 4"]
) -> tuple[Float[Array, "B"], Float[Array, "B J 3"]]:
    """Compute the differences of lengths, metres, and their derivatives by the centres, for `left_right_bones`."""
    rows = np.arange(len(bones))
    total = jnp.zeros(len(bones), centres.dtype)
    slopes = jnp.zeros((len(bones), *centres.shape), centres.dtype)
    for (ends, starts), sign in ((bones.T[:2], 1.0), (bones.T[2:], -1.0)):
        vectors = centres[ends] - centres[starts]
        lengths = jnp.linalg.norm(vectors, axis=1)
        directions = vectors / jnp.maximum(lengths, jnp.finfo(lengths.dtype).tiny)[:, None]
        total = total + sign * lengths
        slopes = slopes.at[rows, ends].add(sign * directions).at[rows, starts].add(-sign * directions)
    return total, slopes


def left_right_bones(skeleton: Skeleton, pairs: LeftRightPairs) -> Int[np.ndarray, "B 4"]:
    """List the left joint, its parent, the right joint and its parent of each pair that ends bones."""
    left, right = bone_pairs(skeleton, pairs).T
    parents = np.array(skeleton.parents)
    return np.stack([left, parents[left], right, parents[right]], 1)


def bone_pairs(skeleton: Skeleton, pairs: LeftRightPairs) -> Int[np.ndarray, "B 2"]:
    """Select the pairs that end bones: those whose parents have parents."""
    pairs = np.asarray(pairs, int).reshape(-1, 2)
    grand = np.array([-1 if parent < 0 else skeleton.parents[parent] for parent in skeleton.parents], int)
    return pairs[(grand[pairs] >= 0).all(1) if len(pairs) else slice(0)]


def symmetrise(skeleton: Skeleton, pairs: LeftRightPairs, steps: int = 20) -> Skeleton:
    """Make paired bones equally long, by the smallest displacements of the joint centres."""
    if len(bone_pairs(skeleton, pairs)) == 0:
        return skeleton
    bones = tuple((int(left), int(right)) for left, right in bone_pairs(skeleton, pairs))
    return _with_centres(skeleton, _symmetric_centres(skeleton, bones, steps))


@eqx.filter_jit
def _symmetric_centres(
    skeleton: Skeleton, bones: tuple[tuple[int, int], ...], steps: int
) -> Float[Array, "J 3"]:
    eps = float(jnp.finfo(skeleton.centres.dtype).eps)
    # the SVD gives the minimum-norm step of the underdetermined system
    solver = optx.GaussNewton(rtol=eps, atol=eps, linear_solver=lx.SVD())

    def differences(centres: Float[Array, "J 3"], skeleton: Skeleton) -> Float[Array, "B"]:
        return length_differences(_with_centres(skeleton, centres), bones)[0]

    return optx.least_squares(
        differences, solver, skeleton.centres, args=skeleton, max_steps=steps, throw=False
    ).value


def _with_centres(skeleton: Skeleton, centres: Float[Array, "J 3"]) -> Skeleton:
    return eqx.tree_at(lambda s: s.centres, skeleton, centres)
