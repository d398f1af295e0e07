"""Pieces of the library to profile, each as a function without arguments, on data made beforehand."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

import jaxcap as jc
from benchmarks._scenes import NOISE, human_motion, scan_motion, shared_folder
from benchmarks.adaptation.adapt_people import ACTORS, TAKES, first_pose, make_actor, scan_actor
from benchmarks.learning._learning import learn, make_synthetic_meshes
from benchmarks.markers._markers import MarkerNoise, make_scene
from jaxcap.adapt.adapt_body import adapt_body
from jaxcap.adapt.prepare import make_adapt_task
from jaxcap.adapt.task import AdaptSettings
from jaxcap.markers.calibration.calibrate import calibrate
from jaxcap.markers.motion.inverse_kinematics import solve_markers

TAKE = "02_05"


class Stage(NamedTuple):
    """A piece of the library with its data."""

    run: Callable[[], Any]
    #: what is done, and how often in one run
    unit: str
    count: int


def make_frames(small: bool) -> Stage:
    """Prepare tracking of frames of 5,000 points with a body of 5,000 vertices."""
    count = 5 if small else 30
    subject, body = jc.human(), jc.human(resolution="medium")
    motion, starts = (human_motion(shared_folder(), TAKE, person, count) for person in (subject, body))
    clouds = [scan.cloud for scan in scan_motion(subject, motion, NOISE)]
    tracker, start = jc.make_tracker(body), starts[0]
    return Stage(
        lambda: [frame.pose for frame in jc.fit.track_frames(tracker, clouds, start=start)],
        "tracked frame",
        count,
    )


def make_first_frame(small: bool) -> Stage:
    """Prepare the search for the first pose, without a start."""
    subject, body = jc.human(), jc.human(resolution="low" if small else "medium")
    (scan,) = scan_motion(subject, human_motion(shared_folder(), TAKE, subject, 1), NOISE)
    tracker = jc.make_tracker(body)
    return Stage(lambda: next(jc.fit.track_frames(tracker, [scan.cloud], search=True)).pose, "first frame", 1)


def make_adaptation(small: bool) -> Stage:
    """Prepare a short adaptation to scans of another person."""
    count = 4 if small else 8
    body = jc.human(joints="tracking", resolution="low" if small else "medium")
    actor = make_actor(ACTORS[0])
    motion = human_motion(shared_folder(), TAKES[0], actor.body, count)
    clouds, start = scan_actor(actor.body, motion, "a"), first_pose(motion, actor.body, body, "given")
    settings = AdaptSettings(num_frames=count, proportion_rounds=2, rounds=(2, 2))

    def run() -> Any:
        *_, state = adapt_body(make_adapt_task(body, clouds, start=start, settings=settings))
        return state.motion.poses

    return Stage(run, "adaptation to a scan", count)


def make_calibration(small: bool) -> Stage:
    """Prepare the calibration of a subject from 100 frames of 60 markers."""
    scene = make_scene(shared_folder(), TAKE, MarkerNoise(gaps=0.05), frames=200)
    frames = scene.frames[np.linspace(0, 199, 20 if small else 100).round().astype(int)]
    return Stage(lambda: calibrate(frames, scene.template).subject.offsets, "calibration", 1)


def make_marker_frames(small: bool) -> Stage:
    """Prepare inverse kinematics of 60 markers."""
    count = 50 if small else 1000
    scene = make_scene(shared_folder(), TAKE, MarkerNoise(gaps=0.05), frames=count)
    return Stage(
        lambda: solve_markers(scene.truth, scene.frames).motion.poses, "frame of markers", len(scene.frames)
    )


def make_learning(small: bool) -> Stage:
    """Prepare two rounds of learning a body from registered meshes."""
    meshes, vertices, joints = (4, 300, 3) if small else (20, 2000, 12)
    scene = make_synthetic_meshes(shared_folder(), training=meshes, held_out=1, resolution=vertices)
    return Stage(
        lambda: learn(scene.training, joints=joints, rounds=2).body.vertices, "two rounds of learning", 1
    )


STAGES = {
    "frame": make_frames,
    "first_frame": make_first_frame,
    "markers": make_marker_frames,
    "calibration": make_calibration,
    "adaptation": make_adaptation,
    "learning": make_learning,
}
