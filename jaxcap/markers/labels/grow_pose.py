"""Hypotheses of the labels in one frame: a bone that its distances identify, and then bone by bone along the skeleton."""

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
    skeleton, bones = subject.skeleton, np.asarray(subject.bones)
    offsets, used = np.asarray(subject.offsets, float), np.asarray(subject.weights) > 0
    members = [np.flatnonzero((bones == bone) & used) for bone in range(skeleton.num_joints)]
    distances = np.linalg.norm(points[:, None] - points, axis=2)
    rigid = [match_rigid_bone(offsets[some], points, distances, steady, tolerance) for some in members]
    seeds = sorted(
        (bone for bone in range(skeleton.num_joints) if len(rigid[bone].scores)),
        key=lambda bone: -rigid[bone].scores.max(),
    )[:NUM_SEEDS]
    grown: list[_Growth] = []
    for seed in seeds:
        beam = [_begin(subject, seed, members[seed], rigid[seed], k) for k in range(len(rigid[seed].scores))]
        for bone, before in _outwards(skeleton.parents, seed):
            options = [
                option
                for one in beam
                for option in _continue(
                    one, subject, bone, before, members[bone], rigid[bone], points, distances, steady, tolerance
                )
            ]
            beam = sorted(options, key=lambda one: -one.score)[:NUM_HYPOTHESES]
        grown += beam
    unique = {tuple(one.points.tolist()): one for one in sorted(grown, key=lambda one: one.score)}
    return [one.points for one in sorted(unique.values(), key=lambda one: -one.score)]


def _begin(subject: Subject, bone: int, members, matches: BoneMatches, k: int) -> _Growth:
    count = subject.skeleton.num_joints
    rotations, translations = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    rotations[bone], translations[bone] = matches.rotations[k], matches.translations[k]
    points = np.full(subject.num_markers, -1)
    points[members] = matches.points[k]
    slacks = np.full(count, np.inf)
    slacks[bone] = JOINT_SLACK
    return _Growth(rotations, translations, slacks, points, float(matches.scores[k]))


def _outwards(parents: tuple[int, ...], seed: int) -> list[tuple[int, int]]:
    """List the other bones from a seed outwards, each with the adjacent bone before it."""
    reached, order = [seed], []
    for bone in reached:
        around = [parents[bone], *(child for child, parent in enumerate(parents) if parent == bone)]
        new = [other for other in around if other >= 0 and other not in reached]
        reached += new
        order += [(other, bone) for other in new]
    return order


def _continue(
    grown: _Growth,
    subject: Subject,
    bone: int,
    before: int,
    members: Int[np.ndarray, "N"],
    rigid: BoneMatches,
    points,
    distances,
    steady,
    tolerance: float,
) -> list[_Growth]:
    """Continue a hypothesis with a bone: at its best candidates, or without matched markers."""
    parents, centres = subject.skeleton.parents, np.asarray(subject.skeleton.centres, float)
    pivot = centres[bone if parents[bone] == before else before]
    own = centres[before]
    turn = grown.rotations[before]
    pivot_at = turn @ pivot + grown.translations[before]
    slack = grown.slacks[before]
    if slack > JOINT_SLACK:
        slack = slack + SLACK_PER_METRE * float(np.linalg.norm(pivot - own))
    results = [_place(grown, bone, turn, pivot_at - turn @ pivot, slack)]
    candidates = [rigid] if len(rigid.scores) else []
    if len(members) >= 2 and slack < MAX_PIVOT_SLACK:
        offsets = np.asarray(subject.offsets, float)[members]
        candidates += _match_pairs(offsets, pivot, pivot_at, turn, slack, points, distances, steady, tolerance)
    if not candidates:
        return results
    found = best_matches(candidates, len(members))
    off = np.linalg.norm(found.rotations @ pivot + found.translations - pivot_at, axis=1) / (slack + tolerance)
    cosine = (np.einsum("kab,ab->k", found.rotations, turn) - 1) / 2
    angles = np.arccos(np.clip(cosine, -1, 1)) / np.pi
    taken = np.isin(found.points, grown.points[grown.points >= 0]) & (found.points >= 0)
    scores = found.scores - off**2 - TURN_PENALTY * angles**2
    scores = np.where(taken.any(1) | (off > 2), -np.inf, scores)
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


def _match_pairs(
    offsets, pivot, pivot_at, turn, slack: float, points, distances, steady, tolerance: float
) -> list[BoneMatches]:
    """Find pairs of points with the distances of two markers of a bone from each other and from its joint."""
    out = np.linalg.norm(offsets - pivot, axis=1)
    first, second = np.argsort(-out)[:2]
    away = np.linalg.norm(points - pivot_at, axis=1)
    near = [np.abs(away - out[marker]) < tolerance + slack for marker in (first, second)]
    length = np.linalg.norm(offsets[first] - offsets[second])
    pairs = np.argwhere((np.abs(distances - length) < tolerance) & steady & near[0][:, None] & near[1])
    if not len(pairs):
        return []
    target, source = points[pairs] - pivot_at, offsets[[first, second]] - pivot
    rotations = nearest_rotation(np.einsum("kma,mb->kab", target, source) + PARENT_WEIGHT * turn)
    # the points are more certain than the joint
    shifts = points[pairs].mean(1) - np.einsum("kab,b->ka", rotations, offsets[[first, second]].mean(0))
    return [match_moved(offsets, rotations, shifts, points, tolerance)]
