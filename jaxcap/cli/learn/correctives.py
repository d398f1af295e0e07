"""Correctives of a learned body on the command line: what is learned, and what is printed of it."""

from collections.abc import Callable

import numpy as np

from ...body.skeleton import Skeleton
from ...energy.check_energies import UserTerms
from ...errors import InputError, user_message
from ...learn.correctives.learn_correctives import MIN_MESHES, LearnedCorrectives, learn_correctives
from ...learn.learn_body import Learned
from ...observe.meshes import MeshSequence
from ..console.console import pluralise, say, warn
from ..console.heartbeat import set_activity


def check_number_of_meshes(count: int, correctives: bool) -> None:
    """Check that there are enough meshes for what is learned, before the body is learned. Raises `InputError`."""
    if correctives and count < MIN_MESHES:
        raise InputError(
            f"--correctives needs at least {MIN_MESHES} meshes besides those of --hold-out, and there are {count}; give more meshes, "
            "or leave it out."
        )


def add_correctives(
    learned: Learned, meshes: MeshSequence, terms: Callable[[MeshSequence, Skeleton], UserTerms]
) -> tuple[Learned, LearnedCorrectives | None]:
    """Learn the correctives of a learned body, and print what they do; `terms` makes the energies of its poses.

    If the meshes determine none, for example because they hardly bend, this is printed, and the body stays as it is.
    """
    set_activity("learning correctives")
    try:
        own = terms(meshes, learned.body.skeleton)
        found = learn_correctives(learned.body, learned.motion, meshes, own)
    except InputError as error:
        reason = user_message(error).removeprefix("learn_correctives: ")
        warn(f"--correctives: {reason} The body has none.")
        return learned, None
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
