"""Tables of the results: segments with their markers, joints, bones, residuals."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...markers.calibration.calibrate import Calibration
from ...markers.calibration.observability import bone_length_deviations
from ...markers.local_technique import LocalFit
from ...markers.motion.inverse_kinematics import MarkerSolution
from ...markers.subject import Subject
from ...report.markers.markers import assigned_residuals, describe_bones, score_markers, summarise_residuals
from ..console.console import print_table, say
from ..console.record import give_figures

#: residual of a stray marker, metres, and the share of frames above which it is reported
STRAY_DISTANCE, STRAY_SHARE = 0.05, 0.02
#: number of markers in the table of residuals, the worst first
MAX_LISTED = 10


def print_doubts(messages: Sequence[str]) -> None:
    """Print what should be checked, before the results."""
    if messages:
        say("please check:")
    for sentence in messages:
        say(f"- {sentence}")


def print_segments(local_fit: LocalFit) -> None:
    """Print a row for each segment, with its markers and their attachment weights; then the loose ones."""
    labels, weights = local_fit.markers.labels, local_fit.segments.weights
    seen = np.any(np.asarray(local_fit.markers.visible), axis=0)
    loose = [labels[m] for m in np.flatnonzero(local_fit.segments.is_loose) if seen[m]]
    say(
        f"segments: {local_fit.segments.num_segments}, with {int(seen.sum()) - len(loose)} markers; {len(loose)} are loose"
    )
    rows = []
    for segment, (name, members) in enumerate(
        zip(local_fit.segments.names, local_fit.segments.members, strict=True)
    ):
        parent = local_fit.tree.parents[segment]
        above = local_fit.segments.names[parent] if parent >= 0 else "-"
        if name not in local_fit.skeleton.names:
            above = "no bone"
        rows.append([name, above, ", ".join(f"{labels[m]} {weights[m]:.2f}" for m in members)])
    widths = [max([len(row[column]) for row in rows] + [6]) for column in (1, 2)]
    print_table(
        ["segment", "parent".ljust(widths[0]), "markers and weights".ljust(widths[1])],
        [[name, above.ljust(widths[0]), some.ljust(widths[1])] for name, above, some in rows],
    )
    if loose:
        say(f"loose markers: {', '.join(loose)}")


def print_joints(local_fit: LocalFit) -> None:
    """Print a row for each joint: the residual between its two segments, and the precision of its
    position."""
    names, rows = local_fit.segments.names, []
    for joint in local_fit.joints:
        if joint is None or names[joint.child] not in local_fit.skeleton.names:
            continue
        hinge = joint.axis_in_parent is not None
        # along a hinge's axis the centre is arbitrary
        across = joint.deviations[:-1] if hinge else joint.deviations
        rows.append(
            [
                f"{names[joint.parent]} - {names[joint.child]}",
                "hinge" if hinge else "ball",
                f"{1e3 * joint.residual:.1f} mm",
                f"{1e3 * across[-1]:.1f} mm",
                f"{np.degrees(joint.swept_angle):.0f}°",
            ]
        )
    say(f"joints: {len(rows)}")
    if rows:
        print_table(["joint", "kind", "residual", "precision", "range"], rows)


#: likely reasons of large residuals of a calibrated subject, and of an OpenSim model
SUBJECT_REASONS = "Either an adjacent joint did not rotate in the takes of the calibration, or the markers were moved or mislabelled."
MODEL_REASONS = "Either the model is not scaled to the person of the trial, or the markers have other places or labels than in the model."


def describe_strays(
    labels: Sequence[str], residuals: Float[np.ndarray, "F M"], reasons: str = SUBJECT_REASONS
) -> tuple[str, ...]:
    """Return a sentence about markers with frequent large residuals, which a median over all does not
    show."""
    seen = np.isfinite(residuals)
    shares = ((residuals > STRAY_DISTANCE) & seen).sum(0) / np.maximum(seen.sum(0), 1)
    found = [m for m in np.argsort(-shares, kind="stable") if shares[m] > STRAY_SHARE]
    if not found:
        return ()
    some = f"{len(found)} markers, such as " if len(found) > 8 else ""
    some += ", ".join(f"{labels[m]} in {max(100 * shares[m], 1):.0f} %" for m in found[:8])
    return (
        f"Markers are more than {100 * STRAY_DISTANCE:.0f} cm from their predicted positions: {some} of the frames. {reasons}",
    )


def print_bones(local_fit: LocalFit, calibrated: Calibration | None) -> None:
    """Print a row for each bone between two joints: its length from separate joints, and from the joint
    fit."""
    rows = []
    bones = describe_bones(local_fit.skeleton)
    if calibrated is None:
        rows = [[f"{bone.start} - {bone.end}", f"{1e3 * bone.length:.1f} mm"] for bone in bones]
        print_bone_table(rows, ["bone", "length"])
        return
    deviations = bone_length_deviations(calibrated.subject, calibrated.joints, calibrated.covariance)
    after = {(bone.start, bone.end): bone.length for bone in describe_bones(calibrated.subject.skeleton)}
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
    print_bone_table(rows, ["bone", "separately", "together", "deviation"])


def print_bone_table(rows: list[list[str]], head: list[str]) -> None:
    """Print a table, unless it has no rows."""
    if rows:
        say(f"bones between joints: {len(rows)}")
        print_table(head, rows)


def print_residuals(subject: Subject, solution: MarkerSolution) -> None:
    """Print the residuals over all markers, and the markers with the largest ones."""
    kept = assigned_residuals(subject, solution.residuals, solution.lost)
    totals = summarise_residuals(kept)
    out = np.isfinite(kept) & (solution.weights < 0.5)
    wrong = (
        f"; {int(out.sum())} marker positions have a low weight, as if swapped or moved" if out.any() else ""
    )
    say(
        f"residuals: {1e3 * totals['rms']:.2f} mm rms, median {1e3 * totals['median']:.2f} mm, 95 % within "
        f"{1e3 * totals['p95']:.2f} mm{wrong}"
    )
    give_figures(
        {
            **{f"residual_{name}": totals[name] for name in ("rms", "median", "p95")},
            "frames": len(solution.lost),
            "lost_frames": int(solution.lost.sum()),
        }
    )
    scores = [
        score for score in score_markers(subject, solution.residuals, solution.lost) if np.isfinite(score.rms)
    ]
    scores.sort(key=lambda score: -score.rms)
    print_table(
        ["marker", "bone", "seen", "rms", "median", "worst"],
        [
            [
                score.label,
                score.bone,
                f"{100 * score.seen:.1f} %",
                *(f"{1e3 * value:.1f} mm" for value in (score.rms, score.median, score.worst)),
            ]
            for score in scores[:MAX_LISTED]
        ],
    )
    if len(scores) > MAX_LISTED:
        say(f"... and {len(scores) - MAX_LISTED} more with smaller residuals; --report lists all")
