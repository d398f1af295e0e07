"""`jaxcap markers info`: rate, frames, markers and gaps of a file."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from ...errors import InputError, user_message
from ...io.markers.marker_file import check_marker_extent, median_extent, select_subject
from ...io.markers.up_axis import find_up_axis
from ...io.registry import read_marker_file
from ...markers.segments.gaps import describe_problems, gap_statistics
from ...observe.marker_labels import group_by_subject
from ...observe.markers import MarkerFrames
from ..console.console import pluralise, print_table, say, warn
from ..console.options import Flag, OptionalFile, OptionalUnit, arg
from ..outputs import check_new
from .subject_files import print_subjects
from .takes import UNIT_ASKED, describe_source, largest_subject

#: width of a marker's time bar, characters
WIDTH = 40


@dataclass
class Info:
    """Describe a file of markers: rate, frames, unit, extent, and the gaps of each marker."""

    file: tyro.conf.Positional[Annotated[str, arg(metavar="FILE")]]
    """A .c3d, .trc or .csv file."""
    unit: OptionalUnit = None
    """Unit of the file's lengths, instead of the unit that it states: m, dm, cm, mm, in or ft."""
    subject: Annotated[str | None, arg(metavar="NAME", help_behavior_hint="")] = None
    """Subject to describe if the file has several: the prefix of the labels of its markers."""
    rows: Annotated[int, arg(metavar="N")] = 20
    """Number of markers in the table, the least visible first; 0 lists all."""
    picture: OptionalFile = None
    """Output file for a picture of the gaps, .png."""
    overwrite: Flag = False
    """Replace the picture if it exists."""

    def run(self) -> None:
        path = Path(self.file)
        if self.rows < 0:
            raise InputError(f"--rows {self.rows}: give 0 or a number of markers.")
        if self.picture is not None and self.picture.suffix.lower() != ".png":
            raise InputError(f"{self.picture}: the picture is a PNG file; give a name that ends in .png.")
        check_new(self.picture, self.overwrite)
        file = read_marker_file(path, self.unit)
        subjects = group_by_subject(file.frames.labels)
        several = self.subject is None and len(subjects) > 1
        frames = file.frames if several else select_subject(file.frames, path, self.subject)
        count = len(frames)
        say(f"{path.name}: {pluralise(count, 'frame')} at {frames.rate:g} frames per second, {count / frames.rate:.2f} s, the first frame is {file.first_frame}")  # fmt: skip
        say(f"markers: {len(frames.labels)}{_starred(frames)}, unit {file.unit}, {_extent(frames)}")
        # the largest of several subjects shows the vertical and the unit
        body = next(iter(largest_subject(frames)), frames)
        found = find_up_axis(file._replace(frames=body))
        if found is not None:
            say(f"up axis: {describe_source(found)}")
        for name, members in subjects.items():
            say(f"subject: {name}, {len(members)} markers")
        print_subjects(frames)
        for kind, labels in file.other_points.items():
            say(f"{kind}: {len(labels)} ({_some(labels)})")
        _print_gaps(frames, self.rows)
        for sentence in (*file.warnings, *describe_problems(frames)):
            warn(sentence)
        if several:
            warn(
                f"there are {len(subjects)} subjects: {', '.join(subjects)}; `markers fit` fits all of them, `markers solve` and `markers label` "
                "take their files, and other verbs read one, selected with --subject."
            )
        try:
            for sentence in check_marker_extent(body, path, file.scale, option_hint=UNIT_ASKED)[1]:
                warn(sentence)
        except InputError as error:
            warn(user_message(error))
        if self.picture is not None:
            from ...report.markers.marker_gaps import draw_gaps

            draw_gaps(self.picture, frames, path.name)
            say(f"written: {self.picture}")


def _print_gaps(frames: MarkerFrames, most: int) -> None:
    """Print the table of gaps, sorted by visibility, the least visible marker first."""
    seen, gaps = np.asarray(frames.visible), gap_statistics(frames)
    gappy = np.flatnonzero(gaps.num_gaps)
    whole = 100 * seen.mean()
    if not len(gappy):
        say("gaps: none, every marker is seen in every frame")
        return
    say(
        f"gaps: {len(gappy)} of {len(frames.labels)} markers have gaps; {whole:.{1 if whole < 99.9 else 3}f} % is seen"
    )
    order = gappy[np.argsort(gaps.visible_fraction[gappy], kind="stable")]
    shown = order[: most or None]
    print_table(
        ["marker", "seen", "gaps", "longest", "time".ljust(WIDTH)],
        [
            [
                frames.labels[i],
                f"{100 * gaps.visible_fraction[i]:.2f} %",
                str(gaps.num_gaps[i]),
                f"{gaps.longest_gap[i] / frames.rate:.3g} s",
                time_bar(seen[:, i]),
            ]
            for i in shown
        ],
    )
    if len(order) > len(shown):
        say(f"... and {len(order) - len(shown)} more; --rows 0 shows all")


def time_bar(seen: np.ndarray, width: int = WIDTH) -> str:
    """Format a time bar from left to right: full if a marker is always visible, empty if never."""
    marks = " ░▒▓█"
    try:
        marks.encode(sys.stdout.encoding or "ascii")
    except UnicodeEncodeError:
        marks = " .:+#"
    parts = np.array_split(seen, min(width, len(seen)))
    # short gaps must show: only a gapless part is full, and only a part without observations is empty
    shares = [float(part.mean()) for part in parts]
    inner = len(marks) - 3
    return "".join(
        marks[0]
        if share == 0
        else marks[-1]
        if share == 1
        else marks[1 + min(int(share * (inner + 1)), inner)]
        for share in shares
    ).ljust(width)


def _starred(frames: MarkerFrames) -> str:
    count = sum(label.startswith("*") for label in frames.labels)
    return f" ({count} without a label)" if count else ""


def _extent(frames: MarkerFrames) -> str:
    seen = np.asarray(frames.visible)
    places = np.asarray(frames.positions, float)[seen]
    sides = " x ".join(f"{side:.3g}" for side in np.ptp(places, axis=0))
    size = median_extent(frames)
    return f"all frames {sides} m" + ("" if np.isnan(size) else f", one frame {size:.3g} m")


def _some(labels: tuple[str, ...]) -> str:
    return ", ".join(labels[:6]) + (", ..." if len(labels) > 6 else "")
