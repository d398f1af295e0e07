"""Checks of the input of `jaxcap adapt`, before a run of hours."""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...adapt.check_scans import check_actor, check_cameras, check_later_scans
from ...adapt.poses.select_frames import select_evenly
from ...adapt.task import AdaptState, AdaptTask, Stage, plan_stages
from ...body.body import Body
from ...body.matching.plan import plan_retarget
from ...body.pose import Pose
from ...body.skeleton import Skeleton
from ...edit.retargeting.retarget import retarget
from ...energy.energy import AbstractEnergy
from ...errors import InputError, user_message
from ...geometry.camera import Camera
from ...io.archives.prior import Priors
from ...io.cameras import read_cameras
from ...io.meshes.clouds import Scans
from ...observe import Scan
from ...tracking.check_cloud import check_cloud_extent
from ..console.console import pluralise, progress, warn
from ..console.heartbeat import set_activity
from ..motions import load_motion
from ..sources import Up, up_rotation, upright_camera

#: minimum share of usable scans
MIN_USABLE_SHARE = 0.5
#: fewer scans than this are adapted to with a warning
FEW_SCANS = 3
#: number of scans that are compared with the cameras, evenly spaced
COMPARED_SCANS = 5
#: maximum number of scans with a warning each
MAX_WARNINGS = 5
#: maximum number of lost frames that are listed with their reasons
NAMED = 20
UNORDERED = (
    "successive scans are not more similar than other pairs of scans, so they are treated as unordered in time, and the "
    "motion is not smoothed; give --ordered if they show one motion"
)


class RunFiles(NamedTuple):
    """The contents of the files of a run other than body and scans, which are read before the scans."""

    #: in metres, y up
    cameras: tuple[Camera, ...] = ()
    #: the pose near that of the first scan
    start: Pose | None = None
    priors: Priors | None = None
    terms: tuple[AbstractEnergy, ...] = ()


class AdaptedScans(NamedTuple):
    """Scans with a body of the person in them and its poses."""

    task: AdaptTask
    state: AdaptState
    scans: Scans


class InputSummary(NamedTuple):
    """What reading the scans has shown, before the fit."""

    #: frames whose scan is empty, unreadable, or impossible for the body, each with a sentence
    unusable: dict[int, str]
    #: a hash of the content of every scan
    digests: tuple[str, ...]


def warn_of_few(count: int) -> None:
    """Warn of scans that are too few to show the joints of a person."""
    if count < FEW_SCANS:
        warn(
            f"{pluralise(count, 'scan')} can hardly show where the joints of a person are, so they are as in people of a similar "
            "surface; more scans in other poses show them"
        )


def check_input(scans: Scans, body: Body) -> InputSummary:
    """Read every scan once.

    **Raises:** `InputError` if the first scan is unusable, or too many are.
    """
    found: dict[int, str] = {}
    digests = ["cannot be read"] * len(scans)
    for frame in progress(range(len(scans)), len(scans), label="reading"):
        try:
            scan = scans[frame]
            digests[frame] = _digest(scan)
            check_cloud_extent(body, scan.points, scan.name)
        except InputError as error:
            if frame == 0:
                raise
            found[frame] = user_message(error)
    good = len(scans) - len(found)
    if found and good < MIN_USABLE_SHARE * len(scans):
        raise InputError(
            f"{len(found)} of {len(scans)} scans cannot be used, which is too many; the first: "
            f"{next(iter(found.values()))}"
        )
    return InputSummary(found, tuple(digests))


def _digest(scan: Scan) -> str:
    """Hash the content of a scan without its name."""
    parts = [np.ascontiguousarray(part) for part in scan[1:] if part is not None]
    return hashlib.sha256(b"|".join(part.tobytes() for part in parts)).hexdigest()[:16]


def warn_of_unusable(reasons: Mapping[int, str]) -> None:
    """Warn of scans that are skipped, with reasons for the first ones."""
    for frame in list(reasons)[:MAX_WARNINGS]:
        warn(f"{reasons[frame].rstrip('.')}; frame {frame} is fitted without a scan.")
    if len(reasons) > MAX_WARNINGS:
        warn(f"{len(reasons) - MAX_WARNINGS} further frames are fitted without a scan, too.")


def format_explained(state: AdaptState) -> str:
    """Format the number of frames in which the body explains the scan."""
    frames, lost = len(state.motion), len(state.lost)
    return "all scans explained" if not lost else f"{frames - lost} of {frames} scans explained"


def warn_of_lost(state: AdaptState, scans: Scans) -> None:
    """List the frames that the body does not explain, each with the reasons."""
    if not state.lost:
        return
    warn(f"{len(state.lost)} of {len(scans)} frames are lost; do not trust their poses:")
    reasons = state.reasons or ("not explained by the body",) * len(state.lost)
    for frame, reason in list(zip(state.lost, reasons, strict=True))[:NAMED]:
        warn(f"  {Path(scans.names[frame]).name}: {reason}")
    if len(state.lost) > NAMED:
        warn(f"  and {len(state.lost) - NAMED} more: frames {', '.join(map(str, state.lost[NAMED:]))}")


def warn_of_others(state: AdaptState, scans: Scans) -> None:
    """Warn of scans that seem to show other people than most of the scans do."""
    for other in state.others:
        named = [Path(scans.names[frame]).name for frame in other.frames]
        more = f" and {len(named) - NAMED} more" if len(named) > NAMED else ""
        parts = ", ".join(
            f"{1000 * abs(shift):.1f} mm further {'out' if shift > 0 else 'in'} at the {name}"
            for name, shift in other.differences
        )
        warn(
            f"{len(named)} of {other.compared} compared scans may be of another person than the others: {', '.join(named[:NAMED])}{more}; "
            f"their surface is {parts}, so the body may be a mean of several people; adapt to the scans of each person by itself, "
            "unless only clothes differ or these poses are wrong"
        )


def check_people(task: AdaptTask, state: AdaptState, names: Sequence[str]) -> None:
    """Check after the stage `size` that the first scan is of one person, and after the first stage that tracks all frames the later
    scans; the message names the option to continue anyway. `names` are those of the scans.

    **Raises:** `InputError` if one is not.
    """
    if state.within:
        return
    try:
        if state.done == 1:
            check_actor(task, state, names[0])
        elif state.done == 1 + plan_stages(task.settings).index(Stage("track")):
            set_activity("looking for a second person in the scans")
            check_later_scans(task, state, names)
    except InputError as error:
        raise InputError(
            f"{user_message(error)} If the scan does show one person, give --skip-person-check."
        ) from None


def load_cameras(path: Path | None, up: Up) -> tuple[Camera, ...]:
    """Load the cameras of a calibration in metres, with y up; none without a file. Raises `InputError`."""
    return () if path is None else tuple(upright_camera(camera, up) for camera in read_cameras(path))


def check_scan_cameras(
    cameras: Sequence[Camera], scans: Scans, frames: Sequence[int], up: Up, where: Path | None
) -> None:
    """Check that cameras of the file `where`, if there are any, can have observed the scans of some frames. Raises
    `InputError`."""
    if cameras:
        turn = up_rotation(up)
        shown = [scans[n].points @ turn.T for n in select_evenly(frames, COMPARED_SCANS)]
        check_cameras(cameras, shown, str(where))


def first_pose(path: Path | None, skeleton: Skeleton) -> Pose | None:
    """Load the first pose of a motion and retarget it to a skeleton of other proportions; None without a file.
    Raises `InputError`."""
    if path is None:
        return None
    of, motion = load_motion(path)
    try:
        plan = plan_retarget(of, skeleton, None, motion)
    except ValueError as error:
        raise InputError(f"{path}: {user_message(error)}") from None
    for line in plan.matches.warnings:
        warn(f"{path}: {line}")
    return retarget(motion.slice(slice(1)), of, skeleton, plan=plan)[0]


def is_none_or_nonnegative(weight: float | None) -> bool:
    """Test if the weight of a term is in range, or not given."""
    return weight is None or 0 <= weight < np.inf
