"""`jaxcap markers label`: labels for unlabelled markers, by a calibrated subject."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from ...errors import InputError
from ...io.markers.subject import load_subject
from ...io.registry import write_markers
from ...io.system.run_lock import run_lock
from ...io.table import write_csv
from ...markers.labels.label_markers import Labelling, label_markers
from ...markers.subjects.label_subjects import label_subjects
from ...observe.markers import MarkerFrames
from ..console.console import say, warn
from ..console.heartbeat import set_activity
from ..console.options import Flag, OptionalFile, OptionalUnit, arg
from ..outputs import check_parent
from .subject_files import names_in, subject_names
from .takes import OptionalSubject, OptionalUp, check_new, check_points, read_take


@dataclass
class Label:
    """Label the markers of a raw file by a calibrated subject: points without labels get those of the subject.

    Labels of the subject that the file has are kept, unless the poses contradict them. Points that are no markers are left
    out. Frames without a pose that explains the points are listed."""

    file: tyro.conf.Positional[Annotated[str, arg(metavar="RAW")]]
    """A .c3d, .trc or .csv file. Labels that the subject does not have, such as *7 or C_12, are ignored."""
    subject: tyro.conf.UseAppendAction[
        Annotated[tuple[Path, ...], arg(metavar="FILE", help_behavior_hint="")]
    ]
    """The subject: a result of `jaxcap markers fit`. Several people and props in one file: one --subject for each; the labels
    then have the names of their files as prefixes, such as Anna:LASI of subject-Anna.npz and subject-Ben.npz."""
    out: Annotated[Path, arg(aliases=("-o",), metavar="OUT")]
    """Output file for the labelled markers, .c3d, .trc or .csv."""
    ignore_labels: Flag = False
    """Ignore all labels of the file."""
    tracks: OptionalFile = None
    """Output file for a table of all pieces of trajectories, with their frames and labels, .csv."""
    unit: OptionalUnit = None
    """Unit of the file's lengths, instead of the unit that it states: m, dm, cm, mm, in or ft."""
    person: OptionalSubject = None
    """Person to use if the file has several: the prefix of the labels of their markers."""
    up: OptionalUp = None
    """Up axis of the file; the result then has y up. Default: the axes of the file are kept."""
    overwrite: Flag = False
    """Replace the results if they exist."""

    def run(self) -> None:
        files = [path for path in (self.out, self.tracks) if path is not None]
        check_points((self.out,), "markers")
        if self.tracks is not None:
            if self.tracks.suffix.lower() != ".csv":
                raise InputError(
                    f"{self.tracks}: the table of tracks is a CSV file; give a name that ends in .csv."
                )
            check_parent(self.tracks)
        check_new(files, self.overwrite)
        if not self.subject:
            raise InputError("There is no subject; give a result of `jaxcap markers fit` as --subject.")
        names = subject_names(self.subject, names_in([self.file], self.unit))
        subjects = dict(zip(names, map(load_subject, self.subject), strict=True))
        set_activity("reading the file")
        frames = read_take(
            self.file, self.unit, self.person, self.up, "keep", several=len(subjects) > 1
        ).frames
        with run_lock(*files):
            set_activity("labelling the markers")
            try:
                if len(subjects) > 1:
                    found = label_subjects(subjects, frames, ignore_labels=self.ignore_labels)
                else:
                    found = label_markers(subjects[names[0]], frames, ignore_labels=self.ignore_labels)
            except ValueError as error:
                raise InputError(f"{self.file}: {error}") from None
            write_markers(self.out, found.frames)
            say(f"labelled markers: {self.out}")
            if self.tracks is not None:
                write_csv(self.tracks, [one._asdict() for one in found.tracks])
                say(f"tracks: {self.tracks}")
        _print_summary(frames, found)
        for sentence in found.messages:
            warn(f"{Path(self.file).name}: {sentence}")


def _print_summary(frames: MarkerFrames, found: Labelling) -> None:
    """Print how many points have labels, and how many tracks have none."""
    total, labelled = int(np.asarray(frames.visible).sum()), int(np.asarray(found.frames.visible).sum())
    counts = Counter(one.label is not None for one in found.tracks)
    say(
        f"{labelled} of {total} points ({100 * labelled / max(total, 1):.1f} %) have labels, in {counts[True]} tracks; "
        f"{counts[False]} tracks with {total - labelled} points are of no marker and left out"
    )
    share = 100 * np.asarray(found.frames.visible).mean(0)
    worst = sorted(zip(found.frames.labels, share.tolist(), strict=True), key=lambda pair: pair[1])[:5]
    say(f"seen least: {', '.join(f'{label} {percent:.0f} %' for label, percent in worst)}")
