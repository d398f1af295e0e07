"""`jaxcap evaluate`: distances from scans to the body, and errors of the joints."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float

from ..body.body import pose_body
from ..body.kinematics import joint_paths
from ..body.skeleton import Skeleton
from ..errors import InputError
from ..io.archives.archive import load_arrays
from ..io.archives.npz import get_array
from ..io.meshes.clouds import read_clouds
from ..io.table import write_json
from ..metrics import Summary, distance_summary, joint_errors, scan_to_surface
from .console.console import print_table, progress, say
from .console.options import (
    BodySpec,
    CloudsSpec,
    Flag,
    MotionSpec,
    OptionalCount,
    OptionalFile,
    Skl,
    Unit,
    Up,
    Vj,
    arg,
)
from .console.record import give_figures
from .motions import load_motion, load_moving_body
from .outputs import check_new
from .sources import up_rotation


@dataclass
class Evaluate:
    """Measure distances from scans to the surface of a body, and joint errors if the true motion is given."""

    body: BodySpec
    motion: MotionSpec
    clouds: CloudsSpec
    truth: OptionalFile = None
    """True motion: a file as for MOTION, or an .npz with the arrays `joints` (F, J, 3) and `names` (J,), for F frames
    and J joints."""
    out: Annotated[OptionalFile, arg(aliases=("-o",))] = None
    """Output file for the report, .json."""
    skl: Skl = None
    vj: Vj = None
    first: OptionalCount = None
    """First cloud: the number in the file names of a pattern, otherwise counted from 0."""
    last: OptionalCount = None
    """Last cloud, inclusive."""
    unit: Unit = "m"
    """Unit of the clouds, and of BODY if it is a mesh: m, dm, cm, mm, in or ft."""
    up: Up = "y"
    """Up axis of the clouds, and of BODY if it is a mesh."""
    vertices: OptionalCount = None
    """Reduce the body to about N vertices."""
    points: OptionalCount = None
    """Use N random points of each cloud. Default: all."""
    overwrite: Flag = False
    """Replace the report if it exists."""

    def run(self) -> None:
        check_new(self.out, self.overwrite)
        if self.points is not None and self.points < 1:
            raise InputError(f"--points is {self.points}; it must be at least 1.")
        files = {"skl": self.skl, "vj": self.vj, "vertices": self.vertices, "unit": self.unit, "up": self.up}
        body, motion = load_moving_body(self.body, self.motion, **files)
        scans = read_clouds(self.clouds, self.first, self.last, self.unit)
        if motion.num_frames != len(scans):
            raise InputError(
                f"{self.motion}: the motion has {motion.num_frames} frames, but there are {len(scans)} clouds; "
                "give one cloud for each frame: select clouds with --first and --last, or frames with `jaxcap edit cut`."
            )
        turn, rng = up_rotation(self.up), np.random.default_rng(0)
        truth = None if self.truth is None else read_truth(self.truth, body.skeleton, motion.num_frames)
        distances = []
        for frame, scan in enumerate(progress(scans, len(scans), label="measuring")):
            points = scan.points
            if self.points is not None and self.points < len(points):
                points = points[rng.choice(len(points), self.points, replace=False)]
            vertices = np.asarray(pose_body(body, motion[frame]).vertices)
            distances.append(scan_to_surface(points @ turn.T, vertices, np.asarray(body.faces)))
        surface = distance_summary(np.concatenate(distances))
        report: dict = {
            "unit": "m",
            "frames": len(scans),
            "scan_to_surface": surface._asdict(),
            "per_frame": [distance_summary(d)._asdict() for d in distances],
        }
        rows = [_line("scan to surface", surface)]
        give_figures({f"scan_to_surface_{name}": value for name, value in surface._asdict().items()})
        if truth is not None:
            names, there = truth
            places = [body.skeleton.names.index(name) for name in names]
            errors = joint_errors(np.asarray(joint_paths(body.skeleton, motion.poses))[:, places], there)
            joints = distance_summary(errors.reshape(-1))
            rows.append(_line("joint centres", joints))
            give_figures({f"joint_centres_{name}": value for name, value in joints._asdict().items()})
            report["joint_centres"] = {
                **joints._asdict(),
                "percentile_99": float(np.quantile(errors, 0.99)),
                "by_joint": dict(zip(names, errors.mean(0).tolist(), strict=True)),
            }
        print_table(["millimetres", "mean", "sd", "median", "MAD", "IQR", "count"], rows)
        if self.out is not None:
            write_json(self.out, report)
            say(f"saved in {self.out}")


def read_truth(path: Path, skeleton: Skeleton, frames: int) -> tuple[list[str], Float[np.ndarray, "F K 3"]]:
    """Read the true joint positions of a file; return the joints that the skeleton has, and their positions.
    Raises `InputError`."""
    wanted = ("joints", "names")
    arrays = load_arrays(path, lambda name: name in wanted) if path.suffix.lower() == ".npz" else {}
    if "joints" in arrays:
        names = list(skeleton.names)
        if "names" in arrays:
            names = get_array(arrays, "names", path, (None,), "text").tolist()
        joints = get_array(arrays, "joints", path, (None, len(names), 3), row_name="frame")
    else:
        own, motion = load_motion(path)
        names, joints = list(own.names), np.asarray(joint_paths(own, motion.poses))
    if len(joints) != frames:
        raise InputError(
            f"{path}: the true motion has {len(joints)} frames; expected {frames}, as in the estimated motion."
        )
    shared = [name for name in names if name in skeleton.names]
    if not shared:
        raise InputError(
            f"{path}: no joint of the true motion is a joint of the body, which has {', '.join(skeleton.names)}; "
            "give the true motion of this body."
        )
    return shared, np.asarray(joints, float)[:, [names.index(name) for name in shared]]


def _line(name: str, summary: Summary) -> list[str]:
    return [name, *(f"{1000 * value:.2f}" for value in summary[:5]), str(summary.count)]
