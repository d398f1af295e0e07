"""Joints of the left and of the right: which are twins, and bones that are as long as their twins."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
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
    """Make paired bones equally long, by the smallest shifts of the skeleton's centres."""
    if len(bones_of(skeleton, pairs)) == 0:
        return skeleton
    bones = tuple((int(left), int(right)) for left, right in bones_of(skeleton, pairs))
    return _with_centres(skeleton, _evened(skeleton, bones, steps))


@eqx.filter_jit
def _evened(skeleton: Skeleton, bones: tuple[tuple[int, int], ...], steps: int) -> Float[Array, "J 3"]:
    eps = float(jnp.finfo(skeleton.centres.dtype).eps)
    # of all solutions of fewer rows than unknowns the SVD gives the shortest
    solver = optx.GaussNewton(rtol=eps, atol=eps, linear_solver=lx.SVD())

    def differences(centres: Float[Array, "J 3"], skeleton: Skeleton) -> Float[Array, "B"]:
        return length_differences(_with_centres(skeleton, centres), bones)[0]

    return optx.least_squares(
        differences, solver, skeleton.centres, args=skeleton, max_steps=steps, throw=False
    ).value


def _with_centres(skeleton: Skeleton, centres: Float[Array, "J 3"]) -> Skeleton:
    return eqx.tree_at(lambda s: s.centres, skeleton, centres)
