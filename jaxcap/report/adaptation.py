"""The report of an adaptation: one page with the improvements and the settings."""

import importlib.metadata
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..adapt.evaluate import Evaluation, Variant, quantile, summarise
from ..adapt.objective import Terms
from ..adapt.task import AdaptState, AdaptTask
from ..arguments import checked
from ..body.body import Body
from ..io.system.atomic import write_text
from .adaptation_charts import (
    angle_charts,
    distance_charts,
    frame_chart,
    heat_maps,
    history_chart,
    jitter_table,
)
from .page import Markup, element, page, section, table

TITLE = "Adaptation of a template to an actor"
VARIANTS = {
    "not adapted": "the template, scaled to the size of the actor",
    "first frame": "the template, adapted to the first scan only",
    "many frames": "the adapted body, each pose fitted independently",
    "smooth": "the adapted body with the smoothed motion",
}
#: columns of the table of the objective's terms
TERM_COLUMNS = (
    "stage",
    "pairs, mm",
    "pose prior",
    "second differences, degrees",
    "shape change, mm",
    "asymmetry, mm",
)
#: columns of the table of variants
VARIANT_COLUMNS = (
    "body",
    "mean",
    "standard deviation",
    "median",
    "MAD",
    "IQR",
    "90 % quantile",
    "body to scan, median",
    "lost frames",
)
NOISE_NOTE = """Distances include the noise of the scans, so no body has zero distances."""
MEASURES_NOTE = """MAD is the median absolute deviation from the median. IQR is the interquartile range, which contains half of
all distances. Distances from body to scan include every vertex, also those that no camera saw, and are limited from below by
the gaps between points."""
HEAT_MAP_NOTE = """Each body at rest, from the front and the back. The colour of a vertex is the mean distance of its nearest scanned
points over all measured frames."""
ANGLE_NOTE = """The rotation angle of each joint from rest, about its main axis. Poses that are fitted independently jitter with
the noise of the scans."""
SMOOTHING_NOTE = """ The smoothed motion should follow the movement without jitter."""
JITTER_NOTE = """Jitter is the rotation of a joint from the mean of the previous and the next frame, as root mean square. Real
movement contributes to it, too."""
PAIRS_NOTE = """The distance that the adaptation minimises: between the points of pairs, along their normals, with lower weights
for distant pairs. Some stages use other scans, so a small increase need not mean a worse body."""
LOST_NOTE = """Each frame is compared with the typical values of all frames for each part: unexplained points, surface that
should be visible but has no points, and the distance from the points to the body."""
OTHERS_NOTE = """The body was adapted to all scans, but these differ from most others as scans of another person do. Adapt to the
scans of each person by itself, unless only clothes differ, or the poses are wrong."""
#: largest number of lost frames that are listed
MAX_LISTED = 20
#: packages whose versions may affect a result
PACKAGES = ("jaxcap", "jax", "numpy", "scipy")


@checked
def report_adaptation(
    path: str | Path, task: AdaptTask, state: AdaptState, stages: Evaluation, settings: Mapping[str, object]
) -> None:
    """Write the report as one HTML file that includes all pictures.

    **Arguments:** `stages` with all variants, from `compare_stages`; `settings` maps the options of the
    adaptation, by their user-visible names, to their values.

    **Raises:** `InputError` if the file cannot be written.
    """
    write_text(path, adaptation_page(task, state, stages, settings))


@checked
def adaptation_page(
    task: AdaptTask, state: AdaptState, stages: Evaluation, settings: Mapping[str, object]
) -> str:
    """Build the page of `report_adaptation`."""
    skeleton, angles = state.body.skeleton, stages.angles
    parts = [
        element("h1", TITLE),
        summary_cards(task, state, stages),
        section(
            "Distances between scans and body",
            variant_table(stages.variants),
            *measure_notes(task, stages),
            distance_charts(stages.variants),
        ),
        section("Distances on the body", element("p", HEAT_MAP_NOTE), heat_maps(stages.variants)),
    ]
    if len(stages.measured_frames) > 1:
        parts.append(section("Distances over time", frame_chart(stages, task.rate)))
    if angles is not None and len(angles.seconds) > 2:
        notes = element("p", ANGLE_NOTE, SMOOTHING_NOTE if angles.after is not None else "")
        shakes = (jitter_table(angles, skeleton), element("p", JITTER_NOTE, class_="soft"))
        parts.append(section("Joint angles over time", notes, angle_charts(angles, skeleton), *shakes))
    if state.others:
        parts.append(
            section("Scans of other people", others_table(state), element("p", OTHERS_NOTE, class_="soft"))
        )
    if state.lost:
        parts.append(section("Lost frames", lost_table(state), element("p", LOST_NOTE, class_="soft")))
    every = element("details", element("summary", "All stages"), history_table(state.history, state.terms))
    parts.append(section("Convergence", element("p", PAIRS_NOTE), history_chart(state.history), every))
    parts.append(section("Settings", settings_table(task, settings)))
    return page(TITLE, *parts)


def summary_cards(task: AdaptTask, state: AdaptState, stages: Evaluation) -> Markup:
    """Summarise size, distances and lost frames in plain words."""
    first, last = stages.variants[0], stages.variants[-1]
    before, after = (1000 * quantile(variant.scan_to_body, 0.5) for variant in (first, last))
    size = (
        "is the size ratio of actor to template, before the adaptation of shape. At rest the height of the body is now "
        f"{_height(state.body):.2f} m, that of the template {_height(task.template):.2f} m."
    )
    nearer = (
        "is the median distance of scanned points from the body: before, with the template scaled to the size of "
        "the actor, and after."
    )
    lost = len(last.lost)
    followed = "were tracked. No frame was lost."
    if lost:
        named = ", ".join(map(str, last.lost[:MAX_LISTED])) + (" and more" if lost > MAX_LISTED else "")
        followed = f"were tracked. Lost, counted from 0: {named}; their figures are not reliable."
    cards = (
        (f"× {state.size:.3f}", size),
        (f"{before:.1f} mm → {after:.1f} mm", nearer),
        (f"{task.num_frames - lost} of {task.num_frames} frames", followed),
    )
    blocks = [element("div", element("strong", strong), text, class_="card") for strong, text in cards]
    return element("div", *blocks, class_="cards")


def lost_table(state: AdaptState) -> Markup:
    """Tabulate lost frames with their reasons."""
    reasons = state.reasons or ("",) * len(state.lost)
    rows = [[str(frame), reason] for frame, reason in zip(state.lost, reasons, strict=True)]
    return table("Lost frames, counted from 0", ("frame", "reason"), rows, words=(1,))


def others_table(state: AdaptState) -> Markup:
    """Tabulate the scans that seem to show other people, with the differences of these from most scans."""
    rows = [
        (
            ", ".join(map(str, other.frames[:MAX_LISTED]))
            + (" and more" if len(other.frames) > MAX_LISTED else ""),
            ", ".join(f"{1000 * shift:+.1f} mm at the {name}" for name, shift in other.differences),
        )
        for other in state.others
    ]
    return table(
        "Frames, counted from 0",
        ("frames", "distance of the surface from that of the others, outwards"),
        rows,
        words=(0, 1),
    )


def variant_table(variants: tuple[Variant, ...]) -> Markup:
    """Build table 4.3 of the thesis, one row per variant.

    It adds the ninth decile, the distances from body to scan, and lost frames.
    """
    return table(
        "Distance from scanned points to the body, millimetres",
        VARIANT_COLUMNS,
        [_variant_row(v) for v in variants],
    )


def measure_notes(task: AdaptTask, stages: Evaluation) -> list[Markup]:
    """Describe the figures of the table."""
    kinds = "; ".join(f"{v.name}: {VARIANTS[v.name]}" for v in stages.variants if v.name in VARIANTS)
    points = int(stages.variants[0].scan_to_body.counts.sum())
    frames = f"{len(stages.measured_frames)} of {task.num_frames} frames were measured, with {points:,} points in total."
    notes = (
        f"{kinds[:1].upper()}{kinds[1:]}.",
        f"{frames} Lost frames are included. {NOISE_NOTE}",
        MEASURES_NOTE,
    )
    return [element("p", note, class_="soft") for note in notes]


def history_table(history: Sequence[tuple[str, float]], terms: Sequence[Terms]) -> Markup:
    """Tabulate the figures of `history_chart`, and the other terms of the objective as root mean squares."""
    rows = []
    for (name, distance), values in zip(history, terms, strict=True):
        lengths = [1000 * np.sqrt(value) for value in (values.shape, values.symmetry)]
        shake = np.degrees(np.sqrt(values.temporal))
        rows.append(
            [name, f"{distance:.2f}", f"{values.pose:.3g}", f"{shake:.2f}", *(f"{v:.2f}" for v in lengths)]
        )
    return table("Terms of the objective after every stage", TERM_COLUMNS, rows)


def settings_table(task: AdaptTask, settings: Mapping[str, object]) -> Markup:
    """Tabulate options and versions."""
    rows = [
        [name.replace("_", " "), "not given" if value is None else str(value)]
        for name, value in settings.items()
    ]
    rows += [
        ["number of scans", str(task.num_frames)],
        ["vertices of the body", str(len(task.template.vertices))],
    ]
    rows += [["joints of the body", str(task.template.skeleton.num_joints)]]
    rows += [[name, _version(name)] for name in PACKAGES] + [["Python", platform.python_version()]]
    return table("Options and versions", ["option", "value"], rows, words=(1,))


def _variant_row(variant: Variant) -> list[str]:
    summary = summarise(variant.scan_to_body)
    distances = [summary.mean, summary.sd, summary.median, summary.mad, summary.iqr]
    distances += [quantile(variant.scan_to_body, 0.9), quantile(variant.body_to_scan, 0.5)]
    return [variant.name, *(f"{1000 * x:.2f}" for x in distances), str(len(variant.lost))]


def _height(body: Body) -> float:
    """Compute the height of a body, metres; y is up."""
    return float(np.ptp(np.asarray(body.vertices, float)[:, 1]))


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"
