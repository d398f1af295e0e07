"""`jaxcap limits learn`: learn joint limits from motions that show the full range."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from ...biomechanics.angle_samples import gather_angle_samples
from ...biomechanics.person_samples import gather_person_samples
from ...errors import InputError, user_message
from ...io.angle_reader import AngleUnits, is_angle_table, read_angles
from ...io.archives.limits import save_limits
from ...io.registry import MARKER_READERS, read_markers
from ...limits.implicit_surface import LimitSurface, SurfaceLimits
from ...limits.learning.choice import Sizes, find_choice
from ...limits.learning.fit_chart import chart_coordinates
from ...limits.learning.full_turns import find_full_turns
from ...limits.learning.held_out import HeldOut
from ...limits.learning.learn_limits import learn_limits
from ...limits.learning.marker_frames import arm_samples
from ...limits.learning.samples import JointSamples, angular_range, parse_joints
from ..console.console import print_table, say, warn
from ..console.options import MOTION_FORMATS, Flag, MotionsSpec, OptionalUnit, arg
from ..motions import load_motion
from ..outputs import check_npz, make_folder

#: range in degrees below which a joint's motion shows little of its limits
MIN_RANGE = 5.0
#: sizes of limits in sentences
_SIZES = {"voxel": "widths of voxels", "margin": "margins", "keyframe": "widths of keyframes"}


@dataclass
class Learn:
    """Learn joint limits from motions that show the full range; the limits of a child may depend on its parent's
    pose.

    Rotations that the motions do not show are forbidden, beyond a margin by which takes, or people, differ from each other.
    Limits of hips, knees, ankles, shoulders, elbows and wrists also apply to other skeletons of people."""

    motions: Annotated[
        MotionsSpec,
        arg(
            help=f"Motions: {MOTION_FORMATS}; or one recording of markers: .c3d, .trc, .csv; or tables of joint angles: .csv, .mat, .mot, .sto."
        ),
    ]
    joints: Annotated[str, arg(metavar="NAMES")]
    """Joints, separated by commas. PARENT:CHILD makes the limits of the child depend on the parent, as
    in LeftArm:LeftForeArm,Head. Names of the first skeleton that has the joint, or anatomical names such as
    shoulder_l:elbow_l."""
    out: Annotated[Path, arg(aliases=("-o",), metavar="OUT")]
    """Output file for the limits, .npz."""
    markers: Annotated[str | None, arg(metavar="LABELS", help_behavior_hint="")] = None
    """For a recording of markers: the labels at shoulder, upper arm, elbow and forearm, separated by commas."""
    trunk: Annotated[str | None, arg(metavar="LABELS", help_behavior_hint="")] = None
    """For a recording of markers: three labels on the trunk, to which the shoulder is attached, separated by
    commas."""
    subject: Annotated[str | None, arg(metavar="NAME", help_behavior_hint="")] = None
    """For a recording of markers with several subjects: the subject to use, as the prefix of the labels of its
    markers."""
    voxel: Annotated[float | None, arg(metavar="DEGREES", help_behavior_hint="")] = None
    """Width of the smallest voxels of rotations, degrees. Default: 2, 4 or 8 for one, two or three angles, with
    --margin; with a single take, the smallest width with which one part of it predicts enough of the rest (see
    --coverage)."""
    margin: Annotated[float | None, arg(metavar="DEGREES", help_behavior_hint="")] = None
    """Distance around the rotations of the motions that is allowed, degrees. Default: chosen, see --hold-out; none if
    --voxel is given."""
    hold_out: Annotated[HeldOut | None, arg(metavar="{people,takes,blocks}", help_behavior_hint="")] = None
    """What is left out in turn to choose widths and margins: whole people, whole takes, or blocks of ten seconds. Default:
    the first of these of which there are several."""
    people: Annotated[str | None, arg(metavar="NAMES", help_behavior_hint="")] = None
    """The person of each file, separated by commas. Default: files with equal joint positions at rest are of one
    person."""
    person_margin: Annotated[float, arg(metavar="DEGREES")] = 0.0
    """Additional margin of every joint, degrees, for the use of limits of one person for others. People's ranges differ by
    5 to 12 degrees (standard deviation)."""
    both_sides: Flag = False
    """Learn each joint also from the mirrored motion of the other side."""
    convention: Annotated[
        AngleUnits | None, arg(metavar="{isb,isb-degrees,isb-radians}", help_behavior_hint="")
    ] = None
    """Convention of tables of joint angles that do not state it: that of docs/joint_angles.md in degrees (isb), in degrees
    also if all angles are tiny (isb-degrees), or in radians (isb-radians)."""
    keyframe_width: Annotated[float | None, arg(metavar="DEGREES", help_behavior_hint="")] = None
    """Width of the voxels of the parent's rotations, degrees. Each voxel has its own limits of the child. Default:
    chosen together with --voxel."""
    min_samples: Annotated[int, arg(metavar="N")] = 1
    """Smallest number of samples with which a voxel of the smallest width is kept."""
    coverage: Annotated[float | None, arg(metavar="SHARE", help_behavior_hint="")] = None
    """Share of held-out motion that the limits have to allow. Default: 0.99, between blocks 0.98."""
    report: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")] = None
    """Output folder for pictures of samples, voxels and surfaces."""
    unit: OptionalUnit = None
    """Unit of the files' lengths, instead of the unit that they state."""
    overwrite: Flag = False
    """Replace the limits if they exist."""

    def run(self) -> None:
        self.check()
        samples = self.samples()
        try:
            turning = find_full_turns(samples)
            limits = learn_limits(
                samples,
                voxel=None if self.voxel is None else float(np.radians(self.voxel)),
                keyframe=None if self.keyframe_width is None else float(np.radians(self.keyframe_width)),
                margin=None if self.margin is None else float(np.radians(self.margin)),
                min_samples=self.min_samples,
                coverage=self.coverage,
                held_out=self.hold_out,
                person_margin=float(np.radians(self.person_margin)),
            )
        except ValueError as error:
            raise InputError(user_message(error)) from None
        save_limits(self.out, limits)
        for joint, span in turning.items():
            warn(
                f"'{joint}' turns through {np.degrees(span):.0f} degrees, so it has no limits and no joint depends on it"
            )
        print_summary(limits, samples)
        say(self.describe_choice(samples))
        say(f"written: {self.out}")
        if self.report is not None:
            self.draw(limits, samples)

    def check(self) -> None:
        """Check that options are in range and compatible. Raises `InputError`."""
        if not self.motions:
            raise InputError("There are no motions to learn from; give .bvh, .amc or .npz files.")
        check_npz(self.out, self.overwrite, "a set of limits")
        for name, width in (("--voxel", self.voxel), ("--keyframe-width", self.keyframe_width)):
            if width is not None and not 0.1 <= width <= 90:
                raise InputError(f"{name} is {width:g}; it must be between 0.1 and 90 degrees.")
        if self.min_samples < 1:
            raise InputError(f"--min-samples is {self.min_samples}; it must be at least 1.")
        for name, angle in (("--margin", self.margin), ("--person-margin", self.person_margin)):
            if angle is not None and not 0 <= angle <= 90:
                raise InputError(f"{name} is {angle:g}; it must be between 0 and 90 degrees.")
        if self.coverage is not None and not 0 < self.coverage <= 1:
            raise InputError(f"--coverage is {self.coverage:g}; it must be above 0 and at most 1.")
        if self.report is not None:
            make_folder(self.report)

    def samples(self) -> dict[str, JointSamples]:
        """Collect the rotations of the joints in all files, by joint."""
        pairs = parse_joints(self.joints)
        people = None if self.people is None else [name.strip() for name in self.people.split(",")]
        if people is not None and len(people) != len(self.motions):
            raise InputError(
                f"--people has {len(people)} names for {len(self.motions)} files; give one for each, in their order."
            )
        tables = [self.convention is not None or is_angle_table(path) for path in self.motions]
        if any(tables) and not all(tables):
            raise InputError(
                "Tables of joint angles and motions are not learned from together; convert the motions with "
                "`jaxcap convert --as angles`."
            )
        suffixes = {Path(path).suffix.lower() for path in self.motions}
        if not any(tables) and suffixes & set(MARKER_READERS):
            return self.marker_samples(pairs)
        if self.markers is not None or self.trunk is not None:
            raise InputError("--markers and --trunk need files of markers, but these are not.")
        names = [str(path) for path in self.motions]
        try:
            if any(tables):
                angles = [read_angles(path, self.convention) for path in self.motions]
                found = [
                    gather_angle_samples(angles, joint, parent, names, people, self.both_sides)
                    for joint, parent in pairs
                ]
            else:
                motions = [load_motion(path, self.unit) for path in self.motions]
                found = [
                    gather_person_samples(motions, joint, parent, names, people, self.both_sides)
                    for joint, parent in pairs
                ]
        except ValueError as error:
            raise InputError(user_message(error)) from None
        return {one.joint: one for one in found}

    def describe_choice(self, samples: dict[str, JointSamples]) -> str:
        """Describe the sizes that were chosen, and by what."""
        given = Sizes(self.voxel, self.keyframe_width, self.margin)
        found = [find_choice(one, given, self.hold_out, self.coverage) for one in samples.values()]
        names = dict.fromkeys(name for each in found for name in each.chosen)
        if not names:
            return "all sizes are those given; no motion was left out to choose them"
        what, first = " and ".join(_SIZES[name] for name in names), found[0]
        if first.left_out == "blocks":
            return (
                f"{what} are chosen by leaving out blocks of ten seconds, of which the others allow {100 * first.coverage:g} %: "
                "other takes and other people may go further"
                + ("; give several takes" if len(self.motions) == 1 else "")
            )
        one = next(iter(samples.values()))
        groups = one.people if first.left_out == "people" else one.takes
        assert groups is not None
        return (
            f"{what} are chosen by leaving out each of {len(np.unique(groups))} {first.left_out}, of which the others allow "
            f"{100 * first.coverage:g} % on average"
        )

    def marker_samples(self, pairs) -> dict[str, JointSamples]:
        if self.markers is None or self.trunk is None:
            raise InputError(
                f"{', '.join(self.motions)}: give the markers of an arm with --markers SHOULDER,UPPER,ELBOW,FOREARM, and "
                "three more with --trunk; or solve the markers first with `jaxcap markers`."
            )
        if len(self.motions) > 1 or len(pairs) != 2 or pairs[1][1] != pairs[0][0]:
            raise InputError(
                "Limits from markers need one file and one pair of joints, such as --joints shoulder:elbow."
            )
        path = next(iter(self.motions))
        frames = read_markers(path, self.unit, subject=self.subject)
        names = [[word.strip() for word in text.split(",")] for text in (self.markers, self.trunk)]
        upper, lower = arm_samples(frames, *names, names=(pairs[0][0], pairs[1][0]))
        say(f"{Path(path).name}: {len(upper.rotations)} of {len(frames)} frames show the whole arm")
        return {upper.joint: upper, lower.joint: lower}

    def draw(self, limits: SurfaceLimits, samples: dict[str, JointSamples]) -> None:
        from ...report.limit_pictures import draw_limits

        assert self.report is not None
        for surface in limits.surfaces:
            one = samples[surface.joint]
            places = chart_coordinates(surface.chart, one.rotations)
            parents = None
            if surface.parent_chart is not None and one.parent is not None:
                parents = chart_coordinates(surface.parent_chart, one.parent.rotations)
            path = self.report / f"{surface.joint}.png"
            draw_limits(path, surface, places, parents)
            say(f"written: {path}")


def print_summary(limits: SurfaceLimits, samples: dict[str, JointSamples]) -> None:
    """Print a row for each joint: its angles and range, its voxels, its parent's keyframes."""
    print_table(
        [
            "joint",
            "depends on",
            "angles",
            "samples",
            "range",
            "primitives",
            "voxels from",
            "margin",
            "keyframes",
        ],
        [_row(surface, samples[surface.joint]) for surface in limits.surfaces],
    )
    for one in samples.values():
        turned = np.degrees(angular_range(one.rotations))
        if turned < MIN_RANGE:
            warn(
                f"'{one.joint}' rotates by only {turned:.1f} degrees; rotations that the motions do not show are forbidden"
            )


def _row(surface: LimitSurface, samples: JointSamples) -> list[str]:
    keyframes, primitives = surface.centres.shape[:2]
    return [
        surface.joint,
        surface.parent or "-",
        str(surface.chart.dimension),
        str(len(samples.rotations)),
        f"{np.degrees(angular_range(samples.rotations)):.0f}°",
        str(primitives),
        f"{np.degrees(4 * float(surface.unit)):.2g}°",
        f"{np.degrees(2 * float(surface.margin)):.2g}°",
        "-" if surface.parent is None else str(keyframes),
    ]
