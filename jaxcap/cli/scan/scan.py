"""`jaxcap scan`: simulated depth camera scans of a body's motion."""

import functools
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float, Int

from ...body.body import Body, pose_body, posed_vertices
from ...body.pose import Motion, take_poses
from ...errors import InputError, user_message
from ...geometry.camera import Camera, check_no_lenses, check_views, ring_of_cameras
from ...geometry.sampling import even_indices
from ...io.archives.npz import save_motion
from ...io.cameras import read_cameras, write_cameras
from ...io.meshes.ply import write_ply
from ...io.system.run_lock import run_lock
from ...scanner.rooms import Room, make_room
from ...scanner.scan import sample_dropped_views, scan_frame, scan_scene
from ...scanner.sensors import SENSORS
from ...scanner.settings import Scanner, check_scanner
from ..console.console import progress, say, warn
from ..console.options import BodySpec, Flag, MotionSpec, OptionalCount, OptionalFile, arg
from ..motions import load_moving_body
from ..track.results import make_writable
from .depth_images import image_path, write_images
from .folder import frame_path, gather_clouds, prepare_folder

#: number of frames in which a camera has to see part of the body at least once
CHECKED_FRAMES = 24
#: options that a model of a depth camera and a file of cameras replace, and those that depth images do not have
SENSOR_OPTIONS = (
    "resolution", "field_of_view", "noise", "noise_growth", "depth_step", "flying", "holes", "max_grazing_angle",
)  # fmt: skip
CAMERA_OPTIONS = ("views", "arc", "distance", "height", "resolution", "field_of_view")
CLOUD_OPTIONS = ("voxel", "points", "outliers")


@dataclass
class Scan:
    """Scan a moving body with virtual depth cameras; write scan_0000.ply, ..., the cameras (cameras.json), the
    true motion (truth.npz) and the rate (scan.json). With --as depth, write depth images (depth0/0000.png, ...) with
    masks of the person (mask0/0000.png, ...) instead of clouds.

    Each scan is written when it is finished, and does not depend on the scans before it. --resume continues an
    interrupted run."""

    body: BodySpec
    motion: MotionSpec
    out: Annotated[Path, arg(aliases=("-o",), metavar="FOLDER")]
    """Output folder."""
    views: int = 8
    """Number of cameras on the arc."""
    arc: float = 360.0
    """Angle of the arc of cameras, degrees. The middle of the arc is in front of the body."""
    distance: float = 2.5
    """Distance of the cameras from the vertical axis through the middle of the body, metres."""
    height: float = 1.2
    """Height of the cameras above the lowest point of the body, metres."""
    resolution: Annotated[tuple[int, int], arg(metavar="WIDTH HEIGHT")] = (320, 240)
    """Width and height of an image, pixels."""
    field_of_view: float = 60.0
    """Horizontal field of view, degrees."""
    cameras: OptionalFile = None
    """Calibrated cameras, .json as written by this verb, instead of the arc of cameras. The file then determines the
    image size and the field of view."""
    sensor: Annotated[
        Literal["kinect-v1", "azure-kinect", "realsense-d435"] | None,
        arg(metavar="{kinect-v1,azure-kinect,realsense-d435}", help_behavior_hint=""),
    ] = None
    """Depth camera whose image size, field of view and published errors are used, instead of --resolution,
    --field-of-view and the options from --noise to --max-grazing-angle."""
    room: Flag = False
    """Put floor, walls, a table and a chair around the body."""
    noise: float = 0.002
    """Standard deviation of the part of the depth error that does not depend on the depth, metres."""
    noise_growth: float = 0.0
    """Standard deviation, at a depth of 1 m, of the part of the depth error that grows with the square of the depth,
    metres."""
    depth_step: float = 0.0
    """Step to which depths are rounded, at a depth of 1 m, metres. The step grows with the square of the depth.
    0 disables rounding."""
    flying: float = 0.0
    """Share of the pixels at depth edges whose depth is between foreground and background (flying pixels)."""
    holes: float = 0.0
    """Share of the measured pixels that are lost in holes."""
    max_grazing_angle: float = 80.0
    """Largest angle between surface normal and ray at which the surface is still measured, degrees."""
    drop: float = 0.0
    """Probability that a camera gives no image in a frame."""
    voxel: float = 0.0
    """Keep one point in each cube of this side length, metres; 0 keeps all points."""
    points: OptionalCount = None
    """Keep N random points of each cloud. Default: all."""
    outliers: float = 0.0
    """Share of points replaced by random points around the body."""
    kind: Annotated[Literal["cloud", "mesh", "depth"], arg(name="as")] = "cloud"
    """Content of the scans: points (cloud); points, and a grid of triangles for each view (mesh); or depth images
    (depth)."""
    npz: Flag = False
    """Also write all clouds to one file, clouds.npz."""
    seed: int = 0
    """Random seed. The same seed gives the same scans."""
    rate: Annotated[float | None, arg(metavar="RATE", help_behavior_hint="")] = None
    """Scans per second, at most the rate of the motion. Default: the rate of the motion, one scan for each frame."""
    resume: Flag = False
    """Continue an interrupted run."""
    overwrite: Flag = False
    """Replace earlier scans."""

    def run(self) -> None:
        scanner = self.scanner()
        self.check()
        body, motion = load_moving_body(self.body, self.motion)
        motion = thin_motion(motion, self.rate)
        shown = even_indices(len(motion), CHECKED_FRAMES, nearest=True)
        places = np.asarray(posed_vertices(body, take_poses(motion.poses, shown)), float)
        cameras = self.make_cameras(places)
        corners = places.reshape(-1, 3)
        room = make_room(corners.min(0), corners.max(0)) if self.room else None
        make_writable(self.out)
        with run_lock(self.out):
            self.scan_all(scanner, cameras, room, body, motion)

    def scan_all(
        self, scanner: Scanner, cameras: list[Camera], room: Room | None, body: Body, motion: Motion
    ) -> None:
        """Scan all remaining frames, while the lock excludes other runs in the folder."""
        settings = {**self.settings(), "rate": motion.rate}
        prepare_folder(self.out, settings, (body, motion, cameras), self.resume, self.overwrite)
        write_cameras(self.out / "cameras.json", cameras)
        save_motion(self.out / "truth.npz", motion, body.skeleton)
        missing = [frame for frame in range(len(motion)) if not self.last_file(frame).is_file()]
        if len(missing) < len(motion):
            say(f"{len(motion) - len(missing)} of {len(motion)} scans already exist")
        scan = functools.partial(self.scan, scanner, cameras, room, body, motion)
        blind, sizes = defaultdict(list), []
        there, scans = len(motion) - len(missing), ((frame, scan(frame)) for frame in missing)
        try:
            for frame, counts in progress(scans, len(motion), there, "scanning"):
                sizes.append(counts.sum())
                dropped = sample_dropped_views(scanner.drop, len(cameras), self.seed, frame)
                for view in np.flatnonzero(~dropped & (counts == 0)):
                    blind[int(view)].append(frame)
        except KeyboardInterrupt:
            kept = there + len(sizes)
            raise KeyboardInterrupt(
                f"stopped after {kept} of {len(motion)} scans, which are written; --resume continues"
            ) from None
        for view, frames in sorted(blind.items()):
            warn(
                f"view {view} is empty in {len(frames)} of {len(missing)} frames, the first is frame {frames[0]}"
            )
        if self.npz:
            gather_clouds(self.out, len(motion))
        unit = "pixels of the body" if self.kind == "depth" else "points"
        what = f", {np.mean(sizes):.0f} {unit} each on average," if sizes else ""
        say(
            f"{len(motion)} scans from {len(cameras)} views{what} with cameras.json and truth.npz are in {self.out}"
        )

    def check(self) -> None:
        """Check that options are in range, before any file is read. Raises `InputError`."""
        if self.seed < 0:
            raise InputError(f"--seed is {self.seed}; it must be at least 0.")
        if self.rate is not None and not 0 < self.rate < np.inf:
            raise InputError(f"--rate is {self.rate:g}; it must be above 0 frames per second.")
        if self.resume and self.overwrite:
            raise InputError("--resume continues a run and --overwrite replaces it; give one of them.")
        if self.npz and self.kind != "cloud":
            raise InputError(f"--npz is for clouds, and --as {self.kind} was given; omit one of them.")
        self.check_replaced("--cameras", CAMERA_OPTIONS, self.cameras is not None)
        self.check_replaced("--sensor", SENSOR_OPTIONS, self.sensor is not None)
        self.check_replaced("--as depth", CLOUD_OPTIONS, self.kind == "depth")
        if self.cameras is None:
            ring_of_cameras(
                self.views,
                self.arc,
                self.distance,
                self.height,
                [0.0] * 3,
                *self.images(),
            )

    def check_replaced(self, option: str, names: tuple[str, ...], given: bool) -> None:
        """Check that no option was given which another one replaces. Raises `InputError`."""
        fields = self.__dataclass_fields__
        for name in names if given else ():
            if getattr(self, name) != fields[name].default:
                raise InputError(f"--{name.replace('_', '-')} has no effect with {option}; omit one of them.")

    def images(self) -> tuple[tuple[int, int], float]:
        """Return width and height of images, pixels, and the horizontal field of view, degrees."""
        if self.sensor is None:
            return self.resolution, self.field_of_view
        sensor = SENSORS[self.sensor]
        return sensor.resolution, sensor.field_of_view

    def last_file(self, frame: int) -> Path:
        """Return the file of a frame that is written last."""
        return image_path(self.out, 0, frame, "mask") if self.kind == "depth" else frame_path(self.out, frame)

    def scanner(self) -> Scanner:
        """Make the scanner of the options. Raises `InputError`."""
        shared = set(Scanner._fields) & set(self.__dataclass_fields__)
        if self.sensor is not None:
            shared -= set(SENSOR_OPTIONS)
        base = Scanner() if self.sensor is None else SENSORS[self.sensor].errors
        scanner = base._replace(**{name: getattr(self, name) for name in shared}, mesh=self.kind == "mesh")
        try:
            check_scanner(scanner)
        except InputError as error:
            said = user_message(error)
            raise InputError(f"--{said}" if " of the scanner is " in said else said) from None
        return scanner

    def settings(self) -> dict[str, object]:
        """Collect the settings that affect the scans, by the names of the options."""
        excluded = ("body", "motion", "out", "cameras", "resume", "overwrite", "npz", "kind")
        names = [name for name in self.__dataclass_fields__ if name not in excluded]
        return {"as": self.kind, **{name: getattr(self, name) for name in names}}

    def make_cameras(self, places: Float[np.ndarray, "F V 3"]) -> list[Camera]:
        """Make the cameras, and check that each sees part of the body in some frame. Raises `InputError`."""
        corners = places.reshape(-1, 3)
        low, high = corners.min(0), corners.max(0)
        if self.cameras is None:
            middle, top = 0.5 * (low + high), low[1] + self.height
            where, cameras = "--views", ring_of_cameras(
                self.views, self.arc, self.distance, top, middle, *self.images()
            )  # fmt: skip
        else:
            where, cameras = str(self.cameras), read_cameras(self.cameras)
        check_views(cameras, corners, where)
        check_no_lenses(cameras, f"{where}: camera")
        return cameras

    def scan(
        self,
        scanner: Scanner,
        cameras: list[Camera],
        room: Room | None,
        body: Body,
        motion: Motion,
        frame: int,
    ) -> Int[np.ndarray, "C"]:
        """Scan one frame, write it, and count its points or pixels of the body in each view.

        **Raises:** `InputError` if all views are empty.
        """
        vertices = np.asarray(pose_body(body, motion[frame]).vertices, float)
        faces = np.asarray(body.faces)
        if self.kind == "depth":
            surfaces = [(vertices, faces), *([] if room is None else [room])]
            images = scan_scene(scanner, cameras, surfaces, self.seed, frame)
            counts = np.array([np.sum(image.labels == 0) for image in images])
            check_seen(frame, cameras, bool(counts.any()))
            write_images(self.out, images, frame)
            return counts
        fused = scan_frame(scanner, cameras, vertices, faces, self.seed, frame, room)
        check_seen(frame, cameras, len(fused.points) > 0 and not (scanner.mesh and len(fused.faces) == 0))
        write_ply(frame_path(self.out, frame), fused.points, fused.normals, fused.views, fused.faces)
        return np.bincount(fused.views, minlength=len(cameras))


def check_seen(frame: int, cameras: list[Camera], seen: bool) -> None:
    """Check that some view of a frame shows the body. Raises `InputError`."""
    if not seen:
        raise InputError(
            f"frame {frame}: all {len(cameras)} views are empty; move the cameras, reduce --drop and --holes, "
            "or increase --max-grazing-angle. The previous frames are kept."
        )


def thin_motion(motion: Motion, rate: float | None) -> Motion:
    """Subsample a motion to a lower rate, frames per second, by the nearest frames.

    **Raises:** `InputError` for a higher rate than the motion's.
    """
    if rate is None:
        return motion
    if rate > motion.rate * (1 + 1e-9):
        raise InputError(
            f"--rate is {rate:g}, and the motion has {motion.rate:g} frames per second; give a lower rate."
        )
    count = int(np.floor((len(motion) - 1) * rate / motion.rate + 1e-9)) + 1
    frames = np.floor(np.arange(count) * motion.rate / rate + 0.5).astype(int)
    return Motion(take_poses(motion.poses, np.minimum(frames, len(motion) - 1)), float(rate))
