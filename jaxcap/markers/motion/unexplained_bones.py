"""Bones with markers that the pose of a frame does not explain."""

import numpy as np
from jaxtyping import Bool, Float

from ..subject import Subject
from .doubtful_solutions import FAR, far_markers

#: least number of visible markers of such a bone
MIN_MARKERS = 2
#: least number of frames of a bone, and largest number of bones, in a message
MIN_FRAMES, MAX_BONES = 3, 8


def unexplained_bones(
    subject: Subject, used: Bool[np.ndarray, "F M"], distances: Float[np.ndarray, "F M"]
) -> Bool[np.ndarray, "F J"]:
    """Find the bones whose used markers, two or more, are all far from where the pose has them.

    The median of all markers does not show this, as robust weights let a whole limb go.
    """
    members = (np.asarray(subject.bones)[:, None] == np.arange(subject.skeleton.num_joints)).astype(int)
    counts = used.astype(int) @ members
    return (counts >= MIN_MARKERS) & (far_markers(used, distances).astype(int) @ members == counts)


def describe_unexplained(subject: Subject, unexplained: Bool[np.ndarray, "F J"]) -> tuple[str, ...]:
    """Describe bones that are unexplained in some frames, in a sentence; none if there are none."""
    counts = unexplained.sum(0)
    bones = [joint for joint in np.argsort(-counts, kind="stable") if counts[joint] >= MIN_FRAMES]
    if not bones:
        return ()
    named = []
    for joint in bones[:MAX_BONES]:
        frames = np.flatnonzero(unexplained[:, joint])
        named.append(f"{subject.skeleton.names[joint]} in {len(frames)} frames ({frames[0]} to {frames[-1]})")
    more = f" and {len(bones) - MAX_BONES} other bones" if len(bones) > MAX_BONES else ""
    return (
        f"The pose does not explain the markers of {', '.join(named)}{more}: all of them are more than {100 * FAR:.0f} cm off, "
        "and the bone may have any rotation there; check the labels of these frames.",
    )
