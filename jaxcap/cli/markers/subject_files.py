"""Files of several subjects: their names, and a run for each of them."""

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any, ClassVar, NoReturn, Protocol, runtime_checkable

from ...errors import InputError, user_message
from ...io.registry import read_marker_file
from ...markers.subject import Subject
from ...markers.subjects.split_subjects import (
    UNNAMED_PERSON,
    SubjectMarkers,
    SubjectSplit,
    find_named_groups,
    select_members,
    split_subjects,
)
from ...observe.marker_labels import group_by_subject
from ...observe.markers import MarkerFrames
from ..console.console import say, warn
from ..outputs import check_npz, names_folder
from .takes import Pieces, Up, check_folder, check_new, read_take, separate_static


@runtime_checkable
class SubjectFitter(Protocol):
    """A dataclass of options that fits one subject and writes it to the places that they name."""

    __dataclass_fields__: ClassVar[dict[str, Any]]
    files: tuple[str, ...]
    static: Path | None
    unit: str | None
    subject: str | None
    up: Up | None
    pieces: Pieces
    out: Path
    joints: tuple[Path, ...]
    report: Path | None
    overwrite: bool

    def fit_subject(self, markers: SubjectMarkers, is_prop: bool, static: MarkerFrames | None) -> None:
        """Fit a subject, a person with its static trial, and write it."""
        ...


def has_several(frames: MarkerFrames) -> bool:
    """Test if the labels have the prefixes of several subjects."""
    return len(group_by_subject(frames.labels)) > 1


def print_subjects(frames: MarkerFrames) -> None:
    """Print the people and the rigid props of a recording, and why other markers are neither."""
    split = split_subjects(frames)
    for kind, some in (("people", split.people), ("props", split.props)):
        if some:
            say(f"{kind}: {', '.join(f'{one.name} ({len(one.labels)} markers)' for one in some)}")
    if split.people or split.props:
        for other in split.unassigned:
            say(f"no subject: {other.reason}")


def file_name(name: str) -> str:
    """Make a name of a file from that of a subject."""
    return re.sub(r"[^\w.-]+", "_", name) or "_"


def place_of(path: Path, name: str, *, alone: bool = False) -> Path:
    """Place a subject's result: `Anna.npz` in a folder, `subject-Anna.npz` next to `subject.npz`, which is its own if alone."""
    if names_folder(path):
        return path / f"{file_name(name)}.npz"
    return path if alone else path.with_name(f"{path.stem}-{file_name(name)}{path.suffix}")


def check_subject_place(path: Path, overwrite: bool) -> None:
    """Check that subjects can be written to a file, or into a folder. Raises `InputError`."""
    if names_folder(path):
        check_folder(path)
    else:
        check_npz(path, overwrite, "a subject")


def refuse_all(path: str, frames: MarkerFrames, split: SubjectSplit) -> NoReturn:
    """Raise `InputError` for a recording of several subjects that are neither people nor props."""
    groups = group_by_subject(frames.labels)
    most = max(groups, key=lambda name: len(groups[name]))
    raise InputError(
        f"{path}: none of the {len(groups)} subjects is a person or a rigid prop. {' '.join(other.reason for other in split.unassigned)} To "
        f"fit one by the segments that are found, select one with --subject {most}."
    )


def static_and_moving(
    options: SubjectFitter, takes: list[MarkerFrames]
) -> tuple[MarkerFrames | None, list[MarkerFrames]]:
    """Read the static trial, or find it among the takes; return it and the other takes."""
    if options.static is None:
        return separate_static(takes, options.files)
    static = read_take(
        str(options.static), options.unit, None, options.up, options.pieces, several=True
    ).frames
    return static if options.subject is None else static_of(static, options.subject), takes


def static_of(static: MarkerFrames, name: str | None) -> MarkerFrames | None:
    """Select the markers of a person in a static trial: those with the name, or all if none has a name."""
    groups = find_named_groups(static)
    if not groups:
        return static
    if name is None and len(groups) == 1:
        name = next(iter(groups))
    if name is not None and name in groups:
        return select_members(static, groups[name])
    people = split_subjects(static).people
    if name == UNNAMED_PERSON and len(people) == 1:
        return people[0].frames
    if name == UNNAMED_PERSON and people:
        raise InputError(
            f"The person in the takes has no name, and the static trial has {len(people)} people ({', '.join(one.name for one in people)}); "
            "give the labels of both the same prefix, such as Anna:LASI."
        )
    warn(f"the static trial has no markers of {name}; it has those of {', '.join(groups)}")
    return None


def without_labels(frames: MarkerFrames | None, labels: Collection[str]) -> MarkerFrames | None:
    """Select the markers that have none of some labels."""
    if frames is None:
        return None
    return select_members(
        frames, {index: label for index, label in enumerate(frames.labels) if label not in labels}
    )


def fit_each(options: SubjectFitter, split: SubjectSplit, static: MarkerFrames | None = None) -> None:
    """Fit each person and prop of a recording with results of its own; those that fail do not stop the others.

    **Raises:** `InputError` with the reasons of those that failed, after all others are written.
    """
    if static is not None and len(split.people) > 1 and not find_named_groups(static):
        raise InputError(
            f"The static trial has no names, and the takes have those of {len(split.people)} people; give its labels a prefix such as "
            f"{split.people[0].name}:LASI, or select a person with --subject."
        )
    for other in split.unassigned:
        warn(other.reason)
    subjects = [*((one, False) for one in split.people), *((one, True) for one in split.props)]
    say(
        f"people: {', '.join(one.name for one in split.people) or 'none'}; props: {', '.join(one.name for one in split.props) or 'none'}"
    )
    alone = len(subjects) == 1
    runs = [
        replace(
            options,
            out=place_of(options.out, one.name, alone=alone),
            joints=tuple(
                path if alone else path.with_name(f"{path.stem}-{file_name(one.name)}{path.suffix}")
                for path in options.joints
            ),
            report=options.report
            if options.report is None or alone
            else options.report / file_name(one.name),
        )
        for one, _ in subjects
    ]
    check_new([path for run in runs for path in (run.out, *run.joints)], options.overwrite)
    of_props = {label for prop in split.props for label in prop.labels}

    def fit(run: SubjectFitter, one: SubjectMarkers, is_prop: bool) -> None:
        if is_prop or static is None:
            run.fit_subject(one, is_prop, None)
        else:
            run.fit_subject(one, is_prop, without_labels(static_of(static, one.name), of_props))

    run_each(
        {
            one.name: partial(fit, run, one, is_prop)
            for run, (one, is_prop) in zip(runs, subjects, strict=True)
        },
        "fitted",
    )


def run_each(runs: Mapping[str, Callable[[], None]], done: str) -> None:
    """Run a function for each subject, by its name; those that fail do not stop the others.

    **Raises:** `InputError` with the reasons of those that failed and are not `done`, after all others.
    """
    failed = []
    for name, run in runs.items():
        if len(runs) > 1:
            say(f"\n{name}:")
        try:
            run()
        except (InputError, ValueError) as error:
            failed.append(f"{name}: {user_message(error)}")
            say(f"not {done}; the reason is in the last message")
    if failed:
        raise InputError(
            f"{len(failed)} of {len(runs)} subjects {'is' if len(failed) == 1 else 'are'} not {done}. {' '.join(failed)}"
        )


def subject_names(paths: Sequence[Path], present: Collection[str] = ()) -> list[str]:
    """Name subjects by their files: `Anna` and `Ben` of `subject-Anna.npz` and `subject-Ben.npz`.

    A name that is `present` in a recording and whose file this is comes first, such as `S-01` or `Anna Lee`. Raises `InputError`.
    """
    words = [path.stem.split("-") for path in paths]
    while len(words) > 1 and min(map(len, words)) > 1 and len({word[0] for word in words}) == 1:
        words = [word[1:] for word in words]
    by_file = {file_name(name): name for name in present}
    names = []
    for path, rest in zip(paths, words, strict=True):
        parts = path.stem.split("-")
        ends = ["-".join(parts[start:]) for start in range(len(parts))]
        names.append(next((by_file[end] for end in ends if end in by_file), "-".join(rest)))
    for path, name in zip(paths, names, strict=True):
        if names.count(name) > 1:
            raise InputError(
                f"{path}: two subjects have the name '{name}'; give their files different names."
            )
    return names


def names_in(trials: Sequence[str], unit: str | None) -> set[str]:
    """List the names of subjects in recordings."""
    return {name for path in trials for name in find_named_groups(read_marker_file(Path(path), unit).frames)}


def named_trials(
    trials: Sequence[str], unit: str | None, subjects: Mapping[str, Subject]
) -> dict[str, list[str]]:
    """List the subjects of each trial whose names are prefixes or suffixes of its labels.

    **Raises:** `InputError` where labels without a prefix are those of two subjects.
    """
    found = {}
    for path in trials:
        frames = read_marker_file(Path(path), unit).frames
        groups = find_named_groups(frames)
        bare = {name: set(one.labels) for name, one in subjects.items() if name not in groups}
        for one, other in combinations(bare, 2):
            shared = sorted(bare[one] & bare[other] & set(frames.labels))
            if shared:
                raise InputError(
                    f"{path}: '{shared[0]}' is a marker of {one} and of {other}, and has no prefix; label the trial first, with "
                    "`jaxcap markers label` and all subjects."
                )
        found[path] = [name for name in subjects if name in groups]
    return found
