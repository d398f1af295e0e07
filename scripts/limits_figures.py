"""Draw the pictures of tracking and depth frames with learned limits.

    python -m scripts.limits_figures
    python -m scripts.limits_figures --folder /tmp --frames 120

Run it from the root of the checkout; the captures lie where the benchmarks look for them. The upper arm,
forearm and hand are painted in two colours, on either side of the plane in which the elbow bends, so that
their twist shows.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

import jaxcap as jc
from benchmarks._scenes import shared_folder, takes_of
from benchmarks.limits._depth import FOCAL, depth_frames, fit_frames
from benchmarks.limits._stereo import ARM, descendants, simulate_arm
from benchmarks.limits.limits_track import (
    LIMITED_JOINTS,
    TAKES,
    arm_pairs,
    compare,
    learn_from,
    make_contenders,
    with_arm,
)
from jaxcap.geometry import rotation
from jaxcap.report.pictures import new_figure
from jaxcap.report.render import CLAY, INK, draw_surface, rotate_view, set_frame

ASSETS = Path(__file__).resolve().parents[1] / "assets"
#: the take that is drawn, and how many of its frames
TAKE, SHOWN = "02_08", 6
#: what the rows show
ROWS = {"truth": "ground truth and points", "none": "without limits", "energy": "with limits"}
DOT = "#1c7293"
SIDES = np.array([[0.95, 0.60, 0.25], [0.45, 0.65, 0.85]])
#: degrees that the eye stands to the person's right
SIDE = 35.0


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--folder", type=Path, default=ASSETS)
    parser.add_argument("--frames", type=int, help="number of frames to track")
    parser.add_argument("--only", choices=("track", "depth"))
    options = parser.parse_args()
    if options.only != "depth":
        draw_tracking(options.folder / "limits_track.png", options.frames)
    if options.only != "track":
        draw_depth(options.folder / "limits_depth.png")


def draw_tracking(path: Path, frames: int | None) -> None:
    """Draw frames evenly spread over a take: ground truth, without limits, and with limits."""
    shared, body = shared_folder(), jc.human(resolution="low", joints="tracking")
    learned = [take for take in takes_of(shared, "01") + takes_of(shared, "02") if take not in TAKES]
    limits = learn_from(shared, learned, body, arm_pairs())
    seen = simulate_arm(shared, (TAKE,), body, frames)
    contenders = make_contenders(body, limits)
    found = compare({name: contenders[name] for name in ("none", "energy")}, body, seen, 0)
    poses = {"truth": seen.truth} | {
        name: with_arm(body.skeleton, seen.truth, outcome.rotations) for name, outcome in found.items()
    }
    shown = np.linspace(0, len(seen.first) - 1, SHOWN + 1).astype(int)[1:]
    view, colours = rotate_view(np.eye(3), SIDE), arm_colours(body)
    canvas, figure = new_figure(1.9 * SHOWN, 5.6)
    plots = figure.subplots(len(ROWS), SHOWN)
    for row, (name, label) in zip(plots, ROWS.items(), strict=True):
        for plot, number in zip(row, shown, strict=True):
            pose = jc.Pose(
                poses[name].translations[number], poses[name].rotations[number], poses[name].scale[number]
            )
            vertices = np.asarray(jc.pose_body(body, pose).vertices, float)
            draw_surface(plot, vertices, np.asarray(body.faces), view, colours)
            title = ""
            if name == "truth":
                points = seen.points[number][seen.weights[number] > 0] @ view.T
                plot.scatter(points[:, 0], points[:, 1], s=0.8, c=DOT, linewidths=0, zorder=3)
                title = f"{number / 30:.1f} s"
            else:
                shoulder, elbow = found[name].twists[number]
                title = f"shoulder {shoulder:.0f}°, elbow {elbow:.0f}°"
            set_frame(plot, np.array([-0.75, -0.05]), np.array([0.58, 0.95]), title)
            plot.title.set_fontsize(7)
        row[0].text(
            -0.02,
            0.5,
            label,
            rotation=90,
            va="center",
            ha="right",
            transform=row[0].transAxes,
            fontsize=8,
            color=INK,
        )
    figure.suptitle(f"CMU {TAKE}: twist errors of shoulder and elbow", fontsize=9, color=INK)
    figure.subplots_adjust(left=0.04, right=0.99, top=0.91, bottom=0.01, wspace=0.03, hspace=0.12)
    canvas.print_png(path)
    sys.stderr.write(f"written: {path}\n")


def arm_colours(body: jc.Body) -> np.ndarray:
    """Make vertex colours `(V, 3)`: two on the right arm, clay elsewhere."""
    skeleton, vertices = body.skeleton, np.asarray(body.vertices, float)
    parts = np.asarray(body.skin.dominant_bones())
    colours = np.tile(CLAY, (len(vertices), 1))
    for joint in ARM:
        j = skeleton.index(joint)
        inside = descendants(skeleton, joint)[parts]
        across = np.asarray(rotation.to_matrix(skeleton.orientations[j]), float)[:, 1]
        side = (vertices - np.asarray(skeleton.centres[j], float)) @ across > 0
        colours[inside] = SIDES[side[inside].astype(int)]
    return colours


def draw_depth(path: Path) -> None:
    """Draw the points of every frame, and the fitted body, from the camera's position."""
    shared, body = shared_folder(), jc.human(resolution="low", joints="tracking")
    limits = learn_from(shared, takes_of(shared, "01") + takes_of(shared, "02"), body, LIMITED_JOINTS)
    fitted = fit_frames(depth_frames(shared), limits)
    canvas, figure = new_figure(10.0, 6.6)
    plots = figure.subplots(3, 4).reshape(-1)
    view = np.eye(3)
    for number, (plot, one) in enumerate(zip(plots, fitted, strict=True)):
        points = np.asarray(one.cloud.points, float)[np.asarray(one.cloud.weights) > 0]
        middle = np.median(points, 0)
        vertices = np.asarray(jc.pose_body(body, one.pose).vertices, float) - middle
        apart = np.array([1.3, 0.0])
        draw_surface(plot, vertices, np.asarray(body.faces), view)
        seen = (points - middle)[:, :2] - apart
        plot.scatter(seen[:, 0], seen[:, 1], s=0.5, c=DOT, linewidths=0, rasterized=True)
        valid = "valid" if one.valid.all() else "not valid"
        title = f"{number + 1}: {valid}, {one.distance_mm:.0f} mm"
        set_frame(plot, np.array([-2.0, -0.55]), np.array([0.7, 0.75]), title)
        plot.title.set_fontsize(8)
    figure.suptitle(
        f"Twelve frames of a depth camera (focal length {FOCAL:.0f} pixels) and the fitted poses",
        fontsize=9,
        color=INK,
    )
    figure.subplots_adjust(left=0.01, right=0.99, top=0.9, bottom=0.01, wspace=0.02, hspace=0.12)
    canvas.print_png(path)
    sys.stderr.write(f"written: {path}\n")


if __name__ == "__main__":
    main()
