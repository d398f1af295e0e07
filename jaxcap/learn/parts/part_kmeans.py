"""Refinement of rigid parts: k-means with rigid motions, and split-and-drop moves out of local minima."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from ...geometry.procrustes import Moments, rigid_errors, rigid_motions
from .agglomerate import agglomerate, merged_labels
from .rigid_residuals import MovingSurface, part_costs, part_moments
from .surface_graph import adjacency, boundary_edges, cut_patches, make_connected, membership
from .two_bone_blend import Motions, TwoBoneBlend, fit_part_blends, fit_two_bone_blends, make_motions

#: patches into which a part is cut before it is split in two
SPLIT_PATCHES = 24
#: the most rounds of k-means, and the relative change at which it has converged
ROUNDS, RTOL = 30, 1e-3
#: split-and-drop moves tried per part
MOVES_PER_PART = 1
#: rounds in which patch borders move, and the share of its cost below which a vertex changes patch
BORDER_ROUNDS, BORDER_RATIO = 5, 0.5


class PartState(NamedTuple):
    """The current parts, their motions and their blends."""

    labels: Int[np.ndarray, "V"]
    moments: Moments
    motions: Motions
    blend: TwoBoneBlend

    def error(self, scene: MovingSurface) -> float:
        """Compute the blend error, vertices weighted by area, summed over frames."""
        return float(scene.surface.areas @ self.blend.errors)


def improve_parts(scene: MovingSurface, labels: Int[np.ndarray, "V"], count: int) -> PartState:
    """Refine parts by k-means, then drop one part and split another as long as both together lower the error.

    The error is that of vertices moved by a blend of their own part and an adjacent one (`fit_two_bone_blends`), as under a
    skin. Parts that only model the bend of the skin around a joint are therefore replaced by parts that move
    independently.
    """
    state = settle_parts(scene, labels, count)
    # splits are cached by part; neighbours affect them little, and the error after the move decides
    splits: dict[bytes, tuple[float, np.ndarray]] = {}
    refused: set[tuple[bytes, bytes]] = set()
    for _ in range(MOVES_PER_PART * count if count > 2 else 0):
        keys = [np.flatnonzero(state.labels == part).tobytes() for part in range(count)]
        for part, key in enumerate(keys):
            if key not in splits:
                splits[key] = _split(scene, state, part)
        touching = np.unique(boundary_edges(scene.surface, state.labels)[0], axis=0)
        drops = [_drop(scene, state, part, touching) for part in range(count)]
        change = np.array([cost for cost, _ in drops])[:, None] - np.array([splits[key][0] for key in keys])
        np.fill_diagonal(change, np.inf)
        for i, first in enumerate(keys):
            for j, second in enumerate(keys):
                if (first, second) in refused:
                    change[i, j] = np.inf
        dropped, part = np.unravel_index(np.argmin(change), change.shape)
        least = state.error(scene)
        if change[dropped, part] > -RTOL * least:
            break
        tried = drops[dropped][1].copy()
        tried[splits[keys[part]][1]] = dropped
        after = settle_parts(scene, tried, count)
        if after.error(scene) < (1 - RTOL) * least:
            state = after
        else:
            refused.add((keys[dropped], keys[part]))
    return state


def refine_patch_borders(scene: MovingSurface, patches: Int[np.ndarray, "V"]) -> Int[np.ndarray, "V"]:
    """Move vertices at patch borders to a neighbouring patch that fits their motion clearly better.

    Patches are cut without regard to motion. After this, none crosses a joint.
    """
    ring = adjacency(scene.surface)
    rows = np.arange(len(patches))
    for _ in range(BORDER_ROUNDS):
        count = int(patches.max()) + 1
        costs = part_costs(scene, *rigid_motions(part_moments(scene, patches, count)))
        near = (ring @ membership(patches, np.ones(len(patches)), count).T).toarray() > 0
        current_costs = BORDER_RATIO * costs[rows, patches]
        reach = np.where(near, costs, np.inf)
        reach[rows, patches] = current_costs
        moved = np.argmin(reach, axis=1)
        if (moved == patches).all():
            break
        patches = np.unique(make_connected(scene.surface, moved, costs), return_inverse=True)[1]
    return patches


def settle_parts(scene: MovingSurface, labels: Int[np.ndarray, "V"], count: int) -> PartState:
    """Refine `count` parts by k-means, and compute their motions and blends.

    Vertices with the label -1 first go to the neighbouring part that fits them best.
    """
    labels, moments = _refine(scene, labels, count)
    motions = make_motions(*rigid_motions(moments))
    touching = np.unique(boundary_edges(scene.surface, labels)[0], axis=0)
    return PartState(
        labels, moments, motions, fit_part_blends(scene.rest, scene.paths, labels, motions, touching)
    )


def _drop(
    scene: MovingSurface, state: PartState, part: int, touching: np.ndarray
) -> tuple[float, np.ndarray]:
    """Compute the rise of the error without a part, and the labels after that.

    Each of its vertices goes to the part with the larger share in the best blend of two parts around it.
    """
    around = np.unique(touching[(touching == part).any(1)])
    around = around[around != part]
    vertices = np.flatnonzero(state.labels == part)
    pairs = np.array([(a, b) for a in around for b in around if a <= b], int)
    errors, shares = fit_two_bone_blends(scene.rest[vertices], scene.paths[vertices], state.motions, pairs)
    best = np.argmin(errors, axis=1)
    rows = np.arange(len(vertices))
    rise = scene.surface.areas[vertices] @ (errors[rows, best] - state.blend.errors[vertices])
    labels = state.labels.copy()
    labels[vertices] = np.where(shares[rows, best] >= 0.5, pairs[best, 0], pairs[best, 1])
    return float(rise), labels


def _split(scene: MovingSurface, state: PartState, part: int) -> tuple[float, np.ndarray]:
    """Compute the fall of the error when a part is split in two, and the vertices of one half."""
    vertices = np.flatnonzero(state.labels == part)
    patches = cut_patches(scene.surface, scene.rest, SPLIT_PATCHES, vertices)
    if patches.max() < 1:
        return 0.0, vertices[:0]
    small = part_moments(scene, patches, int(patches.max()) + 1)
    merging = agglomerate(small, boundary_edges(scene.surface, patches)[0])
    half = vertices[merged_labels(merging, 2)[patches[vertices]] == 1]
    count = len(state.motions.rotations)
    labels = state.labels.copy()
    labels[half] = count
    moved = part_moments(scene, np.where(labels == part, 0, np.where(labels == count, 1, -1)), 2)
    rotations, translations = rigid_motions(moved)
    motions = make_motions(
        np.concatenate([state.motions.rotations, rotations[1:]]),
        np.concatenate([state.motions.translations, translations[1:]]),
    )
    motions.rotations[part], motions.translations[part] = rotations[0], translations[0]
    motions = make_motions(motions.rotations, motions.translations)
    touching = np.unique(boundary_edges(scene.surface, labels)[0], axis=0)
    after = fit_part_blends(scene.rest[vertices], scene.paths[vertices], labels[vertices], motions, touching)
    return float(scene.surface.areas[vertices] @ (state.blend.errors[vertices] - after.errors)), half


def _refine(scene: MovingSurface, labels: np.ndarray, count: int) -> tuple[np.ndarray, Moments]:
    """Alternate between assigning vertices to parts and fitting rigid motions (Le and Deng 2012), until
    convergence.

    Parts stay connected. Returns the best labels found, and their moments.
    """
    ring = adjacency(scene.surface)
    degree = np.asarray(ring.sum(1))
    labels = make_connected(
        scene.surface, labels, part_costs(scene, *rigid_motions(part_moments(scene, labels, count)))
    )
    best, best_moments, least = labels, part_moments(scene, labels, count), np.inf
    for _ in range(ROUNDS):
        moments = part_moments(scene, labels, count)
        error = rigid_errors(moments).sum()
        if error < least:
            done = error > (1 - RTOL / 10) * least
            best, best_moments, least = labels, moments, error
            if done:
                break
        else:
            break
        costs = part_costs(scene, *rigid_motions(moments))
        # averaging costs over neighbours keeps borders short
        smooth = 0.5 * costs + 0.5 * (ring @ costs) / np.maximum(degree, 1)
        labels = make_connected(scene.surface, np.argmin(smooth, axis=1), smooth)
        if len(np.unique(labels)) < count:
            break
    return best, best_moments
