"""Labels of several subjects in one recording: one assignment in each frame over all of them."""

import re
from collections.abc import Mapping
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

from ...arguments import checked
from ...observe.markers import MarkerFrames
from ..labels.label_markers import Labelling, label_markers
from ..motion.inverse_kinematics import solve_markers
from ..segments.pair_distances import median_distances
from ..subject import Subject
from .join_subjects import join_subjects

#: two subjects are exchanged if the distances on their bones then fit to this share of the misfit before; with a larger share,
#: up to its inverse, they cannot be distinguished
MAX_SHARE = 0.7


@checked
def label_subjects(
    subjects: Mapping[str, Subject], frames: MarkerFrames, *, ignore_labels: bool = False
) -> Labelling:
    """Label the markers of several calibrated subjects, people and props, in one recording.

    In each frame the points are assigned at once to the markers of all subjects, predicted by their poses. Subjects with the same
    marker set are distinguished by the distances between the markers of single bones. If these hardly differ, a message says
    so.

    **Arguments:** `subjects` by name; `frames` with any labels, of which those such as `Anna:LASI` are kept unless the poses
    contradict them; with `ignore_labels` all are ignored.

    **Raises:** `ValueError` as `label_markers`.
    """
    joined = join_subjects(subjects)
    found = label_markers(joined, frames, ignore_labels=ignore_labels)
    if len(subjects) == 1:
        return found
    misfits, names = identity_misfits(subjects, found.frames), list(subjects)
    order = find_exchanges(misfits)
    messages = describe_identities(names, misfits[:, order])
    changed = {names[column]: names[row] for row, column in enumerate(order) if row != column}
    if changed:
        found = exchange_subjects(joined, found, changed)
        listed = ", ".join(f"{old} is {new}" for old, new in changed.items())
        messages = [
            f"By the distances on their bones the subjects were exchanged, which is corrected: {listed}.",
            *messages,
        ]
    return found._replace(messages=(*messages, *found.messages))


def find_exchanges(misfits: Float[np.ndarray, "S S"]) -> Int[np.ndarray, "S"]:
    """Find the subject (column of `identity_misfits`) whose markers belong to each one (row).

    The best assignment consists of cycles of subjects. Each is decided by itself: subjects are exchanged if the sum of their
    misfits then falls below `MAX_SHARE` of that before.
    """
    best = linear_sum_assignment(np.where(np.isfinite(misfits), misfits, 1e6))[1]
    order = np.arange(len(best))
    for first in range(len(best)):
        cycle = [first]
        while best[cycle[-1]] != first:
            cycle.append(int(best[cycle[-1]]))
        if misfits[cycle, best[cycle]].sum() < MAX_SHARE * misfits[cycle, cycle].sum():
            order[cycle] = best[cycle]
    return order


def identity_misfits(subjects: Mapping[str, Subject], frames: MarkerFrames) -> Float[np.ndarray, "S S"]:
    """Compute how badly the markers of each subject (columns) fit another one (rows), metres.

    It is the mean difference of distances between markers of one bone. Infinite where the labels differ, zero on
    the diagonal where a subject has no such distances.
    """
    positions, seen = np.asarray(frames.positions, float), np.asarray(frames.visible)
    names = list(subjects)
    misfits = np.full((len(names), len(names)), np.inf)
    for column, name in enumerate(names):
        own = [index for index, label in enumerate(frames.labels) if label.startswith(f"{name}:")]
        labels = [frames.labels[index].removeprefix(f"{name}:") for index in own]
        observed = median_distances(positions[:, own], seen[:, own])
        for row, other in enumerate(subjects.values()):
            if row == column or set(labels) == set(other.labels):
                misfits[row, column] = _misfit(other, labels, observed)
    return misfits


def _misfit(subject: Subject, labels: list[str], observed: Float[np.ndarray, "N N"]) -> float:
    offsets, bones = np.asarray(subject.offsets, float), np.asarray(subject.bones)
    away = []
    for a, b in combinations(range(len(labels)), 2):
        if labels[a] not in subject.labels or labels[b] not in subject.labels:
            continue
        i, j = subject.labels.index(labels[a]), subject.labels.index(labels[b])
        if bones[i] == bones[j] and np.isfinite(observed[a, b]):
            away.append(abs(float(np.linalg.norm(offsets[i] - offsets[j])) - observed[a, b]))
    return float(np.mean(away)) if away else 0.0


def describe_identities(names: list[str], misfits: Float[np.ndarray, "S S"]) -> list[str]:
    """Describe the pairs of subjects that fit each other's markers nearly as well as their own, or better."""
    said = []
    for a, b in combinations(range(len(names)), 2):
        own, other = misfits[a, a] + misfits[b, b], misfits[a, b] + misfits[b, a]
        if np.isfinite(other) and own > MAX_SHARE * other:
            relation = "better than" if other < own else "nearly as well as"
            said.append(
                f"{names[a]} and {names[b]} fit each other's markers {relation} their own (the distances on their bones differ by "
                f"{500 * other:.1f} mm from each other's, and by {500 * own:.1f} mm from their own); check who is who."
            )
    return said


def exchange_subjects(joined: Subject, found: Labelling, names: Mapping[str, str]) -> Labelling:
    """Exchange subjects with equal labels, and solve their motion again: `names` has the new name of each of them.

    Tracks and messages have the new names too; a label in quotes is one of the input, which stays.
    """
    longest_first = sorted(joined.labels, key=len, reverse=True)
    pattern = re.compile(rf"(?<![\w'])({'|'.join(map(re.escape, longest_first))})(?!\w)")

    def rename(label: str) -> str:
        name, _, rest = label.partition(":")
        return f"{names.get(name, name)}:{rest}"

    labels = [rename(label) for label in found.frames.labels]
    columns = np.array([labels.index(label) for label in joined.labels])
    frames = MarkerFrames(
        found.frames.positions[:, columns],
        found.frames.visible[:, columns],
        joined.labels,
        found.frames.rate,
    )
    tracks = tuple(
        one if one.label is None else one._replace(label=rename(one.label)) for one in found.tracks
    )
    messages = tuple(pattern.sub(lambda match: rename(match[0]), message) for message in found.messages)
    motion = solve_markers(joined, frames).motion
    return found._replace(frames=frames, tracks=tracks, motion=motion, messages=messages)
