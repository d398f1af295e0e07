"""Figures of a skeleton with its markers, and of the residual of each marker."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...body.pose import Motion
from ...io.system.atomic import atomic_path
from ...markers.motion.gap_filling import joint_frames, predicted_positions
from ...markers.motion.label_matching import match_markers
from ...markers.subject import Subject
from ...observe.markers import MarkerFrames
from ..pictures import new_figure, round_up
from ..render import INK, PAPER, distinct_colours, set_frame

#: frames in a picture; largest number of columns for frames; largest number of labelled markers
NUM_FRAMES, MAX_COLUMNS, MAX_LABELS = 3, 1200, 150
#: height of the three views, inches
HEIGHT = 12.6
#: colours of a marker on no bone, and of missing observations
LOOSE_COLOUR, MISSING_COLOUR = "#9aa5b1", (0.80, 0.80, 0.80)
#: columns of the legend of bones
LEGEND_COLUMNS = 8
RESIDUAL_COLOURS = ("#12355b", "#1c7293", "#4fb286", "#f2c14e", "#f2803c", "#c81d25")
#: z is up if this share of the longest side or more lies along it, as in most laboratories
MIN_UP_SHARE = 0.8


def draw_skeleton(
    path: str | Path,
    subject: Subject,
    motion: Motion,
    frames: MarkerFrames,
    residuals: Float[np.ndarray, "F M"],
    title: str,
) -> None:
    """Write a PNG of some frames from the front and, below, from the side and from above.

    Bones go from joint to joint, and to the markers at a limb's end. Observed markers are dots in the colour
    of their bone; crosses are their positions predicted by the subject.

    **Raises:** `InputError` if the file cannot be written.
    """
    matched = match_markers(subject, frames)
    seen, positions = np.asarray(matched.seen), np.asarray(matched.positions, float)
    shown = _choose_frames(seen, residuals)
    some = Motion(_take_poses(motion.poses, shown), motion.rate)
    joints = np.asarray(joint_frames(subject.skeleton, some).positions, float)
    expected = np.asarray(predicted_positions(subject, some), float)
    attached, bones = np.asarray(subject.weights) > 0, np.asarray(subject.bones)
    palette = distinct_colours(subject.skeleton.num_joints)
    axes = upright_view(positions[shown], seen[shown])
    middles = [_centre(positions[f, seen[f]], joints[i]) for i, f in enumerate(shown)]
    views = [axes, np.array([-axes[2], axes[1], axes[0]]), np.array([axes[0], -axes[2], axes[1]])]
    legend = 0.2 * -(-subject.skeleton.num_joints // LEGEND_COLUMNS)
    canvas, figure = new_figure(3.9 * len(shown) + 0.4, HEIGHT + legend)
    plots = figure.subplots(len(views), len(shown), squeeze=False)
    for row, view in enumerate(views):
        # the frame ignores loose markers, which may be far from the body
        reach = np.concatenate([(joints[i] - middles[i]) @ view.T for i in range(len(shown))]
                               + [(expected[i, attached] - middles[i]) @ view.T for i in range(len(shown))])  # fmt: skip
        low, high = reach.min(0)[:2], reach.max(0)[:2]
        for column, f in enumerate(shown):
            plot = plots[row, column]
            at = lambda x, c=column, v=view: ((x - middles[c]) @ v.T)[..., :2]  # noqa: E731
            _draw_bones(plot, subject, at(joints[column]), at(expected[column]), palette)
            there = seen[f]
            colours = np.where(attached[:, None], palette[bones], _rgb(LOOSE_COLOUR))
            xy = at(positions[f])
            plot.scatter(*xy[there].T, s=17, c=colours[there], edgecolors=INK, linewidths=0.35, zorder=4)
            cross = at(expected[column])[attached]
            plot.scatter(*cross.T, s=11, c=INK, marker="+", linewidths=0.5, zorder=5)
            own = residuals[f][np.isfinite(residuals[f])]
            off = f", {1e3 * np.sqrt(np.mean(own**2)):.1f} mm rms" if len(own) else ""
            set_frame(plot, low, high, f"frame {f}{off}" if row == 0 else "")
    figure.suptitle(_escape_dollars(title), fontsize=12, color=INK, y=0.985)
    figure.text(
        0.5,
        0.1 / (HEIGHT + legend),
        "dots: observed markers, in the colour of their bone (grey: on no bone); crosses: predicted positions; "
        "rows: from the front, from the side, from above",
        ha="center",
        fontsize=7.5,
        color=INK,
        wrap=True,
    )
    _add_bone_legend(figure, subject, palette, 0.3 / (HEIGHT + legend))
    bottom = (0.45 + legend) / (HEIGHT + legend)
    figure.subplots_adjust(left=0.01, right=0.99, top=0.92, bottom=bottom, wspace=0.02, hspace=0.04)
    with atomic_path(path) as beside:
        canvas.print_png(beside)


def draw_residuals(
    path: str | Path, subject: Subject, residuals: Float[np.ndarray, "F M"], rate: float, title: str
) -> None:
    """Write a PNG of marker residuals over time, one row per marker, ordered by bone.

    Colours are the residuals, and bars their root mean squares. If frames share a column, the largest
    residual is drawn.

    **Raises:** `InputError` if the file cannot be written.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    held = np.flatnonzero((np.asarray(subject.weights) > 0) & np.isfinite(residuals).any(0))
    if not len(held):
        held = np.arange(0)
    bones = np.asarray(subject.bones)
    order = held[np.argsort(bones[held], kind="stable")]
    values = 1e3 * residuals[:, order]
    count, rows = len(order), min(max(len(order), 4), MAX_LABELS)
    figures = values[np.isfinite(values)]
    top = round_up(float(np.quantile(figures, 0.99))) if len(figures) else 1.0
    heat, scale = LinearSegmentedColormap.from_list("residual", RESIDUAL_COLOURS), Normalize(0.0, top)
    parts = np.linspace(0, len(values), min(MAX_COLUMNS, len(values)) + 1).astype(int)[:-1]
    worst = np.maximum.reduceat(np.where(np.isfinite(values), values, -1.0), parts, axis=0).T
    paint = np.where(worst[..., None] < 0, MISSING_COLOUR, heat(scale(worst))[..., :3])
    canvas, figure = new_figure(12.5, 0.155 * rows + 1.6)
    height = figure.get_figheight()
    bottom, tall = 1.15 / height, (0.155 * rows) / height
    plot = figure.add_axes((0.15, bottom, 0.60, tall))
    if count:
        plot.imshow(paint, aspect="auto", interpolation="nearest",
                    extent=(0, len(residuals) / rate, count - 0.5, -0.5))  # fmt: skip
    step = max(-(-count // MAX_LABELS), 1)
    labels = [
        f"{_escape_dollars(subject.labels[m])}  ({_escape_dollars(subject.skeleton.names[bones[m]])})"
        for m in order[::step]
    ]
    plot.set_yticks(range(0, count, step), labels, fontsize=6, color=INK)
    for edge in np.flatnonzero(np.diff(bones[order])) + 0.5:
        plot.axhline(edge, color=PAPER, linewidth=0.9)
    plot.set_xlabel("seconds", fontsize=9, color=INK)
    bars = figure.add_axes((0.765, bottom, 0.215, tall))
    some = np.isfinite(values)
    rms = np.sqrt(np.where(some, values**2, 0.0).sum(0) / np.maximum(some.sum(0), 1))
    bars.barh(range(count), rms, color=heat(scale(rms)), height=0.8)
    for row, value in enumerate(rms):
        bars.text(value, row, f" {value:.1f}", va="center", fontsize=5.5, color=INK)
    bars.set(ylim=(count - 0.5, -0.5), yticks=[], xlim=(0, 1.18 * max(float(rms.max(initial=0.0)), 1e-3)))
    bars.set_xlabel("root mean square, millimetres", fontsize=9, color=INK)
    for one in (plot, bars):
        one.tick_params(axis="x", labelsize=8, colors=INK)
        one.tick_params(axis="y", length=0)
        for side in one.spines.values():
            side.set_visible(False)
    place = figure.add_axes((0.15, 0.42 / height, 0.3, 0.1 / height))
    bar = figure.colorbar(ScalarMappable(scale, heat), cax=place, orientation="horizontal", extend="max")
    bar.set_label("distance of the observed from the predicted position, millimetres (grey: not observed)", fontsize=7.5, color=INK)  # fmt: skip
    bar.ax.tick_params(labelsize=7, colors=INK, length=2)
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    whole = (
        f": {np.sqrt(np.mean(figures**2)):.2f} mm rms, median {np.median(figures):.2f} mm"
        if len(figures)
        else ""
    )
    figure.suptitle(f"{_escape_dollars(title)}{whole}", fontsize=11, color=INK, y=1 - 0.12 / height)
    with atomic_path(path) as beside:
        canvas.print_png(beside)


def upright_view(positions: Float[np.ndarray, "F M 3"], seen: np.ndarray) -> Float[np.ndarray, "3 3"]:
    """Choose a view of a body from its front or back: rows are right, up and towards the eye.

    Up is the axis of the markers' largest extent in a frame, or z if its extent is hardly less. Right is the
    horizontal direction of the markers' largest variance.
    """
    sides = np.median([np.ptp(x[s], axis=0) for x, s in zip(positions, seen, strict=True) if s.any()], axis=0)
    up = 2 if sides[2] > MIN_UP_SHARE * sides.max() else int(np.argmax(sides))
    flat = np.concatenate([x[s] - x[s].mean(0) for x, s in zip(positions, seen, strict=True) if s.any()])
    flat[:, up] = 0.0
    right = np.linalg.eigh(flat.T @ flat)[1][:, -1]
    right *= np.sign(right[np.argmax(np.abs(right))])
    axes = np.zeros((3, 3))
    axes[0], axes[1, up] = right, 1.0
    axes[2] = np.cross(axes[0], axes[1])
    return axes


def _draw_bones(
    plot: Any, subject: Subject, joints: np.ndarray, markers: np.ndarray, palette: np.ndarray
) -> None:
    skeleton = subject.skeleton
    attached, bones = np.asarray(subject.weights) > 0, np.asarray(subject.bones)
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            line = joints[[parent, joint]]
            plot.plot(*line.T, color=palette[parent], linewidth=3.2, solid_capstyle="round", zorder=2)
        own = markers[attached & (bones == joint)]
        for place in own:
            plot.plot(
                *np.stack([joints[joint], place]).T, color=palette[joint], linewidth=0.5, alpha=0.6, zorder=1
            )
        if joint not in skeleton.parents and len(own):
            line = np.stack([joints[joint], own.mean(0)])
            plot.plot(*line.T, color=palette[joint], linewidth=3.2, solid_capstyle="round", zorder=2)
    plot.scatter(*joints.T, s=30, c="white", edgecolors=INK, linewidths=1.0, zorder=3)


def _add_bone_legend(figure: Any, subject: Subject, palette: np.ndarray, bottom: float) -> None:
    """Add a legend of the colour of each bone below the views."""
    from matplotlib.lines import Line2D

    names = subject.skeleton.names
    lines = [
        Line2D([], [], color=colour, linewidth=3.2, label=_escape_dollars(name))
        for name, colour in zip(names, palette, strict=True)
    ]
    figure.legend(
        handles=lines, loc="lower center", bbox_to_anchor=(0.5, bottom), ncols=min(LEGEND_COLUMNS, len(names)),
        fontsize=7, labelcolor=INK, frameon=False, handlelength=1.4, borderpad=0, labelspacing=0.3,
    )  # fmt: skip


def _choose_frames(seen: np.ndarray, residuals: np.ndarray) -> list[int]:
    """Choose the frames with most markers in each third, the middle one of equals."""
    counts = np.isfinite(residuals).sum(1)
    shown = counts if counts.any() else seen.sum(1)
    chosen = []
    for part in np.array_split(np.arange(len(seen)), min(NUM_FRAMES, len(seen))):
        best = part[shown[part] == shown[part].max()]
        chosen.append(int(best[len(best) // 2]))
    return chosen


def _take_poses(poses, rows: list[int]):
    return type(poses)(*(leaf[np.array(rows)] for leaf in (poses.translations, poses.rotations, poses.scale)))


def _centre(positions: np.ndarray, joints: np.ndarray) -> np.ndarray:
    both = np.concatenate([positions, joints]) if len(positions) else joints
    return 0.5 * (both.min(0) + both.max(0))


def _rgb(colour: str) -> np.ndarray:
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255


def _escape_dollars(text: str) -> str:
    """Escape dollar signs, which would begin a formula."""
    return text.replace("$", r"\$")
