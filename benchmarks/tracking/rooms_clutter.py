"""Track people in clouds with a floor, a wall, or both, against the same clouds without them.

    python -m benchmarks.rooms_clutter
    python -m benchmarks.rooms_clutter --takes 02_05 --frames 30 --picture rooms.png

A floor has 30 % of the points of a cloud, a wall behind the person 30 %, with the noise of the other points. The embedded
human and a small woman, each tracked with a coarser mesh of the same build, perform CMU's takes. Floor and wall do not
move. The tracker gets no data about them. `--keep-planes` tracks the clouds as they are. Run it from the root of the checkout.
"""

import argparse
import time
from pathlib import Path

import equinox as eqx
import numpy as np

import jaxcap as jc
from benchmarks._scenes import NOISE, human_motion, scan_motion, shared_folder
from benchmarks.report import finish, progress
from jaxcap.metrics import joint_errors, scan_to_surface
from jaxcap.report.distance_pictures import FrameView, draw_views

TAKES = ("02_05", "02_07", "01_01")
BUILDS = {"average": {}, "small_woman": {"sex": "female", "height": 1.55}}
SCENES = ("clean", "floor", "wall", "both")
#: share of the points of a cloud on each plane; sides of a plane, and the gap between wall and person, metres
SHARE, SIDE, GAP = 0.3, 3.0, 0.3
#: mean joint error of a frame above which it is lost, millimetres
LOST = 60.0

_posed = eqx.filter_jit(jc.pose_body)


def clutter(cloud: jc.Cloud, scene: str, low: np.ndarray, rng: np.random.Generator) -> jc.Cloud:
    """Add the planes of a scene to a cloud; `low` is the lowest corner of the person's box in the whole motion."""
    real = np.asarray(cloud.weights) > 0
    points, normals = [np.asarray(cloud.points)[real]], [np.asarray(cloud.normals)[real]]
    names = {"clean": (), "floor": ("floor",), "wall": ("wall",), "both": ("floor", "wall")}[scene]
    middle = points[0].mean(0)
    count = round(SHARE / (1 - SHARE * len(names)) * len(points[0]))
    for name in names:
        axis = 1 if name == "floor" else 2
        plane = rng.uniform(-SIDE / 2, SIDE / 2, (count, 3)) + middle
        plane[:, axis] = low[axis] - (0.0 if name == "floor" else GAP)
        if name == "wall":
            plane[:, 1] = rng.uniform(low[1], low[1] + 2.4, count)
        points.append(plane + NOISE.deviation * rng.normal(size=plane.shape))
        normals.append(np.eye(3)[axis] + np.radians(NOISE.tilt) / np.sqrt(2) * rng.normal(size=plane.shape))
    return jc.make_cloud(np.concatenate(points), np.concatenate(normals))


def track(tracker: jc.fit.Tracker, clouds: list[jc.Cloud], joints: np.ndarray, keep: bool) -> dict:
    """Track one sequence; return its poses, errors in millimetres, and the frames that are reported as lost."""
    begun = time.perf_counter()
    frames = list(jc.fit.track_frames(tracker, clouds, planes=() if keep else None))
    found = np.stack([np.asarray(_posed(tracker.body, frame.pose).joints) for frame in frames])
    errors = 1000 * joint_errors(found, joints)
    wrong = errors.mean(1) > LOST
    told = np.array([frame.lost for frame in frames])
    return {
        "poses": [frame.pose for frame in frames],
        "mean_mm": float(errors.mean()),
        "lost": int((told | wrong).sum()),
        "wrong_and_good": int((wrong & np.array([frame.verdict == "good" for frame in frames])).sum()),
        "seconds": time.perf_counter() - begun,
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.rooms_clutter", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--takes", nargs="+", default=TAKES)
    parser.add_argument("--builds", nargs="+", choices=BUILDS, default=tuple(BUILDS))
    parser.add_argument("--frames", type=int, default=100, help="number of frames of each take")
    parser.add_argument("--keep-planes", action="store_true", help="do not remove floors and walls")
    parser.add_argument("--picture", type=Path, help="write a PNG of the last frames of the first take")
    options = parser.parse_args()
    shared, begun, figures, views = shared_folder(), time.perf_counter(), {}, []
    for build in options.builds:
        subject = jc.human(**BUILDS[build])
        body = jc.human(resolution="medium", **BUILDS[build])
        tracker = jc.make_tracker(body)
        for take in options.takes:
            motion = human_motion(shared, take, subject, options.frames)
            scans = scan_motion(subject, motion, NOISE, "whole")
            rest = np.asarray(subject.vertices, float)
            ends = [np.asarray(scan.joints).min(0) for scan in scans]
            low = np.min(ends, axis=0)
            # the sole is below the lowest joint
            low[1] -= float(np.asarray(subject.skeleton.centres)[:, 1].min() - rest[:, 1].min())
            for scene in SCENES:
                rng = np.random.default_rng(7)
                clouds = [clutter(scan.cloud, scene, low, rng) for scan in scans]
                joints = np.stack([scan.joints for scan in scans])
                found = track(tracker, clouds, joints, options.keep_planes)
                poses = found.pop("poses")
                figures[f"{build}_{take}_{scene}"] = found
                progress(
                    f"{build}, {take}, {scene}: {found['mean_mm']:.2f} mm, {found['lost']} lost, {found['seconds']:.0f} s"
                )
                if options.picture and build == options.builds[0] and take == options.takes[0]:
                    vertices = np.asarray(_posed(body, poses[-1]).vertices, float)
                    points = np.asarray(clouds[-1].points)[np.asarray(clouds[-1].weights) > 0].astype(float)
                    distances = scan_to_surface(points, vertices, np.asarray(body.faces))
                    middle = vertices.mean(0) * [1.0, 0.0, 1.0]
                    views.append(
                        FrameView(
                            f"{scene}: {found['mean_mm']:.1f} mm",
                            vertices - middle,
                            points - middle,
                            distances,
                        )
                    )
    if options.picture:
        draw_views(
            options.picture,
            views,
            np.asarray(jc.human(resolution="medium").faces),
            "clouds of a room, tracked",
        )
    cases = [(build, take) for build in options.builds for take in options.takes]
    for scene in SCENES[1:]:
        figures[f"{scene}_ratio"] = max(
            figures[f"{build}_{take}_{scene}"]["mean_mm"] / figures[f"{build}_{take}_clean"]["mean_mm"]
            for build, take in cases
        )
        figures[f"{scene}_lost"] = sum(figures[f"{build}_{take}_{scene}"]["lost"] for build, take in cases)
    limits = {f"{scene}_ratio": ("<=", 1.2) for scene in SCENES[1:]} | {
        f"{scene}_lost": ("==", 0) for scene in SCENES[1:]
    }
    finish(
        "rooms_clutter",
        figures,
        limits,
        {"frames": options.frames, "cases": len(cases)},
        {"run": time.perf_counter() - begun},
    )


if __name__ == "__main__":
    main()
