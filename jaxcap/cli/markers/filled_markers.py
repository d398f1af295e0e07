"""Files of markers without gaps, and of the deviations of the filled positions."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...io.registry import write_markers
from ...io.table import write_csv
from ...markers.motion.gap_filling import estimate_gaps
from ...markers.motion.inverse_kinematics import MarkerSolution
from ...markers.subject import Subject
from ...observe.markers import MarkerFrames
from ..console.console import say


def deviations_path(path: Path) -> Path:
    """Name the file of the deviations that belongs to a file of markers without gaps."""
    return path.with_name(f"{path.stem}-deviations.csv")


def write_filled(
    paths: Sequence[Path], subject: Subject, solution: MarkerSolution, frames: MarkerFrames
) -> None:
    """Write markers without gaps, and a table of the standard deviations of filled positions.

    No format of markers has a place for a standard deviation: the residual of a C3D file belongs to a position that
    cameras measured. The table has an empty cell where a position was observed.
    """
    found = estimate_gaps(subject, solution.motion, frames, weights=solution.weights, lost=solution.lost)
    filled = found.deviations > 0
    for path in paths:
        write_markers(path, found.frames)
        rows = [
            {
                "time": f"{frame / frames.rate:.6g}",
                **{
                    label: f"{deviation:.3g}" if deviation > 0 else ""
                    for label, deviation in zip(subject.labels, row.tolist(), strict=True)
                },
            }
            for frame, row in enumerate(found.deviations)
        ]
        write_csv(deviations_path(path), rows)
        say(f"markers without gaps: {path}, with their standard deviations in {deviations_path(path).name}")
    if filled.any():
        deviations = 1e3 * found.deviations[filled]
        say(
            f"{int(filled.sum())} filled positions: standard deviation along the least certain axis {np.median(deviations):.1f} mm "
            f"median, 95 % within {np.quantile(deviations, 0.95):.1f} mm"
        )
