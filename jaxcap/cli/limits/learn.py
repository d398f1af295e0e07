"""`jaxcap limits learn`: learn joint limits from motions that show the full range."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from ...errors import InputError, user_message
from ...io.archives.limits import save_limits
from ...io.registry import MARKER_READERS, read_markers
from ...limits.implicit_surface import LimitSurface, SurfaceLimits
from ...limits.learning.fit_chart import chart_coordinates
from ...limits.learning.learn_limits import COVERAGE, learn_limits
from ...limits.learning.marker_frames import arm_samples
from ...limits.learning.samples import JointSamples, angular_range, gather_samples, parse_joints
from ..console.console import print_table, say, warn
from ..console.options import MOTION_FORMATS, Flag, MotionsSpec, OptionalUnit, arg
from ..motions import load_motion
from ..outputs import check_npz, make_folder

#: range in degrees below which a joint's motion shows little of its limits
MIN_RANGE = 5.0


@dataclass
class Learn:
    """Learn joint limits from motions that show the full range; the limits of a child may depend on its parent's
    pose.

    Left and right are learned separately. Rotations that the motions do not show are forbidden."""

    motions: Annotated[
        MotionsSpec,
        arg(
            help=f"Motions of one skeleton: {MOTION_FORMATS}; or one recording of markers: .c3d, .trc, .csv."
        ),
    ]
    joints: Annotated[str, arg(metavar="NAMES")]
    """Joints, separated by commas. PARENT:CHILD makes the limits of the child depend on the parent, as
    in LeftArm:LeftForeArm,Head."""
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
    """Width of the smallest voxels of rotations, degrees. Default: the smallest width with which one part of the
    motion predicts enough of the rest (see --coverage)."""
    keyframe_width: Annotated[float | None, arg(metavar="DEGREES", help_behavior_hint="")] = None
    """Width of the voxels of the parent's rotations, degrees. Each voxel has its own limits of the child. Default:
    chosen together with --voxel."""
    min_samples: Annotated[int, arg(metavar="N")] = 1
    """Smallest number of samples with which a voxel of the smallest width is kept."""
    coverage: float = COVERAGE
    """Share of held-out motion that the limits have to allow, if --voxel or --keyframe-width is not given."""
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
            limits = learn_limits(
                samples,
                voxel=None if self.voxel is None else float(np.radians(self.voxel)),
                keyframe=None if self.keyframe_width is None else float(np.radians(self.keyframe_width)),
                min_samples=self.min_samples,
                coverage=self.coverage,
            )
        except ValueError as error:
            raise InputError(user_message(error)) from None
        save_limits(self.out, limits)
        print_summary(limits, samples)
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
        if not 0 < self.coverage <= 1:
            raise InputError(f"--coverage is {self.coverage:g}; it must be above 0 and at most 1.")
        if self.report is not None:
            make_folder(self.report)

    def samples(self) -> dict[str, JointSamples]:
        """Collect the rotations of the joints in all files, by joint."""
        pairs = parse_joints(self.joints)
        suffixes = {Path(path).suffix.lower() for path in self.motions}
        if suffixes & set(MARKER_READERS):
            return self.marker_samples(pairs)
        if self.markers is not None or self.trunk is not None:
            raise InputError("--markers and --trunk need files of markers, but these are motions.")
        motions = [load_motion(path, self.unit) for path in self.motions]
        try:
            return {joint: gather_samples(motions, joint, parent, self.motions) for joint, parent in pairs}
        except ValueError as error:
            raise InputError(user_message(error)) from None

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
        ["joint", "depends on", "angles", "samples", "range", "primitives", "voxels from", "keyframes"],
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
        "-" if surface.parent is None else str(keyframes),
    ]
