"""Markers with unknown labels, on the bones that they move with."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...body.pose import Motion
from ...observe.markers import MarkerFrames
from ..marker_sets.recognise import MarkerSet
from ..motion.inverse_kinematics import marker_residuals_of_frames
from ..subject import Subject, make_subject

#: distance of a marker from its median position on its bone that this percentile of the frames is within, at most, metres;
#: others are on no bone
MAX_SPREAD, SPREAD_PERCENTILE = 0.03, 90
#: largest distance of a marker from the joint of its bone, metres
MAX_DISTANCE = 0.6
#: least number of frames with the marker
MIN_FRAMES = 10


class FurtherMarkers(NamedTuple):
    """A subject with markers that follow one of its bones, in addition to those on landmarks."""

    subject: Subject
    #: the added markers, and those that follow no bone
    added: tuple[str, ...]
    loose: tuple[str, ...]
    #: distances of the added markers from their positions, metres
    added_residuals: Float[np.ndarray, "F A"]

    def residuals(self, others: Float[np.ndarray, "F N"]) -> Float[np.ndarray, "F M"]:
        """Append the residuals of the added markers to those of all others."""
        return np.concatenate([others, self.added_residuals], axis=1)


def attach_further_markers(
    subject: Subject, motion: Motion, lost: Bool[np.ndarray, "F"], frames: MarkerFrames, markers: MarkerSet
) -> FurtherMarkers:
    """Attach each unknown marker to the bone on which its position varies least.

    Bones are those with markers of their own. Markers that vary by more than `MAX_SPREAD` on each bone are on none.
    """
    seen, positions = np.asarray(frames.visible), np.asarray(frames.positions, float)
    unknown = [
        index
        for index, label in enumerate(frames.labels)
        if label not in subject.labels and not markers.virtual[index]
    ]
    bones = sorted(set(np.asarray(subject.bones).tolist()))
    centres = np.asarray(subject.skeleton.centres, float)
    added, loose, rows, places, spreads, residuals = [], [], [], [], [], []
    for index in unknown:
        # one probe on each bone: its residual is the marker's position on that bone
        probes = make_subject(
            subject.skeleton, bones, np.zeros((len(bones), 3)), [f"probe{bone}" for bone in bones]
        )
        targets = jnp.asarray(np.repeat(positions[:, index, None], len(bones), 1), subject.offsets.dtype)
        local = np.asarray(marker_residuals_of_frames(probes, motion.poses, targets), float)
        shown = seen[:, index] & ~lost
        if shown.sum() < MIN_FRAMES:
            loose.append(frames.labels[index])
            continue
        middle = np.median(local[shown], axis=0)
        apart = np.linalg.norm(local - middle, axis=2)
        # nearly all of the time, as a mark on the floor is at rest relative to a foot at times
        spread = np.percentile(apart[shown], SPREAD_PERCENTILE, axis=0)
        spread[np.linalg.norm(middle - centres[bones], axis=1) > MAX_DISTANCE] = np.inf
        best = int(np.argmin(spread))
        if spread[best] > MAX_SPREAD:
            loose.append(frames.labels[index])
            continue
        added.append(frames.labels[index])
        rows.append(bones[best])
        places.append(middle[best])
        variance = np.mean(np.var(local[shown][:, best], axis=0))
        spreads.append(max(float(np.sqrt(variance)), 1e-3))
        residuals.append(np.where(shown, apart[:, best], np.nan))
    wider = make_subject(
        subject.skeleton,
        [*np.asarray(subject.bones).tolist(), *rows],
        np.concatenate([np.asarray(subject.offsets, float), np.reshape(places, (-1, 3))]),
        (*subject.labels, *added),
        weights=np.append(np.asarray(subject.weights, float), np.ones(len(added))),
        deviations=np.append(np.asarray(subject.deviations, float), spreads),
        models=(*subject.models, *("rigid",) * len(added)),
        posture=subject.posture,
    )
    return FurtherMarkers(
        wider, tuple(added), tuple(loose), np.reshape(residuals, (len(added), len(frames))).T
    )
