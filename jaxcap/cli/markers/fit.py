"""`jaxcap markers fit`: a subject, with its skeleton and marker placements, from takes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...body.pose import Motion
from ...energy.energy import AbstractEnergy
from ...errors import InputError
from ...io.markers.marker_corrections import read_corrections
from ...io.markers.subject import save_subject
from ...io.system.run_lock import run_lock
from ...markers.calibration.calibrate import Calibration, calibrate
from ...markers.human.check_person import check_recognised
from ...markers.human.fit_human import HumanFit, fit_human, select_set, visible_markers
from ...markers.human.human_template import make_human_template
from ...markers.human.static_pose import append_static
from ...markers.local_technique import fit_local
from ...markers.marker_sets.recognise import recognise_markers
from ...markers.motion.inverse_kinematics import MarkerSolution, solve_markers
from ...markers.rotation_centres.estimate_joint import CentreMethod
from ...markers.segments.merge_takes import merge_takes
from ...markers.subject import Subject, marker_body
from ...markers.subjects.prop import fit_prop
from ...markers.subjects.split_subjects import SubjectMarkers, SubjectSplit, split_subjects
from ...observe.markers import MarkerFrames
from ...report.markers.markers import assigned_residuals, report_markers, summarise_residuals
from ...report.markers.person_page import write_person_page
from ..console.console import say
from ..console.heartbeat import set_activity
from ..console.options import SKELETON_FORMATS, Flag, OptionalFile, OptionalUnit, arg
from ..motions import load_skeleton
from ..outputs import make_folder
from ..terms import FloorHeight, LimitsFile, LimitWeight, PriorFile, check_floor, read_terms
from .fit_person import bone_rows, find_landmarks, print_person
from .result_tables import describe_strays, print_bones, print_doubts, print_joints, print_segments
from .segments import joint_figures, match_segments, read_symmetry, write_segments
from .subject_files import check_subject_place, fit_each, has_several, place_of, refuse_all, static_and_moving
from .takes import (
    Files,
    OptionalFolder,
    OptionalSubject,
    OptionalUp,
    Pieces,
    TakesSpec,
    check_folder,
    check_new,
    check_points,
    read_take,
    write_joints,
)

OptionalThreshold = Annotated[float | None, arg(metavar="METRES", help_behavior_hint="")]
SamePairs = Annotated[tuple[str, ...], arg(metavar="LEFT:RIGHT", help_behavior_hint="")]


#: options of the technique without a person's skeleton, and their defaults
FREE_OPTIONS = {"method": "score", "threshold": None, "segments": None, "symmetry": (), "local": False}


class FittedMarkers(NamedTuple):
    """A subject and its motion through takes."""

    subject: Subject
    motion: Motion
    residuals: Float[np.ndarray, "F M"]


@dataclass
class Fit:
    """Calibrate a subject from its takes: joints, bone lengths, and the position of each marker on its bone.
    Give a take in which every joint moves; a static pose can be added.

    A person is recognised by the labels of the markers, and gets the skeleton of the embedded human. Anything else gets a
    skeleton of the segments that are found. Quantities that the takes do not determine are reported."""

    files: TakesSpec
    """Takes: .c3d, .trc or .csv files. Markers with equal labels are the same marker. A file in which a person stands still is the
    static trial, as with --static."""
    out: Annotated[Path, arg(aliases=("-o",), metavar="OUT")] = Path("subject.npz")
    """Output file for the subject, .npz, or an output folder. If the takes show several people or rigid props, each is a
    subject: subject-Anna.npz, or Anna.npz in the folder."""
    method: CentreMethod = "score"
    """Method for rotation centres: spheres about the centres (sphere), the symmetric methods SCoRE and SARA (score),
    or the method of Gamage and Lasenby (gamage)."""
    threshold: OptionalThreshold = None
    """Largest range of the distance between two markers of one segment over the frames, metres. Markers beyond it stay loose. Default:
    none; the usual range is estimated from the data."""
    segments: OptionalFile = None
    """Text file with corrections of segments: marker, segment and weight in each line. The segment - leaves a marker
    without a segment. The segments.txt of --report is such a file, to start from."""
    template: Annotated[
        str | None,
        arg(
            metavar="{human,none,FILE}",
            help_behavior_hint="",
            help="human: the skeleton of a person, by the labels of the markers, or where these are unknown by their geometry; none: segments and joints are found, as "
            f"for animals and objects. Default: human where the labels are known. FILE: a skeleton ({SKELETON_FORMATS}) that "
            "defines which segments are connected; --segments is then needed, to give the segments the names of its joints.",
        ),
    ] = None
    symmetry: SamePairs = ()
    """Pairs of segments that have bones of equal length, such as lthigh:rthigh."""
    local: Flag = False
    """Stop after every joint is estimated separately; do not fit poses, bone lengths and marker positions together."""
    static: OptionalFile = None
    """A static trial of a person, who stands still in it: .c3d, .trc or .csv. It counts as much as the takes, and its markers need
    not be in them, such as those at medial epicondyles and malleoli."""
    frames: Annotated[int, arg(metavar="N")] = 100
    """Number of frames in which poses, bone lengths and marker positions are fitted together. The chosen frames differ
    as much as possible."""
    rigid: Flag = False
    """Fix the markers on their bones. Without this option, markers may slide as joints rotate, if the data show
    this."""
    limits: LimitsFile = None
    limit_weight: LimitWeight = 100.0
    prior: PriorFile = None
    floor: FloorHeight = None
    unit: OptionalUnit = None
    """Unit of the files' lengths, instead of the unit that they state: m, dm, cm, mm, in or ft."""
    subject: OptionalSubject = None
    """Subject to use if a file has several: the prefix of the labels of its markers. Default: all of them."""
    up: OptionalUp = None
    """Up axis of the files; the subject then has y up. Default: the axes of the files are kept, and
    the printed line of each file names its up axis if it is known."""
    pieces: Pieces = "refuse"
    """Handling of trajectories that continue under new names after gaps: stop with an error (refuse), join them
    (join), or keep them separate (keep)."""
    joints: Files = ()
    """Output files for the joint centres of every frame, .trc, .c3d or .csv."""
    report: OptionalFolder = None
    """Output folder for report.json, segments.txt, and pictures of the skeleton with its markers and of the
    residuals."""
    overwrite: Flag = False
    """Replace the subject and the joint centres if they exist."""

    def run(self) -> None:
        pairs = self.check()
        with run_lock(self.out, *self.joints):
            self.fit(pairs)

    def fit(self, pairs: tuple[tuple[str, str], ...]) -> None:
        """Read, fit and write, while the lock excludes other runs with the same output files."""
        set_activity("reading the takes")
        one = self.template not in (None, "human") or bool(self.free_options())
        read = [read_take(path, self.unit, self.subject, self.up, self.pieces, several=not one) for path in self.files]  # fmt: skip
        takes, ups = [take.frames for take in read], {take.up for take in read}
        united = merge_takes(takes)
        check_floor(self.floor, np.asarray(united.positions))
        split = SubjectSplit((), (), ()) if one else split_subjects(united)
        if self.subject is not None and len(split.props) == 1:
            split = split._replace(props=(split.props[0]._replace(name=self.subject),))
        if self.template == "human" and not split.people and not has_several(united):
            split = split._replace(props=())
        if split.props or len(split.people) > 1 or (split.people and has_several(united)):
            static, moving = static_and_moving(self, takes)
            fit_each(
                self, split if len(moving) == len(takes) else split_subjects(merge_takes(moving)), static
            )
            return
        if has_several(united):
            refuse_all(self.files[0], united, split)
        if self.is_person(united):
            own = replace(self, out=place_of(self.out, "person", alone=True))
            static, moving = static_and_moving(self, takes)
            own.fit_person(merge_takes(moving), static, ups.pop() if len(ups) == 1 else None)
        else:
            replace(self, out=place_of(self.out, "subject", alone=True)).fit_segments(united, pairs)

    def fit_subject(self, markers: SubjectMarkers, is_prop: bool, static: MarkerFrames | None) -> None:
        """Fit one of several subjects and write it."""
        if not is_prop:
            self.fit_person(markers.frames, static)
            return
        set_activity(f"fitting the prop {markers.name}")
        fit = fit_prop(markers.frames, markers.name)
        say(f"a rigid prop of {fit.subject.num_markers} markers: {', '.join(fit.subject.labels)}")
        notes = self.print_residuals(fit.subject, fit.residuals, fit.lost, fit.messages)
        self.write_results(fit.subject, fit.motion, fit.lost)
        if self.report is not None:
            result = FittedMarkers(fit.subject, fit.motion, fit.residuals)
            self.draw_report(self.report, result, markers.frames, notes, fit.lost, {})

    def is_person(self, frames: MarkerFrames) -> bool:
        """Decide if the markers are those of a person with known labels, and say if they are not."""
        if self.template is not None:
            return self.template == "human"
        free = self.free_options()
        if free:
            say(f"{free[0]} is of the technique without a person's skeleton (--template none), which is used")
            return False
        try:
            check_recognised(recognise_markers(frames.labels), frames)
        except InputError as error:
            say(
                f"--template none is used, which knows no people: {str(error).split('. Rename')[0]}. If they are markers of a "
                "person, give --template human, which finds landmarks by their geometry"
            )
            return False
        return True

    def free_options(self) -> list[str]:
        """List the given options that only the technique without a person's skeleton has."""
        return [f"--{name}" for name, default in FREE_OPTIONS.items() if getattr(self, name) != default]

    def fit_person(
        self, frames: MarkerFrames, static: MarkerFrames | None = None, up: str | None = None
    ) -> None:
        """Fit the embedded human's skeleton and write it; `up` is the up axis if it is known."""
        set_activity("fitting a person's skeleton")
        say(
            f"fitting poses, bone lengths and marker positions together in {min(self.frames, len(frames))} of {len(frames)} frames"
        )
        whole = frames if static is None else append_static(frames, static)
        known = find_landmarks(whole, up)
        shown = select_set(known, visible_markers(whole).labels)
        fit = fit_human(
            frames,
            static=static,
            marker_set=known,
            num_frames=self.frames,
            skin=not self.rigid,
            terms=self.terms(make_human_template(shown).subject),
        )
        print_person(fit)
        further = [message for message in fit.calibration.motion_messages if message not in fit.messages]
        notes = self.print_residuals(fit.subject, fit.residuals, fit.lost, further)
        self.write_results(fit.subject, fit.motion, fit.lost)
        if self.report is not None:
            extra = {"segments": bone_rows(fit), "traits": fit.traits._asdict()}
            pictures = self.draw_report(
                self.report, fit, fit.markers, (*fit.messages, *notes), fit.lost, extra
            )
            write_person_page(self.report / "report.html", fit, self.title(), pictures, notes)
            say(f"report.html, report.json and pictures are in {self.report}")

    def fit_segments(self, united: MarkerFrames, pairs: tuple[tuple[str, str], ...]) -> None:
        """Find segments and joints, fit a skeleton of them, and write it."""
        set_activity("finding segments and joints")
        corrections = None if self.segments is None else read_corrections(self.segments)
        bones = None
        if self.template not in (None, "none") and self.segments is not None:
            template = load_skeleton(Path(str(self.template)))
            bones = match_segments(template, corrections or {}, self.segments, str(self.template))
        found = fit_local(
            united,
            threshold=self.threshold,
            method=self.method,
            template=bones,
            symmetry=pairs,
            corrections=corrections,
        )
        print_doubts(found.messages)
        print_segments(found)
        print_joints(found)
        fitted: Calibration | MarkerSolution
        terms = self.terms(found.subject)
        if self.local:
            subject = found.subject
            fitted = solve_markers(subject, found.markers, terms=terms)
        else:
            say(
                f"fitting poses, bone lengths and marker positions together in {min(self.frames, len(united))} of {len(united)} frames"
            )
            known = [pair for pair in pairs if set(pair) <= set(found.skeleton.names)]
            fitted = calibrate(
                found.markers,
                found.subject,
                symmetry=known,
                num_frames=self.frames,
                skin=not self.rigid,
                terms=terms,
            )
            subject = fitted.subject
        lost = fitted.lost
        if not np.isfinite(assigned_residuals(subject, fitted.residuals, lost)).any():
            raise InputError(
                f"{', '.join(self.files)}: no pose of the estimated skeleton explains any frame; check that the markers are of one body, and the unit."
            )
        print_bones(found, fitted if isinstance(fitted, Calibration) else None)
        later = self.print_residuals(subject, fitted.residuals, lost, fitted.messages)
        notes = tuple(dict.fromkeys((*found.messages, *later)))
        self.write_results(subject, fitted.motion, lost)
        if self.report is not None:
            make_folder(self.report)
            write_segments(self.report, found)
            result = FittedMarkers(subject, fitted.motion, fitted.residuals)
            extra = {"local_joints": joint_figures(found)}
            self.draw_report(self.report, result, found.markers, notes, lost, extra)
            say(f"report.json, segments.txt and pictures are in {self.report}")

    def terms(self, subject: Subject) -> tuple[AbstractEnergy, ...]:
        """Read the energies that the options name, for the skeleton and the markers of a subject."""
        return read_terms(
            marker_body(subject),
            limits=self.limits,
            limit_weight=self.limit_weight,
            floor=self.floor,
            prior=self.prior,
        )

    def print_residuals(
        self,
        subject: Subject,
        residuals: Float[np.ndarray, "F M"],
        lost: Bool[np.ndarray, "F"] | None,
        messages: Sequence[str],
    ) -> tuple[str, ...]:
        """Print the residuals of all markers, and the notes; return the notes."""
        set_activity("measuring residuals")
        kept = assigned_residuals(subject, residuals, lost)
        totals = summarise_residuals(kept)
        say(
            f"residuals: {1e3 * totals['rms']:.2f} mm rms, median {1e3 * totals['median']:.2f} mm, "
            f"95 % within {1e3 * totals['p95']:.2f} mm"
        )
        sentences = tuple(dict.fromkeys((*messages, *describe_strays(subject.labels, kept))))
        if sentences:
            say("notes:")
        for sentence in sentences:
            say(f"- {sentence}")
        return sentences

    def write_results(self, subject: Subject, motion: Motion, lost: Bool[np.ndarray, "F"] | None) -> None:
        """Write the subject, and the joint centres of every frame."""
        make_folder(self.out.absolute().parent)
        save_subject(self.out, subject)
        say(
            f"{self.out}: {int((np.asarray(subject.weights) > 0).sum())} markers on {subject.skeleton.num_joints} bones"
        )
        write_joints(self.joints, subject.skeleton, motion, lost)

    def draw_report(
        self,
        folder: Path,
        fit: HumanFit | FittedMarkers,
        frames: MarkerFrames,
        notes: Sequence[str],
        lost: Bool[np.ndarray, "F"] | None,
        extra: Mapping[str, object],
    ) -> list[Path]:
        """Draw the pictures and write `report.json`; return the pictures."""
        set_activity("drawing the report")
        make_folder(folder)
        return report_markers(
            folder,
            fit.subject,
            fit.motion,
            frames,
            fit.residuals,
            title=self.title(),
            notes=notes,
            lost=lost,
            extra=extra,
        )

    def title(self) -> str:
        """Make the title of the report: the subject and its takes."""
        return f"{self.out.stem}: " + ", ".join(Path(path).name for path in self.files)

    def check(self) -> tuple[tuple[str, str], ...]:
        """Check that options are in range and compatible; return the pairs of `--symmetry`. Raises
        `InputError`."""
        if not self.files:
            raise InputError(
                "There are no files to fit to; give takes of one subject, such as static.c3d rom.c3d."
            )
        if self.threshold is not None and not 0 < self.threshold < np.inf:
            raise InputError(f"--threshold is {self.threshold:g}; give a distance above 0, in metres.")
        if self.frames < 3:
            raise InputError(f"--frames is {self.frames}; give at least 3.")
        if self.template == "human":
            free = self.free_options()
            if free:
                raise InputError(
                    f"{free[0]} is an option of --template none; leave it out, or leave out --template human."
                )
        elif self.template not in (None, "none") and self.segments is None:
            raise InputError(
                "--template needs --segments, a file that gives segments the names of the template's joints; "
                "start from segments.txt of --report."
            )
        check_subject_place(self.out, self.overwrite)
        check_points(self.joints, "joint centres")
        check_new(self.joints, self.overwrite)
        check_folder(self.report)
        return read_symmetry(self.symmetry)
