"""`jaxcap limits compare`: the similarity of two subjects' ranges of motion."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ...errors import InputError, user_message
from ...limits.compare import compare_samples
from ...limits.learning.samples import gather_samples, parse_joints
from ..console.console import print_table
from ..console.options import MotionSpec, arg
from ..motions import load_motion


@dataclass
class Compare:
    """Compare the joint rotations of two subjects: the distances from each rotation of a subject to the closest
    rotation of the other.

    The mean and the standard deviation of these distances are printed for each joint."""

    reference: Annotated[MotionSpec, arg(metavar="REFERENCE")]
    other: Annotated[
        MotionSpec, arg(metavar="OTHER", help="Motion of another subject, in any format of REFERENCE.")
    ]
    joints: Annotated[str, arg(metavar="NAMES")]
    """Joints, separated by commas."""

    def run(self) -> None:
        rows = []
        try:
            for joint, _ in parse_joints(self.joints):
                one, two = (
                    gather_samples([load_motion(path)], joint, None, [str(path)])
                    for path in (self.reference, self.other)
                )
                found = compare_samples(one, two)
                degrees = np.degrees(2 * np.array([found.mean, found.deviation]))
                rows.append(
                    [
                        joint,
                        f"{found.mean:.4f}",
                        f"{found.deviation:.4f}",
                        f"{degrees[0]:.1f}°",
                        f"{degrees[1]:.1f}°",
                    ]
                )
        except ValueError as error:
            raise InputError(user_message(error)) from None
        print_table(["joint", "mean", "sd", "mean", "sd"], rows)
