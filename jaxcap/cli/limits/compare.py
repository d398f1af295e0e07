"""`jaxcap limits compare`: how alike the ranges of two performers are."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from ...errors import InputError
from ...io.registry import read_motion
from ...limits.compare import compare_samples
from ...limits.samples import gather_samples, parse_joints
from ..options import arg
from ..say import table


@dataclass
class Compare:
    """Distances between the rotations of two performers' joints, from each to the closest of the other."""

    reference: tyro.conf.Positional[Annotated[Path, arg(metavar="REFERENCE")]]
    """A motion: .bvh, .amc (with its .asf beside it) or .npz."""
    other: tyro.conf.Positional[Annotated[Path, arg(metavar="OTHER")]]
    """Another performer's."""
    joints: Annotated[str, arg(metavar="NAMES")]
    """Joints, after commas."""

    def run(self) -> None:
        rows = []
        try:
            for joint, _ in parse_joints(self.joints):
                one, two = (
                    gather_samples([read_motion(path)], joint, None, [str(path)])
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
            raise InputError(str(error)) from None
        table(["joint", "mean", "sd", "mean", "sd"], rows)
