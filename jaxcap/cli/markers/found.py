"""Tables of the results: segments with their markers, joints, bones."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...markers.calibration.calibrate import Calibration
from ...markers.calibration.observability import length_deviations
from ...markers.local import LocalFit
from ...report.markers.markers import bones_between
from ..console.console import say, table

#: residual of a stray marker, metres, and the share of frames above which it is reported
STRAY, OFTEN = 0.05, 0.02


def tell_segments(found: LocalFit) -> None:
    """Print a row for each segment, with its markers and their attachment weights; then the loose ones."""
    labels, weights = found.markers.labels, found.segments.weights
    seen = np.any(np.asarray(found.markers.seen), axis=0)
    loose = [labels[m] for m in np.flatnonzero(found.segments.loose) if seen[m]]
    say(
        f"segments: {found.segments.num_segments}, with {int(seen.sum()) - len(loose)} markers; {len(loose)} are loose"
    )
    rows = []
    for segment, (name, members) in enumerate(zip(found.segments.names, found.segments.members, strict=True)):
        parent = found.tree.parents[segment]
        above = found.segments.names[parent] if parent >= 0 else "-"
        if name not in found.skeleton.names:
            above = "no bone"
        rows.append([name, above, ", ".join(f"{labels[m]} {weights[m]:.2f}" for m in members)])
    widths = [max([len(row[column]) for row in rows] + [6]) for column in (1, 2)]
    table(
        ["segment", "parent".ljust(widths[0]), "markers and weights".ljust(widths[1])],
        [[name, above.ljust(widths[0]), some.ljust(widths[1])] for name, above, some in rows],
    )
    if loose:
        say(f"loose markers: {', '.join(loose)}")


def tell_joints(found: LocalFit) -> None:
    """Print a row for each joint: the residual between its two segments, and the precision of its
    position."""
    names, rows = found.segments.names, []
    for joint in found.joints:
        if joint is None or names[joint.child] not in found.skeleton.names:
            continue
        hinge = joint.axis_in_parent is not None
        # along a hinge's axis the centre is arbitrary
        across = joint.precision[:-1] if hinge else joint.precision
        rows.append(
            [
                f"{names[joint.parent]} - {names[joint.child]}",
                "hinge" if hinge else "ball",
                f"{1e3 * joint.residual:.1f} mm",
                f"{1e3 * across[-1]:.1f} mm",
                f"{np.degrees(joint.swept):.0f}°",
            ]
        )
    say(f"joints: {len(rows)}")
    if rows:
        table(["joint", "kind", "residual", "precision", "range"], rows)


def strays(labels: Sequence[str], residuals: Float[np.ndarray, "F M"]) -> tuple[str, ...]:
    """Return a sentence about markers with frequent large residuals, which a median over all does not
    show."""
    seen = np.isfinite(residuals)
    shares = ((residuals > STRAY) & seen).sum(0) / np.maximum(seen.sum(0), 1)
    found = [m for m in np.argsort(-shares, kind="stable") if shares[m] > OFTEN]
    if not found:
        return ()
    more = f" and {len(found) - 8} more" if len(found) > 8 else ""
    some = ", ".join(f"{labels[m]} in {max(100 * shares[m], 1):.0f} %" for m in found[:8])
    return (
        f"Markers are more than {100 * STRAY:.0f} cm from their positions in the subject: {some}{more} of frames. Either an "
        "adjacent joint did not rotate in the takes of the calibration, or the markers were moved or mislabelled.",
    )


def tell_bones(found: LocalFit, calibrated: Calibration | None) -> None:
    """Print a row for each bone between two joints: its length from separate joints, and from the joint
    fit."""
    rows = []
    bones = bones_between(found.skeleton)
    if calibrated is None:
        rows = [[f"{bone.start} - {bone.end}", f"{1e3 * bone.length:.1f} mm"] for bone in bones]
        table_of(rows, ["bone", "length"])
        return
    deviations = length_deviations(calibrated.subject, calibrated.joints, calibrated.covariance)
    after = {(bone.start, bone.end): bone.length for bone in bones_between(calibrated.subject.skeleton)}
    for bone in bones:
        deviation = deviations[calibrated.subject.skeleton.index(bone.end)]
        known = "" if np.isnan(deviation) else f"± {1e3 * deviation:.1f} mm"
        rows.append(
            [
                f"{bone.start} - {bone.end}",
                f"{1e3 * bone.length:.1f} mm",
                f"{1e3 * after[bone.start, bone.end]:.1f} mm",
                known,
            ]
        )
    table_of(rows, ["bone", "separately", "together", "deviation"])


def table_of(rows: list[list[str]], head: list[str]) -> None:
    """Print a table, unless it has no rows."""
    if rows:
        say(f"bones between joints: {len(rows)}")
        table(head, rows)
