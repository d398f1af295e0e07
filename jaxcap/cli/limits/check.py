"""`jaxcap limits check`: violations of joint limits in a motion."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from ...io.table import write_json
from ...limits.distance_from_samples import sample_distance_frames
from ...limits.frame_evaluation import comfort_frames
from ...limits.implicit_surface import SurfaceLimits
from ..console.console import print_table, say
from ..console.options import Flag, MotionSpec, OptionalBody, OptionalUnit, arg
from ..outputs import check_new
from .motion_limits import LimitsFile, MotionLimits, format_runs, read_motion_limits


@dataclass
class Check:
    """Report the joints of a motion that violate limits: in which frames, and by how much.

    For learned limits, two more columns are reported. Comfort is 1 for the most frequent rotations of the motions that the limits
    were learned from, and 0 for rotations that they do not show. Furthest is the largest rotation to the nearest one that these
    motions show, also where the limits allow it."""

    motion: MotionSpec
    limits: LimitsFile
    """Joint limits: a result of `jaxcap limits learn`, or a .cst or .asf file."""
    out: Annotated[Path | None, arg(aliases=("-o",), metavar="OUT", help_behavior_hint="")] = None
    """Output file for the report with all frames, .json."""
    body: OptionalBody = None
    unit: OptionalUnit = None
    """Unit of the motion's lengths, if its file states none. Default: centimetres for BVH."""
    overwrite: Flag = False
    """Replace the report if it exists."""

    def run(self) -> None:
        check_new(self.out, self.overwrite)
        held = read_motion_limits(self.motion, self.limits, self.unit, self.body)
        comforts, distances = comfort_of(held), distance_of(held)
        say(format_summary(self.motion.name, held))
        limited = sorted(set(np.asarray(held.limits.residual_joints(held.skeleton)).tolist()))
        names = held.skeleton.names
        print_table(
            ["joint", "beyond", "worst", "furthest", "comfort", "frames"],
            [
                [
                    names[joint],
                    f"{100 * held.is_violated[:, joint].mean():.2f} %",
                    f"{held.degrees[:, joint].max():.1f}°",
                    f"{distances[names[joint]].max():.1f}°" if names[joint] in distances else "-",
                    f"{np.median(comforts[names[joint]]):.2f}" if names[joint] in comforts else "-",
                    format_runs(held.is_violated[:, joint]),
                ]
                for joint in limited
            ],
        )
        if self.out is not None:
            write_json(self.out, build_report(held, comforts, distances, limited))
            say(f"written: {self.out}")


def format_summary(name: str, checked: MotionLimits) -> str:
    frames = np.any(checked.is_violated, axis=1)
    return (
        f"{name}: {len(checked.is_violated)} frames, {int(frames.sum())} with a joint beyond its limits "
        f"({100 * frames.mean():.2f} %)"
    )


def comfort_of(checked: MotionLimits) -> dict[str, np.ndarray]:
    """Compute the comfort of every frame by joint, for learned limits."""
    if not isinstance(checked.limits, SurfaceLimits):
        return {}
    found = np.asarray(comfort_frames(checked.limits, checked.skeleton, checked.motion), float)
    return {s.joint: found[:, column] for column, s in enumerate(checked.limits.surfaces)}


def distance_of(checked: MotionLimits) -> dict[str, np.ndarray]:
    """Compute the distance of every frame from all that was seen, degrees, by joint, for learned limits."""
    if not isinstance(checked.limits, SurfaceLimits):
        return {}
    found = np.degrees(np.asarray(sample_distance_frames(checked.limits, checked.skeleton, checked.motion)))
    return {s.joint: found[:, column] for column, s in enumerate(checked.limits.surfaces)}


def build_report(
    checked: MotionLimits,
    comforts: dict[str, np.ndarray],
    distances: dict[str, np.ndarray],
    limited: list[int],
) -> dict:
    """Build the report for JSON: angles in degrees, comfort as a share of the samples."""
    joints = {}
    for joint in limited:
        name = checked.skeleton.names[joint]
        joints[name] = {
            "beyond_share": float(checked.is_violated[:, joint].mean()),
            "worst_degrees": float(checked.degrees[:, joint].max()),
            "frames_beyond": np.flatnonzero(checked.is_violated[:, joint]).tolist(),
            "degrees": np.round(checked.degrees[:, joint], 3).tolist(),
        }
        if name in comforts:
            joints[name]["degrees_from_seen"] = np.round(distances[name], 3).tolist()
            joints[name]["comfort"] = np.round(comforts[name], 4).tolist()
    return {"frames": len(checked.is_violated), "joints": joints}
