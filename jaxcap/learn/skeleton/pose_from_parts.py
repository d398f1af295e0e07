"""Poses of a skeleton that follow rigid parts, joint by joint in closed form."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ...body.pose import Pose
from ...body.skeleton import KINDS, Skeleton
from ...geometry import rotation
from ...geometry.procrustes import Moments, nearest_rotation, rigid_motions

#: the most sweeps over the joints, and the relative decrease of the error at which they end
SWEEPS, RTOL = 30, 1e-3
#: parts with a smaller share of the mass begin with the rotation of their parents
MIN_MASS_SHARE = 0.01

_quaternions = jax.jit(rotation.from_matrix)


def fit_poses(skeleton: Skeleton, moments: Moments) -> Pose:
    """Fit poses, stacked over F frames, in which the bones fit their points by least squares.

    Each joint in turn takes the optimal rotation for its whole subtree, in closed form by Procrustes
    (Adaptation, section 3.2.1, for each limb by itself). Each step lowers the sum of squares; sweeps end when
    it has converged.

    **Arguments:** `moments` of the points of J bones (`group_moments`), with their weights. Roots of kind
    "free" also translate; joints of kinds other than "free" and "ball" are fixed.
    """
    centres = np.asarray(skeleton.centres, float)
    parents = np.array(skeleton.parents)
    count, frames = len(parents), moments.target.shape[1]
    turning = [j for j in range(count) if skeleton.kinds[j] in ("free", "ball")]
    free = [j for j in turning if KINDS[skeleton.kinds[j]][0] == 3 and parents[j] < 0]
    rotations, _ = rigid_motions(moments)
    # small parts, which hardly determine a rotation, and fixed joints first follow their parents
    smallest = MIN_MASS_SHARE * moments.mass.sum()
    for j in range(count):
        if moments.mass[j] <= smallest or j not in turning:
            rotations[j] = np.eye(3) if parents[j] < 0 else rotations[parents[j]]
    local = np.stack(
        [
            rotations[j] if parents[j] < 0 else _relative_rotation(rotations[parents[j]], rotations[j])
            for j in range(count)
        ]
    )
    shifts = np.zeros((count, frames, 3))
    descent = skeleton.descendants
    # translate each root so that its whole tree is at its points
    world_r, world_t = world_transforms(centres, parents, local, shifts)
    for j in free:
        below = np.flatnonzero(descent[j])
        target_sum, current_sum, _ = _transformed_sums(moments.at(below), world_r[below], world_t[below])
        shifts[j] = (target_sum - current_sum) / moments.mass[below].sum()
    least = np.inf
    for _ in range(SWEEPS):
        world_r, world_t = world_transforms(centres, parents, local, shifts)
        for j in [*reversed(turning), *turning]:
            below = np.flatnonzero(descent[j] & (moments.mass > 0))
            if len(below) == 0:
                continue
            # sums over points of x and x' about the joint, x' the current positions
            pivot = np.einsum("fab,b->fa", world_r[j], centres[j]) + world_t[j]
            target_sum, current_sum, cross = _transformed_sums(
                moments.at(below), world_r[below], world_t[below]
            )
            mass = moments.mass[below].sum()
            if j in free:
                place, was = target_sum / mass, current_sum / mass
            else:
                place = was = pivot
            cross = cross - target_sum[:, :, None] * was[:, None] - place[:, :, None] * current_sum[:, None]
            cross = cross + mass * place[:, :, None] * was[:, None]
            turn = nearest_rotation(cross)
            moved = np.flatnonzero(descent[j])
            world_t[moved] = np.einsum("fab,dfb->dfa", turn, world_t[moved] - was) + place
            world_r[moved] = np.einsum("fab,dfbc->dfac", turn, world_r[moved])
        for j in range(count):
            local[j] = world_r[j] if parents[j] < 0 else _relative_rotation(world_r[parents[j]], world_r[j])
            if j in free:
                shifts[j] = np.einsum("fab,b->fa", world_r[j], centres[j]) + world_t[j] - centres[j]
        error = _error(moments, world_r, world_t)
        if error > (1 - RTOL) * least:
            break
        least = error
    dtype = skeleton.centres.dtype
    turns = _quaternions(jnp.asarray(local.swapaxes(0, 1), dtype))
    return Pose(jnp.asarray(shifts.swapaxes(0, 1), dtype), turns, jnp.ones(frames, dtype))


def motion_moments(
    points: Float[np.ndarray, "V 3"],
    labels: Int[np.ndarray, "V"],
    weights: Float[np.ndarray, "V"],
    rotations: Float[np.ndarray, "F K 3 3"],
    translations: Float[np.ndarray, "F K 3"],
) -> Moments:
    """Compute the moments of points that move exactly with the rigid motions of their parts."""
    count = rotations.shape[1]
    r, t = rotations.swapaxes(0, 1), translations.swapaxes(0, 1)
    mass = np.bincount(labels, weights, count)
    source = np.stack([np.bincount(labels, weights * points[:, i], count) for i in range(3)], 1)
    square = np.zeros((count, 3, 3))
    np.add.at(square, labels, weights[:, None, None] * points[:, :, None] * points[:, None, :])
    target = np.einsum("kfab,kb->kfa", r, source) + mass[:, None, None] * t
    cross = r @ square[:, None] + t[..., :, None] * source[:, None, None, :]
    squared_norms = np.einsum("kii->k", square)
    shifted = 2 * np.einsum("kfa,kfa->k", t, target) - mass * np.sum(t * t, (1, 2))
    return Moments(mass, source, target, squared_norms, len(rotations) * squared_norms + shifted, cross)


def _relative_rotation(parent: np.ndarray, child: np.ndarray) -> np.ndarray:
    return np.einsum("fba,fbc->fac", parent, child)


def world_transforms(
    centres: np.ndarray, parents: np.ndarray, local: np.ndarray, shifts: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute world transforms of bones, (J, F, 3, 3) and (J, F, 3), from local rotations and shifts."""
    world_r, world_t = np.empty_like(local), np.empty_like(shifts)
    for j, parent in enumerate(parents):
        shift = shifts[j] + centres[j] - np.einsum("fab,b->fa", local[j], centres[j])
        if parent < 0:
            world_r[j], world_t[j] = local[j], shift
        else:
            world_r[j] = world_r[parent] @ local[j]
            world_t[j] = np.einsum("fab,fb->fa", world_r[parent], shift) + world_t[parent]
    return world_r, world_t


def _transformed_sums(
    moments: Moments, r: np.ndarray, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sum x, x' and x x'^T over the points of several bones, with x' = r p + t: (F, 3), (F, 3), (F, 3, 3)."""
    now = np.einsum("dfab,db->dfa", r, moments.source) + moments.mass[:, None, None] * t
    cross = np.einsum("dfac,dfbc->fab", moments.cross, r) + np.einsum("dfa,dfb->fab", moments.target, t)
    return moments.target.sum(0), now.sum(0), cross


def _error(moments: Moments, r: np.ndarray, t: np.ndarray) -> float:
    """Compute the sum of squares `|r p + t - x|^2`."""
    frames = r.shape[1]
    turned = np.einsum("kfab,kb->kfa", r, moments.source)
    squares = moments.target_square.sum() + frames * moments.source_square.sum()
    squares += np.einsum("k,kfa,kfa->", moments.mass, t, t) + 2 * np.sum(turned * t)
    return float(squares - 2 * np.sum(moments.target * t) - 2 * np.sum(moments.cross * r))
