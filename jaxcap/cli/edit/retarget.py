"""`jaxcap edit retarget`: the motion of one person for another."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from ...body.body import Body
from ...body.kinematics import joint_paths
from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ...edit.ground import ground, lowest, sole_heights
from ...edit.meet_points import PointPair, meet_points
from ...edit.retarget import UP, floor_of, retarget, size_ratio
from ...edit.retarget_shape import retarget_shape
from ...errors import InputError
from ...io.body_motion import read_motion_of
from ..options import Flag, OptionalFile, OptionalUnit, arg
from ..say import progress, say
from ..sources import load_body
from .files import (
    OTHER_UNIT,
    MotionFile,
    OutMotion,
    check_out,
    extent,
    load_target,
    read_edited,
    save,
    skeleton_of,
    table_of,
)

OptionalBody = Annotated[str | None, arg(metavar="BODY", help_behavior_hint="")]


@dataclass
class Retarget:
    """Give a motion to another body or skeleton: limbs point the same way, feet keep to the floor.

    Bodies of one mesh, whose vertices correspond, are aligned by their surfaces; all others by the names of joints."""

    motion: MotionFile
    """.bvh, .amc (with its .asf beside it) or .npz."""
    target: tyro.conf.Positional[Annotated[str, arg(metavar="TARGET")]]
    """`human` (with options, as in `human:female,height=1.6`), a body .npz, or a skeleton (.bvh, .asf, .skl, .npz)."""
    out: OutMotion
    """The target's motion, .bvh or .npz."""
    source: OptionalBody = None
    """The body that the motion is of."""
    by: Literal["auto", "surface", "names"] = "auto"
    """By what source and target are aligned; auto takes the surface where --source has the target's mesh."""
    names: OptionalFile = None
    """A text file with the name of a joint of the source and one of the target in each line, where names do not match."""
    points: OptionalFile = None
    """A text file of points that are to meet: in each line one of the source, one of the target, and a weight if not 1. A
    name is a joint, a number a vertex."""
    in_place: Flag = False
    """Bring --points to the very places of the source's, not to those in the target's size."""
    ground: Flag = False
    """Lift or lower every frame of a body until its soles are as high as the source's."""
    floor: Annotated[float | None, arg(metavar="METRES", help_behavior_hint="")] = None
    """How high the source's floor lies, metres; as high as its lowest point where not given."""
    unit: OptionalUnit = None
    """Unit of the motion's lengths, in place of what it says."""
    overwrite: Flag = False
    """Replace the motion where it is there."""

    def run(self) -> None:
        self.check()
        source, target = self.source_body(), load_target(self.target)
        skeleton, motion = self.read(source)
        self.check_units(skeleton, skeleton_of(target))
        try:
            surface = self.by_surface(source, target)
            if surface:
                assert source is not None and isinstance(target, Body)
                moved, ratio, floor = self.along_surface(source, target, motion)
            else:
                moved, ratio, floor = self.along_names(skeleton, source, skeleton_of(target), motion)
            if self.points is not None:
                given = source if source is not None else skeleton
                moved = self.meet(moved, target, motion, given, ratio, floor)
            if self.ground:
                assert isinstance(target, Body)
                moved = self.stand(moved, target, skeleton, source, motion, ratio, floor)
        except ValueError as error:
            raise InputError(f"{self.motion}: {error}") from None
        how = "surface" if surface else "names of joints"
        say(
            f"{self.motion.name} retargeted by the {how}: 1 m becomes {ratio:.3f} m, the floor is at {floor:.3f} m"
        )
        if isinstance(target, Body):
            low = lowest(target, moved.poses) - floor
            say(
                f"the lowest vertex is {1000 * np.median(low):.0f} mm over the floor in the median, from "
                f"{1000 * low.min():.0f} to {1000 * low.max():.0f} mm"
            )
        save(self.out, skeleton_of(target), moved)

    def check(self) -> None:
        """That the options go together. Raises `InputError`."""
        check_out(self.out, self.overwrite)
        if self.by == "surface" and self.source is None:
            raise InputError("--by surface takes the body that the motion is of; give it by --source.")
        if self.in_place and self.points is None:
            raise InputError("--in-place is for --points, and none are given.")
        if self.names is not None and self.by == "surface":
            raise InputError(
                "--names is for retargeting by names, and --by surface was given; leave one of them out."
            )
        if self.floor is not None and not np.isfinite(self.floor):
            raise InputError(f"--floor is {self.floor}; it must be a number of metres.")

    def source_body(self) -> Body | None:
        return None if self.source is None else load_body(self.source)[0]

    def read(self, source: Body | None) -> tuple[Skeleton, Motion]:
        skeleton, motion = read_edited(self.motion, self.unit)
        if source is not None:
            return source.skeleton, read_motion_of(source, self.motion, self.unit)
        return skeleton, motion

    def check_units(self, source: Skeleton, target: Skeleton) -> None:
        reaches = extent(source), extent(target)
        if not 1 / OTHER_UNIT < reaches[0] / max(reaches[1], 1e-9) < OTHER_UNIT:
            raise InputError(
                f"{self.motion}: its joints reach over {reaches[0]:.3g} m at rest and those of {self.target} over "
                f"{reaches[1]:.3g} m; say by --unit what the motion's lengths are in."
            )

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
                f"{self.target}: its mesh is not that of {self.source}, so their vertices do not correspond; leave --by "
                "surface out."
            )
        if self.ground and not isinstance(target, Body):
            raise InputError(f"{self.target}: --ground takes a body with a surface; this is a skeleton.")
        return alike and self.by != "names" and self.names is None

    def along_surface(self, source: Body, target: Body, motion: Motion) -> tuple[Motion, float, float]:
        found = retarget_shape(
            source,
            target,
            motion,
            floor=self.floor,
            progress=lambda blocks: progress(blocks, len(blocks), label="retargeting"),
        )
        say(
            f"the surface is {1000 * found.rmse.mean():.1f} mm off the source's pose in the target's build, "
            f"{1000 * found.rmse.max():.1f} mm in the worst frame"
        )
        return found.motion, found.ratio, found.floor

    def along_names(
        self, skeleton: Skeleton, source: Body | None, target: Skeleton, motion: Motion
    ) -> tuple[Motion, float, float]:
        names = None if self.names is None else {row[1]: row[2] for row in table_of(self.names)}
        floor = self.floor
        if floor is None and source is not None:
            floor = floor_of(lowest(source, motion.poses)[:, None, None] * UP)
        elif floor is None:
            floor = floor_of(joint_paths(skeleton, motion.poses))
        moved = retarget(motion, skeleton, target, names, floor=floor)
        return moved, size_ratio(skeleton, target, names), floor

    def stand(self, moved, target: Body, skeleton, source, motion, ratio: float, floor: float) -> Motion:
        if source is not None:
            soles = lowest(source, motion.poses) - floor
        else:
            soles = sole_heights(joint_paths(skeleton, motion.poses))
        return ground(target, moved, floor + ratio * soles)

    def meet(self, moved, target, motion, source, ratio: float, floor: float) -> Motion:
        assert self.points is not None
        pairs = [point_pair(self.points, row) for row in table_of(self.points)]
        met = meet_points(
            moved, target, motion, source, pairs, ratio=1.0 if self.in_place else ratio, floor=floor
        )
        for column, pair in enumerate(pairs):
            off = 1000 * met.distances[:, column]
            say(f"{pair.source} and {pair.target}: {off.mean():.1f} mm apart, {off.max():.1f} mm at most")
        return met.motion


def point_pair(path: Path, row: list[str]) -> PointPair:
    """A line of `table_of`, with its number before it. Raises `InputError`."""
    number, here, there, *weight = row
    try:
        heavy = float(weight[0]) if weight else 1.0
    except ValueError:
        raise InputError(f"{path}:{number}: the weight '{weight[0]}' is not a number.") from None
    return PointPair(*(int(word) if word.isdigit() else word for word in (here, there)), weight=heavy)
