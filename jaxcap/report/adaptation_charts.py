"""Charts and figures of an adaptation: distances, their distribution over body and time, and joint angles
over time."""

from collections.abc import Sequence

import numpy as np

from ..adapt.evaluate import AngleHistory, Evaluation, Variant, quantile, share_below, summarise
from ..body.skeleton import Skeleton
from .chart import Line, legend, line_chart
from .heat_map import colour_scale, heat_limit, heat_pictures
from .page import Markup, element, join_markup, table
from .pictures import round_up

#: styles of the variants in their order; the last one is drawn over the one before
LINE_STYLES = ("c0", "c1", "c2", "c3 dashed")
#: bins of the histogram; number of joints with a chart; number of body parts in the table of largest
#: distances
NUM_BINS, NUM_JOINTS, NUM_PARTS = 50, 6, 12


def distance_charts(variants: Sequence[Variant]) -> Markup:
    """Plot the cumulative and the binned distribution of distances.

    The range ends at the 97 % quantile of the worst variant.
    """
    limit = round_up(1000 * max(quantile(variant.scan_to_body, 0.97) for variant in variants))
    edges = np.linspace(0.0, limit, NUM_BINS + 1)
    within = [100 * share_below(variant.scan_to_body, edges / 1000) for variant in variants]
    shares = [np.diff(share) for share in within]
    middles, width = 0.5 * (edges[1:] + edges[:-1]), edges[1]
    named = list(zip(variants, LINE_STYLES, within, shares, strict=False))
    below = [Line(variant.name, edges, share, look) for variant, look, share, _ in named]
    at = [Line(variant.name, middles, share, look) for variant, look, _, share in named]
    distance = "distance from point to body, mm"
    charts = (
        line_chart(
            "Share of scanned points within a distance of the body",
            below,
            distance,
            "points within, %",
            x_range=(0.0, limit),
            y_range=(0.0, 100.0),
        ),
        line_chart(
            "Share of scanned points by distance from the body",
            at,
            distance,
            f"points per {width:.2g} mm, %",
            x_range=(0.0, limit),
            y_range=(0.0, 1.06 * max(float(share.max()) for share in shares)),
        ),
    )
    return join_markup(legend(below), element("div", *map(_figure, charts), class_="grid"))


def heat_maps(variants: Sequence[Variant]) -> Markup:
    """Render each body from the front and the back on one colour scale, with a table by body parts."""
    heats = [1000 * variant.heat for variant in variants]
    limit = heat_limit(heats)
    pictures = heat_pictures([variant.body for variant in variants], heats, limit)
    parts = [mean_by_part(variant) for variant in variants]
    figures = []
    for variant, picture, part in zip(variants, pictures, parts, strict=True):
        mean = f"{1000 * summarise(variant.scan_to_body).mean:.1f} mm"
        worst = ", ".join(f"{name} ({value:.1f} mm)" for name, value in list(part.items())[:3])
        alt = f"Body from the front and from the back, {variant.name}: {mean} on average; largest at {worst}."
        caption = element("figcaption", element("b", variant.name), f": {mean} on average")
        figures.append(element("figure", element("img", src=picture, alt=alt), caption))
    names = list(parts[0])[:NUM_PARTS]
    rows = [[name, *(f"{part[name]:.1f}" if name in part else "–" for part in parts)] for name in names]
    by_part = table(
        "Mean distance by part of the body, millimetres; the parts with the largest initial distances",
        ["part", *(variant.name for variant in variants)],
        rows,
    )
    scale = colour_scale(limit, "millimetres", "Grey: nearest to no scanned point.")
    grid = element("div", *figures, class_="grid")
    return join_markup(grid, scale, element("details", element("summary", "The same as a table"), by_part))


def mean_by_part(variant: Variant) -> dict[str, float]:
    """Average the heat over the scanned vertices of each bone, millimetres; the largest first."""
    bones, known = np.asarray(variant.body.skin.dominant_bones()), np.isfinite(variant.heat)
    means = {
        name: 1000 * float(variant.heat[known & (bones == number)].mean())
        for number, name in enumerate(variant.body.skeleton.names)
        if (known & (bones == number)).any()
    }
    return dict(sorted(means.items(), key=lambda item: -item[1]))


def frame_chart(stages: Evaluation, rate: float) -> Markup:
    """Plot the median distance of every measured frame."""
    seconds = np.array(stages.measured_frames) / rate
    lines = [
        Line(variant.name, seconds, 1000 * variant.frame_medians, look)
        for variant, look in zip(stages.variants, LINE_STYLES, strict=False)
    ]
    high = 1.06 * max(float(line.y.max()) for line in lines)
    chart = line_chart(
        "Median distance from scan to body over time",
        lines,
        "seconds",
        "median distance, mm",
        y_range=(0.0, high),
    )
    return join_markup(legend(lines), element("figure", chart, class_="single"))


def angle_charts(angles: AngleHistory, skeleton: Skeleton) -> Markup:
    """Plot the angles of the joints that move most, before and after smoothing."""
    shown = moving_joints(angles, skeleton)
    figures, looks = [], []
    for joint in shown:
        looks = [Line("independent frames", angles.seconds, np.degrees(angles.before[:, joint]), "c0 thin")]
        if angles.after is not None:
            looks.append(Line("smoothed", angles.seconds, np.degrees(angles.after[:, joint]), "c3"))
        name = skeleton.names[joint]
        chart = line_chart(f"Angle of {name} over time", looks, "seconds", "degrees")
        figures.append(_figure(chart, name))
    return join_markup(legend(looks), element("div", *figures, class_="grid"))


def jitter_table(angles: AngleHistory, skeleton: Skeleton) -> Markup:
    """Tabulate the angle ranges of the shown joints, and the deviations of frames from the mean of their
    neighbours."""
    final = angles.before if angles.after is None else angles.after
    rows = []
    for joint in moving_joints(angles, skeleton):
        turned = np.degrees(np.ptp(final[:, joint]))
        rows.append([skeleton.names[joint], f"{turned:.0f}", *_jitter_cells(angles, [joint])])
    rows.append(["all joints", "", *_jitter_cells(angles, list(range(skeleton.num_joints)))])
    head = ["joint", "range of its angle", "jitter, independent frames"]
    return table(
        "Joints with the largest rotations, degrees",
        head if angles.after is None else [*head, "jitter, smoothed"],
        rows,
    )


def moving_joints(angles: AngleHistory, skeleton: Skeleton) -> list[int]:
    """Find the joints whose angles vary most, in descending order, without the root."""
    final = angles.before if angles.after is None else angles.after
    turning = [
        joint
        for joint, (kind, parent) in enumerate(zip(skeleton.kinds, skeleton.parents, strict=True))
        if kind not in ("fixed", "translate") and parent >= 0
    ]
    spread = np.std(final, axis=0)
    return sorted(turning, key=lambda joint: -spread[joint])[:NUM_JOINTS]


def history_chart(history: Sequence[tuple[str, float]]) -> Markup:
    """Plot the distance after every stage."""
    values = np.array([value for _, value in history])
    line = Line("root mean square", np.arange(1.0, len(values) + 1), values, "c2")
    high = 1.06 * float(values.max())
    chart = line_chart(
        "Distance after every stage", [line], "stage", "pair distance, mm", y_range=(0.0, high)
    )
    return element("figure", chart, class_="single")


def _jitter_cells(angles: AngleHistory, joints: Sequence[int]) -> list[str]:
    """Compute root mean squares over joints, before and after smoothing."""
    both = [shake for shake in (angles.roughness_before, angles.roughness_after) if shake is not None]
    return [f"{np.degrees(np.sqrt(np.mean(shake[list(joints)] ** 2))):.2f}" for shake in both]


def _figure(chart: Markup, caption: str | None = None) -> Markup:
    captions = [] if caption is None else [element("figcaption", element("b", caption))]
    return element("figure", *captions, chart)
