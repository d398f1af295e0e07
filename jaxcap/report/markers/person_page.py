"""The report of a person's skeleton: one page with the doubts, lengths, pictures and joint angles."""

import base64
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...biomechanics.angles import JointAngles, joint_angles
from ...io.system.atomic import write_text
from ...markers.human.body_lengths import segment_lengths
from ...markers.human.body_size import is_adult
from ...markers.human.fit_human import HumanFit
from ..chart import Line, legend, line_chart
from ..page import Markup, element, page, section, table
from .markers import score_markers

#: angles that are drawn: title, and the name without its side
ANGLES = (
    ("Hip flexion", "hip_flexion"),
    ("Knee flexion", "knee_flexion"),
    ("Ankle dorsiflexion", "ankle_dorsiflexion"),
    ("Shoulder elevation", "shoulder_elevation"),
    ("Elbow flexion", "elbow_flexion"),
)


def write_person_page(
    path: str | Path, fit: HumanFit, title: str, pictures: Sequence[Path], notes: Sequence[str]
) -> None:
    """Write the page, with the pictures inside it.

    **Arguments:** `pictures` of the skeleton among its markers and of the residuals; `notes`, further sentences.

    **Raises:** `InputError` if the file cannot be written.
    """
    write_text(Path(path), person_page(fit, title, pictures, notes))


def person_page(fit: HumanFit, title: str, pictures: Sequence[Path], notes: Sequence[str]) -> str:
    """Build the page of `write_person_page`."""
    said = [element("li", sentence) for sentence in fit.messages]
    doubts = element("ul", *said) if said else element("p", "Nothing is in doubt.")
    parts = [
        element("h1", title),
        section("Please check", doubts),
        section("Lengths between joint centres", _lengths(fit)),
        *(section(picture.stem.capitalize(), _picture(picture)) for picture in pictures),
        section("Joint angles", *_angle_charts(fit)),
        section("Markers", _markers(fit)),
    ]
    if notes:
        parts.append(section("Notes", element("ul", *(element("li", sentence) for sentence in notes))))
    return page(title, *parts)


def _lengths(fit: HumanFit) -> Markup:
    rows = []
    for one in segment_lengths(fit.calibration, fit.subject.skeleton, is_adult=is_adult(fit.traits)):
        is_width = math.isnan(one.right)
        known = "from anatomy" if math.isnan(one.deviation) else f"± {1e3 * one.deviation:.0f}"
        usual = "" if math.isnan(one.percentile) else f"{one.percentile:.0f} %"
        rows.append(
            [
                one.name,
                f"{1e3 * one.left:.0f}",
                "" if is_width else f"{1e3 * one.right:.0f}",
                "" if is_width else known,
                usual,
            ]
        )
    caption = "Millimetres; the last column is the share of adults with a shorter segment."
    return table(caption, ["segment", "left", "right", "deviation", "percentile"], rows)


def _picture(path: Path) -> Markup:
    data = base64.b64encode(path.read_bytes()).decode()
    return element("figure", element("img", src=f"data:image/png;base64,{data}", alt=path.stem))


def _angle_charts(fit: HumanFit) -> list[Markup]:
    """Draw the angles of both sides over time, in degrees (ISB's conventions)."""
    angles: JointAngles = joint_angles(fit.subject.skeleton, fit.motion).to_degrees()
    times = np.arange(len(fit.motion)) / fit.motion.rate
    charts = []
    for title, name in ANGLES:
        lines = [
            Line(
                side, times, np.where(fit.lost, np.nan, np.asarray(angles[f"{name}_{side[0]}"], float)), style
            )
            for side, style in (("left", "c2"), ("right", "c0"))
            if f"{name}_{side[0]}" in angles.names
        ]
        if lines:
            chart = line_chart(title, lines, "seconds", "degrees")
            charts.append(element("figure", chart, element("figcaption", title), legend(lines)))
    return [element("div", *charts, class_="grid")] if charts else [element("p", "No angle is determined.")]


def _markers(fit: HumanFit) -> Markup:
    sets = dict(zip(fit.marker_set.labels, fit.marker_set.names, strict=True))
    rows = [
        [
            score.label,
            sets.get(score.label) or "unknown",
            score.bone,
            f"{100 * score.seen:.0f} %",
            "" if math.isnan(score.rms) else f"{1e3 * score.rms:.1f}",
        ]
        for score in score_markers(fit.subject, fit.residuals, fit.lost)
    ]
    caption = "Residuals are root mean squares, millimetres."
    return table(caption, ["marker", "landmark", "bone", "visible", "residual"], rows, words=(1, 2))
