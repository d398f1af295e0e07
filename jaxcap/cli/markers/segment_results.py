"""Files of the segments and joints that `jaxcap markers fit --template none` finds."""

from pathlib import Path

from ...io.markers.marker_corrections import write_corrections
from ...markers.local_technique import LocalFit


def write_segments(folder: Path, local_fit: LocalFit) -> None:
    """Write the segments as a file of corrections."""
    owner, names = local_fit.segments.marker_segments, local_fit.segments.names
    write_corrections(
        folder / "segments.txt",
        {
            label: ("-", 0.0) if owner[m] < 0 else (names[owner[m]], float(local_fit.segments.weights[m]))
            for m, label in enumerate(local_fit.markers.labels)
        },
    )


def joint_figures(local_fit: LocalFit) -> list[dict[str, object]]:
    """Collect the estimates of the separately fitted joints for `report.json`; metres and radians."""
    names = local_fit.segments.names
    return [
        {
            "joint": names[joint.child],
            "parent": names[joint.parent],
            "hinge": joint.axis_in_parent is not None,
            "residual": joint.residual,
            "precision": joint.deviations.tolist(),
            "bound": joint.arc_bound,
            "swept": joint.swept_angle,
            "method": joint.method,
        }
        for joint in local_fit.joints
        if joint is not None
    ]
