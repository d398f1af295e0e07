"""Draw `assets/tracking.webp`, the moving picture of the README: a crane's steps, scanned and tracked.

    python -m scripts.tracking_picture
    python -m scripts.tracking_picture --every 20 --folder out

What the subject of the crane capture did (Vlasic et al. 2008) is tracked and given to the embedded human, whose
surface is in the public domain. Virtual depth cameras see that with noise; left what they saw, right another mesh of
the human in the poses found. The frames from `FIRST` on end nearly as they begin, so that the picture goes round; it is
drawn for a white page.
"""

import argparse
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float
from PIL import Image

import jaxcap as jc
from benchmarks._crane import frame_cloud, load_crane, rig_crane
from benchmarks._scenes import shared_folder
from jaxcap.metrics import joint_errors
from jaxcap.report.pictures import new_figure
from jaxcap.report.render import INK, draw_surface, rotate_view

ASSETS = Path(__file__).resolve().parents[1] / "assets"
FIRST, RATE = 88, 30
SCANNER = jc.scanner.Scanner(points=5000, noise=0.008, flying=0.3)
#: metres around the subject that are shown, to the side and up
REACH, LOW, HIGH = 0.88, -0.1, 1.98
#: inches of one half, and pixels of the whole
WIDE, HEIGHT, PIXELS = 3.6, 4.6, 680
SKIN = np.array([0.56, 0.71, 0.86])
FAR, NEAR = np.array([0.80, 0.84, 0.88]), np.array([0.10, 0.25, 0.42])
BONE, SHADOW = "#d7473d", "#e9ecef"
#: the eye is above the subject and the light falls from the upper left, degrees and metres a metre of height
TURN, TILT, LIGHT_SLOPE = 24.0, 8.0, (0.35, -0.25)

_posed = eqx.filter_jit(jc.pose_body)


class DrawnFrame(NamedTuple):
    """The input and the result of one frame, metres."""

    points: Float[np.ndarray, "N 3"]
    vertices: Float[np.ndarray, "V 3"]
    joints: Float[np.ndarray, "J 3"]


def main() -> None:
    """Scan, track, draw."""
    parser = argparse.ArgumentParser(
        prog="python -m scripts.tracking_picture", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--every", type=int, default=1, help="draw every n-th frame only")
    parser.add_argument("--folder", type=Path, default=ASSETS)
    options = parser.parse_args()

    actor, body = jc.human(), jc.human(resolution="medium", joints="tracking")
    performance = perform(actor.skeleton)
    parents, faces = body.skeleton.parents, np.asarray(body.faces)
    frames = list(follow(actor, performance, body))
    truth = np.array([_posed(actor, performance[number]).joints for number in range(performance.num_frames)])
    errors = joint_errors(np.array([shown.joints for shown in frames]), truth)
    sys.stderr.write(f"mean joint error: {1000 * errors.mean():.1f} mm\n")

    pictures = [draw(shown, faces, parents) for shown in frames[:: options.every]]
    path = options.folder / "tracking.webp"
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        beside = Path(folder) / path.name
        pictures[0].save(
            beside,
            save_all=True,
            append_images=pictures[1:],
            duration=round(1000 * options.every / RATE),
            loop=0,
            quality=50,
            method=6,
        )
        os.replace(beside, path)
    sys.stderr.write(f"{path}: {len(pictures)} frames, {path.stat().st_size / 1e6:.2f} MB\n")


def perform(skeleton: jc.Skeleton) -> jc.Motion:
    """Retarget the capture from `FIRST` on to a human skeleton."""
    crane = load_crane(shared_folder())
    body = rig_crane(crane)
    motion = jc.track(body, [frame_cloud(crane, number) for number in range(len(crane.frames))])
    return jc.retarget(motion, body.skeleton, skeleton).slice(slice(FIRST, None))


def follow(actor: jc.Body, performance: jc.Motion, body: jc.Body) -> Iterator[DrawnFrame]:
    """Track an actor in simulated scans with a body."""
    surfaces = [
        np.asarray(_posed(actor, performance[n]).vertices, float) for n in range(performance.num_frames)
    ]
    middle = np.mean(surfaces, (0, 1))
    cameras = jc.geometry.ring_of_cameras(6, 360, 3.2, middle[1] + 0.4, middle, (240, 240), 50)
    scans = [
        jc.scanner.scan_frame(SCANNER, cameras, vertices, np.asarray(actor.faces), frame=number)
        for number, vertices in enumerate(surfaces)
    ]
    clouds = (jc.make_cloud(scan.points, scan.normals) for scan in scans)
    for scan, tracked in zip(
        scans, jc.fit.track_frames(jc.make_tracker(body), clouds, search=True), strict=True
    ):
        posed = _posed(body, tracked.pose)
        yield DrawnFrame(scan.points, np.asarray(posed.vertices, float), np.asarray(posed.joints, float))


def draw(shown: DrawnFrame, faces: np.ndarray, parents: tuple[int, ...]) -> Image.Image:
    """Draw both halves side by side, centred at the subject."""
    view = raise_view(rotate_view(np.eye(3), TURN), TILT)
    # the floor goes with the lower foot
    centre = [shown.vertices[:, 0].mean(), shown.vertices[:, 1].min(), shown.vertices[:, 2].mean()]
    points, vertices, joints = shown.points - centre, shown.vertices - centre, shown.joints - centre
    canvas, figure = new_figure(2 * WIDE, HEIGHT)
    left, right = figure.subplots(1, 2)
    figure.subplots_adjust(left=0, right=1, bottom=0, top=1, wspace=0)
    for plot, title in (
        (left, "input: points of depth cameras"),
        (right, "output: a pose of the skeleton in every frame"),
    ):
        plot.set(xlim=(-REACH, REACH), ylim=(LOW, LOW + 2 * REACH * HEIGHT / WIDE), aspect="equal")
        plot.set_axis_off()
        plot.text(0.5, 0.955, title, transform=plot.transAxes, ha="center", fontsize=10.5, color=INK)
    cast_shadow(right, vertices, faces, view)
    draw_points(left, points, view)
    draw_surface(right, vertices, faces, view, SKIN)
    draw_bones(right, joints @ view.T, parents)
    canvas.draw()
    wide = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    return wide.resize((PIXELS, round(PIXELS * HEIGHT / (2 * WIDE))), Image.Resampling.LANCZOS)


def raise_view(view: Float[np.ndarray, "3 3"], degrees: float) -> Float[np.ndarray, "3 3"]:
    """Raise the viewpoint of a view."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ view


def cast_shadow(plot, vertices: np.ndarray, faces: np.ndarray, view: np.ndarray) -> None:
    """Draw the projection of the body's triangles along the light on the floor."""
    from matplotlib.collections import PolyCollection

    floor = vertices + vertices[:, 1:2] * [LIGHT_SLOPE[0], -1.0, LIGHT_SLOPE[1]]
    corners = (floor @ view.T)[faces][:, :, :2]
    plot.add_collection(PolyCollection(list(corners), facecolors=SHADOW, edgecolors=SHADOW, zorder=1))


def draw_points(plot, points: np.ndarray, view: np.ndarray) -> None:
    """Draw the cloud, with near points darker and on top."""
    seen = points @ view.T
    order = np.argsort(seen[:, 2])
    near = (seen[order, 2:] - seen[:, 2].min()) / np.ptp(seen[:, 2])
    colours = (1 - near) * FAR + near * NEAR
    plot.scatter(seen[order, 0], seen[order, 1], s=2.4, c=colours, linewidths=0, zorder=2)


def draw_bones(plot, joints: np.ndarray, parents: tuple[int, ...]) -> None:
    for joint, parent in enumerate(parents):
        if parent >= 0:
            plot.plot(
                *joints[[parent, joint], :2].T,
                color=BONE,
                lw=1.5,
                alpha=0.85,
                zorder=3,
                solid_capstyle="round",
            )
    plot.scatter(joints[:, 0], joints[:, 1], s=9, c=BONE, linewidths=0, zorder=4)


if __name__ == "__main__":
    main()
