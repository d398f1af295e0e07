"""The table of residuals that `jaxcap markers solve` prints."""

import numpy as np

from ...markers.motion.inverse_kinematics import MarkerSolution
from ...markers.subject import Subject
from ...report.markers.markers import assigned_residuals, score_markers, summarise_residuals
from ..console.console import print_table, say

#: number of markers in the table, the worst first
MAX_LISTED = 10


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
