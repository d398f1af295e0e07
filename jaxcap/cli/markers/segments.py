"""Segments of `jaxcap markers fit --template none`: pairs of equal length, the template's bones, and files of results."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from ...body.skeleton import Skeleton
from ...errors import InputError
from ...io.markers.marker_corrections import write_corrections
from ...markers.local_technique import LocalFit


def read_symmetry(words: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Parse pairs of names from `left:right`, also several separated by commas. Raises `InputError`."""
    pairs = []
    for word in (part for words_ in words for part in words_.split(",")):
        left, colon, right = (side.strip() for side in word.partition(":"))
        if not colon or not left or not right or left == right:
            raise InputError(
                f"--symmetry has '{word}'; give two segments as left:right, such as lthigh:rthigh."
            )
        pairs.append((left, right))
    return tuple(pairs)


def match_segments(
    template: Skeleton, corrections: Mapping[str, tuple[str, float]], file: Path, template_file: str
) -> tuple[Skeleton, dict[str, str]]:
    """Match the segments of a file of corrections to the template's bones by name; return both. Raises `InputError`."""
    given = dict.fromkeys(segment for segment, weight in corrections.values() if weight > 0)
    bones = {name: name for name in given if name in template.names}
    if len(bones) < 2:
        raise InputError(
            f"{file}: {len(bones)} of its segments have the name of a joint of {template_file}, which has "
            f"{', '.join(template.names[:12])}{', ...' if len(template.names) > 12 else ''}; name at least two."
        )
    return template, bones


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
