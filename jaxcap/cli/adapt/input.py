"""What `jaxcap adapt` is given, looked at before hours are spent on it."""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ...adapt.check import check_cameras
from ...adapt.poses.task_pairs import some_of
from ...adapt.task import AdaptState
from ...body.body import Body
from ...body.pose import Pose
from ...body.skeleton import Skeleton
from ...edit.retargeting.plan import plan_retarget
from ...edit.retargeting.retarget import retarget
from ...errors import InputError, sentence_of
from ...fit.tracking.check import check_extent
from ...geometry.camera import Camera
from ...io.cameras import read_cameras
from ...io.meshes.clouds import Scans
from ...observe import Scan
from ..console.console import progress, warn
from ..motions import load_motion
from ..sources import Up, up_rotation

#: the least number of scans, and the least share of all, that have to be good
LEAST, GOOD = 3, 0.5
#: scans that cameras are held against, spread over all
LOOKED_AT = 5
#: scans that are told of one by one
TOLD = 5
#: lost frames that are named with their reasons
NAMED = 20


class Looked(NamedTuple):
    """What is seen of scans before any of them is met by a body."""

    #: frames whose scan is empty, cannot be read, or cannot be of the body, each with the sentence that says so
    unusable: dict[int, str]
    #: of every scan, what tells that it is the same: a hash of all that it has
    digests: tuple[str, ...]


def look_through(scans: Scans, body: Body) -> Looked:
    """Read every scan once.

    **Raises:** `InputError` where the first scan is one of them, or too many are.
    """
    found: dict[int, str] = {}
    digests = ["cannot be read"] * len(scans)
    for frame in progress(range(len(scans)), len(scans), label="reading"):
        try:
            scan = scans[frame]
            digests[frame] = _digest(scan)
            check_extent(body, scan.points, scan.name)
        except InputError as error:
            if frame == 0:
                raise
            found[frame] = sentence_of(error)
    good = len(scans) - len(found)
    if found and (good < LEAST or good < GOOD * len(scans)):
        raise InputError(
            f"{len(found)} of {len(scans)} scans cannot be used, too many to go on without them; the first: "
            f"{next(iter(found.values()))}"
        )
    return Looked(found, tuple(digests))


def _digest(scan: Scan) -> str:
    """Of all that a scan has beside its name."""
    parts = [np.ascontiguousarray(part) for part in scan[1:] if part is not None]
    return hashlib.sha256(b"|".join(part.tobytes() for part in parts)).hexdigest()[:16]


def warn_of_unusable(reasons: Mapping[int, str]) -> None:
    """Tell of scans that are left out, the first ones by what is wrong with them."""
    for frame in list(reasons)[:TOLD]:
        warn(f"{reasons[frame].rstrip('.')}; frame {frame} goes without a scan.")
    if len(reasons) > TOLD:
        warn(f"{len(reasons) - TOLD} further frames go without a scan, too.")


def explained_words(state: AdaptState) -> str:
    """Say in how many frames the body explains the scan."""
    frames, lost = len(state.motion), len(state.lost)
    return "all scans explained" if not lost else f"{frames - lost} of {frames} scans explained"


def warn_of_lost(state: AdaptState, scans: Scans) -> None:
    """Name the frames that the body does not explain, each with the reasons."""
    if not state.lost:
        return
    warn(f"{len(state.lost)} of {len(scans)} frames are lost, do not trust their poses:")
    reasons = state.reasons or ("not explained by the body",) * len(state.lost)
    for frame, reason in list(zip(state.lost, reasons, strict=True))[:NAMED]:
        warn(f"  {Path(scans.names[frame]).name}: {reason}")
    if len(state.lost) > NAMED:
        warn(f"  and {len(state.lost) - NAMED} more: frames {', '.join(map(str, state.lost[NAMED:]))}")


def load_cameras(path: Path, scans: Scans, frames: Sequence[int], up: Up) -> tuple[Camera, ...]:
    """The cameras of a calibration in metres as the scans lie, y up. Raises `InputError` where they cannot have taken
    the scans of these frames."""
    cameras = [_upright(camera, up) for camera in read_cameras(path)]
    turn = up_rotation(up)
    check_cameras(cameras, [scans[n].points @ turn.T for n in some_of(frames, LOOKED_AT)], str(path))
    return tuple(cameras)


def _upright(camera: Camera, up: Up) -> Camera:
    """The same camera where the vertical of the world is y."""
    turn = jnp.asarray(up_rotation(up), camera.rotation.dtype)
    return eqx.tree_at(lambda c: c.rotation, camera, camera.rotation @ turn.T)


def first_pose(path: Path, skeleton: Skeleton) -> Pose:
    """The first pose of a motion, carried over to a skeleton of other proportions. Raises `InputError`."""
    of, motion = load_motion(path)
    try:
        plan = plan_retarget(of, skeleton, None, motion)
    except ValueError as error:
        raise InputError(f"{path}: {sentence_of(error)}") from None
    for line in plan.matches.warnings:
        warn(f"{path}: {line}")
    return retarget(motion.slice(slice(1)), of, skeleton, plan=plan)[0]
