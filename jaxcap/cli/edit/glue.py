"""`jaxcap edit glue`: animate a raw scan."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro
from jaxtyping import Float, UInt8

from ...body.body import pose_body
from ...edit.glue import animate_scan, glue_scan
from ...errors import InputError, user_message
from ...geometry.mesh import vertex_normals
from ...io.meshes.colours import read_colours
from ...io.meshes.mesh import Mesh, read_mesh
from ...io.meshes.obj import write_obj
from ...io.meshes.ply import write_ply
from ..console.console import progress, say, warn
from ..console.options import (
    BODY_FORMATS,
    MOTION_FORMATS,
    BodySpec,
    Flag,
    MotionSpec,
    OptionalFile,
    Unit,
    arg,
)
from ..sources import load_body
from ..track.results import make_writable
from .files import Frames, frame_range, load_checked_motion

#: distance of points from the body above which a warning is given, metres
WARNING_DISTANCE = 0.05


@dataclass
class Glue:
    """Animate a raw scan with the body that is fitted to the scan: each point of the scan is attached to the closest
    triangle of the body.

    A mesh is written for each frame, with the triangles and colours of the scan."""

    scan: tyro.conf.Positional[Annotated[Path, arg(metavar="SCAN")]]
    """Scan of the person, a mesh or a cloud: .ply, .obj, .off or .glb."""
    body: Annotated[BodySpec, arg(help=f"Body that is fitted to the scan: {BODY_FORMATS}.")]
    motion: Annotated[MotionSpec, arg(help=f"Motion of the body that animates the scan: {MOTION_FORMATS}.")]
    out: Annotated[Path, arg(aliases=("-o",), metavar="FOLDER")]
    """Output folder for glued_0000.ply, glued_0001.ply, ..."""
    fitted: OptionalFile = None
    """Motion with the pose in which the body is fitted to the scan. Default: MOTION."""
    frame: int = 0
    """Frame with the pose of the scan, in --fitted if it is given, else in MOTION; counted from 0."""
    frames: Frames = None
    """First and last frame of MOTION to write. Default: all frames."""
    max_distance: Annotated[float, arg(metavar="METRES")] = 0.3
    """Largest distance of a scan point from the body, metres. A point further away is an error."""
    kind: Annotated[Literal["ply", "obj"], arg(name="as")] = "ply"
    """Format of the meshes."""
    unit: Unit = "m"
    """Unit of the scan, and of BODY if it is a mesh: m, dm, cm, mm, in or ft."""
    overwrite: Flag = False
    """Replace the meshes in the folder."""

    def run(self) -> None:
        if not 0 < self.max_distance < np.inf:
            raise InputError(f"--max-distance is {self.max_distance:g}; it must be above 0 metres.")
        body, _ = load_body(self.body, unit=self.unit)
        scan = read_mesh(self.scan, self.unit)
        colours = read_colours(self.scan, len(scan.vertices))
        _, motion = load_checked_motion(self.motion, None, body)
        where = self.motion if self.fitted is None else self.fitted
        fitted = motion if self.fitted is None else load_checked_motion(self.fitted, None, body)[1]
        if not 0 <= self.frame < len(fitted):
            raise InputError(
                f"{where}: there is no frame {self.frame} in this motion; its {len(fitted)} frames are 0 to {len(fitted) - 1}."
            )
        first, last = frame_range(motion, self.frames, self.motion)
        vertices = np.asarray(pose_body(body, fitted[self.frame]).vertices, float)
        self.check_size(scan, vertices)
        try:
            attachment = glue_scan(scan.vertices, vertices, np.asarray(body.faces), self.max_distance)
        except ValueError as error:
            raise InputError(f"{self.scan}: {user_message(error)}") from None
        off = np.abs(np.asarray(attachment.heights))
        if (off > WARNING_DISTANCE).any():
            warn(
                f"{self.scan}: {100 * (off > WARNING_DISTANCE).mean():.1f} % of the points are more than {1000 * WARNING_DISTANCE:.0f} mm away from the "
                "body; other objects in the scan move with it, too"
            )
        self.begin()
        numbers = range(first, last + 1)
        for frame in progress(numbers, len(numbers), label="gluing"):
            self.write(frame, scan, np.asarray(animate_scan(attachment, body, motion[frame]), float), colours)
        said = "with their colours" if colours is not None else "without colours, as the scan has none"
        say(
            f"{len(numbers)} meshes of {len(scan.vertices)} points and {len(scan.faces)} triangles, {said}, are in {self.out}"
        )

    def check_size(self, scan: Mesh, vertices: Float[np.ndarray, "V 3"]) -> None:
        sizes = [float(np.ptp(points, axis=0).max()) for points in (scan.vertices, vertices)]
        if not 1 / 5.0 < sizes[0] / max(sizes[1], 1e-9) < 5.0:
            raise InputError(
                f"{self.scan}: the scan is {sizes[0]:.4g} m long and the body {sizes[1]:.4g} m; "
                "give the unit of the scan with --unit."
            )

    def begin(self) -> None:
        """Make the folder and remove glued scans from it, if --overwrite is given. Raises `InputError`."""
        make_writable(self.out)
        there = [path for path in self.out.iterdir() if re.fullmatch(r"glued_\d{4,}\.(ply|obj)", path.name)]
        if there and not self.overwrite:
            raise InputError(
                f"{self.out}: this folder contains glued scans; give --overwrite to replace them."
            )
        for path in there:
            path.unlink()

    def write(
        self,
        frame: int,
        scan: Mesh,
        points: Float[np.ndarray, "N 3"],
        colours: UInt8[np.ndarray, "N 4"] | None,
    ) -> None:
        path = self.out / f"glued_{frame:04d}.{self.kind}"
        if self.kind == "ply":
            write_ply(path, points, vertex_normals(points, scan.faces), faces=scan.faces, colours=colours)
            return
        write_obj(path, points, scan.faces, colours)
