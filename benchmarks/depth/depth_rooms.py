"""Track people of other builds in furnished rooms, seen by one depth camera: `python -m benchmarks.depth_rooms`.

Five people, none of whom is the tracked template, perform takes of CMU from which the prior of poses was not learned. One
Azure Kinect sees each of them whole, from the hips up, and whole while they also turn by 360 degrees about the vertical.
The room has a floor, three walls, a table and a chair. As `jaxcap track --depth` does, the
background is estimated from the sequence, the person is found in each image, and no start is given. The
embedded human is fitted to the person's shape in the same frames, then tracked (`--as-it-is` tracks it without).
`--without` tracks the same points without the images too. `--outfit skirt --clothes` dresses all of them, and tracks with the
model of clothes. Hidden thighs are among the joints only where the cloth lies near them.

A joint is visible if its pixel shows the person, at most 20 cm in front of the joint. Sides are right in a frame if
shoulders, hips and visible limbs are nearer to their own than to the opposite ones.
"""

import argparse
import time
from pathlib import Path
from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from benchmarks._clothes import OUTFITS, dress, dressed_mesh
from benchmarks._scenes import human_motion, shared_folder
from benchmarks.depth._overlays import Overlay, draw_overlays, make_overlay
from benchmarks.report import finish, progress
from jaxcap.depth.background import MAX_FRAMES
from jaxcap.geometry import rotation
from jaxcap.geometry.camera import Camera, look_at, project_points
from jaxcap.geometry.sampling import even_indices
from jaxcap.scanner.ray_casting import make_ray_mesh, render_depth
from jaxcap.scanner.scan import scan_scene
from jaxcap.tracking.track import track_frames
from jaxcap.tracking.track_frame import replace_body

Scenario = Literal["whole", "hips_up", "turning"]
SCENARIOS: tuple[Scenario, ...] = ("whole", "hips_up", "turning")
BUILDS = (
    dict(sex="female", age=22, weight=0.25, muscle=0.45, height=1.58),
    dict(sex="male", age=28, weight=0.4, muscle=0.8, height=1.88),
    dict(sex="male", age=55, weight=0.9, muscle=0.4, height=1.75),
    dict(sex="female", age=60, weight=0.8, muscle=0.35, height=1.65),
    dict(sex="female", age=33, weight=0.5, muscle=0.7, height=1.78),
)
#: takes that the prior of poses has not seen, in which a person stands and moves the arms, and first frames in them
TAKES = (("02_05", 0), ("02_07", 0), ("02_05", 150), ("02_07", 200), ("02_05", 300))
#: distances of the camera from the middle of the motion, metres
DISTANCES = {
    "whole": (2.4, 2.8, 3.2, 3.5, 3.0),
    "hips_up": (1.5, 1.6, 1.5, 1.7, 1.6),
    "turning": (2.6, 2.4, 3.0, 2.8, 3.2),
}
#: largest depth of a joint below visible surface, metres
JOINT_DEPTH = 0.2
#: pairs of joints that tell left from right, always and where they are visible
CORE = (("LeftArm", "RightArm"), ("LeftUpLeg", "RightUpLeg"))
LIMBS = (
    ("LeftForeArm", "RightForeArm"),
    ("LeftHand", "RightHand"),
    ("LeftLeg", "RightLeg"),
    ("LeftFoot", "RightFoot"),
)
#: a frame with a larger mean error of visible joints is rightly called lost, metres
LOST_ERROR = 0.08

_pose_body = eqx.filter_jit(jc.pose_body)


class Scene(NamedTuple):
    """The frames of one person in one room."""

    camera: Camera
    clouds: list[jc.Cloud]
    #: the floor that the first frame shows
    floor: jc.observe.Plane | None
    joints: np.ndarray
    visible: np.ndarray
    masks: list[np.ndarray]
    #: intersection over union of the found person with the true one, in each frame
    found: list[float]


class Result(NamedTuple):
    """The errors of one tracked scene."""

    errors: np.ndarray
    verdicts: list[str]
    sides: np.ndarray
    heading: np.ndarray
    overlaps: np.ndarray
    seconds: list[float]
    #: the first, the middle and the last frame
    pictures: list[Overlay]


def make_motion(shared: Path, body: jc.Body, number: int, scenario: Scenario, frames: int) -> jc.Motion:
    """Make the motion of a person, which begins in the direction of the camera."""
    take, first = TAKES[number]
    motion = human_motion(shared, take, body, first + frames).slice(slice(first, None))
    facing = heading(np.asarray(_pose_body(body, motion[0]).joints), body.skeleton)
    steps = np.linspace(0.0, 2 * np.pi, len(motion)) if scenario == "turning" else np.zeros(len(motion))
    poses = []
    for pose, step in zip((motion[frame] for frame in range(len(motion))), steps, strict=True):
        poses.append(turned(body, pose, step - np.radians(facing)))
    return jc.stack_poses(poses, motion.rate)


def turned(body: jc.Body, pose: jc.Pose, angle: float) -> jc.Pose:
    """Rotate a pose about the vertical through its root."""
    q = rotation.about_axis(jnp.array([0.0, 1.0, 0.0]), jnp.asarray(angle))
    return eqx.tree_at(
        lambda p: p.rotations, pose, pose.rotations.at[0].set(rotation.multiply(q, pose.rotations[0]))
    )


def heading(joints: np.ndarray, skeleton: jc.Skeleton) -> float:
    """Compute the direction of the line through both shoulders about the vertical, degrees; zero faces +z."""
    across = joints[skeleton.index("LeftArm")] - joints[skeleton.index("RightArm")]
    return float(np.degrees(np.arctan2(-across[2], across[0])))


def make_scene(shared: Path, number: int, scenario: Scenario, frames: int, outfit: str) -> Scene:
    """Simulate the frames of one person in an outfit (`_clothes`)."""
    person = jc.human(joints="tracking", resolution="medium", **BUILDS[number])
    motion = make_motion(shared, person, number, scenario, frames)
    dressed = list(dress(person, motion, outfit))
    meshes = [dressed_mesh(person, one) for one in dressed]
    vertices, joints = [mesh[0] for mesh in meshes], np.array([one.joints for one in dressed])
    low, high = np.min([v.min(0) for v in vertices], 0), np.max([v.max(0) for v in vertices], 0)
    room, sensor = jc.scanner.make_room(low, high), jc.scanner.SENSORS["azure-kinect"]
    middle, away = joints[:, 0].mean(0), DISTANCES[scenario][number]
    hips = joints[:, person.skeleton.index("Hips"), 1].mean()
    eye = np.array([middle[0], low[1] + 1.2 if scenario != "hips_up" else hips + 0.4, middle[2] + away])
    target = np.array([middle[0], low[1] + 1.0, middle[2]])
    if scenario == "hips_up":
        # the lower edge of the image is at the hips
        half = np.degrees(
            np.arctan(
                np.tan(np.radians(sensor.field_of_view / 2)) * sensor.resolution[1] / sensor.resolution[0]
            )
        )
        target[1] = eye[1] + away * np.tan(np.radians(half) - np.arctan(0.4 / away))
    camera = look_at(eye, target, *sensor.resolution, sensor.field_of_view)
    images = [
        scan_scene(sensor.errors, [camera], [mesh, (room.vertices, room.faces)], number, frame)[0]
        for frame, mesh in enumerate(meshes)
    ]
    spread = even_indices(frames, MAX_FRAMES, nearest=True)
    background = jc.depth.estimate_background(camera, [images[frame].depth for frame in spread])
    clouds, visible, masks, found = [], [], [], []
    floor = None
    for frame, image in enumerate(images):
        mask = jc.depth.find_person(camera, image.depth, f"frame {frame}", background)
        truth = image.labels == 0
        found.append(float(np.sum(mask & truth) / np.sum(mask | truth)))
        clouds.append(jc.depth.cloud_of_depths([camera], [image.depth], [mask], name=f"frame {frame}"))
        if frame == 0:
            floor = jc.depth.find_floor_of_person([camera], [image.depth], clouds[0])
        visible.append(visible_joints(camera, joints[frame], np.where(truth, image.depth, 0.0)))
        masks.append(truth)
    return Scene(camera, clouds, floor, joints, np.array(visible), masks, found)


def visible_joints(camera: Camera, joints: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Test which joints are at most `JOINT_DEPTH` behind measured surface of the person."""
    pixels, along = (np.asarray(a, float) for a in project_points(camera, jnp.asarray(joints)))
    column, row = np.round(pixels).astype(int).T
    inside = (along > 0) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    shown = np.zeros(len(joints))
    shown[inside] = depth[row[inside], column[inside]]
    return (shown > 0) & (along - shown < JOINT_DEPTH)


def sides_are_right(found: np.ndarray, truth: np.ndarray, visible: np.ndarray, skeleton: jc.Skeleton) -> bool:
    """Test if left and right joints are nearer to their own true places than to the opposite ones."""
    for pairs, always in ((CORE, True), (LIMBS, False)):
        for names in pairs:
            left, right = (skeleton.index(name) for name in names)
            if not always and not (visible[left] and visible[right]):
                continue
            own = np.linalg.norm(found[[left, right]] - truth[[left, right]], axis=1).sum()
            opposite = np.linalg.norm(found[[right, left]] - truth[[left, right]], axis=1).sum()
            if own > opposite:
                return False
    return True


def track_scene(body: jc.Body, scene: Scene, with_images: bool, fit_shape: bool, clothes: bool) -> Result:
    """Track the frames of a scene, and compare joints with the truth."""
    terms = (
        ()
        if scene.floor is None
        else (jc.energy.make_floor(body, scene.floor.offset, tuple(scene.floor.normal.tolist()), 0.02),)
    )
    tracker = jc.make_tracker(body, terms=terms, partial=True, clothes=clothes)
    clouds = scene.clouds
    if not with_images:
        clouds = [eqx.tree_at(lambda c: c.views, cloud, ()) for cloud in clouds]
    if fit_shape:
        body = jc.adapt.estimate_shape(tracker, clouds)
        tracker = replace_body(tracker, body)
    skeleton, faces = body.skeleton, np.asarray(body.faces)
    errors, verdicts, sides, headings, overlaps, seconds = [], [], [], [], [], []
    pictures, drawn = [], (0, len(clouds) // 2, len(clouds) - 1)
    begin = time.perf_counter()
    for number, frame in enumerate(track_frames(tracker, clouds, search=True)):
        seconds.append(time.perf_counter() - begin)
        posed = _pose_body(body, frame.pose)
        joints = np.asarray(posed.joints, float)
        errors.append(
            np.where(scene.visible[number], np.linalg.norm(joints - scene.joints[number], axis=1), np.nan)
        )
        verdicts.append(frame.verdict)
        sides.append(sides_are_right(joints, scene.joints[number], scene.visible[number], skeleton))
        difference = heading(joints, skeleton) - heading(scene.joints[number], skeleton)
        headings.append((difference + 180) % 360 - 180)
        vertices = np.asarray(posed.vertices, float)
        image = render_depth(scene.camera, make_ray_mesh(vertices, faces))
        shown = image.depth > 0
        if number in drawn:
            pictures.append(make_overlay(scene.masks[number], image.incidence_cosines, vertices, faces))
        overlaps.append(np.sum(shown & scene.masks[number]) / np.sum(shown | scene.masks[number]))
        progress(
            f"frame {number}: {frame.verdict}, visible joints {1000 * np.nanmean(errors[-1]):.0f} mm, heading "
            f"{headings[-1]:+.0f} degrees, overlap {overlaps[-1]:.2f}; {', '.join(frame.reasons)}"
        )
        begin = time.perf_counter()
    return Result(
        np.array(errors), verdicts, np.array(sides), np.array(headings), np.array(overlaps), seconds, pictures
    )


def summary(prefix: str, results: list[Result]) -> dict[str, float]:
    """Summarise the errors of several scenes."""
    errors = np.concatenate([result.errors.ravel() for result in results])
    errors = 1000 * errors[np.isfinite(errors)]
    frames = [
        (verdict, float(np.nanmean(row)))
        for result in results
        for verdict, row in zip(result.verdicts, result.errors, strict=True)
    ]
    wrongly_lost = sum(verdict == "lost" and error < LOST_ERROR for verdict, error in frames)
    wrong_and_good = sum(verdict == "good" and error > LOST_ERROR for verdict, error in frames)
    return {
        f"{prefix}_joints_mean_mm": float(errors.mean()),
        f"{prefix}_joints_p95_mm": float(np.quantile(errors, 0.95)),
        f"{prefix}_right_sides_share": float(np.mean([result.sides.mean() for result in results])),
        f"{prefix}_heading_end_degrees": float(max(abs(result.heading[-1]) for result in results)),
        f"{prefix}_overlap_mean": float(np.mean([result.overlaps.mean() for result in results])),
        f"{prefix}_wrongly_lost": float(wrongly_lost),
        f"{prefix}_wrong_and_good": float(wrong_and_good),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--builds", type=int, nargs="+", default=list(range(len(BUILDS))))
    parser.add_argument("--scenarios", nargs="+", choices=SCENARIOS, default=list(SCENARIOS))
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--without", action="store_true", help="also track the points without the images")
    parser.add_argument("--as-it-is", action="store_true", help="do not fit the human to the person's shape")
    parser.add_argument("--outfit", choices=OUTFITS, default="bare", help="what the people wear")
    parser.add_argument("--clothes", action="store_true", help="track with the model of clothes")
    parser.add_argument("--picture", type=Path, help="write a PNG with three frames of each scene")
    options = parser.parse_args()
    shared, body = shared_folder(), jc.human(resolution="low", joints="tracking")
    figures, found, seconds, pictures = {}, [], [], []
    for scenario in options.scenarios:
        results: dict[bool, list[Result]] = {True: [], False: []}
        for number in options.builds:
            scene = make_scene(shared, number, scenario, options.frames, options.outfit)
            found += scene.found
            for with_images in (True, False) if options.without else (True,):
                progress(f"{scenario}, person {number}, {'with' if with_images else 'without'} images")
                results[with_images].append(
                    track_scene(body, scene, with_images, not options.as_it_is, options.clothes)
                )
                seconds.append(results[with_images][-1].seconds)
            pictures += results[True][-1].pictures
        figures |= summary(scenario, results[True])
        if options.without:
            figures |= summary(f"{scenario}_without_images", results[False])
    figures |= {
        "found_person_overlap_mean": float(np.mean(found)),
        "found_person_overlap_worst": float(np.min(found)),
    }
    if options.picture is not None:
        draw_overlays(options.picture, pictures)
    limits = {
        "whole_joints_mean_mm": ("<=", 30.0),
        "whole_joints_p95_mm": ("<=", 60.0),
        "whole_right_sides_share": ("==", 1.0),
        "hips_up_joints_mean_mm": ("<=", 35.0),
        "hips_up_wrongly_lost": ("==", 0),
        "turning_heading_end_degrees": ("<=", 10.0),
    }
    limits = {name: limit for name, limit in limits.items() if name in figures}
    sizes = {"people": len(options.builds), "frames": options.frames, "vertices": len(body.vertices)}
    taken = {
        "first_frame": float(np.median([one[0] for one in seconds])),
        "median_frame": float(np.median([one for run in seconds for one in run[1:]])),
    }
    finish("depth_rooms", figures, limits, sizes, taken)


if __name__ == "__main__":
    main()
