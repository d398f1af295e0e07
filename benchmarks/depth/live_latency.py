"""Track depth images of 640 x 480 pixels as they arrive, 30 times a second: `python -m benchmarks.live_latency`.

The embedded human walks on the spot and waves, in a furnished room, 2.4 m in front of a depth camera with the errors of an Azure
Kinect. With `--take` it performs a take of CMU instead, without the motion of the hips across the floor. The images are made before the clock starts (`--images` keeps them for
the next run), and are shown forward and backward in turn for `--seconds`. The tracked body is the human with fewer vertices, and starts
at the true pose of the first frame.

Measured are the frames tracked per second, the share that is dropped, and the time from the arrival of a frame to its pose. The
processor time for each frame is that of all threads; on two cores it may be twice the time between frames. The joints are compared
with the truth, and with two runs without a clock over the first `--compare` frames: one by the same steps (`offline`), and one as
`jaxcap track --depth` makes and tracks its clouds (`track`).
"""

import argparse
import time
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from benchmarks._scenes import human_motion, shared_folder
from benchmarks.depth.depth_rooms import heading, turned
from benchmarks.report import finish, progress
from jaxcap.body.body import posed_vertices
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.depth.stream.cloud_stream import NUM_POINTS, CloudStream
from jaxcap.geometry.camera import Camera, look_at
from jaxcap.live.live_tracker import ITERATIONS, JUDGE_EVERY
from jaxcap.scanner.scan import scan_scene
from jaxcap.tracking.online import OnlineTracker

#: size of the images, pixels, horizontal field of view, degrees, distance and height of the camera, metres
SIZE, FIELD_OF_VIEW, DISTANCE, HEIGHT = (640, 480), 75.0, 2.4, 1.2
#: standard deviation of the first frame, metres, as its pose is known
START_SIGMA = 0.03
#: seconds for the last frame
END_SECONDS = 30.0

_pose_body = eqx.filter_jit(jc.pose_body)


class Scene(NamedTuple):
    """The images of a person who walks on the spot."""

    camera: Camera
    #: millimetres
    depth: np.ndarray
    joints: np.ndarray
    start: jc.Pose


def make_poses(body: jc.Body, take: str, first: int, frames: int) -> list[jc.Pose]:
    """Make the poses of a take on the spot, facing the camera; of the package's own performance without a take."""
    if not take:
        performance = walk_and_wave(body.skeleton, seconds=(first + frames) / 30.0)
        return [performance[frame] for frame in range(first, first + frames)]
    motion = human_motion(shared_folder(), take, body, first + frames).slice(slice(first, None))
    angle = -np.radians(heading(np.asarray(_pose_body(body, motion[0]).joints), body.skeleton))
    poses = [turned(body, motion[frame], angle) for frame in range(len(motion))]
    hips = np.array([np.asarray(pose.translations)[0] for pose in poses])
    drift = np.linspace(0.0, 1.0, len(poses))[:, None] * (hips[-1] - hips[0]) * [1, 0, 1]
    return [
        eqx.tree_at(
            lambda p: p.translations, pose, pose.translations.at[0].add(-jnp.asarray(step, jnp.float32))
        )
        for pose, step in zip(poses, drift, strict=True)
    ]


def make_scene(take: str, first: int, frames: int) -> Scene:
    """Simulate the images."""
    person = jc.human(joints="tracking", resolution="medium")
    poses = make_poses(person, take, first, frames)
    posed = [_pose_body(person, pose) for pose in poses]
    vertices = [np.asarray(one.vertices, float) for one in posed]
    joints = np.array([np.asarray(one.joints, float) for one in posed])
    low, high = np.min([v.min(0) for v in vertices], 0), np.max([v.max(0) for v in vertices], 0)
    room, middle = jc.scanner.make_room(low, high), joints[:, 0].mean(0)
    camera = look_at(
        [middle[0], low[1] + HEIGHT, middle[2] + DISTANCE],
        [middle[0], low[1] + 1.0, middle[2]],
        *SIZE,
        FIELD_OF_VIEW,
    )
    images = []
    for frame, points in enumerate(vertices):
        surfaces = [(points, np.asarray(person.faces)), (room.vertices, room.faces)]
        (image,) = scan_scene(jc.scanner.SENSORS["azure-kinect"].errors, [camera], surfaces, 0, frame)
        images.append(np.round(1000 * image.depth).astype(np.uint16))
        if frame % 20 == 0:
            progress(f"image {frame} of {len(vertices)}")
    return Scene(camera, np.array(images), joints, poses[0])


def kept_scene(path: Path | None, take: str, first: int, frames: int) -> Scene:
    """Make the scene, or read it from the file of an earlier run."""
    if path is not None and path.is_file():
        with np.load(path) as file:
            camera = Camera(file["rotation"], file["translation"], file["focal"], file["middle"], *SIZE)
            start = jc.Pose(jnp.asarray(file["start_t"]), jnp.asarray(file["start_r"]), jnp.asarray(1.0))
            return Scene(camera, file["depth"], file["joints"], start)
    scene = make_scene(take, first, frames)
    if path is not None:
        camera = scene.camera
        np.savez(
            path, depth=scene.depth, joints=scene.joints, start_t=scene.start.translations, start_r=scene.start.rotations,
            rotation=camera.rotation, translation=camera.translation, focal=camera.focal, middle=camera.principal_point,
        )  # fmt: skip
    return scene


def forward_and_backward(count: int, length: int) -> np.ndarray:
    """Number the images that are shown: 0 to `count - 1`, back to 0, and so on."""
    cycle = np.concatenate([np.arange(count), np.arange(count - 2, 0, -1)])
    return np.resize(cycle, length)


def joints_of(body: jc.Body, pose: jc.Pose) -> np.ndarray:
    return np.asarray(_pose_body(body, pose).joints, float)


def track_offline(tracker: jc.fit.Tracker, scene: Scene, order: np.ndarray, num_points: int) -> np.ndarray:
    """Track by the steps of the live run, without a clock."""
    online, stream = (
        OnlineTracker(tracker, scene.start, search=False, sigma=START_SIGMA, judge_every=JUDGE_EVERY),
        CloudStream([scene.camera], num_points),
    )
    surface, found = None, []
    for number in order:
        frame = online.track(stream.make([scene.depth[number] / 1000.0], surface))
        surface = np.asarray(posed_vertices(tracker.body, frame.pose), float)
        found.append(joints_of(tracker.body, frame.pose))
    online.close()
    return np.array(found)


def track_as_recorded(body: jc.Body, scene: Scene, order: np.ndarray) -> np.ndarray:
    """Track as `jaxcap track --depth` does."""
    tracker = jc.make_tracker(body, partial=True)
    clouds = (jc.depth.cloud_of_depths([scene.camera], [scene.depth[number] / 1000.0]) for number in order)
    frames = jc.fit.track_frames(tracker, clouds, scene.start, search=False, sigma=START_SIGMA)
    return np.array([joints_of(body, frame.pose) for frame in frames])


def run_live(live: jc.live.LiveTracker, scene: Scene, order: np.ndarray, rate: float) -> float:
    """Give the tracker every image at its time; return the processor seconds of this process."""
    metres = [image / 1000.0 for image in scene.depth]
    begin, used = time.monotonic(), time.process_time()
    for number, image in enumerate(order):
        due = begin + number / rate
        time.sleep(max(due - time.monotonic(), 0.0))
        live.push([metres[image]], number / rate, arrived=due)
        if number % int(5 * rate) == 0:
            progress(live.statistics.sentence())
    live.wait(END_SECONDS)
    return time.process_time() - used


def distances_mm(found: dict[int, np.ndarray], other: np.ndarray) -> np.ndarray:
    """Compute the distances of the joints of the frames in both runs, millimetres."""
    return 1000 * np.array(
        [np.linalg.norm(found[number] - other[number], axis=1) for number in found if number < len(other)]
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=30.0)
    parser.add_argument("--take", default="", help="a take of CMU, such as 02_01")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--frames", type=int, default=60, help="number of different images")
    parser.add_argument("--images", type=Path, help="an .npz that keeps the images for the next run")
    parser.add_argument("--points", type=int, default=NUM_POINTS)
    parser.add_argument("--iterations", type=int, default=ITERATIONS)
    parser.add_argument(
        "--compare", type=int, default=170, help="number of frames that are tracked without a clock too"
    )
    options = parser.parse_args()
    scene = kept_scene(options.images, options.take, options.first, options.frames)
    order = forward_and_backward(len(scene.depth), round(options.seconds * options.rate))
    body = jc.human(resolution="low", joints="tracking")
    tracker = jc.live.make_live_tracker(body, iterations=options.iterations)

    poses: dict[int, jc.Pose] = {}
    verdicts: list[str] = []

    def keep(frame: jc.live.LiveFrame) -> None:
        poses[frame.number] = frame.tracked.pose
        verdicts.append(frame.tracked.verdict)

    with jc.live.LiveTracker(
        tracker,
        [scene.camera],
        num_points=options.points,
        on_frame=keep,
        start=scene.start,
        search=False,
        sigma=START_SIGMA,
    ) as live:
        warm_up = live.warm_up([scene.depth[0] / 1000.0])
        progress(f"ready after {warm_up:.1f} s")
        processor = run_live(live, scene, order, options.rate)
        statistics, latencies = live.statistics, live.latencies
    found = {number: joints_of(body, pose) for number, pose in poses.items()}
    compared = order[: options.compare]
    offline = distances_mm(found, track_offline(tracker, scene, compared, options.points))
    recorded = distances_mm(found, track_as_recorded(body, scene, compared))
    truth = distances_mm(found, scene.joints[order])
    figures = {
        "frames_per_second": statistics.tracked / options.seconds,
        "dropped_share": statistics.dropped / len(order),
        "failed": statistics.failed,
        "latency_p50_ms": 1000 * statistics.latency_median,
        "latency_p99_ms": 1000 * statistics.latency_p99,
        "latency_max_ms": 1000 * latencies.max(),
        "processor_ms_per_frame": 1000 * processor / max(statistics.tracked, 1),
        "not_good_share": float(np.mean([verdict != "good" for verdict in verdicts])),
        "offline_joints_mean_mm": offline.mean(),
        "offline_joints_p99_mm": np.quantile(offline, 0.99),
        "track_joints_mean_mm": recorded.mean(),
        "track_joints_p99_mm": np.quantile(recorded, 0.99),
        "truth_joints_mean_mm": truth.mean(),
        "truth_joints_p95_mm": np.quantile(truth, 0.95),
    }
    limits = {
        "frames_per_second": (">=", 0.995 * options.rate),
        "latency_p99_ms": ("<=", 80.0),
        "offline_joints_mean_mm": ("<=", 1.0),
        "track_joints_mean_mm": ("<=", 1.0),
    }
    sizes = {
        "frames": len(order),
        "images": len(scene.depth),
        "pixels": list(SIZE),
        "points": options.points,
        "vertices": len(body.vertices),
        "iterations": options.iterations,
    }
    finish(
        "live_latency",
        figures,
        limits,
        sizes,
        {"warm_up": warm_up, "run": options.seconds, "processor": processor},
    )


if __name__ == "__main__":
    main()
