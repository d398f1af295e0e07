"""Candidate positions of a bone among unlabelled points, by the distances between its markers."""

from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ...geometry.procrustes import group_moments, rigid_motions

#: number of triples of markers that are searched for on each bone, and of candidates that are kept
MAX_TRIPLES, MAX_CANDIDATES = 5, 60
#: least distance of the third marker of a triple from the line through the others, metres
MIN_HEIGHT = 0.015


class BoneMatches(NamedTuple):
    """K candidate positions of a bone: `x = R o + t` of its N markers, and the points that match them."""

    rotations: Float[np.ndarray, "K 3 3"]
    translations: Float[np.ndarray, "K 3"]
    #: indices of points, -1 where no point matches a marker
    points: Int[np.ndarray, "K N"]
    #: sum over matched markers of one minus the squared distance in tolerances
    scores: Float[np.ndarray, "K"]


def match_rigid_bone(
    offsets: Float[np.ndarray, "N 3"],
    points: Float[np.ndarray, "P 3"],
    distances: Float[np.ndarray, "P P"],
    steady: Bool[np.ndarray, "P P"],
    tolerance: float,
) -> BoneMatches:
    """Find triples of points with the distances of three markers of a bone, and match its other markers.

    Only pairs of points with a `steady` distance over time are candidates for one bone.
    """
    found: list[BoneMatches] = []
    for i, j, k in _wide_triples(offsets):
        lengths = [np.linalg.norm(offsets[a] - offsets[b]) for a, b in ((i, j), (i, k), (j, k))]
        near = [(np.abs(distances - length) < tolerance) & steady for length in lengths]
        triples = np.argwhere(near[0][:, :, None] & near[1][:, None, :] & near[2][None])
        if len(triples):
            found.append(match_by_fit(offsets, [i, j, k], triples, points, tolerance))
    return best_matches(found, len(offsets))


def match_by_fit(
    offsets: Float[np.ndarray, "N 3"],
    markers: list[int],
    chosen: Int[np.ndarray, "K 3"],
    points: Float[np.ndarray, "P 3"],
    tolerance: float,
) -> BoneMatches:
    """Align three markers to each of K triples of points, and match all markers of the bone."""
    moments = group_moments(np.ones((1, 3)), offsets[markers], np.swapaxes(points[chosen], 0, 1))
    rotations, translations = (part[0] for part in rigid_motions(moments))
    return match_moved(offsets, rotations, translations, points, tolerance)


def match_moved(
    offsets: Float[np.ndarray, "N 3"],
    rotations: Float[np.ndarray, "K 3 3"],
    translations: Float[np.ndarray, "K 3"],
    points: Float[np.ndarray, "P 3"],
    tolerance: float,
) -> BoneMatches:
    """Match the markers of a bone at K positions to their nearest points."""
    predicted = np.einsum("kab,nb->kna", rotations, offsets) + translations[:, None]
    away = np.linalg.norm(predicted[:, :, None] - points, axis=3)
    nearest = away.argmin(2)
    gain = 1 - (away.min(2) / tolerance) ** 2
    # a point belongs to one marker only
    shared = (nearest[:, :, None] == nearest[:, None]) & (gain[:, None] > gain[:, :, None])
    kept = (gain > 0) & ~shared.any(2)
    return BoneMatches(rotations, translations, np.where(kept, nearest, -1), np.where(kept, gain, 0.0).sum(1))


def best_matches(found: list[BoneMatches], count: int) -> BoneMatches:
    """Join candidates, drop repeated ones, and keep those with the highest scores."""
    if not found:
        return BoneMatches(np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, count), int), np.zeros(0))
    joined = BoneMatches(*(np.concatenate(parts) for parts in zip(*found, strict=True)))
    order = np.argsort(-joined.scores, kind="stable")
    _, first = np.unique(joined.points[order], axis=0, return_index=True)
    chosen = order[np.sort(first)][:MAX_CANDIDATES]
    return BoneMatches(*(part[chosen] for part in joined))


def _wide_triples(offsets: Float[np.ndarray, "N 3"]) -> list[tuple[int, int, int]]:
    """List the triples of markers that are farthest from a line, none where all are near a line."""

    def height(triple: tuple[int, int, int]) -> float:
        a, b, c = offsets[list(triple)]
        sides = [np.linalg.norm(b - a), np.linalg.norm(c - a), np.linalg.norm(c - b)]
        return float(np.linalg.norm(np.cross(b - a, c - a)) / max(*sides, 1e-9))

    triples = [some for some in combinations(range(len(offsets)), 3) if height(some) > MIN_HEIGHT]
    return sorted(triples, key=height, reverse=True)[:MAX_TRIPLES]
