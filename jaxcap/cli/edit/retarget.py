"""`jaxcap edit retarget`: the motion of one person for another."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from ...body.body import Body
from ...body.kinematics import joint_paths
from ...body.matching.joint_matches import UnmatchedJoints
from ...body.matching.plan import UP, plan_retarget
from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ...edit.retargeting.point_pairs import match_points
from ...edit.retargeting.retarget import retarget
from ...edit.retargeting.retarget_shape import retarget_shape
from ...edit.retargeting.soles import ground, lowest_heights, motion_floor_height, sole_heights
from ...errors import InputError, user_message
from ...io.skeletons.joint_names import write_joint_names
from ..console.console import progress, say, warn
from ..console.options import BODY_FORMATS, BodySpec, Flag, OptionalBody, OptionalFile, OptionalUnit, arg
from ..motions import extent
from ..outputs import check_motion, check_new
from ..sources import load_body
from .files import MotionFile, OutMotion, load_checked_motion, write_edited
from .pairs import parse_point_pair, read_name_pairs, read_pair_table
from .skeletons import MAX_SIZE_RATIO, has_known_unit, load_target, skeleton_of

#: distance of a floor from the lowest joint above which it is likely in another unit, metres
MAX_FLOOR_DISTANCE = 5.0


class RetargetedMotion(NamedTuple):
    """A motion of the target, in the world of the source."""

    motion: Motion
    #: target metres for one source metre
    ratio: float
    #: height along `up`, metres
    floor: float
    up: Float[np.ndarray, "3"]


@dataclass
class Retarget:
    """Retarget a motion, that is, transfer it to another body or skeleton: limbs keep their directions, and feet stay
    on the floor.

    Two bodies with the same mesh are aligned by their surfaces, as their vertices correspond. All others are aligned
    by the names of their joints."""

    motion: MotionFile
    target: Annotated[
        BodySpec,
        arg(
            metavar="TARGET",
            help=f"Body that gets the motion: {BODY_FORMATS}; or a skeleton alone: .skl, .bvh, .asf or a motion .npz.",
        ),
    ]
    out: OutMotion
    """Output file for the target's motion, .bvh or .npz."""
    source: OptionalBody = None
    by: Literal["auto", "surface", "names"] = "auto"
    """Alignment of source and target. auto uses the surface if --source has the mesh of TARGET and no table of joints
    is read or written; else it uses the names."""
    names: OptionalFile = None
    """Table of matching joints. It overrides matches by name and hierarchy. Give a .json that was written by
    --write-names or by a run with unmatched joints, or a text file with a source joint and a target joint per line."""
    write_names: OptionalFile = None
    """Output file for the table of matched joints, .json. It can be edited and passed to --names."""
    points: OptionalFile = None
    """Text file of points to align: per line a source point, a target point, and a weight if it is not 1. A name
    means a joint, and a number a vertex."""
    in_place: Flag = False
    """Move the points of --points to the exact positions of the source's points, not to positions scaled to the
    target's size."""
    ground: Flag = False
    """Raise or lower TARGET, a body, in every frame so that its soles are as high as the source's, scaled to the
    target's size."""
    floor: Annotated[float | None, arg(metavar="METRES", help_behavior_hint="")] = None
    """Height of the source's floor, metres. Default: the height of the lowest point of the source."""
    unit: OptionalUnit = None
    """Unit of the motion's lengths, if its file states none. Default: centimetres for BVH."""
    target_unit: OptionalUnit = None
    """Unit of the target's lengths, if its file states none."""
    overwrite: Flag = False
    """Replace the motion if it exists."""

    def run(self) -> None:
        self.check()
        source, target = self.load_source(), load_target(self.target, self.target_unit)
        skeleton, motion = self.read(source)
        self.check_units(skeleton, skeleton_of(target))
        given = skeleton if source is None else source
        try:
            surface = self.uses_surface(source, target)
            if surface:
                assert source is not None and isinstance(target, Body)
                found = self.retarget_by_surface(motion, source, target)
            else:
                found = self.retarget_by_names(motion, given, skeleton_of(target))
            if self.points is not None:
                found = self.align_points(motion, given, target, found)
            if self.ground:
                assert isinstance(target, Body)
                found = self.ground_soles(motion, given, target, found)
        except InputError:
            raise
        except ValueError as error:
            raise InputError(f"{self.motion}: {user_message(error)}") from None
        how = "surface" if surface else "joint names"
        say(
            f"{self.motion.name} retargeted by {how}: 1 m becomes {found.ratio:.3f} m, the floor is at {found.floor:.3f} m"
        )
        if isinstance(target, Body):
            low = lowest_heights(target, found.motion.poses, found.up) - found.floor
            say(
                f"height of the lowest vertex above the floor: median {1000 * np.median(low):.0f} mm, from "
                f"{1000 * low.min():.0f} to {1000 * low.max():.0f} mm"
            )
        write_edited(self.out, skeleton_of(target), found.motion)

    def check(self) -> None:
        """Check that the options are compatible. Raises `InputError`."""
        check_motion(self.out, self.overwrite)
        if self.by == "surface" and self.source is None:
            raise InputError("--by surface needs the body of the motion; give it with --source.")
        if self.in_place and self.points is None:
            raise InputError("--in-place needs points; give them with --points.")
        for name, path in (("--names", self.names), ("--write-names", self.write_names)):
            if path is not None and self.by == "surface":
                raise InputError(
                    f"{name} is for retargeting by names, and --by surface was given; omit one of them."
                )
        if self.write_names is not None:
            self.check_table(self.write_names)
        if self.floor is not None and not np.isfinite(self.floor):
            raise InputError(f"--floor is {self.floor}; it must be a number of metres.")

    def check_table(self, path: Path) -> None:
        """Check that a table of joints can be written to a path. Raises `InputError`."""
        if path.suffix.lower() != ".json":
            raise InputError(
                f"{path}: a table of joints is written as .json; give a name that ends in .json."
            )
        check_new(path, self.overwrite)

    def load_source(self) -> Body | None:
        return None if self.source is None else load_body(self.source)[0]

    def read(self, source: Body | None) -> tuple[Skeleton, Motion]:
        try:
            return load_checked_motion(self.motion, self.unit, source)
        except InputError as error:
            said = re.split("; retarget it with", user_message(error))
            if source is None or len(said) == 1:
                raise
            raise InputError(
                f"{said[0]}; --source {self.source} is not the body of this motion; give the right body, or omit --source."
            ) from None

    def check_units(self, source: Skeleton, target: Skeleton) -> None:
        reaches = extent(source), extent(target)
        if not 1 / MAX_SIZE_RATIO < reaches[0] / max(reaches[1], 1e-9) < MAX_SIZE_RATIO:
            raise InputError(
                f"{self.motion}: its skeleton extends over {reaches[0]:.3g} m at rest and that of {self.target} over "
                f"{reaches[1]:.3g} m; {self.unit_advice()}."
            )

    def unit_advice(self) -> str:
        """Format the advice for a source and a target of very different sizes."""
        says = [
            f"the unit of the {which} with {option}"
            for option, which, file in (
                ("--unit", "motion", self.motion),
                ("--target-unit", "target", self.target),
            )
            if not has_known_unit(file)
        ]
        return f"give {' or '.join(says)}" if says else "the unit of one of the files is wrong"

    def floor_height(self, motion: Motion, source: Body | Skeleton, up: np.ndarray) -> float:
        """Return the user's floor height, or the height of the source's lowest point."""
        low = motion_floor_height(source if self.floor is None else skeleton_of(source), motion.poses, up)
        if self.floor is not None and abs(self.floor - low) > MAX_FLOOR_DISTANCE:
            warn(
                f"--floor is {self.floor:g} m, and the lowest joint of the motion is at {low:.2f} m; it is in metres"
            )
        return low if self.floor is None else self.floor

    def uses_surface(self, source: Body | None, target: Body | Skeleton) -> bool:
        alike = (
            source is not None
            and isinstance(target, Body)
            and np.array_equal(np.asarray(source.faces), np.asarray(target.faces))
            and len(source.vertices) == len(target.vertices)
            and len(source.faces) > 0
        )
        if self.by == "surface" and not alike:
            raise InputError(
                f"{self.target}: its mesh is not that of {self.source}, so their vertices do not correspond; omit "
                "--by surface."
            )
        if self.ground and not isinstance(target, Body):
            raise InputError(f"{self.target}: --ground needs a body with a surface; this is a skeleton.")
        return alike and self.by != "names" and self.names is None and self.write_names is None

    def retarget_by_surface(self, motion: Motion, source: Body, target: Body) -> RetargetedMotion:
        moved = retarget_shape(
            motion,
            source,
            target,
            floor=self.floor_height(motion, source, UP),
            progress=lambda blocks: progress(blocks, len(blocks), label="retargeting", noun="blocks"),
        )
        say(
            f"RMS error of the surface in the source's pose: mean {1000 * moved.rmse.mean():.1f} mm, "
            f"{1000 * moved.rmse.max():.1f} mm in the worst frame"
        )
        return RetargetedMotion(moved.motion, moved.ratio, moved.floor, UP)

    def retarget_by_names(
        self, motion: Motion, source: Body | Skeleton, target: Skeleton
    ) -> RetargetedMotion:
        names = None if self.names is None else read_name_pairs(self.names)
        skeleton = skeleton_of(source)
        try:
            plan = plan_retarget(skeleton, target, names, motion)
        except UnmatchedJoints as error:
            raise InputError(
                f"{self.motion}: {user_message(error).rstrip('.')}; {self.write_table_template(error, target)}"
            ) from None
        for line in plan.matches.lines():
            say(line)
        for line in plan.matches.warnings:
            warn(f"{self.motion}: {line}")
        if self.write_names is not None:
            write_joint_names(self.write_names, plan.matches.names, list(plan.matches.unmatched_target))
            say(f"written: {self.write_names}, the table of joints")
        floor = self.floor_height(motion, source, plan.up)
        moved = retarget(motion, skeleton, target, floor=floor, plan=plan)
        return RetargetedMotion(moved, plan.ratio, floor, plan.up)

    def write_table_template(self, error: UnmatchedJoints, target: Skeleton) -> str:
        """Write an incomplete table of joints next to the requested motion, and return a sentence with its
        path."""
        path = self.write_names or self.out.with_name(f"{self.out.stem}_names.json")
        if path.exists() and not self.overwrite:
            return f"{path} already exists; fill it in and give it with --names, or give --overwrite to write a new one."
        blank = dict.fromkeys(error.unassigned, "")
        write_joint_names(path, error.names | blank, sorted(set(target.names) - set(error.names.values())))
        return f'{path} contains the matches found; fill in its empty entries (""), some or all, and give it with --names.'

    def ground_soles(
        self, motion: Motion, source: Body | Skeleton, target: Body, found: RetargetedMotion
    ) -> RetargetedMotion:
        if isinstance(source, Body):
            soles = lowest_heights(source, motion.poses, found.up) - found.floor
        else:
            soles = sole_heights(joint_paths(source, motion.poses), found.up)
        heights = found.floor + found.ratio * soles
        return found._replace(motion=ground(target, found.motion, heights, found.up))

    def align_points(
        self, motion: Motion, source: Body | Skeleton, target: Body | Skeleton, found: RetargetedMotion
    ) -> RetargetedMotion:
        assert self.points is not None
        pairs = [parse_point_pair(self.points, row) for row in read_pair_table(self.points)]
        ratio = 1.0 if self.in_place else found.ratio
        met = match_points(
            motion, source, target, found.motion, pairs, ratio=ratio, floor=found.floor, up=found.up
        )
        for column, pair in enumerate(pairs):
            off = 1000 * met.distances[:, column]
            say(
                f"{pair.source} and {pair.target}: {off.mean():.1f} mm apart on average, {off.max():.1f} mm at most"
            )
        return found._replace(motion=met.motion)
