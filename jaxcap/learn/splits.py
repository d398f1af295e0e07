"""Bones that bend: what a body would gain by one joint more."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import connected_components

from ..body.body import Body
from ..body.pose import Pose
from ..geometry.procrustes import Moments, group_moments, rigid_errors, rigid_motions
from .agglomerate import agglomerate, merged_labels
from .graft import Split
from .hang import bone_motions
from .surface import Surface, adjacency, cut_patches, label_edges, make_surface, membership

#: patches of a bone by which it may be split, and the most sets of them that are tried for a bone of its own
PATCHES, SETS = 32, 8
#: the least number of vertices that make a bone
LEAST = 8
#: rounds in which the border of a split moves, and the share of its cost for which a vertex changes over
ROUNDS, CLEARLY = 8, 0.5


def find_splits(body: Body, poses: Pose, errors: Float[np.ndarray, "F V 3"]) -> list[Split]:
    """The best split of every bone, by what it gains, greatest first.

    The errors are carried back to the rest shape by each vertex's bone, where vertices stand that
    are explained; those that are not move there, and what a bone lacks moves as one. So the bone is
    merged from patches as parts are, and of the last sets the one is split off that lowers the
    error of rigid motions most.
    """
    labels, rest = np.asarray(body.skin.parts()), np.asarray(body.vertices, float)
    surface = make_surface(rest, rest[None], np.asarray(body.faces))
    bones = bone_motions(body.skeleton, poses)
    paths = np.einsum("fvab,fva->vfb", bones.rotations[:, labels], np.asarray(errors, float)) + rest[:, None]
    found = [
        _best_split(body, surface, labels, rest, paths, bone) for bone in range(body.skeleton.num_joints)
    ]
    return sorted((split for split in found if split is not None), key=lambda split: -split.gain)


def _best_split(body: Body, surface: Surface, labels, rest, paths, bone: int) -> Split | None:
    own = _largest_piece(surface, np.flatnonzero(labels == bone))
    if len(own) < 2 * LEAST:
        return None
    patches = cut_patches(surface, rest, min(PATCHES, len(own) // LEAST), own)
    number = int(patches.max()) + 1
    if number < 2:
        return None
    moments = group_moments(membership(patches[own], np.ones(len(own)), number), rest[own], paths[own])
    merging = agglomerate(moments, label_edges(surface, patches)[0])
    sets = {
        tuple(np.flatnonzero(groups == group))
        for count in range(2, min(SETS, number) + 1)
        for groups in [merged_labels(merging, count)]
        for group in range(count)
    }
    halves = np.array([[np.isin(np.arange(number), s), ~np.isin(np.arange(number), s)] for s in sorted(sets)])
    sums = [np.einsum("shp,p...->sh...", halves.astype(float), field) for field in moments]
    best = int(np.argmin(rigid_errors(Moments(*sums)).sum(1)))
    half = np.zeros(len(labels), bool)
    half[own] = halves[best, 1][patches[own]]
    half, both = _sharpen(surface, rest, paths, own, half)
    gain = float(merging.errors[0] - rigid_errors(both).sum())
    if gain <= 0 or not LEAST <= half.sum() <= len(own) - LEAST:
        return None
    rotations, translations = rigid_motions(both)
    upper = _upper_half(body, surface, labels, rest, bone, half)
    order = [0, 1] if upper == 0 else [1, 0]
    below = half if upper == 0 else (labels == bone) & ~half
    children = tuple(
        child
        for child, parent in enumerate(body.skeleton.parents)
        if parent == bone and _side(body, surface, labels, rest, bone, half, child) != upper
    )
    crossing = surface.edges[below[surface.edges[:, 0]] != below[surface.edges[:, 1]]]
    crossing = crossing[(labels[crossing] == bone).all(1)]
    ends = rest[crossing].mean(1)
    middle = ends.mean(0)
    radius = float(np.sqrt(np.mean(np.sum((ends - middle) ** 2, 1))))
    return Split(
        bone,
        gain,
        below,
        children,
        rotations[order].swapaxes(0, 1),
        translations[order].swapaxes(0, 1),
        middle,
        radius,
    )


def _sharpen(surface: Surface, rest, paths, own, half) -> tuple[Bool[np.ndarray, "V"], Moments]:
    """The half of a bone's vertices with a border where they move clearly so, and the moments of
    both halves."""
    rows = np.arange(len(own))
    for turn in range(ROUNDS + 1):
        groups = membership(half[own].astype(int), np.ones(len(own)), 2)
        both = group_moments(groups, rest[own], paths[own])
        rotations, translations = rigid_motions(both)
        there = np.einsum("hfab,vb->vhfa", rotations, rest[own]) + translations
        costs = np.sum((there - paths[own][:, None]) ** 2, (2, 3))
        costs[rows, half[own].astype(int)] *= CLEARLY
        moved = own[costs[:, 1] < costs[:, 0]]
        new = np.zeros_like(half)
        new[_largest_piece(surface, moved)] = True
        if turn == ROUNDS or new.sum() in (0, len(own)) or (new == half).all():
            break
        half = new
    return half, both


def _largest_piece(surface: Surface, own: Int[np.ndarray, "C"]) -> Int[np.ndarray, "P"]:
    if len(own) == 0:
        return own
    _, pieces = connected_components(adjacency(surface)[own][:, own], directed=False)
    return own[pieces == np.argmax(np.bincount(pieces))]


def _upper_half(body: Body, surface: Surface, labels, rest, bone: int, half) -> int:
    """Which half of a bone keeps its joint: the one towards the parent; at a root, the greater."""
    if body.skeleton.parents[bone] < 0:
        return int(half.sum() > (labels == bone).sum() / 2)
    return _side(body, surface, labels, rest, bone, half, bone)


def _side(body: Body, surface: Surface, labels, rest, bone: int, half, joint: int) -> int:
    """Which half of a bone a joint of it is at: the one with more edges to what is beyond, or else
    with the nearer vertex."""
    beyond = body.skeleton.parents[bone] if joint == bone else joint
    both = np.concatenate([surface.edges, surface.edges[:, ::-1]])
    reached = both[(labels[both[:, 0]] == bone) & (labels[both[:, 1]] == beyond), 0]
    if len(reached):
        return int(np.mean(half[reached]) > 0.5)
    gaps = np.linalg.norm(rest - np.asarray(body.skeleton.centres, float)[joint], axis=1)
    return int(gaps[half].min() < gaps[(labels == bone) & ~half].min())
