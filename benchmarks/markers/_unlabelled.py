"""Takes without labels: marker sets of laboratories on the embedded human, in tracks that are cut and mixed with ghosts."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

import jaxcap as jc
from benchmarks.markers._markers import distant_vertices
from jaxcap.markers.labels.label_markers import Labelling
from jaxcap.markers.segments.gaps import find_runs
from jaxcap.markers.subject import Subject, make_subject

#: markers on each bone of the left side or the middle, as in sets of 41 and 53 markers; the right side is as the left
LAYOUTS = {
    41: {"Hips": 4, "Spine1": 5, "Head": 4, "LeftShoulder": 1, "LeftArm": 2, "LeftForeArm": 3, "LeftHand": 2,
         "LeftUpLeg": 2, "LeftLeg": 2, "LeftFoot": 2},
    53: {"Hips": 4, "Spine1": 5, "Head": 4, "LeftShoulder": 2, "LeftArm": 3, "LeftForeArm": 3, "LeftHand": 2,
         "LeftUpLeg": 4, "LeftLeg": 3, "LeftFoot": 2, "LeftToeBase": 1},
}  # fmt: skip


class UnlabelledTake(NamedTuple):
    """Columns without names, each with one or several tracks, and the truth."""

    frames: jc.MarkerFrames
    #: the marker at each place, -1 for a ghost or where nothing is visible
    markers: Int[np.ndarray, "F N"]


def laboratory_subject(count: int, seed: int = 0) -> Subject:
    """Place a set of markers on the skin of the embedded human, far from each other on every bone."""
    body = jc.human(joints="tracking", resolution="low")
    skeleton, vertices = body.skeleton, np.asarray(body.vertices, float)
    influence = np.asarray(body.skin.bone_weights(skeleton.num_joints))
    rng = np.random.default_rng(seed)
    bones, places, labels = [], [], []
    for name in skeleton.names:
        number = LAYOUTS[count].get(name.replace("Right", "Left"), 0)
        joint = skeleton.index(name)
        own = np.flatnonzero(influence[:, joint] > 0.6 * influence[:, joint].max())
        chosen = distant_vertices(vertices, own, number, 0.7, rng)
        bones += [joint] * number
        places += [vertices[c] for c in chosen]
        labels += [f"{name}{index}" for index in range(number)]
    assert len(labels) == count, len(labels)
    return make_subject(
        skeleton, bones, np.array(places, np.float32), labels, deviations=np.full(count, 3e-3, np.float32)
    )


def hide_labels(frames: jc.MarkerFrames, ghosts: float, rng: np.random.Generator) -> UnlabelledTake:
    """Give every piece of a trajectory a new name and a random column, and add ghosts to a share of the points."""
    places, seen = np.asarray(frames.positions, float), np.asarray(frames.visible)
    pieces = [
        (begin, end, marker, places[begin:end, marker])
        for marker in range(places.shape[1])
        for begin, end in find_runs(seen[:, marker])
    ]
    wanted, count = ghosts * seen.sum(), 0
    while count < wanted:
        piece = _ghost(places, seen, rng)
        pieces.append(piece)
        count += piece[1] - piece[0]
    columns: list[np.ndarray] = []
    truth: list[np.ndarray] = []
    order = rng.permutation(len(pieces))
    free: list[int] = []
    for begin, end, marker, path in sorted((pieces[i] for i in order), key=lambda piece: piece[0]):
        # a name is used again after a pause, as capture programs do
        usable = [c for c, until in enumerate(free) if until < begin - 2]
        column = int(rng.choice(usable)) if usable else len(free)
        if column == len(free):
            free.append(0)
            columns.append(np.full((len(places), 3), np.nan))
            truth.append(np.full(len(places), -1))
        columns[column][begin:end], truth[column][begin:end], free[column] = path, marker, end
    order = rng.permutation(len(columns))
    found = jc.make_markers(
        np.stack([columns[c] for c in order], 1), [f"*{number}" for number in range(len(order))], frames.rate
    )
    return UnlabelledTake(found, np.stack([truth[c] for c in order], 1))


def _ghost(places, seen: Bool[np.ndarray, "F M"], rng) -> tuple[int, int, int, Float[np.ndarray, "T 3"]]:
    """Make a reflection that stays, one that drifts through the body, or one beside a marker."""
    count = len(places)
    length = int(min(count, rng.choice([rng.integers(1, 10), rng.integers(10, 60), rng.integers(60, 400)])))
    begin = int(rng.integers(0, count - length + 1))
    frames = slice(begin, begin + length)
    shown = places[begin][seen[begin]]
    low, high = shown.min(0) - 0.2, shown.max(0) + 0.2
    kind = rng.integers(3)
    path = np.tile(rng.uniform(low, high), (length, 1))
    if kind == 1:
        path += np.arange(length)[:, None] * rng.normal(size=3) * 0.003
    if kind == 2:
        marker = int(rng.integers(places.shape[1]))
        if seen[frames, marker].all():
            out = rng.normal(size=3)
            path = places[frames, marker] + rng.uniform(0.02, 0.06) * out / np.linalg.norm(out)
    return begin, begin + length, -1, path + 1e-3 * rng.normal(size=path.shape)


class LabelErrors(NamedTuple):
    """Shares of the places of markers that have their own label, and another one; the longest wrong label, seconds."""

    right: float
    wrong: float
    longest: float


def label_errors(subject: Subject, hidden: UnlabelledTake, found: Labelling) -> LabelErrors:
    """Compare labels with the truth; a label on a ghost is wrong."""
    labels = np.full(hidden.markers.shape, -1)
    for one in found.tracks:
        column = hidden.frames.labels.index(one.name)
        labels[one.begin : one.end, column] = -1 if one.label is None else subject.labels.index(one.label)
    real = hidden.markers >= 0
    wrong = (labels >= 0) & (labels != hidden.markers)
    longest = max((end - begin for column in wrong.T for begin, end in find_runs(column)), default=0)
    right = float((labels == hidden.markers)[real].mean())
    return LabelErrors(right, float(wrong.sum() / real.sum()), longest / hidden.frames.rate)
