"""Track two and three people in the same clouds: `python -m benchmarks.people_many`.

In `two_walk` two people walk past each other, with 0.6 m between the middles of their paths. In `three_walk` a third one
crosses both paths. In `handshake` two people reach out, shake their right hands, and lower them. Everyone has another build.
Four depth cameras around the scene see all people, who hide each other; their images are fused in one cloud without cameras.
The people are found in the first cloud, and no start is given. Each tracker knows the body of its person; with `--same-body`
all are the embedded human of average build instead, and nobody can be distinguished by shape; with `--fit-shape` their shapes
are first estimated from these clouds (`estimate_people_shapes`).

Each person is scanned and tracked alone, too, by the same cameras in the same motion. Joint errors are compared with those.
In `two_walk_camera`, which is not run by default, one Azure Kinect from the side sees the walk of `two_walk`: one person
hides the other one. The errors are those of visible joints.

A frame is exchanged if a tracked person is nearer to another person than to its own.
"""

import argparse
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple, get_args

import equinox as eqx
import jax
import numpy as np
from scipy.optimize import linear_sum_assignment

import jaxcap as jc
from benchmarks._scenes import shared_folder
from benchmarks.report import finish, progress
from benchmarks.tracking._people import People, Scenario, film_people, make_people, scan_people
from benchmarks.tracking._people_pictures import draw_people
from jaxcap.geometry.camera import look_at
from jaxcap.tracking.track_frame import replace_body

#: numbers of cameras, their distance from the middle of the scene and height, metres
CAMERAS, DISTANCE, HEIGHT = 4, 3.8, 1.6
#: points of one person in a cloud, on average
POINTS = 3000
#: number of frames from which shapes are estimated
SHAPE_FRAMES = 40
SCENARIOS: tuple[Scenario, ...] = ("two_walk", "three_walk", "handshake")
SCANNER = jc.scanner.Scanner(noise=0.004, edge_loss=0.5)

_pose_body = eqx.filter_jit(jc.pose_body)


class Tracked(NamedTuple):
    """The frames of one person."""

    #: (F, J, 3) metres
    joints: np.ndarray
    verdicts: list[str]
    reasons: list[tuple[str, ...]]
    poses: list[jc.Pose]


def make_trackers(
    people: People, clouds: list[jc.Cloud], options: argparse.Namespace, partial: bool
) -> list[jc.fit.Tracker]:
    """Make the tracker of each person: of the true body, of an average human, or of a human fitted to the clouds."""
    if not (options.same_body or options.fit_shape):
        return [jc.make_tracker(body, partial=partial) for body in people.bodies]
    tracker = jc.make_tracker(jc.human(joints="tracking", resolution="medium"), partial=partial)
    if options.same_body:
        return [tracker] * len(people.bodies)
    bodies = jc.adapt.estimate_people_shapes(tracker, clouds[:SHAPE_FRAMES], len(people.bodies))
    return [replace_body(tracker, body) for body in bodies]


def track_together(
    trackers: list[jc.fit.Tracker], clouds: list[jc.Cloud], same_body: bool
) -> tuple[list[Tracked], list[float]]:
    """Track all people in clouds of all; also return the seconds of each frame."""
    stream = jc.fit.track_people(trackers[0] if same_body else trackers, clouds, len(trackers))
    frames, seconds = [], []
    for number in range(len(clouds)):
        start = time.perf_counter()
        frames.append(jax.block_until_ready(next(stream)))
        seconds.append(time.perf_counter() - start)
        for k, person in enumerate(frames[-1]):
            if person.reasons:
                progress(f"frame {number}, person {k + 1}: {person.verdict}; {', '.join(person.reasons)}")
    return [collect(tracker, [frame[k] for frame in frames]) for k, tracker in enumerate(trackers)], seconds


def collect(tracker: jc.fit.Tracker, frames: list) -> Tracked:
    """Collect the frames of one person."""
    joints = [np.asarray(_pose_body(tracker.body, frame.pose).joints, float) for frame in frames]
    verdicts, reasons = [frame.verdict for frame in frames], [frame.reasons for frame in frames]
    return Tracked(np.array(joints), verdicts, reasons, [frame.pose for frame in frames])


def track_alone(tracker: jc.fit.Tracker, clouds: list[jc.Cloud]) -> Tracked:
    """Track one person in clouds of this person only."""
    return collect(tracker, list(jc.fit.track_frames(tracker, clouds, search=True)))


def match_people(tracked: list[Tracked], people: People, in_order: bool) -> list[int]:
    """Find the true person of each tracked one, by the first frame, unless they are in order."""
    if in_order:
        return list(range(len(tracked)))
    away = [[np.linalg.norm(one.joints[0] - truth[0]) for truth in people.joints] for one in tracked]
    return [int(column) for column in linear_sum_assignment(np.array(away))[1]]


def count_exchanges(tracked: list[Tracked], people: People, who: list[int]) -> int:
    """Count the frames of people who are nearer to another person than to their own."""
    count = 0
    for one, own in zip(tracked, who, strict=True):
        away = np.linalg.norm(one.joints[None] - people.joints, axis=-1).mean(-1)
        count += int(np.sum(np.argmin(away, 0) != own))
    return count


def observe(
    people: People, who: list[int], scenario: Scenario, pixels: int
) -> tuple[list[jc.Cloud], np.ndarray]:
    """Make the clouds of some people, and find the joints (K, F, J) with which poses are compared."""
    if scenario == "two_walk_camera":
        sensor = jc.scanner.SENSORS["azure-kinect"]
        eye = [DISTANCE, HEIGHT, 0.0]
        camera = look_at(eye, [0.0, 0.9, 0.0], *sensor.resolution, sensor.field_of_view)
        return film_people(people, who, camera, sensor)
    resolution = (pixels, pixels * 3 // 4)
    cameras = jc.geometry.ring_of_cameras(CAMERAS, 360, DISTANCE, HEIGHT, [0.0, 0.9, 0.0], resolution, 70.0)
    clouds = scan_people(people, who, cameras, SCANNER, POINTS)
    return clouds, np.ones((len(who), *people.joints.shape[1:3]), bool)


def run_scenario(scenario: Scenario, options: argparse.Namespace) -> tuple[dict[str, float], list[float]]:
    """Track the people of one scenario together and alone."""
    people = make_people(shared_folder(), scenario, options.frames)
    everyone = list(range(len(people.bodies)))
    progress(f"{scenario}: {len(everyone)} people, {len(people.motions[0])} frames")
    clouds, visible = observe(people, everyone, scenario, options.pixels)
    trackers = make_trackers(people, clouds, options, scenario == "two_walk_camera")
    together, seconds = track_together(trackers, clouds, options.same_body)
    who = match_people(together, people, not (options.same_body or options.fit_shape))
    if options.picture is not None:
        path = options.picture.with_name(f"{options.picture.stem}_{scenario}.png")
        draw_people(path, trackers, [one.poses for one in together], clouds)
    ratios, errors, p95, lost_more = [], [], [], 0
    for tracker, own, tracked in zip(trackers, who, together, strict=True):
        alone = track_alone(tracker, observe(people, [own], scenario, options.pixels)[0])
        distances = [
            1000 * np.linalg.norm(one.joints - people.joints[own], axis=-1) for one in (tracked, alone)
        ]
        error, single = (each[visible[own]] for each in distances)
        ratios.append(error.mean() / single.mean())
        errors.append(error.mean())
        p95.append(np.quantile(error, 0.95) / np.quantile(single, 0.95))
        pairs = zip(tracked.verdicts, alone.verdicts, strict=True)
        lost_more += sum(verdict == "lost" != single for verdict, single in pairs)
        worst = int(np.argmax(distances[0].mean(1)))
        progress(
            f"person {own + 1}: {error.mean():.1f} mm together, {single.mean():.1f} mm alone; 95 %: "
            f"{np.quantile(error, 0.95):.1f} and {np.quantile(single, 0.95):.1f} mm; worst frame {worst}: "
            f"{distances[0][worst].mean():.1f} and {distances[1][worst].mean():.1f} mm; verdicts alone: "
            f"{dict(Counter(alone.verdicts))}"
        )
    figures = {
        "exchanges": float(count_exchanges(together, people, who)),
        "error_ratio": float(max(ratios)),
        "error_ratio_p95": float(max(p95)),
        "joints_mean_mm": float(max(errors)),
        "lost": float(sum(one.verdicts.count("lost") for one in together)),
        "lost_but_not_alone": float(lost_more),
        "not_good": float(sum(verdict != "good" for one in together for verdict in one.verdicts)),
    }
    progress(f"{scenario}: {', '.join(f'{name} {value:.3g}' for name, value in figures.items())}")
    return {f"{scenario}_{name}": value for name, value in figures.items()}, seconds


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenarios", nargs="+", choices=get_args(Scenario), default=list(SCENARIOS))
    parser.add_argument(
        "--frames", type=int, default=50, help="number of frames in the middle of each scenario"
    )
    parser.add_argument("--same-body", action="store_true", help="track everyone with the same body")
    parser.add_argument("--fit-shape", action="store_true", help="estimate the shape of each person first")
    parser.add_argument("--pixels", type=int, default=320, help="width of the images")
    parser.add_argument("--picture", type=Path, help="write a PNG of three frames of each scenario")
    options = parser.parse_args()
    figures, limits, seconds = {}, {}, []
    for scenario in options.scenarios:
        found, taken = run_scenario(scenario, options)
        figures |= found
        seconds += taken[1:]
        limits |= {f"{scenario}_exchanges": ("==", 0), f"{scenario}_error_ratio": ("<=", 1.3)}
        if scenario in SCENARIOS:
            limits[f"{scenario}_lost_but_not_alone"] = ("==", 0)
    sizes = {"cameras": CAMERAS, "points_of_a_person": POINTS, "frames": options.frames}
    finish("people_many", figures, limits, sizes, {"median_frame": float(np.median(seconds))})


if __name__ == "__main__":
    main()
