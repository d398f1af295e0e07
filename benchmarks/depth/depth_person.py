"""Find people in simulated rooms with furniture, seen by one depth camera: `python -m benchmarks.depth_person`.

An Azure Kinect sees a room with a floor, three walls, a table and a chair. An armchair stands nearer to the camera than the
person, on the left. In five scenes a person performs a take of CMU; stands on one spot and moves one arm; stands on one
spot and sways by 2 cm; does not move at all; performs and leaves the room after half of the frames. The person is found
without background, with the background of the sequence itself, and with that of empty frames. Measured is the
intersection over union of the found pixels with the true ones, in frames that show the person, and the number of frames
in which somebody is found and nobody is there. In the background of the sequence itself, the share of a person's pixels
that it absorbs is measured, too.
"""

import argparse
import time

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import trimesh

import jaxcap as jc
from benchmarks._scenes import shared_folder
from benchmarks.depth.depth_rooms import BUILDS, DISTANCES, make_motion
from benchmarks.report import finish, progress
from jaxcap.depth import Background, estimate_background, find_person
from jaxcap.depth.background import is_background
from jaxcap.errors import NoPersonError
from jaxcap.geometry import rotation
from jaxcap.geometry.camera import Camera, look_at
from jaxcap.scanner.scan import scan_scene

SCENES = ("performs", "moves_an_arm", "sways", "still", "leaves")
METHODS = ("alone", "itself", "empty")
#: size of the armchair, metres, and its position from the person, towards the left of the image and the camera
ARMCHAIR, ASIDE = (0.7, 0.9, 0.7), (-0.9, 0.5)
#: number of empty frames
NUM_EMPTY = 8
#: frames of a take from one image to the next
STRIDE = 5
#: sway of a person who stands, metres; angle of the moving arm, radians
SWAY, ARM = 0.02, 0.6

_pose_body = eqx.filter_jit(jc.pose_body)


def make_poses(scene: str, person: jc.Body, number: int, frames: int) -> list[jc.Pose]:
    """Make the poses of a scene."""
    motion = make_motion(shared_folder(), person, number, "whole", STRIDE * (frames - 1) + 1)
    poses = [motion[frame] for frame in range(0, len(motion), STRIDE)]
    if scene in ("performs", "leaves"):
        return poses
    found = []
    for phase in np.sin(np.linspace(0.0, 4 * np.pi, frames)):
        pose = poses[0]
        if scene == "sways":
            shift = jnp.array([SWAY * phase, 0.0, 0.5 * SWAY * phase])
            pose = eqx.tree_at(lambda p: p.translations, pose, pose.translations.at[0].add(shift))
        if scene == "moves_an_arm":
            joint = person.skeleton.index("LeftArm")
            turn = rotation.about_axis(jnp.array([0.0, 0.0, 1.0]), jnp.asarray(ARM * phase))
            turned = rotation.multiply(pose.rotations[joint], turn)
            pose = eqx.tree_at(lambda p: p.rotations, pose, pose.rotations.at[joint].set(turned))
        found.append(pose)
    return found


def simulate(scene: str, number: int, frames: int):
    """Simulate a scene: the camera, depths, pixels of the person, and empty frames."""
    person = jc.human(joints="tracking", resolution="low", **BUILDS[number])
    vertices = [
        np.asarray(_pose_body(person, pose).vertices, float)
        for pose in make_poses(scene, person, number, frames)
    ]
    low, high = np.min([v.min(0) for v in vertices], 0), np.max([v.max(0) for v in vertices], 0)
    middle = 0.5 * (low + high)
    room, sensor = jc.scanner.make_room(low, high), jc.scanner.SENSORS["azure-kinect"]
    corner = np.array([middle[0] + ASIDE[0], low[1], middle[2] + ASIDE[1]])
    chair = trimesh.creation.box(bounds=[corner, corner + ARMCHAIR])
    things = [
        (room.vertices, room.faces),
        (np.asarray(chair.vertices, float), np.asarray(chair.faces, int)),
    ]
    eye = np.array([middle[0], low[1] + 1.2, middle[2] + DISTANCES["whole"][number] + 0.4])
    target = np.array([middle[0], low[1] + 1.0, middle[2]])
    camera = look_at(eye, target, *sensor.resolution, sensor.field_of_view)
    depths, truths = [], []
    for frame, points in enumerate(vertices):
        gone = scene == "leaves" and frame >= frames // 2
        people = [] if gone else [(points, np.asarray(person.faces))]
        (image,) = scan_scene(sensor.errors, [camera], [*things, *people], number, frame)
        depths.append(image.depth)
        truths.append(image.labels == len(things))
    empty = [
        scan_scene(sensor.errors, [camera], things, 100 + number, frame)[0].depth
        for frame in range(NUM_EMPTY)
    ]
    return camera, depths, truths, empty


def evaluate(
    camera: Camera, depths: list[np.ndarray], truths: list[np.ndarray], background: Background | None
) -> tuple[list[float], int]:
    """Find the person in each frame; return overlaps with people, and the number of people that are not there."""
    overlaps, wrong = [], 0
    for depth, truth in zip(depths, truths, strict=True):
        try:
            found = find_person(camera, depth, background=background)
        except NoPersonError:
            found = np.zeros_like(truth)
        if truth.any():
            overlaps.append(float(np.sum(found & truth) / np.sum(found | truth)))
        else:
            wrong += bool(found.any())
    return overlaps, wrong


def share_absorbed(background: Background, depths: list[np.ndarray], truths: list[np.ndarray]) -> float:
    """Compute the largest share of a person's pixels in a frame that count as background."""
    return max(
        float(np.mean(is_background(background, depth)[truth]))
        for depth, truth in zip(depths, truths, strict=True)
        if truth.any()
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--builds", type=int, nargs="+", default=list(range(len(BUILDS))))
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument("--frames", type=int, default=30)
    options = parser.parse_args()
    figures, absorbed, seconds, count = {}, {}, [], 0
    for scene in options.scenes:
        overlaps: dict[str, list[float]] = {method: [] for method in METHODS}
        wrong = dict.fromkeys(METHODS, 0)
        for number in options.builds:
            camera, depths, truths, empty = simulate(scene, number, options.frames)
            count += len(depths)
            begin = time.perf_counter()
            own = estimate_background(camera, depths)
            seconds.append(time.perf_counter() - begin)
            backgrounds = {
                "alone": None,
                "itself": own,
                "empty": estimate_background(camera, empty, empty=True),
            }
            for method, background in backgrounds.items():
                found, nobody = evaluate(camera, depths, truths, background)
                overlaps[method] += found
                wrong[method] += nobody
                if method == "itself":
                    absorbed[scene] = max(absorbed.get(scene, 0.0), share_absorbed(own, depths, truths))
                progress(
                    f"{scene}, person {number}, {method}: overlap {np.mean(found):.3f}, worst {np.min(found):.3f}, "
                    f"{nobody} frames with somebody who is not there; {'' if background is None else background.doubt}"
                )
        figures[f"{scene}_itself_absorbed_worst"] = absorbed[scene]
        for method in METHODS:
            figures[f"{scene}_{method}_overlap_mean"] = float(np.mean(overlaps[method]))
            figures[f"{scene}_{method}_overlap_worst"] = float(np.min(overlaps[method]))
            if scene == "leaves":
                figures[f"{scene}_{method}_nobody_found"] = float(wrong[method])
    limits = {
        "performs_itself_overlap_worst": (">=", 0.8),
        "performs_empty_overlap_worst": (">=", 0.8),
        "moves_an_arm_itself_overlap_worst": (">=", 0.8),
        "leaves_itself_nobody_found": ("==", 0),
        "leaves_empty_nobody_found": ("==", 0),
    }
    limits |= {f"{scene}_itself_absorbed_worst": ("<=", 0.05) for scene in SCENES}
    limits = {name: limit for name, limit in limits.items() if name in figures}
    sizes = {"people": len(options.builds), "frames": count}
    finish("depth_person", figures, limits, sizes, {"background": float(np.median(seconds))})


if __name__ == "__main__":
    main()
