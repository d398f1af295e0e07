"""Tracks with a label that another track fits as well, such as a marker and a reflection near it at the end of a limb.

Where a bone has one or two markers its pose follows whatever has their labels, so the distance from the prediction is no
evidence. The frames are solved again with the other track in the place of the first one. The track that fits better keeps
the label; if neither fits clearly better, both stay without one: a missing marker does less harm than a wrong one.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..motion.initial_pose import estimate_separate_poses
from ..motion.inverse_kinematics import INITIAL_SEARCH, solve_from_poses
from ..subject import Subject
from .tracks import Track
from .vote import LabelledTrack

#: largest median distance of a rival from the predicted marker, metres
MAX_REACH = 0.15
#: a track with more frames than this without its rival has evidence of its own
MAX_ALONE = 6
#: number of frames that are solved again for a pair of tracks
NUM_FRAMES = 5
#: the better track costs less by this in a frame, in squared gates: with gates of eight standard deviations, odds of 20 to 1
MIN_DIFFERENCE = 0.1


class _Rivals(NamedTuple):
    """Indices of a labelled track and of one without a label, and the frames that both have."""

    own: int
    other: int
    frames: Int[np.ndarray, "K"]


def decide_rivals(
    subject: Subject,
    labelled: list[LabelledTrack],
    positions: Float[np.ndarray, "F N 3"],
    predicted: Float[np.ndarray, "F M 3"],
    columns: Int[np.ndarray, "F M"],
    gates: Float[np.ndarray, "M"],
) -> list[LabelledTrack]:
    """Compare labelled tracks with unlabelled ones in the same frames; take away labels between which the poses do not decide.

    **Arguments:** `columns` of the labels in each frame, -1 where they have none.
    """
    rivals = _find_rivals(labelled, positions, predicted)
    if not rivals:
        return labelled
    frames = np.concatenate([each.frames for each in rivals])
    markers = np.concatenate([np.full(len(each.frames), labelled[each.own].marker) for each in rivals])
    costs = []
    for side in ("own", "other"):
        places = np.concatenate(
            [np.full(len(each.frames), labelled[getattr(each, side)].track.column) for each in rivals]
        )
        chosen = columns[frames].copy()
        chosen[np.arange(len(frames)), markers] = places
        costs.append(_frame_costs(subject, positions[frames], chosen, gates))
    difference = np.split(costs[1] - costs[0], np.cumsum([len(each.frames) for each in rivals])[:-1])
    found = list(labelled)
    # a track with several rivals has to be better than all of them
    for each, gain in sorted(zip(rivals, difference, strict=True), key=lambda pair: pair[1].mean()):
        marker = labelled[each.own].marker
        if gain.mean() < MIN_DIFFERENCE and found[each.own].marker == marker:
            found[each.own] = found[each.own]._replace(marker=-1)
            track = labelled[each.other].track
            is_free = all(one.marker != marker or not _overlap(one.track, track) for one in found)
            if gain.mean() < -MIN_DIFFERENCE and is_free and found[each.other].marker < 0:
                found[each.other] = found[each.other]._replace(marker=marker)
    return found


def _find_rivals(labelled: list[LabelledTrack], positions, predicted) -> list[_Rivals]:
    rivals = []
    free = [number for number, one in enumerate(labelled) if one.marker < 0]
    for number, (track, marker) in enumerate(labelled):
        for other in free if marker >= 0 else ():
            common = _overlap(track, labelled[other].track)
            if not common or track.end - track.begin - len(common) > MAX_ALONE:
                continue
            away = positions[common, labelled[other].track.column] - predicted[common, marker]
            if np.median(np.linalg.norm(away, axis=1)) < MAX_REACH:
                frames = np.unique(np.linspace(common[0], common[-1], NUM_FRAMES).round().astype(int))
                rivals.append(_Rivals(number, other, frames))
    return rivals


def _overlap(one: Track, other: Track) -> range:
    """Return the frames that two tracks have in common."""
    return range(max(one.begin, other.begin), min(one.end, other.end))


def _frame_costs(subject: Subject, positions, columns, gates) -> Float[np.ndarray, "K"]:
    """Compute the squared distances of all markers from solved poses, in gates, at most one each.

    The poses start from the markers alone: from a pose with the other track, a marker far away counts as an outlier.
    """
    seen = columns >= 0
    at = np.take_along_axis(positions, np.maximum(columns, 0)[..., None], 1)
    targets = jnp.asarray(np.where(seen[..., None], at, 0.0), subject.offsets.dtype)
    shown = jnp.asarray(seen)
    starts = estimate_separate_poses(subject, targets, shown)
    solved = solve_from_poses(subject, starts, targets, shown, INITIAL_SEARCH)
    lengths = np.asarray(solved.residuals, float)
    return np.where(seen, np.minimum((lengths / gates) ** 2, 1.0), 0.0).sum(1)
