"""Hypotheses of the labels in one frame: a bone that its distances identify, and then bone by bone along the skeleton."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ...geometry.procrustes import nearest_rotation
from ..subject import Subject
from .rigid_matches import BoneMatches, best_matches, match_moved, match_rigid_bone

#: number of bones to start from, of hypotheses that are continued, and of candidates for the next bone of each
NUM_SEEDS, NUM_HYPOTHESES, NUM_OPTIONS = 4, 30, 4
#: uncertainty of a joint centre of a bone with matched markers, metres, and of a bone without for each metre from its own joint
JOINT_SLACK, SLACK_PER_METRE = 0.03, 0.6
#: largest uncertainty of a joint from which a bone with two markers is found, metres
MAX_PIVOT_SLACK = 0.12
#: weight of the parent's rotation, metres squared, and penalty of a rotation by half a turn from it
PARENT_WEIGHT, TURN_PENALTY = 2e-4, 0.6


class _Growth(NamedTuple):
    """The bones of a hypothesis so far: `x = R o + t`, the slack of their positions, and matched points."""

    rotations: Float[np.ndarray, "J 3 3"]
    translations: Float[np.ndarray, "J 3"]
    slacks: Float[np.ndarray, "J"]
    points: Int[np.ndarray, "M"]
    score: float


class _Search:
    """The points of a frame, and the markers of each bone that are looked for among them."""

    def __init__(self, subject: Subject, points, steady, tolerance: float, rotations=None):
        bones, used = np.asarray(subject.bones), np.asarray(subject.weights) > 0
        self.subject, self.points, self.steady, self.tolerance = subject, points, steady, tolerance
        # the rotations of bones in a pose near by, or at rest
        self.rotations = (
            np.tile(np.eye(3), (len(subject.skeleton.parents), 1, 1)) if rotations is None else rotations
        )
        self.offsets = np.asarray(subject.offsets, float)
        self.centres = np.asarray(subject.skeleton.centres, float)
        self.members = [np.flatnonzero((bones == bone) & used) for bone in range(subject.skeleton.num_joints)]
        self.distances = np.linalg.norm(points[:, None] - points, axis=2)

    def match_rigidly(self, bone: int) -> BoneMatches:
        offsets = self.offsets[self.members[bone]]
        return match_rigid_bone(offsets, self.points, self.distances, self.steady, self.tolerance)


def grow_hypotheses(
    subject: Subject,
    points: Float[np.ndarray, "P 3"],
    steady: Bool[np.ndarray, "P P"],
    tolerance: float,
) -> list[Int[np.ndarray, "M"]]:
    """Find labellings of the points of a frame, the most probable first: the point of each marker, or -1.

    **Arguments:** `points` metres; `steady` pairs, whose distance is constant in the frames around;
    `tolerance` of distances on one bone, metres.
    """
    search = _Search(subject, points, steady, tolerance)
    rigid = [search.match_rigidly(bone) for bone in range(subject.skeleton.num_joints)]
    entries = _entries(rigid)
    grown: list[_Growth] = []
    for seed in entries[:NUM_SEEDS]:
        beam = [
            _begin(subject, seed, search.members[seed], rigid[seed], k)
            for k in range(len(rigid[seed].scores))
        ]
        for bone, before in _outwards(subject.skeleton.parents, [seed], entries):
            options = [option for one in beam for option in _continue(one, search, bone, before, rigid[bone])]
            beam = sorted(options, key=lambda one: -one.score)[:NUM_HYPOTHESES]
        grown += beam
    unique = {tuple(one.points.tolist()): one for one in sorted(grown, key=lambda one: one.score)}
    return [one.points for one in sorted(unique.values(), key=lambda one: -one.score)]


def regrow_bones(
    subject: Subject,
    rotations: Float[np.ndarray, "J 3 3"],
    translations: Float[np.ndarray, "J 3"],
    known: Bool[np.ndarray, "J"],
    matched: Int[np.ndarray, "M"],
    points: Float[np.ndarray, "P 3"],
    tolerance: float,
) -> Int[np.ndarray, "M"]:
    """Match the bones of a pose that are not `known` anew, outwards from those that are.

    `matched` are the points of the markers, or -1; those of unknown bones are ignored. Returns the points
    of all markers.
    """
    steady = np.ones((len(points), len(points)), bool)
    search = _Search(subject, points, steady, tolerance, rotations)
    kept = np.where(known[np.asarray(subject.bones)], matched, -1)
    slacks = np.where(known, JOINT_SLACK, np.inf)
    beam = [_Growth(rotations, translations, slacks, kept, 0.0)]
    rigid = [
        search.match_rigidly(bone) if not known[bone] else best_matches([], len(search.members[bone]))
        for bone in range(subject.skeleton.num_joints)
    ]
    order = _outwards(subject.skeleton.parents, np.flatnonzero(known).tolist(), _entries(rigid))
    for bone, before in order:
        options = [option for one in beam for option in _continue(one, search, bone, before, rigid[bone])]
        beam = sorted(options, key=lambda one: -one.score)[:NUM_OPTIONS]
    return beam[0].points


def _begin(subject: Subject, bone: int, members, matches: BoneMatches, k: int) -> _Growth:
    count = subject.skeleton.num_joints
    rotations, translations = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    rotations[bone], translations[bone] = matches.rotations[k], matches.translations[k]
    points = np.full(subject.num_markers, -1)
    points[members] = matches.points[k]
    slacks = np.full(count, np.inf)
    slacks[bone] = JOINT_SLACK
    return _Growth(rotations, translations, slacks, points, float(matches.scores[k]))


def _outwards(parents: tuple[int, ...], reached: list[int], entries: Sequence[int]) -> list[tuple[int, int]]:
    """List the other bones outwards from those that are reached, each with the adjacent bone before it.

    Trees without a reached bone follow, each from the first of its `entries`, which has -1 before it.
    """
    reached, order, place = list(reached), [], 0
    for entry in [-1, *entries]:
        if entry >= 0 and entry not in reached:
            reached.append(entry)
            order.append((entry, -1))
        while place < len(reached):
            bone = reached[place]
            place += 1
            around = [parents[bone], *(child for child, parent in enumerate(parents) if parent == bone)]
            new = [other for other in around if other >= 0 and other not in reached]
            reached += new
            order += [(other, bone) for other in new]
    return order


def _entries(rigid: Sequence[BoneMatches]) -> list[int]:
    """List the bones with candidate positions, the best first."""
    some = [bone for bone, found in enumerate(rigid) if len(found.scores)]
    return sorted(some, key=lambda bone: -rigid[bone].scores.max())


def _continue(grown: _Growth, search: _Search, bone: int, before: int, rigid: BoneMatches) -> list[_Growth]:
    """Continue a hypothesis with a bone: at its best candidates, or without matched markers."""
    parents, members = search.subject.skeleton.parents, search.members[bone]
    if before < 0:
        return _enter(grown, members, bone, rigid)
    pivot, own = search.centres[bone if parents[bone] == before else before], search.centres[before]
    pivot_at = grown.rotations[before] @ pivot + grown.translations[before]
    # without other evidence a bone keeps its rotation from the one before it
    turn = grown.rotations[before] @ search.rotations[before].T @ search.rotations[bone]
    slack = grown.slacks[before]
    if slack > JOINT_SLACK:
        slack = slack + SLACK_PER_METRE * float(np.linalg.norm(pivot - own))
    results = [_place(grown, bone, turn, pivot_at - turn @ pivot, slack)]
    candidates = [rigid] if len(rigid.scores) else []
    if len(members) >= 2 and slack < MAX_PIVOT_SLACK:
        candidates += _match_pairs(search, search.offsets[members], pivot, pivot_at, turn, slack)
    if not candidates:
        return results
    found = best_matches(candidates, len(members))
    off = np.linalg.norm(found.rotations @ pivot + found.translations - pivot_at, axis=1) / (
        slack + search.tolerance
    )
    cosine = (np.einsum("kab,ab->k", found.rotations, turn) - 1) / 2
    angles = np.arccos(np.clip(cosine, -1, 1)) / np.pi
    taken = np.isin(found.points, grown.points[grown.points >= 0]) & (found.points >= 0)
    # a bone that is nowhere says nothing of the next one
    scores = found.scores - off**2 - (TURN_PENALTY * angles**2 if np.isfinite(slack) else 0.0)
    scores = np.where(taken.any(1) | (off > 2), -np.inf, scores)
    return results + _place_best(grown, members, bone, found, scores)


def _enter(grown: _Growth, members: Int[np.ndarray, "N"], bone: int, rigid: BoneMatches) -> list[_Growth]:
    """Begin another tree of the skeleton, at the best candidates of one of its bones, or nowhere."""
    nowhere = _place(grown, bone, np.eye(3), np.zeros(3), np.inf)
    taken = np.isin(rigid.points, grown.points[grown.points >= 0]) & (rigid.points >= 0)
    return [
        nowhere,
        *_place_best(grown, members, bone, rigid, np.where(taken.any(1), -np.inf, rigid.scores)),
    ]


def _place_best(
    grown: _Growth,
    members: Int[np.ndarray, "N"],
    bone: int,
    found: BoneMatches,
    scores: Float[np.ndarray, "K"],
) -> list[_Growth]:
    """Continue a hypothesis with the candidates of a bone that have the highest positive scores."""
    results = []
    for k in np.argsort(-scores, kind="stable")[:NUM_OPTIONS]:
        if scores[k] > 0:
            placed = _place(grown, bone, found.rotations[k], found.translations[k], JOINT_SLACK)
            placed.points[members] = found.points[k]
            results.append(placed._replace(score=grown.score + float(scores[k])))
    return results


def _place(grown: _Growth, bone: int, rotation, translation, slack: float) -> _Growth:
    rotations, translations, slacks = grown.rotations.copy(), grown.translations.copy(), grown.slacks.copy()
    rotations[bone], translations[bone], slacks[bone] = rotation, translation, slack
    return _Growth(rotations, translations, slacks, grown.points.copy(), grown.score)


def _match_pairs(search: _Search, offsets, pivot, pivot_at, turn, slack: float) -> list[BoneMatches]:
    """Find pairs of points with the distances of two markers of a bone from each other and from its joint."""
    points, tolerance = search.points, search.tolerance
    out = np.linalg.norm(offsets - pivot, axis=1)
    first, second = np.argsort(-out)[:2]
    away = np.linalg.norm(points - pivot_at, axis=1)
    near = [np.abs(away - out[marker]) < tolerance + slack for marker in (first, second)]
    length = np.linalg.norm(offsets[first] - offsets[second])
    pairs = np.argwhere(
        (np.abs(search.distances - length) < tolerance) & search.steady & near[0][:, None] & near[1]
    )
    if not len(pairs):
        return []
    target, source = points[pairs] - pivot_at, offsets[[first, second]] - pivot
    rotations = nearest_rotation(np.einsum("kma,mb->kab", target, source) + PARENT_WEIGHT * turn)
    # the points are more certain than the joint
    shifts = points[pairs].mean(1) - np.einsum("kab,b->ka", rotations, offsets[[first, second]].mean(0))
    return [match_moved(offsets, rotations, shifts, points, tolerance)]
