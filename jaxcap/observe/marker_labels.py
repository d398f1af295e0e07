"""Subjects by the labels of markers: `Anna:LASI`, `Anna_LASI`, `LASI1`."""

import re
from collections.abc import Iterator, Mapping, Sequence

#: separators of a subject's name from a label, apart from the colon
SEPARATORS = "_.|- "
#: the index of a marker, and its label without the subject
Members = Mapping[int, str]


def group_by_subject(labels: Sequence[str]) -> dict[str, list[int]]:
    """Group markers by subject, the prefix of labels such as `Anna:LKNE`, in the file's order."""
    return {name: list(members) for name, members in group_by_colon(labels).items()}


def group_by_colon(labels: Sequence[str]) -> dict[str, dict[int, str]]:
    """Group markers by the prefix of labels such as `Anna:LKNE`, with their labels after the first colon."""
    found: dict[str, dict[int, str]] = {}
    for index, label in enumerate(labels):
        subject, colon, rest = label.partition(":")
        if colon and subject.strip() and rest.strip():
            found.setdefault(subject.strip(), {})[index] = rest.strip()
    return found


def affix_groupings(labels: Sequence[str]) -> Iterator[dict[str, dict[int, str]]]:
    """Yield groupings by other prefixes and suffixes: `Anna_LASI`, `LASI.Anna`, `1LASI`, `LASI1`.

    Each groups the labels that have the affix by it; others are in no group. Whether an affix is a subject's name, the
    labels without it have to show.
    """
    for separator in SEPARATORS:
        for at_end in (False, True):
            yield _group(labels, lambda label, s=separator, e=at_end: _split(label, s, e))
    for pattern in (r"(?P<name>\d+)(?P<rest>\D.*)", r"(?P<rest>.*\D)(?P<name>\d+)"):
        yield _group(labels, lambda label, p=pattern: _match(label, p))


def label_stem(label: str) -> str:
    """Cut the number of a marker from its label: `Sword` of `Sword_12`; empty for `*12` and `12`."""
    return re.sub(r"[\W_]*\d*$", "", label.strip()).strip("*_ .-|:")


def _group(labels: Sequence[str], split) -> dict[str, dict[int, str]]:
    found: dict[str, dict[int, str]] = {}
    for index, label in enumerate(labels):
        name, rest = split(label)
        if name and rest:
            found.setdefault(name, {})[index] = rest
    return found


def _split(label: str, separator: str, at_end: bool) -> tuple[str, str]:
    if at_end:
        rest, _, name = label.rpartition(separator)
    else:
        name, _, rest = label.partition(separator)
    return name.strip(), rest.strip()


def _match(label: str, pattern: str) -> tuple[str, str]:
    found = re.fullmatch(pattern, label)
    return ("", "") if found is None else (found["name"], found["rest"].strip(SEPARATORS))
