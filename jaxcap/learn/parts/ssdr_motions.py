"""Bone motions under linear blending of two bones per vertex."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...geometry.linear import solve_symmetric
from ...geometry.procrustes import Moments, group_moments, rigid_motions
from .rigid_residuals import MovingSurface
from .surface_graph import boundary_edges, membership
from .two_bone_blend import Motions, TwoBoneBlend, fit_part_blends, homogeneous, make_motions, path_products

#: rounds of weights, rest vertices and motions; more rounds fit better, but bones separate at the joints
ROUNDS = 3


class TwoBoneSkinning(NamedTuple):
    """Two-bone linear blend skinning of a moving surface."""

    motions: Motions
    blend: TwoBoneBlend
    rest: Float[np.ndarray, "V 3"]


def estimate_bone_motions(
    scene: MovingSurface, labels: Int[np.ndarray, "V"], motions: Motions
) -> TwoBoneSkinning:
    """Estimate bone motions from rigid part motions under two-bone blending (Le and Deng 2012, section 4).

    The best rigid motion of all vertices of a part is biased towards its neighbours by blended vertices. In
    turn, the method updates each vertex's weight of its own part against an adjacent one, its rest position,
    and the motion of each part, by Procrustes on the residual of the other part. Each update lowers the
    error.
    """
    touching = np.unique(boundary_edges(scene.surface, labels)[0], axis=0)
    rest = scene.rest
    mixed = fit_part_blends(rest, scene.paths, labels, motions, touching)
    for _ in range(ROUNDS):
        rest = _rest_vertices(scene, labels, motions, mixed)
        motions = _bone_motions(scene, rest, labels, motions, mixed)
        mixed = fit_part_blends(rest, scene.paths, labels, motions, touching)
    return TwoBoneSkinning(motions, mixed, rest)


def _rest_vertices(
    scene: MovingSurface, labels: np.ndarray, motions: Motions, mixed: TwoBoneBlend
) -> np.ndarray:
    """Solve `M p + m = x` for rest positions by least squares over the frames, `[M m]` the blend at the
    vertex."""
    count, frames = motions.translations.shape[:2]
    rows = np.arange(len(labels))
    w = mixed.shares[:, None]
    sums = path_products(scene.paths, motions, np.arange(count))
    carried = w * sums[rows, labels] + (1 - w) * sums[rows, mixed.partners]
    cross = motions.products[labels, mixed.partners]
    w = w[:, :, None]
    both = w**2 * motions.products[labels, labels]
    both = both + (1 - w) ** 2 * motions.products[mixed.partners, mixed.partners]
    both = both + w * (1 - w) * (cross + cross.swapaxes(1, 2))
    # opposite rotations can make the system singular; regularise towards the current position
    ridge = 1e-6 * frames * np.eye(3)
    right = carried[:, :3] - both[:, :3, 3] + 1e-6 * frames * scene.rest
    return solve_symmetric(both[:, :3, :3] + ridge, right)


def _bone_motions(
    scene: MovingSurface, rest: np.ndarray, labels: np.ndarray, motions: Motions, mixed: TwoBoneBlend
) -> Motions:
    """Update the rigid motion of each part in turn, with all others fixed."""
    count = len(motions.rotations)
    areas, shares, partners = scene.surface.areas, mixed.shares, mixed.partners
    alone = partners == labels
    others = np.where(alone, 0.0, 1 - shares)
    first = membership(labels, areas * shares, count)
    moments = group_moments(first + membership(partners, areas * others, count), rest, scene.paths)
    weights = membership(labels, areas * shares**2, count) + membership(partners, areas * others**2, count)
    mass, source = np.asarray(weights.sum(1)).ravel(), weights @ rest
    whole = homogeneous(rest)
    outer = (areas * shares * others)[:, None, None] * whole[:, :, None] * whole[:, None, :]
    overlap = np.zeros((count, count, 4, 4))
    np.add.at(overlap, (labels, partners), outer)
    overlap = overlap + overlap.swapaxes(0, 1)
    affine = np.concatenate([motions.rotations, motions.translations[..., None]], -1)
    for part in range(count):
        if mass[part] <= 0:
            continue
        near = np.flatnonzero(overlap[part, :, 3, 3] > 0)
        taken = np.einsum("ofab,obc->fac", affine[near], overlap[part, near])
        left = Moments(
            mass[part],
            source[part],
            moments.target[part] - taken[:, :, 3],
            moments.source_square[part],
            moments.target_square[part],
            moments.cross[part] - taken[:, :, :3],
        )
        affine[part, :, :, :3], affine[part, :, :, 3] = rigid_motions(left)
    return make_motions(affine[..., :3].copy(), affine[..., 3].copy())
