"""`jaxcap edit retarget`: the motion of one person for another."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from ...body.body import Body
from ...body.kinematics import joint_paths
from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ...edit.matching.matches import UnmatchedJoints
from ...edit.retargeting.plan import UP, plan_retarget
from ...edit.retargeting.point_pairs import meet_points
from ...edit.retargeting.retarget import retarget
from ...edit.retargeting.retarget_shape import retarget_shape
from ...edit.retargeting.soles import floor_under, ground, lowest, sole_heights
from ...errors import InputError, sentence_of
from ...io.skeletons.joint_names import write_joint_names
from ..console.console import progress, say, warn
from ..console.options import BODY_WORDS, BodySpec, Flag, OptionalBody, OptionalFile, OptionalUnit, arg
from ..motions import extent
from ..outputs import check_motion
from ..sources import load_body
from .files import MotionFile, OutMotion, read_edited, save
from .pairs import names_of, point_pair, table_of
from .skeletons import OTHER_UNIT, load_target, says_unit, skeleton_of

#: distance of a floor from the lowest joint above which it is likely in another unit, metres
FAR = 5.0


class Found(NamedTuple):
    """A motion of the target, in the world of the source."""

    motion: Motion
    #: target metres for one source metre
    ratio: float
    #: height along `up`, metres
    floor: float
    up: Float[np.ndarray, "3"]


@dataclass
class Retarget:
    """Retarget a motion to another body or skeleton: limbs keep their directions, and feet stay on the floor.

    Bodies with the same mesh, whose vertices correspond, are aligned by their surfaces; all others by the names of
    joints."""

    motion: MotionFile
    target: Annotated[
        BodySpec,
        arg(metavar="TARGET", help=f"{BODY_WORDS}; or only a skeleton: .skl, .bvh, .asf, a motion .npz."),
    ]
    out: OutMotion
    """Output file for the target's motion, .bvh or .npz."""
    source: OptionalBody = None
    by: Literal["auto", "surface", "names"] = "auto"
    """Alignment of source and target. auto uses the surface if --source has the mesh of the target, else the
    names."""
    names: OptionalFile = None
    """Table of matching joints, which overrides matches by name and hierarchy. JSON, as --write-names or an error
    message about unmatched joints writes it; or a text file with a source joint and a target joint per line."""
    write_names: OptionalFile = None
    """Write the table of matched joints as JSON, to edit and to pass to --names."""
    points: OptionalFile = None
    """Text file of points to align: per line a source point, a target point, and a weight if it is not 1. A name is a
    joint, a number is a vertex."""
    in_place: Flag = False
    """Move --points to the exact positions of the source's points, not to positions scaled to the target's size."""
    ground: Flag = False
    """Raise or lower every frame of a body so that its soles are as high as the source's, scaled to the target's
    size."""
    floor: Annotated[float | None, arg(metavar="METRES", help_behavior_hint="")] = None
    """Height of the source's floor, metres. Default: the height of its lowest point."""
    unit: OptionalUnit = None
    """Unit of the motion's lengths, if its file states none. Default: centimetres for BVH."""
    target_unit: OptionalUnit = None
    """Unit of the target's lengths, if its file states none."""
    overwrite: Flag = False
    """Replace the motion if it exists."""

    def run(self) -> None:
        self.check()
        source, target = self.source_body(), load_target(self.target, self.target_unit)
        skeleton, motion = self.read(source)
        self.check_units(skeleton, skeleton_of(target))
        given = skeleton if source is None else source
        try:
            surface = self.by_surface(source, target)
            if surface:
                assert source is not None and isinstance(target, Body)
                found = self.along_surface(motion, source, target)
            else:
                found = self.along_names(motion, given, skeleton_of(target))
            if self.points is not None:
                found = self.meet(motion, given, target, found)
            if self.ground:
                assert isinstance(target, Body)
                found = self.stand(motion, given, target, found)
        except InputError:
            raise
        except ValueError as error:
            raise InputError(f"{self.motion}: {sentence_of(error)}") from None
        how = "surface" if surface else "joint names"
        say(
            f"{self.motion.name} retargeted by {how}: 1 m becomes {found.ratio:.3f} m, the floor is at {found.floor:.3f} m"
        )
        if isinstance(target, Body):
            low = lowest(target, found.motion.poses, found.up) - found.floor
            say(
                f"height of the lowest vertex above the floor: median {1000 * np.median(low):.0f} mm, from "
                f"{1000 * low.min():.0f} to {1000 * low.max():.0f} mm"
            )
        save(self.out, skeleton_of(target), found.motion)

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
            raise InputError(f"{path}: a table of joints is written as .json; give a name that ends in .json.")
        if path.exists() and not self.overwrite:
            raise InputError(f"{path}: this file already exists; give --overwrite to replace it.")

    def source_body(self) -> Body | None:
        return None if self.source is None else load_body(self.source)[0]

    def read(self, source: Body | None) -> tuple[Skeleton, Motion]:
        try:
            return read_edited(self.motion, self.unit, source)
        except InputError as error:
            said = re.split("; retarget it with", sentence_of(error))
            if source is None or len(said) == 1:
                raise
            raise InputError(
                f"{said[0]}; --source {self.source} is not the body of this motion; give the right body, or omit --source."
            ) from None

    def check_units(self, source: Skeleton, target: Skeleton) -> None:
        reaches = extent(source), extent(target)
        if not 1 / OTHER_UNIT < reaches[0] / max(reaches[1], 1e-9) < OTHER_UNIT:
            raise InputError(
                f"{self.motion}: its skeleton extends over {reaches[0]:.3g} m at rest and that of {self.target} over "
                f"{reaches[1]:.3g} m; {self.units_to_say()}."
            )

    def units_to_say(self) -> str:
        """Format the advice for a source and a target of very different sizes."""
        says = [
            f"the unit of the {which} with {option}"
            for option, which, file in (
                ("--unit", "motion", self.motion),
                ("--target-unit", "target", self.target),
            )
            if not says_unit(file)
        ]
        return f"give {' or '.join(says)}" if says else "the unit of one of the files is wrong"

    def floor_for(self, motion: Motion, source: Body | Skeleton, up: np.ndarray) -> float:
        """Return the user's floor height, or the height of the source's lowest point."""
        low = floor_under(source if self.floor is None else skeleton_of(source), motion.poses, up)
        if self.floor is not None and abs(self.floor - low) > FAR:
            warn(
                f"--floor is {self.floor:g} m, and the lowest joint of the motion is at {low:.2f} m; it is in metres"
            )
        return low if self.floor is None else self.floor

    def by_surface(self, source: Body | None, target: Body | Skeleton) -> bool:
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

    def along_surface(self, motion: Motion, source: Body, target: Body) -> Found:
        moved = retarget_shape(
            motion,
            source,
            target,
            floor=self.floor_for(motion, source, UP),
            progress=lambda blocks: progress(blocks, len(blocks), label="retargeting", what="blocks"),
        )
        say(
            f"RMS error of the surface in the source's pose: mean {1000 * moved.rmse.mean():.1f} mm, "
            f"{1000 * moved.rmse.max():.1f} mm in the worst frame"
        )
        return Found(moved.motion, moved.ratio, moved.floor, UP)

    def along_names(self, motion: Motion, source: Body | Skeleton, target: Skeleton) -> Found:
        names = None if self.names is None else names_of(self.names)
        skeleton = skeleton_of(source)
        try:
            plan = plan_retarget(skeleton, target, names, motion)
        except UnmatchedJoints as error:
            raise InputError(
                f"{self.motion}: {sentence_of(error).rstrip('.')}; {self.table_to_start(error, target)}"
            ) from None
        for line in plan.matches.lines():
            say(line)
        for line in plan.matches.warnings:
            warn(f"{self.motion}: {line}")
        if self.write_names is not None:
            write_joint_names(self.write_names, plan.matches.names, list(plan.matches.unmatched_target))
            say(f"written: {self.write_names}, the table of joints")
        floor = self.floor_for(motion, source, plan.up)
        moved = retarget(motion, skeleton, target, floor=floor, plan=plan)
        return Found(moved, plan.ratio, floor, plan.up)

    def table_to_start(self, error: UnmatchedJoints, target: Skeleton) -> str:
        """Write an incomplete table of joints next to the requested motion, and return a sentence with its
        path."""
        path = self.write_names or self.out.with_name(f"{self.out.stem}_names.json")
        if path.exists() and not self.overwrite:
            return f"{path} already exists; fill it in and give it with --names, or give --overwrite to write a new one."
        blank = dict.fromkeys(error.open, "")
        write_joint_names(path, error.names | blank, sorted(set(target.names) - set(error.names.values())))
        return f'{path} contains the matches found; fill in its empty entries (""), some or all, and give it with --names.'

    def stand(self, motion: Motion, source: Body | Skeleton, target: Body, found: Found) -> Found:
        if isinstance(source, Body):
            soles = lowest(source, motion.poses, found.up) - found.floor
        else:
            soles = sole_heights(joint_paths(source, motion.poses), found.up)
        heights = found.floor + found.ratio * soles
        return found._replace(motion=ground(target, found.motion, heights, found.up))

    def meet(self, motion: Motion, source: Body | Skeleton, target: Body | Skeleton, found: Found) -> Found:
        assert self.points is not None
        pairs = [point_pair(self.points, row) for row in table_of(self.points)]
        ratio = 1.0 if self.in_place else found.ratio
        met = meet_points(
            motion, source, target, found.motion, pairs, ratio=ratio, floor=found.floor, up=found.up
        )
        for column, pair in enumerate(pairs):
            off = 1000 * met.distances[:, column]
            say(f"{pair.source} and {pair.target}: {off.mean():.1f} mm apart on average, {off.max():.1f} mm at most")
        return found._replace(motion=met.motion)
