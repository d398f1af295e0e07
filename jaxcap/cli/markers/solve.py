"""`jaxcap markers solve`: the motion of a known subject through trials."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from ...energy.energy import AbstractEnergy
from ...errors import InputError
from ...io.archives.journal import hash_file, hash_files
from ...io.markers.subject import load_subject
from ...io.opensim.storage import SUFFIXES as STORAGE_SUFFIXES
from ...io.opensim.storage import write_coordinates
from ...io.registry import MOTION_WRITERS, write_motion
from ...io.system.run_lock import run_lock
from ...markers.labels.exchanges import mend_labels
from ...markers.motion.inverse_kinematics import MarkerSolution, solve_markers
from ...markers.motion.solve_coordinates import solve_coordinates
from ...markers.subject import Subject, marker_body
from ...observe.markers import MarkerFrames
from ...report.markers.markers import assigned_residuals, report_markers
from ..console.console import say, warn
from ..console.heartbeat import set_activity
from ..console.options import Flag, OptionalFile, OptionalUnit, arg
from ..outputs import check_parent, is_run_complete, make_folder, names_folder
from ..terms import FloorHeight, LimitsFile, LimitWeight, PriorFile, check_floor, read_terms
from .filled_markers import deviations_path, write_filled
from .opensim import SUFFIX as OSIM_SUFFIX
from .opensim import SolvedModel, load_subject_or_model
from .prop_tables import is_prop, prop_table, write_prop_table
from .result_tables import MODEL_REASONS, SUBJECT_REASONS, describe_strays, print_residuals
from .solved_trials import read_solved, write_solved
from .streamed import Latency, dispatch_synchronously, solve_streamed
from .subject_files import file_name, named_trials, names_in, run_each, subject_names
from .takes import (
    Files,
    OptionalFolder,
    OptionalSubject,
    OptionalUp,
    Pieces,
    Take,
    check_folder,
    check_new,
    check_points,
    read_take,
    write_joints,
)

TrialsSpec = tyro.conf.Positional[Annotated[tuple[str, ...], arg(metavar="TRIALS...", help_behavior_hint="")]]


@dataclass
class Solve:
    """Solve for the motion of a subject in trials; write the motion and, if requested, joint centres, markers without
    gaps, and a report.

    Exchanged labels are corrected by the poses, and reported. Frames with too few markers, or without a pose that fits,
    keep the previous pose. The numbers of these frames are printed."""

    subject_file: tyro.conf.Positional[Annotated[Path, arg(metavar="SUBJECT")]]
    """A subject: a result of `jaxcap markers fit`, or an OpenSim model (.osim) with its markers."""
    trials: TrialsSpec
    """Trials: .c3d, .trc or .csv files. Markers are identified by their labels. Further subjects (.npz) may come before them:
    the results of each are in a folder with its name, or have it in their names, and the name is the prefix of its labels."""
    out: Annotated[Path, arg(aliases=("-o",), metavar="OUT")]
    """Output file for the motion, .bvh or .npz, and for the coordinates of an OpenSim model .mot or .sto; or an output folder,
    which gets .bvh, .npz, and for an OpenSim model .mot, for each trial."""
    joints: Files = ()
    """Output files for joint centres, .trc, .c3d or .csv. If OUT is a folder, they are written there, with the
    name of the trial as a prefix."""
    filled: Files = ()
    """Output files for markers without gaps, .trc, .c3d or .csv. If OUT is a folder, they are named as for
    --joints. NAME-deviations.csv in the same folder has the standard deviations of the filled positions, metres."""
    tasks: OptionalFile = None
    """Tasks of OpenSim's inverse kinematics for an OpenSim model (.xml): weights of markers and of coordinates."""
    limits: LimitsFile = None
    prior: PriorFile = None
    floor: FloorHeight = None
    limit_weight: LimitWeight = 100.0
    stream: Flag = False
    """Solve each frame without knowledge of later frames, as in a live stream, and print the computing time per
    frame. Exchanged labels are left out, and not corrected."""
    report: OptionalFolder = None
    """Output folder for report.json, and pictures of the skeleton with its markers and of the residuals."""
    unit: OptionalUnit = None
    """Unit of the trials' lengths, instead of the unit that they state: m, dm, cm, mm, in or ft."""
    subject: OptionalSubject = None
    """Subject to use if a trial has several: the prefix of the labels of its markers."""
    up: OptionalUp = None
    """Up axis of the trials; results then have y up. Default: the axes of the trials are kept, and
    the printed line of each file names its up axis if it is known."""
    pieces: Pieces = "refuse"
    """Handling of trajectories that continue under new names after gaps: stop with an error (refuse), join them
    (join), or keep them separate (keep)."""
    resume: Flag = False
    """Continue an interrupted run; solved trials are kept."""
    overwrite: Flag = False
    """Replace the results if they exist."""

    def run(self) -> None:
        if self.stream:
            dispatch_synchronously()
        further = [path for path in self.trials if Path(path).suffix.lower() == ".npz"]
        if not further:
            self.solve_trials(self.read)
            return
        if self.subject is not None:
            raise InputError(
                "--subject is the prefix of one subject's labels, and the names of several subjects' files are theirs; leave it out."
            )
        paths = [self.subject_file, *map(Path, further)]
        trials = tuple(path for path in self.trials if path not in further)
        names = subject_names(paths, names_in(trials, self.unit))
        named = named_trials(trials, self.unit, dict(zip(names, map(load_subject, paths), strict=True)))
        runs = [self.for_subject(path, name, trials) for path, name in zip(paths, names, strict=True)]
        for run in runs:
            run.check()
            check_new(run.results, self.overwrite or self.resume)
        chosen = {
            name: {path: name if name in there else None for path, there in named.items()} for name in names
        }
        run_each(
            {
                name: partial(run.solve_trials, partial(run.read_of_several, chosen[name]))
                for name, run in zip(names, runs, strict=True)
            },
            "solved",
        )

    def for_subject(self, path: Path, name: str, trials: tuple[str, ...]) -> "Solve":
        """Make the run of one of several subjects, with results of its own."""

        def place(file: Path) -> Path:
            return file.with_name(f"{file.stem}-{file_name(name)}{file.suffix}")

        into = replace(self, trials=trials).into_folder
        return replace(
            self,
            subject_file=path,
            trials=trials,
            out=self.out / file_name(name) if into else place(self.out),
            joints=self.joints if into else tuple(map(place, self.joints)),
            filled=self.filled if into else tuple(map(place, self.filled)),
            report=None if self.report is None else self.report / file_name(name),
        )

    def read(self, path: str) -> Take:
        """Read a trial of one subject."""
        return read_take(path, self.unit, self.subject, self.up, self.pieces)

    def read_of_several(self, chosen: Mapping[str, str | None], path: str) -> Take:
        """Read a trial of several subjects: the markers with the prefix of this one, or all if its labels have none."""
        return read_take(path, self.unit, chosen[path], self.up, self.pieces, several=True)

    def solve_trials(self, read: Callable[[str], Take]) -> None:
        """Solve all trials for one subject."""
        self.check()
        if self.resume and is_run_complete(self.results, self.checkpoint_path):
            return
        check_new(self.results, self.overwrite or (self.resume and self.checkpoint_path.is_file()))
        subject, model = load_subject_or_model(self.subject_file, self.tasks)
        self.check_model(model)
        terms = read_terms(
            marker_body(subject),
            limits=self.limits,
            limit_weight=self.limit_weight,
            floor=self.floor,
            prior=self.prior,
        )
        header = {**self.settings(), "subject_file": hash_file(self.subject_file)}
        set_activity("reading the trials")
        # an invalid trial is reported before any has results; later changes of a file are not read
        digests = {path: hash_file(path) for path in self.trials}
        trials = [read(path) for path in self.trials]
        for trial in trials:
            check_floor(self.floor, np.asarray(trial.frames.positions))
        if self.into_folder:
            make_folder(self.out)
        with run_lock(*((self.out,) if self.into_folder else (self.out, *self.joints, *self.filled))):
            # another run may have ended since
            check_new(self.results, self.overwrite or (self.resume and self.checkpoint_path.is_file()))
            solved = read_solved(self.checkpoint_path, header) if self.resume else {}
            for path, trial in zip(self.trials, trials, strict=True):
                if solved.get(path) == digests[path] and all(
                    file.is_file() for file in self.results_of(path)
                ):
                    say(f"{path}: already solved")
                    continue
                set_activity(f"solving {path}")
                # from now on existing results belong to this run
                write_solved(self.checkpoint_path, header, solved)
                try:
                    self.solve(subject, model, path, trial, terms)
                except (ValueError, KeyboardInterrupt) as stop:
                    if not solved:
                        self.checkpoint_path.unlink(missing_ok=True)
                    elif isinstance(stop, KeyboardInterrupt):
                        message = f"{len(solved)} of {len(self.trials)} trials are solved; --resume continues"
                        raise KeyboardInterrupt(f"stopped; {message}") from None
                    raise
                solved[path] = digests[path]
                write_solved(self.checkpoint_path, header, solved)
            self.checkpoint_path.unlink(missing_ok=True)

    @property
    def checkpoint_path(self) -> Path:
        """The file of the solved trials."""
        return self.out.with_name(f"{self.out.name}.partial")

    def settings(self) -> dict[str, object]:
        """Collect the settings that affect the results, by the names of the options."""
        files = {"joints": self.joints, "filled": self.filled}
        names = ("unit", "subject", "up", "pieces", "stream", "floor", "limit_weight")
        return {
            **{name: getattr(self, name) for name in names},
            **{name: [str(path) for path in paths] for name, paths in files.items()},
            **hash_files({"limits": self.limits, "prior": self.prior, "tasks": self.tasks}),
            "report": None if self.report is None else str(self.report),
        }

    @property
    def into_folder(self) -> bool:
        """True if results go into a folder, for one trial or several."""
        return len(self.trials) > 1 or self.out.suffix.lower() not in (*MOTION_WRITERS, *STORAGE_SUFFIXES)

    def check_model(self, model: SolvedModel | None) -> None:
        """Check that the results belong to the kind of subject. Raises `InputError`."""
        if model is None and self.out.suffix.lower() in STORAGE_SUFFIXES:
            raise InputError(
                f"{self.out}: coordinates are those of an OpenSim model (.osim), and {self.subject_file.name} is none; write "
                f"{' or '.join(MOTION_WRITERS)}."
            )
        if model is not None and self.stream:
            raise InputError("--stream is for subjects; solve an OpenSim model without it.")

    def check(self) -> None:
        """Check that options are compatible and results can be written. Raises `InputError`."""
        if not self.trials:
            raise InputError("There are no trials to solve; give .c3d, .trc or .csv files.")
        if len(self.trials) > 1 and not names_folder(self.out):
            raise InputError(
                f"{self.out}: {len(self.trials)} trials cannot be written to one file; give a folder."
            )
        if self.into_folder and not names_folder(self.out):
            raise InputError(
                f"{self.out}: motions are not written as '{self.out.suffix}' files; use {', '.join(MOTION_WRITERS)}, .mot for an OpenSim model, or "
                "give a folder."
            )
        stems = [Path(path).stem for path in self.trials]
        twice = [stem for stem in stems if stems.count(stem) > 1]
        if twice:
            raise InputError(
                f"There are {stems.count(twice[0])} trials named '{twice[0]}', whose results would be the same file; rename them."
            )
        check_folder(self.report)
        if self.into_folder:
            check_folder(self.out)
            for path in (*self.joints, *self.filled):
                if path.parent != Path("."):
                    raise InputError(
                        f"{path}: with several trials, or a folder for OUT, give a name without a folder."
                    )
        else:
            check_parent(self.out)
        check_points(self.joints, "joint centres")
        check_points(self.filled, "markers")
        if self.resume and self.overwrite:
            raise InputError("--resume continues a run and --overwrite replaces it; give one of them.")
        if self.checkpoint_path.exists() and not (self.resume or self.overwrite):
            raise InputError(
                f"{self.checkpoint_path}: an unfinished run exists; give --resume to continue it or --overwrite to begin anew."
            )

    @property
    def results(self) -> list[Path]:
        """All files of motions and points that the run writes."""
        return [file for path in self.trials for file in self.results_of(path)]

    def results_of(self, trial: str) -> list[Path]:
        """List the output files of one trial."""
        return [
            *self.motions(trial),
            *([prop_table(self.motions(trial)[0])] if is_prop(self.subject_file) else []),
            *self.point_paths(self.joints, trial),
            *self.point_paths(self.filled, trial),
            *map(deviations_path, self.point_paths(self.filled, trial)),
        ]

    def motions(self, trial: str) -> tuple[Path, ...]:
        """List the files of a trial's motion."""
        stem = Path(trial).stem
        if not self.into_folder:
            return (self.out,)
        suffixes = (".bvh", ".npz", *((".mot",) if self.subject_file.suffix.lower() == OSIM_SUFFIX else ()))
        return tuple(self.out / f"{stem}{suffix}" for suffix in suffixes)

    def point_paths(self, files: tuple[Path, ...], trial: str) -> tuple[Path, ...]:
        """List the paths of files for one trial, in the output folder if there is one."""
        if not self.into_folder:
            return files
        return tuple(self.out / f"{Path(trial).stem}-{file.name}" for file in files)

    def solve(
        self,
        subject: Subject,
        model: SolvedModel | None,
        path: str,
        trial: Take,
        terms: tuple[AbstractEnergy, ...],
    ) -> None:
        frames = trial.frames
        if model is not None and trial.up not in (None, "y"):
            warn(
                f"{path}: {trial.up} is probably up in the trial, and y is in the model; give --up {trial.up}"
            )
        values, solution, latency = self.find_poses(subject, model, frames, terms)
        if latency is None and not solution.lost.all():
            mended = mend_labels(subject, solution.motion, frames, lost=solution.lost)
            if mended.changed.any():
                set_activity(f"solving {path} with corrected labels")
                frames = mended.frames
                values, solution, _ = self.find_poses(subject, model, frames, terms)
                solution = solution._replace(messages=(*mended.messages, *solution.messages))
        if solution.lost.all():
            raise InputError(
                f"{path}: the subject explains enough markers in none of {len(frames)} frames; check that the trial "
                "is of this subject, with the markers at the same positions on the body."
            )
        kept = assigned_residuals(subject, solution.residuals, solution.lost)
        solution = solution._replace(
            messages=(
                *solution.messages,
                *describe_strays(subject.labels, kept, SUBJECT_REASONS if model is None else MODEL_REASONS),
            )
        )
        for file in self.motions(path):
            if model is not None and values is not None and file.suffix.lower() in STORAGE_SUFFIXES:
                write_coordinates(file, model.model, values, frames.rate, start=trial.start)
                say(f"coordinates: {file}")
            else:
                write_motion(file, subject.skeleton, solution.motion)
                say(f"motion: {file}")
        if is_prop(self.subject_file):
            write_prop_table(prop_table(self.motions(path)[0]), subject, solution, frames)
        write_joints(self.point_paths(self.joints, path), subject.skeleton, solution.motion, solution.lost)
        if self.filled:
            set_activity(f"filling the gaps of {path}")
            write_filled(self.point_paths(self.filled, path), subject, solution, frames)
        print_residuals(subject, solution)
        if latency is not None:
            say(latency.sentence())
        for sentence in solution.messages:
            warn(f"{Path(path).name}: {sentence}")
        if self.report is not None:
            self.write_report(subject, frames, solution, path, latency)

    def find_poses(
        self,
        subject: Subject,
        model: SolvedModel | None,
        frames: MarkerFrames,
        terms: tuple[AbstractEnergy, ...],
    ) -> tuple[np.ndarray | None, MarkerSolution, Latency | None]:
        """Solve the poses of frames: as one of a model's coordinates, frame by frame, or at once."""
        if model is not None:
            found = solve_coordinates(model.model, subject, frames, targets=model.targets, terms=terms)
            return found.values, found.markers, None
        if self.stream:
            return None, *solve_streamed(subject, frames, terms)
        return None, solve_markers(subject, frames, terms=terms), None

    def write_report(
        self,
        subject: Subject,
        frames: MarkerFrames,
        solution: MarkerSolution,
        path: str,
        latency: Latency | None,
    ) -> None:
        assert self.report is not None
        folder = self.report / Path(path).stem if len(self.trials) > 1 else self.report
        make_folder(folder)
        more = None if latency is None else {"latency": latency.report()}
        report_markers(
            folder,
            subject,
            solution.motion,
            frames,
            solution.residuals,
            title=Path(path).name,
            notes=solution.messages,
            lost=solution.lost,
            extra=more,
        )
        say(f"report.json and pictures are in {folder}")
