"""`jaxcap adapt`: adapt a template body to the actor in a sequence of scans."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np

from ...adapt.adapt_body import adapt_body
from ...adapt.evaluate import Evaluation, compare_stages, quantile, variant_names
from ...adapt.prepare import make_adapt_task
from ...adapt.task import AdaptSettings, AdaptState, AdaptTask, plan_stages
from ...body.body import Body
from ...errors import InputError, user_message
from ...io.archives.journal import hash_files
from ...io.meshes.clouds import Scans, read_clouds
from ...io.registry import write_motion
from ...io.system.run_lock import run_lock
from ...limits.abstract_limits import AbstractLimits
from ...report.adaptation import report_adaptation
from ..body_models import load_model_of
from ..console.console import say, warn
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
from ..console.record import give_figures
from ..console.rounds import RoundProgress
from ..outputs import is_run_complete
from ..scan.rate import ScanRate, find_rate, print_rate
from ..sources import Clouds, load_body, print_room
from ..terms import FloorHeight, LimitsFile, LimitWeight, read_terms
from .actor import load_finished_run, save_actor
from .assignment import MATCHINGS, AssignmentName
from .input import (
    UNORDERED,
    AdaptedScans,
    RunFiles,
    check_input,
    check_people,
    check_scan_cameras,
    first_pose,
    format_explained,
    is_none_or_nonnegative,
    load_cameras,
    warn_of_few,
    warn_of_lost,
    warn_of_others,
    warn_of_unusable,
)
from .parameters import check_parameters, write_actor_parameters
from .prior import PRIOR_FORMS, PriorForm, carried_arrays, prior_file, read_priors
from .state import (
    check_results,
    checkpoint_sentence,
    fingerprint_of,
    format_progress,
    keep_state,
    load_resumed_state,
)

#: minimum number of frames within a long stage between two checkpoints, and maximum number of checkpoints, as
#: each one has all poses
MIN_CHECKPOINT_FRAMES, MAX_CHECKPOINTS = 25, 40
#: options that affect the result
SETTINGS = (
    "frames", "adapt_every", "prior_form", "ignore_occlusion", "assignment", "pair_angle", "pair_distance", "tangential_weight",
    "joint_deviation", "simultaneous", "floor", "limit_weight", "unordered", "ordered", "keep_planes", "smoothness", "pose_weight",
    "unit", "up", "vertices", "first", "last",
)  # fmt: skip
OptionalWeight = Annotated[float | None, arg(metavar="WEIGHT", help_behavior_hint="")]


@dataclass
class Adapt:
    """Adapt a template body to the actor in a sequence of scans; write the actor's own body and its motion.

    Scans need not be registered, complete or free of noise. --resume continues an interrupted run."""

    body: Annotated[BodySpec, arg(help=f"The template: {BODY_FORMATS}.")]
    clouds: CloudsSpec
    out: Annotated[Path, arg(aliases=("-o",), metavar="OUT")]
    """Output file for the actor's body, .npz."""
    motion: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")] = None
    """Output file for the motion, .bvh or .npz. Default: next to the body, `anna-motion.npz` for `anna.npz`."""
    start: OptionalFile = None
    """Motion with its first frame near the pose of the first scan. Default: search for the pose of the first scan."""
    prior: OptionalFile = None
    """Pose prior from `jaxcap prior learn`, in addition to the built-in prior, which prefers rotations near rest relative
    to the range of each joint. The joint ranges in its file are
    hard limits; a shape prior in its file constrains the vertices. Default: the prior in the file of BODY; `none`
    uses no such prior."""
    prior_form: PriorForm = "nearest"
    """Form of the pose prior: distance from the nearest Gaussian of each pair of joints (nearest), or mean likelihood
    of the pairs (mean)."""
    limits: LimitsFile = None
    floor: FloorHeight = None
    limit_weight: LimitWeight = 100.0
    cameras: OptionalFile = None
    """Calibrated cameras of the scans, .json as written by `jaxcap scan`. Vertices that no camera sees are not
    matched."""
    ignore_occlusion: Flag = False
    """Match all vertices in the fields of view of --cameras, including occluded ones."""
    assignment: AssignmentName = "triangles"
    """Match scan points with the nearest point of the triangles at the nearest vertex (triangles), with the nearest vertex
    (vertices), with the nearest point of the surface (surface; six times the time of `triangles`), or with vertices with Gaussian
    weights (soft). With `surface`, if scans are meshes, vertices are also matched to the surface of the scan. `soft` needs
    a first pose within 3 cm."""
    pair_angle: Annotated[float, arg(metavar="DEGREES")] = 90.0
    """Largest angle between the normals of a matched pair, degrees."""
    pair_distance: Annotated[float, arg(metavar="METRES")] = 0.3
    """Largest distance of a matched pair, metres."""
    tangential_weight: Annotated[float, arg(metavar="SHARE")] = 0.05
    """Weight of squared distances along the surface, relative to those normal to it: 1 is point to point, 0 is point
    to plane."""
    skip_person_check: Flag = False
    """Omit the checks that the first scan shows a person, and that no scan shows two."""
    report: OptionalFile = None
    """Also write a report of the adaptation, .html, with pictures and tables. --resume adds it to a finished run."""
    parameters: OptionalFile = None
    """Also write the parameters of a body model that come nearest to the actor, .npz in AMASS's format. --resume adds them to a
    finished run."""
    deviations: Flag = False
    """With --parameters, also write the standard deviations of coefficients and joints."""
    report_every: Annotated[int, arg(metavar="N")] = 1
    """Measure every N-th frame for the report, for speed."""
    frames: Annotated[int, arg(metavar="N")] = 40
    """Number of scans, in different poses, that the body is adapted to."""
    unordered: Flag = False
    """The scans are not ordered in time: the motion is not smoothed, and each pose search starts from the most
    similar scans. Default: determined from the scans, unless --ordered is given."""
    ordered: Flag = False
    """The scans are ordered in time, even if successive scans are not similar."""
    keep_planes: KeepPlanes = False
    adapt_every: Annotated[int, arg(metavar="N")] = 0
    """Adapt during tracking: after every N frames, up to frame 10 N. Use this for motions that the template alone
    cannot track. 0 tracks all frames before the first adaptation."""
    joint_deviation: Annotated[float, arg(metavar="METRES")] = 0.005
    """Standard deviation of joints from the positions that the surrounding surface predicts, metres. Reduce it if the
    poses do not determine the joints."""
    simultaneous: Flag = False
    """Solve for vertices, joints and poses in one step of each round, not one after the other."""
    smoothness: OptionalWeight = None
    """Weight of the smoothness of the motion; 0 disables smoothing. Default: a tenth of the weight that balances
    smoothness with the scans."""
    pose_weight: OptionalWeight = None
    """Weight of the pose prior. Default: a tenth of the weight that balances the prior with the scans."""
    shape_weight: Annotated[tuple[float, float], arg(metavar="FIRST LAST")] = AdaptSettings().shape_weights
    """Weight of the template's shape in the first round that adapts vertices, and the least one in the last round, which is
    chosen by cross-validation. With lower weights, the body follows the scans more closely, including their noise."""
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
    """Reduce the template to about N vertices, for speed."""
    resume: Flag = False
    """Continue an interrupted run."""
    overwrite: Flag = False
    """Replace the results of an earlier run."""

    def run(self) -> None:
        self.check()
        with run_lock(self.out, self.motion_path):
            if not (self.resume and is_run_complete(self.results, self.checkpoint_path)):
                self.adapt_all()

    @property
    def results(self) -> list[Path]:
        """All output files of the run."""
        return [
            path for path in (self.out, self.motion_path, self.parameters, self.report) if path is not None
        ]

    def adapt_all(self) -> AdaptedScans:
        """Read, adapt, write and report, while the lock excludes other runs with the same output files.

        A finished run that is resumed is only read, and what it lacks is written."""
        known = prior_file(self.body, self.prior)
        header = self.settings() | hash_files({"prior": known, "limits": self.limits})
        body, limits = load_body(
            self.body, limits=self.limits, vertices=self.vertices, unit=self.unit, up=self.up
        )
        # before the scans, as reading all of them takes long
        files = self.read_files(body, limits, known)
        scans = read_clouds(self.clouds, self.first, self.last, self.unit)
        print_rate(find_rate(self.rate, self.clouds))
        seen = check_input(scans, body)
        header |= fingerprint_of(body, seen.digests)
        finished = self.resume and self.out.is_file() and not self.checkpoint_path.is_file()
        state = (
            load_finished_run(self.out, self.motion_path, header)
            if finished
            else load_resumed_state(self.checkpoint_path, header, self.resume, self.overwrite)
        )
        task = self.task(body, scans, files, tuple(seen.unusable))
        carried = carried_arrays(self.body, files.priors)
        warn_of_unusable(seen.unusable)
        warn_of_few(task.num_frames - len(task.missing))
        if task.settings.unordered and not self.unordered:
            warn(UNORDERED)
        if state is None or not finished:
            state = self.adapt(task, state, header, scans.names)
            self.write(state, header, scans, carried)
        if self.parameters is not None:
            of_task = task if self.deviations else None
            write_actor_parameters(self.parameters, self.body, self.vertices, state, of_task)
        if self.report is not None:
            self.write_report(self.report, task, state, known)
        self.checkpoint_path.unlink(missing_ok=True)
        return AdaptedScans(task, state, scans)

    def write(
        self, state: AdaptState, header: dict[str, object], scans: Scans, extra_arrays: dict[str, np.ndarray]
    ) -> None:
        """Write the motion, and the body with the arrays `extra_arrays` it; print a line about both."""
        try:
            write_motion(self.motion_path, state.body.skeleton, state.motion)
            save_actor(self.out, state, extra_arrays, header, self.motion_path)
        except InputError as error:
            raise InputError(
                f"{user_message(error)} {checkpoint_sentence(self.checkpoint_path, state.done)}."
            ) from None
        warn_of_others(state, scans)
        say(
            f"{self.out}: {len(state.body.vertices)} vertices, {state.size:.3f} times the template's size; "
            f"{state.history[-1][1]:.2f} mm from scan to body; {len(state.motion)} poses in {self.motion_path}, "
            f"{format_explained(state)}"
        )
        give_figures(
            {"size": state.size, "scan_to_body": 1e-3 * state.history[-1][1], "frames": len(state.motion)}
        )
        warn_of_lost(state, scans)

    def adapt(
        self, task: AdaptTask, state: AdaptState | None, header: dict[str, object], names: Sequence[str]
    ) -> AdaptState:
        """Run all remaining stages, with a checkpoint after each and within long ones; `names` are those of the
        scans."""
        stages = plan_stages(task.settings)
        with RoundProgress(len(stages), 0 if state is None else state.done, "adapting") as bar:
            try:
                for reached in adapt_body(
                    task, state, every=max(MIN_CHECKPOINT_FRAMES, task.num_frames // MAX_CHECKPOINTS)
                ):
                    if not self.skip_person_check:
                        check_people(task, reached, names)
                    keep_state(self.checkpoint_path, reached, header)
                    state = reached
                    bar.update(state.done, format_progress(task, state, stages))
            except KeyboardInterrupt:
                done = 0 if state is None else state.done
                raise KeyboardInterrupt(
                    f"stopped; {checkpoint_sentence(self.checkpoint_path, done)}"
                ) from None
        assert state is not None
        return state

    def write_report(self, path: Path, task: AdaptTask, state: AdaptState, known: Path | None) -> None:
        """Measure the result and its baselines, and write the report; `known` is the file of the prior. After
        a stop, or later, --resume does only this."""
        names, stages = variant_names(task.settings), Evaluation(())
        with RoundProgress(len(names), 0, "measuring") as bar:
            try:
                for stages in compare_stages(task, state, step=self.report_every):
                    done, near = len(stages.variants), quantile(stages.variants[-1].scan_to_body, 0.5)
                    bar.update(done, f"{names[done - 1]}: {1000 * near:.2f} mm from scan to body, median")
            except KeyboardInterrupt:
                raise KeyboardInterrupt(
                    f"stopped; body and motion are written, --resume writes {path}"
                ) from None
        how = {
            "template": self.body,
            "scans": clouds_words(self.clouds),
            **self.settings(),
            "prior": known,
            "cameras": self.cameras,
            "start": self.start,
        }
        report_adaptation(path, task, state, stages, how)
        say(f"{path}: the report")

    @property
    def checkpoint_path(self) -> Path:
        """The path of the checkpoint."""
        return self.out.with_name(self.out.name + ".partial")

    @property
    def motion_path(self) -> Path:
        return self.motion or self.out.with_name(self.out.stem + "-motion.npz")

    def check(self) -> None:
        """Check that options are in range and results can be written. Raises `InputError`."""
        ranges = {
            "--frames": (self.frames, self.frames >= 2, "at least 2"),
            "--adapt-every": (self.adapt_every, self.adapt_every >= 0, "at least 0"),
            "--joint-deviation": (
                self.joint_deviation,
                0 < self.joint_deviation < 1,
                "above 0 and below 1 metre",
            ),
            "--pair-angle": (self.pair_angle, 0 < self.pair_angle <= 180, "above 0 and at most 180 degrees"),
            "--pair-distance": (self.pair_distance, 0 < self.pair_distance < np.inf, "above 0 metres"),
            "--tangential-weight": (
                self.tangential_weight,
                0 <= self.tangential_weight <= 1,
                "between 0 and 1",
            ),
            "--smoothness": (self.smoothness, is_none_or_nonnegative(self.smoothness), "at least 0"),
            "--pose-weight": (self.pose_weight, is_none_or_nonnegative(self.pose_weight), "at least 0"),
            "--shape-weight": (
                min(self.shape_weight),
                0 < min(self.shape_weight) <= max(self.shape_weight) < np.inf,
                "above 0",
            ),
            "--report-every": (self.report_every, self.report_every >= 1, "at least 1"),
            "--rate": (self.rate, self.rate is None or 0 < self.rate < np.inf, "above 0 frames per second"),
        }
        check_ranges(ranges)
        if self.unordered and self.ordered:
            raise InputError("--unordered and --ordered are opposites; give one of them, or none.")
        if self.ignore_occlusion and self.cameras is None:
            raise InputError("--ignore-occlusion needs cameras; give them with --cameras.")
        check_parameters(self.parameters, self.body, self.deviations)
        check_results(self.results, self.report, self.resume, self.overwrite)

    def read_files(self, body: Body, limits: AbstractLimits | None, prior: Path | None) -> RunFiles:
        """Read the files of the options other than body and scans; `limits` are read. Raises `InputError`."""
        return RunFiles(
            load_cameras(self.cameras, self.up),
            first_pose(self.start, body.skeleton),
            read_priors(prior, body, from_template=self.prior is None, reduced=self.vertices is not None),
            read_terms(body, limits=limits, limit_weight=self.limit_weight, floor=self.floor),
        )

    def task(self, body: Body, scans: Scans, files: RunFiles, missing: tuple[int, ...] = ()) -> AdaptTask:
        """Make the task. Raises `InputError` if the cameras are not those of the scans."""
        cameras, priors = files.cameras, files.priors
        there = [frame for frame in range(len(scans)) if frame not in missing]
        check_scan_cameras(cameras, scans, there, self.up, self.cameras)
        matching = MATCHINGS[self.assignment]._replace(
            max_normal_angle=self.pair_angle,
            max_distance=self.pair_distance,
            tangential_weight=self.tangential_weight,
            aperture=cameras if self.ignore_occlusion else (),
        )
        clouds = Clouds(scans, body, self.up)
        planes = print_room(clouds[there[0]], self.keep_planes)
        return make_adapt_task(
            body,
            clouds,
            find_rate(self.rate, self.clouds).frames,
            start=files.start,
            pose_prior=None if priors is None else PRIOR_FORMS[self.prior_form](priors.prior),
            settings=AdaptSettings(
                num_frames=self.frames,
                joint_deviation=self.joint_deviation,
                shape_weights=self.shape_weight,
                pose_weight=self.pose_weight,
                temporal_weight=self.smoothness,
                every=self.adapt_every,
                simultaneous=self.simultaneous,
                unordered=True if self.unordered else False if self.ordered else None,
                matching=matching,
            ),
            cameras=() if self.ignore_occlusion else cameras,
            missing=missing,
            boxes=None if priors is None else priors.boxes,
            shape_prior=None if priors is None else priors.shape,
            terms=files.terms,
            mesh=partial(clouds.mesh, planes=planes) if self.assignment == "surface" else None,
            planes=planes,
            model=load_model_of(self.body, self.vertices),
            full_body=None if self.vertices is None else load_body(self.body, unit=self.unit, up=self.up)[0],
        )

    def settings(self) -> dict[str, object]:
        """Collect the settings that affect the result, by the names of the options."""
        files = hash_files({"cameras": self.cameras, "start": self.start})
        plain = {name: getattr(self, name) for name in SETTINGS}
        rate = find_rate(self.rate, self.clouds).frames
        return {**plain, "rate": rate, "shape_weight": list(self.shape_weight), **files}
