"""A motion with its joint limits, as the verbs read them."""

from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np

from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ...errors import InputError
from ...io.archives.limits import read_limits
from ...limits.abstract_limits import AbstractLimits
from ...limits.frame_evaluation import allowed_frames, residual_frames
from ...markers.segments.gaps import find_runs
from ..console.options import arg
from ..motions import load_body_motion, load_motion
from ..sources import load_body

LimitsFile = Annotated[Path, arg(aliases=("-l",), metavar="FILE")]


class MotionLimits(NamedTuple):
    """A motion, its limits, and the joints that violate them."""

    skeleton: Skeleton
    motion: Motion
    limits: AbstractLimits
    #: (F, J) whether joints violate their limits; (F, J) by how many degrees, approximately
    is_violated: np.ndarray
    degrees: np.ndarray


def read_motion_limits(motion: Path, limits: Path, unit: str | None, body: str | None = None) -> MotionLimits:
    """Read a motion, that of `body` if one is given, and check it against limits.

    **Raises:** `InputError` if a file is invalid, or the limits are of another skeleton.
    """
    if not limits.is_file():
        raise InputError(f"{limits}: there is no such file; learn limits with `jaxcap limits learn`.")
    if body is None:
        skeleton, moving = load_motion(motion, unit)
    else:
        of = load_body(body, unit=unit or "m")[0]
        skeleton, moving = of.skeleton, load_body_motion(of, motion, unit)
    return find_violations(skeleton, moving, read_limits(limits, skeleton, moving))


def find_violations(skeleton: Skeleton, motion: Motion, limits: AbstractLimits) -> MotionLimits:
    """Check a motion against limits."""
    beyond = ~np.asarray(allowed_frames(limits, skeleton, motion))
    amounts = np.abs(np.asarray(residual_frames(limits, skeleton, motion)))
    degrees = np.zeros(beyond.shape)
    for column, joint in enumerate(np.asarray(limits.residual_joints(skeleton))):
        degrees[:, joint] = np.maximum(degrees[:, joint], np.degrees(amounts[:, column]))
    return MotionLimits(skeleton, motion, limits, beyond, degrees)


def format_runs(frames: np.ndarray, most: int = 4) -> str:
    """Format marked frames as runs, the longest first: `12-40, 3`."""
    found = sorted(find_runs(np.asarray(frames)), key=lambda run: run[0] - run[1])
    text = ", ".join(f"{first}-{end - 1}" if end - first > 1 else f"{first}" for first, end in found[:most])
    return (text or "-") + (", ..." if len(found) > most else "")
