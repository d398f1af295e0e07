"""Doubts about a motion in AMASS's format: angles in degrees, lengths in another unit, another vertical."""

import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

#: angle that no rotation vector in radians has, even one that was unwrapped over a few turns
MAX_ANGLE = 8 * np.pi
#: speed that a person does not keep up, metres per second
MAX_SPEED = 20.0
#: cosines of the trunk with an axis, averaged over a motion: upright, and not upright
UPRIGHT, NOT_UPRIGHT = 0.8, 0.4


def warn_of_doubts(
    path: str | Path,
    poses: Float[np.ndarray, "F D"],
    trans: Float[np.ndarray, "F 3"],
    rate: float,
    up: str,
    known: bool,
) -> None:
    """Warn of parameters that are probably in another unit, or in a world with another vertical, unless that is `known`."""
    for doubt in [*_doubt_units(poses, trans, rate), *([] if known else _doubt_vertical(poses, up))]:
        warnings.warn(f"{path}: {doubt}.", stacklevel=5)


def _doubt_units(
    poses: Float[np.ndarray, "F D"], trans: Float[np.ndarray, "F 3"], rate: float
) -> Iterator[str]:
    angle = float(np.linalg.norm(poses.reshape(-1, 3), axis=1).max())
    if angle > MAX_ANGLE:
        yield f"a joint rotates by {angle:.0f} radians; if the angles are in degrees, convert them to radians"
    speeds = np.linalg.norm(np.diff(trans, axis=0), axis=1) * rate
    speed = float(np.median(speeds)) if len(speeds) else 0.0
    if speed > MAX_SPEED:
        yield f"the person moves at {speed:.0f} m/s; if the positions are in millimetres or centimetres, convert them to metres"


def _doubt_vertical(poses: Float[np.ndarray, "F D"], up: str) -> Iterator[str]:
    """Compare the trunk, which is along y at rest, with the verticals of the worlds."""
    trunk = Rotation.from_rotvec(poses[:, :3]).as_matrix()[:, :, 1].mean(0)
    along_y, along_z = float(trunk[1]), float(trunk[2])
    if up == "z" and along_z < NOT_UPRIGHT and abs(along_y) > UPRIGHT:
        axis, what = ("y", "") if along_y > 0 else ("-y", ", as in the coordinates of a camera")
        yield (
            f"the vertical is not stated, and the person lies if it is z, as read; if it is {axis}{what}, give --up={axis} in `jaxcap convert`, or up='{axis}' in Python"
        )
