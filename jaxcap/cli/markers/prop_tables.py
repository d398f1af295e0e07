"""Tables of the frames of a prop: where it is, how it is turned, and how precisely that is known."""

from pathlib import Path

import numpy as np

from ...io.markers.subject import load_subject
from ...io.table import write_csv
from ...markers.motion.inverse_kinematics import MarkerSolution
from ...markers.subject import Subject
from ...markers.subjects.prop import find_inliers, pose_covariances
from ...observe.markers import MarkerFrames
from ..console.console import say


def is_prop(path: Path) -> bool:
    """Test if a file has a subject of one joint."""
    return path.suffix.lower() == ".npz" and load_subject(path).skeleton.num_joints == 1


def prop_table(motion: Path) -> Path:
    """Name the table that belongs to a motion of a prop."""
    return motion.with_name(f"{motion.stem}-frames.csv")


def write_prop_table(path: Path, prop: Subject, solution: MarkerSolution, frames: MarkerFrames) -> None:
    """Write a row for each frame: translation and its deviations, metres, the rotation as a quaternion, and its deviations, radians.

    Deviations are along and about the prop's axes. The cells of lost frames are empty.
    """
    poses = solution.motion.poses
    lost = np.asarray(solution.lost)
    inliers = find_inliers(prop, np.asarray(solution.residuals, float))
    spread = np.sqrt(np.diagonal(pose_covariances(prop, inliers, lost), axis1=1, axis2=2))
    numbers = np.concatenate(
        [np.asarray(poses.translations[:, 0]), np.asarray(poses.rotations[:, 0]), spread], axis=1
    )
    names = ("x", "y", "z", "qw", "qx", "qy", "qz", "dx", "dy", "dz", "drx", "dry", "drz")
    rows = [
        {
            "time": f"{frame / frames.rate:.6g}",
            **{
                name: "" if is_lost else f"{value:.7g}"
                for name, value in zip(names, row.tolist(), strict=True)
            },
        }
        for frame, (row, is_lost) in enumerate(zip(numbers, lost.tolist(), strict=True))
    ]
    write_csv(path, rows)
    say(f"frames of the prop: {path}")
