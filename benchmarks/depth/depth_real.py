"""Track a real person who turns on the spot, seen from the hips up by one depth camera: `python -m benchmarks.depth_real`.

The body is the embedded human, of no known build, and no start is given. It is fitted to the person's shape in the same
frames, then tracked (`--as-it-is` tracks it without). The person is given by masks, or is found in
each image (`--find-person`). Measured are the heading of the shoulders against the true turn, the overlap of the
rendered body with the mask within the part of the image that the sensor measures, and the distance from the person's
points to the surface. Every fourth frame is also searched for by itself, as a first one. `--picture FILE` writes every
fifth frame: red is the mask, green the body, and below each frame stands the body from the left.
"""

import argparse
import time
from pathlib import Path

import numpy as np

import jaxcap as jc
from benchmarks._scenes import shared_folder
from benchmarks.depth._overlays import draw_overlays, make_overlay
from benchmarks.report import finish, progress
from jaxcap.depth import cloud_of_depths
from jaxcap.geometry.camera import Camera
from jaxcap.geometry.closest import nearest_on_surface
from jaxcap.scanner.ray_casting import make_ray_mesh, render_depth
from jaxcap.tracking.track import track_frames

#: every so many-th frame is drawn
PICTURE_STEP = 5
#: error of the heading above which the pose of a single frame is wrong, degrees
WRONG_HEADING = 30.0


def read_frames(shared: Path) -> tuple[Camera, np.ndarray, np.ndarray, np.ndarray]:
    """Read the camera, depths in metres, masks and the true turn in degrees."""
    with np.load(shared / "data" / "depth" / "turning_person_40.npz") as file:
        depths = file["depth_mm"].astype(float) / 1000.0
        masks = np.unpackbits(file["mask"], axis=2).astype(bool)
        focal, centre, turn = float(file["focal"]), file["centre"].astype(float), file["turn_degrees"]
    height, width = depths.shape[1:]
    axes = np.diag([1.0, -1.0, -1.0])
    return Camera(axes, np.zeros(3), np.full(2, focal), centre, width, height), depths, masks, turn  # pyright: ignore[reportArgumentType]


def heading(body: jc.Body, pose: jc.Pose) -> float:
    """Compute the direction of the line through both shoulders about the vertical, degrees."""
    joints = np.asarray(jc.pose_body(body, pose).joints)
    across = joints[body.skeleton.index("LeftArm")] - joints[body.skeleton.index("RightArm")]
    return float(np.degrees(np.arctan2(-across[2], across[0])))


def overlap(shown: np.ndarray, mask: np.ndarray, measured: np.ndarray) -> float:
    """Compute intersection over union of two masks in a part of the image."""
    return float(np.sum(shown & mask & measured) / np.sum((shown | mask) & measured))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--find-person", action="store_true", help="find the person in the images")
    parser.add_argument("--as-it-is", action="store_true", help="do not fit the human to the person's shape")
    parser.add_argument(
        "--starts", type=int, default=4, help="also search for the pose of each so many-th frame alone"
    )
    parser.add_argument("--picture", type=Path)
    options = parser.parse_args()
    camera, depths, masks, turn = read_frames(shared_folder())
    # the rows and columns within which the sensor measures anything
    rows, columns = (np.flatnonzero((depths > 0).any(axes)) for axes in ((0, 2), (0, 1)))
    measured = np.zeros(depths.shape[1:], bool)
    measured[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1] = True
    body = jc.human(resolution="low", joints="tracking")
    tracker = jc.make_tracker(body, partial=True)
    clouds = [
        cloud_of_depths([camera], [depth], None if options.find_person else [mask], name=f"frame {number}")
        for number, (depth, mask) in enumerate(zip(depths, masks, strict=True))
    ][: options.frames]
    if not options.as_it_is:
        body = jc.adapt.estimate_shape(tracker, clouds)
        tracker = jc.make_tracker(body, partial=True)
    headings, overlaps, distances, verdicts, pictures, seconds = [], [], [], [], [], []
    begin, faces = time.perf_counter(), np.asarray(body.faces)
    for number, frame in enumerate(track_frames(tracker, clouds, search=True)):
        seconds.append(time.perf_counter() - begin)
        vertices = np.asarray(jc.pose_body(body, frame.pose).vertices, float)
        image = render_depth(camera, make_ray_mesh(vertices, faces))
        points = np.asarray(clouds[number].points, float)[np.asarray(clouds[number].weights) > 0]
        headings.append(heading(body, frame.pose))
        overlaps.append(overlap(image.depth > 0, masks[number], measured))
        distances.append(float(np.median(nearest_on_surface(points, vertices, faces).distances)))
        verdicts.append(frame.verdict)
        progress(
            f"frame {number}: {frame.verdict}, heading {headings[-1]:.0f} degrees, overlap {overlaps[-1]:.3f}, "
            f"{1000 * distances[-1]:.1f} mm; {', '.join(frame.reasons)}"
        )
        if number % PICTURE_STEP == 0:
            pictures.append(make_overlay(masks[number], image.incidence_cosines, vertices, faces))
        begin = time.perf_counter()
    if options.picture is not None:
        draw_overlays(options.picture, pictures)
    turned = np.unwrap(headings, period=360) - headings[0]
    wrong_starts = []
    for number in range(0, len(clouds), options.starts):
        first = next(iter(track_frames(tracker, clouds[number : number + 1], search=True)))
        error = abs((heading(body, first.pose) - headings[0] - turn[number] + 180) % 360 - 180)
        progress(f"searched in frame {number} alone: {first.verdict}, heading {error:.0f} degrees off")
        if error > WRONG_HEADING:
            wrong_starts.append(number)
    figures = {
        "heading_error_degrees": float(np.abs(turned - turn[: len(turned)]).max()),
        "overlap_mean": float(np.mean(overlaps)),
        "overlap_worst": float(np.min(overlaps)),
        "scan_to_surface_mm": 1000 * float(np.median(distances)),
        "num_lost": verdicts.count("lost"),
        "num_doubtful": verdicts.count("doubtful"),
        "num_wrong_starts": len(wrong_starts),
    }
    limits = {
        "heading_error_degrees": ("<=", 8.0),
        "overlap_mean": (">=", 0.90),
        "overlap_worst": (">=", 0.84),
        "scan_to_surface_mm": ("<=", 8.0),
        "num_wrong_starts": ("==", 0),
    }
    sizes = {"frames": len(headings), "points": len(clouds[0].points), "vertices": len(body.vertices)}
    taken = {"first_frame": seconds[0], "median_frame": float(np.median(seconds[1:]))}
    finish("depth_real", figures, limits, sizes, taken)


if __name__ == "__main__":
    main()
