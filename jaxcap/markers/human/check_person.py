"""Checks that markers are those of one person, with left and right as labelled."""

import numpy as np
from jaxtyping import Bool, Float

from ...body.pose import Motion
from ...errors import InputError
from ...geometry.procrustes import rigid_fit
from ...observe.markers import MarkerFrames
from ..marker_sets.landmarks import mirror_landmark
from ..marker_sets.recognise import MarkerSet, recognise_markers
from ..segments.pair_distances import median_distances
from ..segments.rigid_motion import MIN_DISPLACEMENT, displacement, distance_ranges, is_rigid
from ..subject import Subject
from .rest_positions import placed_markers

#: least number of markers on known landmarks, and of bones that carry them
MIN_MARKERS, MIN_BONES = 6, 3
#: largest standard deviation of a marker on a landmark, metres; those on plates have more
MAX_DEVIATION = 0.03
#: distance of markers with the same label on one person, at most, metres
MAX_SAME_DISTANCE = 0.25
#: bones that hardly move relative to each other
TRUNK = ("Hips", "LowerBack", "Spine", "Spine1", "LeftShoulder", "RightShoulder", "LeftUpLeg", "RightUpLeg")
#: share of the distances that exchanged sides leave in the best frame, below which they are exchanged
MIRRORED_SHARE = 0.7
#: number of frames that are looked at
NUM_FRAMES = 25
#: largest share of lost frames of one person
MAX_LOST_SHARE = 0.5
#: rotation below which a person stands still, radians
STILL_ANGLE = np.radians(10.0)


def count_landmarks(known: MarkerSet, frames: MarkerFrames) -> tuple[int, int]:
    """Count the visible markers at landmarks of a person, not those on plates, and the bones that carry them."""
    placed = [index for index in placed_markers(known) if known.deviations[index] <= MAX_DEVIATION]
    visible = [index for index in placed if np.asarray(frames.visible)[:, index].any()]
    return len(visible), len({known.bones[index] for index in visible})


def has_landmarks(known: MarkerSet, frames: MarkerFrames) -> bool:
    """Test if enough visible markers have labels of a person's landmarks."""
    markers, bones = count_landmarks(known, frames)
    return markers >= MIN_MARKERS and bones >= MIN_BONES


def find_doubled_labels(frames: MarkerFrames) -> list[str]:
    """Find the labels of a person that occur twice, where those that do are a person's by themselves.

    Readers of files rename the second `LASI` to `LASI_2`. Labels of markers that are close to each other do not count.
    """
    distances = median_distances(np.asarray(frames.positions, float), np.asarray(frames.visible))
    second = {}
    for index, label in enumerate(frames.labels):
        first = label.removesuffix("_2")
        if first == label or first not in frames.labels:
            continue
        # two markers of one knee have one label too, in old files
        if not distances[index, frames.labels.index(first)] < MAX_SAME_DISTANCE:
            second[index] = first
    labels, columns = tuple(second.values()), np.array(list(second), int)
    own = MarkerFrames(
        np.asarray(frames.positions)[:, columns], np.asarray(frames.visible)[:, columns], labels, frames.rate
    )
    return list(labels) if labels and has_landmarks(recognise_markers(labels), own) else []


def check_one_person(frames: MarkerFrames) -> None:
    """Check that a person's labels do not occur twice. Raises `InputError`."""
    doubled = find_doubled_labels(frames)
    if doubled:
        raise InputError(
            f"{len(doubled)} labels of a person occur twice ({', '.join(doubled[:6])}, ...), so these are markers of two people "
            "under one name; give the markers of each a prefix such as Anna:LASI."
        )


def check_recognised(known: MarkerSet, frames: MarkerFrames) -> None:
    """Check that enough visible markers have labels of a person's landmarks. Raises `InputError`."""
    if has_landmarks(known, frames):
        return
    markers, bones = count_landmarks(known, frames)
    raise InputError(
        f"{markers} of {len(known.labels)} markers have labels of landmarks of a person ({', '.join(known.labels[:8])}"
        f"{', ...' if len(known.labels) > 8 else ''}), on {bones} bones; at least {MIN_MARKERS} on {MIN_BONES} bones are "
        "needed. Rename the labels, or use fit_local, which needs no labels."
    )


def check_articulated(frames: MarkerFrames) -> None:
    """Check that the markers are not those of a rigid object that moves. Raises `InputError`."""
    ranges = distance_ranges(frames)
    if not is_rigid(ranges, list(range(len(frames.labels)))):
        return
    moved = displacement(frames)
    if moved > MIN_DISPLACEMENT:
        raise InputError(
            f"The markers keep their distances within {1e3 * float(np.nanmax(ranges)):.0f} mm while they move by {moved:.1f} m, so "
            f"they are on a rigid object and on no person ({', '.join(frames.labels[:6])}, ...); fit it with fit_prop, or rename "
            "the labels."
        )


def check_sides(template: Subject, known: MarkerSet, frames: MarkerFrames) -> None:
    """Check that the markers of the trunk are not those of its mirror image. Raises `InputError`."""
    names = dict(zip(known.labels, known.names, strict=True))
    bones = [template.skeleton.names[bone] for bone in np.asarray(template.bones)]
    exact = np.asarray(template.deviations) <= MAX_DEVIATION
    chosen = [m for m, bone in enumerate(bones) if bone in TRUNK and exact[m]]
    landmarks = [str(names[template.labels[m]]) for m in chosen]
    partner = [_partner(landmarks, name) for name in landmarks]
    if not any(other != index for index, other in enumerate(partner)):
        return
    rest = np.asarray(template.offsets, float)[chosen]
    columns = [frames.labels.index(template.labels[m]) for m in chosen]
    visible, misfits = np.asarray(frames.visible)[:, columns], []
    for frame in np.linspace(0, len(frames) - 1, NUM_FRAMES).astype(int):
        seen = visible[frame, np.arange(len(partner))] & visible[frame, partner]
        if seen.sum() < 4:
            continue
        places = np.asarray(frames.positions, float)[frame, columns]
        misfits.append([_misfit(rest[seen], places[order][seen]) for order in (range(len(rest)), partner)])
    # in the frame in which the person is most upright
    if misfits and np.divide(*np.min(misfits, axis=0)[::-1]) < MIRRORED_SHARE:
        raise InputError(
            "Left and right are exchanged: the markers of the trunk fit a person only if the labels of its sides are "
            f"exchanged ({', '.join(template.labels[m] for m in chosen[:6])}, ...). Correct the labels, or the axes of the file "
            "if it is mirrored."
        )


def check_explained(lost: Bool[np.ndarray, "F"], frames: MarkerFrames) -> None:
    """Check that poses of one person explain most of the frames that have enough markers for a pose. Raises `InputError`."""
    enough = np.asarray(frames.visible).sum(1) >= MIN_MARKERS
    share = float(np.mean(lost[enough] if enough.any() else lost))
    if share > MAX_LOST_SHARE:
        raise unexplained_error(share, frames.labels)


def unexplained_error(share: float, labels: tuple[str, ...]) -> InputError:
    """Make the error about a share of the frames that no pose of a person explains."""
    return InputError(
        f"No pose of a person explains {100 * share:.0f} % of the frames: are these markers of two people, of an object, or "
        f"with wrong labels or a wrong unit? The labels are {', '.join(labels[:8])}{', ...' if len(labels) > 8 else ''}."
    )


def stands_still(subject: Subject, motion: Motion) -> bool:
    """Return true if no joint with markers below it rotates."""
    skeleton = subject.skeleton
    carried = np.sum(skeleton.descendants[:, np.asarray(subject.bones)], axis=1)
    joints = np.flatnonzero((np.array(skeleton.parents) >= 0) & (carried > 0))
    q = np.asarray(motion.poses.rotations, float)[:, joints]
    first = q[len(q) // 2]
    angles = 2 * np.arccos(np.clip(np.abs(np.einsum("fja,ja->fj", q, first)), 0, 1))
    return bool(np.percentile(angles, 95, axis=0).max(initial=0.0) < STILL_ANGLE)


def _partner(landmarks: list[str], name: str) -> int:
    """Find the same landmark of the other side, or the landmark itself."""
    other = mirror_landmark(name)
    return landmarks.index(other) if other in landmarks else landmarks.index(name)


def _misfit(source: Float[np.ndarray, "N 3"], target: Float[np.ndarray, "N 3"]) -> float:
    """Compute the root mean square distance after the best rigid motion, metres."""
    turn, shift = rigid_fit(source, target)
    return max(float(np.sqrt(np.mean(np.sum((source @ turn.T + shift - target) ** 2, 1)))), 1e-6)
