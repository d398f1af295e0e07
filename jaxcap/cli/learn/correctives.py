"""Correctives of a learned body on the command line: what is learned, and what is printed of it."""

import numpy as np

from ...errors import InputError, user_message
from ...learn.correctives.learn_correctives import LearnedCorrectives, learn_correctives
from ...learn.learn_body import Learned
from ...observe.meshes import MeshSequence
from ..console.console import pluralise, say, warn
from ..console.heartbeat import set_activity


def add_correctives(learned: Learned, meshes: MeshSequence) -> tuple[Learned, LearnedCorrectives]:
    """Learn the correctives of a learned body, and print what they do.

    **Raises:** `InputError` if there are too few meshes, or if they hardly bend.
    """
    set_activity("learning correctives")
    try:
        found = learn_correctives(learned.body, learned.motion, meshes)
    except ValueError as error:
        raise InputError(
            f"--correctives: {user_message(error).removeprefix('learn_correctives: ')}"
        ) from None
    for line in describe_correctives(found):
        (say if found.is_used else warn)(line)
    return learned._replace(body=found.body, motion=found.motion), found


def describe_correctives(found: LearnedCorrectives) -> list[str]:
    """Describe in sentences how far correctives move the surface, and the error of left-out poses with and without them."""
    choice, joints = found.choice, found.by_joint
    errors = f"{1000 * choice.error_without:.2f} mm without correctives and {1000 * choice.error_with:.2f} mm with them"
    if not found.is_used:
        return [
            f"correctives do not lower the error of poses that are left out of the fit reliably: vertex RMSE {errors}; the body has none"
        ]
    most = int(np.argmax(joints.largest))
    return [
        f"correctives: rank {choice.rank} at {pluralise(len(joints.names), 'joint')}, {joints.ranks.sum()} in all; the surface moves by at "
        f"most {1000 * joints.largest[most]:.1f} mm at {joints.names[most]}",
        f"poses that are left out of the fit: vertex RMSE {errors}",
    ]
