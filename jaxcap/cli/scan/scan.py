"""`jaxcap scan`: simulated depth camera scans of a body's motion."""

import functools
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float

from ...body.body import Body, pose_body, posed_vertices
from ...body.pose import Motion, take_poses
from ...errors import InputError, user_message
from ...geometry.camera import Camera, check_views, ring_of_cameras
from ...geometry.sampling import even_indices
from ...io.archives.npz import save_motion
from ...io.cameras import read_cameras, write_cameras
from ...io.meshes.ply import write_ply
from ...io.system.lock import run_lock
from ...scanner.fuse import FusedScan
from ...scanner.scan import sample_dropped_views, scan_frame
from ...scanner.settings import Scanner, check_scanner
from ..console.console import progress, say, warn
from ..console.options import BodySpec, Flag, MotionSpec, OptionalCount, OptionalFile, arg
from ..motions import load_body_motion
from ..sources import load_body
from ..track.results import make_writable
from .folder import frame_path, gather_clouds, prepare_folder

#: number of frames in which a camera has to see part of the body at least once
CHECKED_FRAMES = 24


@dataclass
class Scan:
    """Scan a moving body with virtual depth cameras; write scan_0000.ply, ..., the cameras (cameras.json) and the
    true motion (truth.npz).

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
    """Calibrated cameras, .json as written by this verb, instead of the arc of cameras."""
    noise: float = 0.002
    """Standard deviation of the part of the depth error that is the same at every depth, metres."""
    noise_growth: float = 0.0
    """Standard deviation of the part of the depth error that grows with the square of the depth: its value at 1 m,
    metres."""
    depth_step: float = 0.0
    """Step to which depths are rounded, which grows with the square of the depth: its value at 1 m, metres. 0 disables
    rounding."""
    flying: float = 0.0
    """Share of the pixels at depth edges that are flying pixels, between foreground and background."""
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
    kind: Annotated[Literal["cloud", "mesh"], arg(name="as")] = "cloud"
    """Write points only (cloud), or also a grid of triangles for each view (mesh)."""
    npz: Flag = False
    """Also write all clouds to one file, clouds.npz."""
    seed: int = 0
    """Random seed. The same seed gives the same scans."""
    rate: Annotated[float | None, arg(metavar="RATE", help_behavior_hint="")] = None
    """Scans per second, at most the rate of the motion. Default: one scan of every frame."""
    resume: Flag = False
    """Continue an interrupted run."""
    overwrite: Flag = False
    """Replace earlier scans."""

    def run(self) -> None:
        scanner = self.scanner()
        self.check()
        body, _ = load_body(self.body)
        motion = thin_motion(load_body_motion(body, self.motion), self.rate)
        shown = even_indices(len(motion), CHECKED_FRAMES, nearest=True)
        places = np.asarray(posed_vertices(body, take_poses(motion.poses, shown)), float)
        cameras = self.make_cameras(places)
        make_writable(self.out)
        with run_lock(self.out):
            self.scan_all(scanner, cameras, body, motion)

    def scan_all(self, scanner: Scanner, cameras: list[Camera], body: Body, motion: Motion) -> None:
        """Scan all remaining frames, while the lock excludes other runs in the folder."""
        settings = {**self.settings(), "rate": motion.rate}
        prepare_folder(self.out, settings, (body, motion, cameras), self.resume, self.overwrite)
        write_cameras(self.out / "cameras.json", cameras)
        save_motion(self.out / "truth.npz", motion, body.skeleton)
        missing = [frame for frame in range(len(motion)) if not frame_path(self.out, frame).is_file()]
        if len(missing) < len(motion):
            say(f"{len(motion) - len(missing)} of {len(motion)} scans already exist")
        scan = functools.partial(self.scan, scanner, cameras, body, motion)
        blind, sizes = defaultdict(list), []
        there, scans = len(motion) - len(missing), ((frame, scan(frame)) for frame in missing)
        try:
            for frame, fused in progress(scans, len(motion), there, "scanning"):
                sizes.append(len(fused.points))
                looked = np.flatnonzero(~sample_dropped_views(self.drop, len(cameras), self.seed, frame))
                for view in np.setdiff1d(looked, fused.views):
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
        what = f", {np.mean(sizes):.0f} points each on average," if sizes else ""
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
        if self.npz and self.kind == "mesh":
            raise InputError("--npz is for clouds, and --as mesh was given; omit one of them.")
        if self.cameras is None:
            ring_of_cameras(
                self.views,
                self.arc,
                self.distance,
                self.height,
                [0.0] * 3,
                self.resolution,
                self.field_of_view,
            )

    def scanner(self) -> Scanner:
        """Make the scanner of the options. Raises `InputError`."""
        shared = set(Scanner._fields) & set(self.__dataclass_fields__)
        scanner = Scanner(**{name: getattr(self, name) for name in shared}, mesh=self.kind == "mesh")
        try:
            check_scanner(scanner)
        except InputError as error:
            said = user_message(error)
            raise InputError(f"--{said}" if " of the scanner is " in said else said) from None
        return scanner

    def settings(self) -> dict[str, object]:
        """Collect the settings that affect the scans, by the names of the options."""
        apart = ("body", "motion", "out", "cameras", "resume", "overwrite", "npz", "kind")
        names = [name for name in self.__dataclass_fields__ if name not in apart]
        return {"as": self.kind, **{name: getattr(self, name) for name in names}}

    def make_cameras(self, places: Float[np.ndarray, "F V 3"]) -> list[Camera]:
        """Make the cameras, and check that each sees part of the body in some frame. Raises `InputError`."""
        corners = places.reshape(-1, 3)
        low, high = corners.min(0), corners.max(0)
        if self.cameras is None:
            middle, top = 0.5 * (low + high), low[1] + self.height
            where, cameras = "--views", ring_of_cameras(
                self.views, self.arc, self.distance, top, middle, self.resolution, self.field_of_view
            )  # fmt: skip
        else:
            where, cameras = str(self.cameras), read_cameras(self.cameras)
        check_views(cameras, corners, where)
        return cameras

    def scan(
        self, scanner: Scanner, cameras: list[Camera], body: Body, motion: Motion, frame: int
    ) -> FusedScan:
        """Scan one frame and write it. Raises `InputError` if all views are empty."""
        vertices = np.asarray(pose_body(body, motion[frame]).vertices, float)
        fused = scan_frame(scanner, cameras, vertices, np.asarray(body.faces), self.seed, frame)
        if len(fused.points) == 0 or (scanner.mesh and len(fused.faces) == 0):
            raise InputError(
                f"frame {frame}: all {len(cameras)} views are empty; move the cameras, reduce --drop and --holes, "
                "or increase --max-grazing-angle. The previous frames are kept."
            )
        write_ply(frame_path(self.out, frame), fused.points, fused.normals, fused.views, fused.faces)
        return fused


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
