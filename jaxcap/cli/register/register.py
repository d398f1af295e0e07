"""`jaxcap register`: register scans, or meshes of different topologies, to the vertices of a body."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

from ...adapt.compare_people import compare_people
from ...adapt.poses.flag_frames import flag_frames
from ...adapt.registration.collect import collect_registered
from ...adapt.registration.register_scans import RegisterSettings, register_scans
from ...adapt.task import AdaptSettings, AdaptState, plan_stages
from ...errors import InputError
from ...io.meshes.clouds import read_clouds
from ...io.system.run_lock import run_lock
from ...observe.floors_and_walls import find_room
from ..adapt.adapt import Adapt
from ..adapt.input import AdaptedScans, check_input, warn_of_others, warn_of_unusable
from ..console.console import progress
from ..console.heartbeat import set_activity
from ..console.options import (
    BODY_FORMATS,
    BodySpec,
    CloudsSpec,
    Flag,
    KeepPlanes,
    OptionalCount,
    OptionalFile,
    Unit,
    Up,
    arg,
    check_ranges,
    clouds_words,
)
from ..motions import load_body_motion
from ..outputs import check_parent
from ..scan.rate import ScanRate, find_rate
from ..sources import Clouds, load_body
from .results import MeshKind, check_out, is_folder, print_registered, write_registered


@dataclass
class Register:
    """Register scans of a person to one topology: meshes with the vertices of a body, in the same order, that meet
    each scan. `jaxcap learn` and `jaxcap fit` read them.

    Scans may be point clouds or meshes of different topologies, partial and noisy. The body is first adapted to
    the person as by `jaxcap adapt`, and written next to the output; it then guides free vertices to each scan. With
    --motion the body is the person's own."""

    body: Annotated[BodySpec, arg(help=f"The body whose vertices the meshes have: {BODY_FORMATS}.")]
    clouds: CloudsSpec
    out: Annotated[Path, arg(aliases=("-o",), metavar="OUT")]
    """Output file, .npz, with the meshes, and for each vertex its distance from the scan and whether it is seen; or a
    folder for registered_0000.ply, registered_0001.ply, ..."""
    kind: Annotated[MeshKind, arg(name="as")] = "ply"
    """Format of the meshes in a folder."""
    motion: OptionalFile = None
    """Poses of BODY in the scans, one for each, from `jaxcap adapt` or `jaxcap track`. BODY is then a body of the
    person and is not adapted. Default: adapt BODY and find the poses."""
    deviation: Annotated[float | None, arg(metavar="METRES", help_behavior_hint="")] = None
    """Standard deviation of the person's surface from the posed, adapted body, metres. With larger values, the meshes follow
    the scans more closely, including their noise. Default: estimated from each scan."""
    length: Annotated[float, arg(metavar="METRES")] = RegisterSettings().length
    """Distance over the surface at which the correlation of these differences falls to 0.14, metres."""
    points: Annotated[int, arg(metavar="N")] = RegisterSettings().num_points
    """Number of points that a scan is thinned to."""
    start: OptionalFile = None
    """Motion with its first frame near the pose of the first scan. Default: search for the pose of the first scan."""
    cameras: OptionalFile = None
    """Calibrated cameras of the scans, .json as written by `jaxcap scan`. Vertices that no camera sees are not
    matched."""
    frames: Annotated[int, arg(metavar="N")] = AdaptSettings().num_frames
    """Number of scans, in different poses, that the body is adapted to."""
    unordered: Flag = False
    """The scans are not ordered in time. Default: determined from the scans, unless --ordered is given."""
    ordered: Flag = False
    """The scans are ordered in time, even if successive scans are not similar."""
    keep_planes: KeepPlanes = False
    skip_person_check: Flag = False
    """Omit the checks that the first scan shows a person, and that no scan shows two."""
    first: OptionalCount = None
    """First frame: the number in the file names of a pattern, otherwise counted from 0."""
    last: OptionalCount = None
    """Last frame, inclusive."""
    unit: Unit = "m"
    """Unit of the scans, and of BODY if it is a mesh: m, dm, cm, mm, in or ft."""
    up: Up = "y"
    """Up axis of the scans, and of BODY if it is a mesh. Results have y up."""
    rate: ScanRate = None
    vertices: OptionalCount = None
    """Reduce the body to about N vertices, for speed."""
    resume: Flag = False
    """Continue an interrupted adaptation."""
    overwrite: Flag = False
    """Replace the meshes and the adapted body of an earlier run."""

    def run(self) -> None:
        self.check()
        with run_lock(self.out):
            self.register()

    def register(self) -> None:
        """Adapt the body or read its poses, and register all scans. Raises `InputError`."""
        adapted = self.adapt() if self.motion is None else self.read_poses(self.motion)
        task, state, scans = adapted
        settings = RegisterSettings(self.deviation, self.length, self.points)
        set_activity("registering")
        found = progress(register_scans(task, state, settings), task.num_frames, label="registering")
        registered = list(found)
        collected = collect_registered(state.body, registered, task.rate)
        write_registered(self.out, collected, scans.names, self.kind)
        print_registered(self.out, collected, registered, scans.names)

    def check(self) -> None:
        """Check that options are in range and the output can be written. Raises `InputError`."""
        check_ranges(
            {
                "--deviation": (
                    self.deviation,
                    self.deviation is None or 0 < self.deviation < 1,
                    "above 0 and below 1 metre",
                ),
                "--length": (self.length, 0 < self.length < 10, "above 0 and below 10 metres"),
                "--points": (self.points, self.points >= 100, "at least 100"),
            }
        )
        if not self.out.name:
            raise InputError(
                f"{self.out} has no name of its own; give a file or a new folder for the meshes."
            )
        if not is_folder(self.out):
            check_parent(self.out)
        check_out(self.out, self.overwrite or self.resume)

    @property
    def adapting(self) -> Adapt:
        """The adaptation of the body to the scans, without smoothing."""
        name = self.out.name if is_folder(self.out) else self.out.stem
        return Adapt(
            self.body,
            self.clouds,
            self.out.with_name(f"{name}-body.npz"),
            start=self.start,
            cameras=self.cameras,
            skip_person_check=self.skip_person_check,
            frames=self.frames,
            unordered=self.unordered,
            ordered=self.ordered,
            keep_planes=self.keep_planes,
            smoothness=0.0,
            first=self.first,
            last=self.last,
            unit=self.unit,
            up=self.up,
            rate=self.rate,
            vertices=self.vertices,
            resume=self.resume,
            overwrite=self.overwrite,
        )

    def adapt(self) -> AdaptedScans:
        """Adapt the body, and write it and its motion. Raises `InputError`."""
        adapting = self.adapting
        adapting.check()
        with run_lock(adapting.out, adapting.motion_path):
            found = adapting.adapt_all()
        return self.with_meshes(found)

    def read_poses(self, path: Path) -> AdaptedScans:
        """Read the body and its poses in the scans, and judge the poses. Raises `InputError`."""
        adapting = self.adapting
        body, limits = load_body(self.body, vertices=self.vertices, unit=self.unit, up=self.up)
        files = adapting.read_files(body, limits, None)
        motion = load_body_motion(body, path)
        scans = read_clouds(self.clouds, self.first, self.last, self.unit)
        if len(motion) != len(scans):
            raise InputError(
                f"{path}: this motion has {len(motion)} frames, but there are {len(scans)} scans in {clouds_words(self.clouds)}; "
                "give the poses of these scans."
            )
        seen = check_input(scans, body)
        warn_of_unusable(seen.unusable)
        task = adapting.task(body, scans, files, tuple(seen.unusable))
        state = AdaptState(len(plan_stages(task.settings)), body, 1.0, motion)
        set_activity("judging the poses")
        state = flag_frames(task, state, final=True)
        state = state._replace(others=compare_people(task, state))
        warn_of_others(state, scans)
        return self.with_meshes(AdaptedScans(task, state, scans))

    def with_meshes(self, found: AdaptedScans) -> AdaptedScans:
        """Add the reader of scans with their triangles to the task."""
        clouds = Clouds(found.scans, found.state.body, self.up)
        planes = () if self.keep_planes else find_room(clouds[found.task.scanned[0]])
        mesh = partial(clouds.mesh, planes=planes)
        rate = find_rate(self.rate, self.clouds).frames
        return found._replace(task=found.task._replace(mesh=mesh, rate=rate))
