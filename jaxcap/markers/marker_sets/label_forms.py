"""Labels of a take in the forms that marker sets have: without names and common endings, with sides in front."""

import re
from collections import Counter
from collections.abc import Sequence

from .marker_table import normalise_label

#: share of the labels that begin or end alike, such as with the name of the person, and share of those of one of two sets of points
_COMMON_SHARE, _GROUP_SHARE = 0.6, 0.3
#: number of words that are cut off each end at most
_MAX_WORDS = 3
#: labels that are the same without the common word from which on those with it and those without it are two sets of points
_MIN_COLLISIONS = 3
#: number of labels in pairs that differ only in a letter at the end from which on the letters are sides
_MIN_PAIRS = 4
_SIDES = ("L", "R", "LEFT", "RIGHT")
#: letters of the sides at the end of French labels (gauche, droite)
_FRENCH_SIDES = "GD"


def label_variants(labels: Sequence[str]) -> list[tuple[str, ...]]:
    """Normalise labels in several ways: as they are, without the words that most begin or end with, and with French sides
    in front as English letters."""
    variants, words = [tuple(normalise_label(label) for label in labels)], _split_words(labels)
    for end in (0, -1):
        for _ in range(_MAX_WORDS):
            common = _common_word(words, end)
            if common is None:
                break
            words = [_without(word, end, common) for word in words]
            variants.append(tuple(normalise_label("".join(word)) for word in words))
    return [*variants, *(_translate_sides(forms) for forms in variants if _has_french_sides(forms))]


def label_groups(labels: Sequence[str]) -> list[list[str]]:
    """Group labels into those with a common word at an end and those without it, if many are the same otherwise.

    Such are two sets of points in one file: `RKnee` of a network that sees joints in images, and `r_knee_study` of the markers that are
    computed from them.
    """
    words = _split_words(labels)
    for end in (0, -1):
        common = _common_word(words, end, _GROUP_SHARE)
        if common is None:
            continue
        marked = {
            label: "".join(_without(word, end, common))
            for label, word in zip(labels, words, strict=True)
            if len(word) > 1 and word[end].upper() == common
        }
        rest, plain = (
            [label for label in labels if label not in marked],
            set(map(normalise_label, marked.values())),
        )
        if sum(normalise_label(label) in plain for label in rest) >= _MIN_COLLISIONS:
            return [list(marked), rest]
    return [list(labels)]


def repeated_labels(labels: Sequence[str]) -> frozenset[str]:
    """Find labels with a number that readers of files append to the second of two equal labels, such as `LASI_2`."""
    return frozenset(label for label in labels if re.sub(r"_\d+$", "", label) in set(labels) - {label})


def exchanged_sides(form: str) -> list[str]:
    """Write a normalised label with the other side: the letter in front, or the one at the end."""
    letters = {"L": "R", "R": "L"}
    front = [letters[form[0]] + form[1:]] if form[:1] in letters else []
    return [*front, *([form[:-1] + letters[form[-1]]] if form[-1:] in letters else [])]


def _split_words(labels: Sequence[str]) -> list[list[str]]:
    return [re.split(r"[_\-. ]+", label.rsplit(":", 1)[-1]) for label in labels]


def _common_word(words: Sequence[Sequence[str]], end: int, share: float = _COMMON_SHARE) -> str | None:
    """Find the word that a share of the labels have at an end, no side and not the whole label."""
    shared = Counter(word[end].upper() for word in words if len(word) > 1)
    if not shared:
        return None
    common, count = shared.most_common(1)[0]
    return None if count < share * len(words) or common in _SIDES else common


def _without(word: list[str], end: int, common: str) -> list[str]:
    if len(word) < 2 or word[end].upper() != common:
        return word
    return word[1:] if end == 0 else word[:-1]


def _has_french_sides(forms: Sequence[str]) -> bool:
    return _count_pairs(forms, _FRENCH_SIDES) >= _MIN_PAIRS and not _count_pairs(forms, "LR")


def _count_pairs(forms: Sequence[str], letters: str) -> int:
    """Count the pairs of labels that differ in their last letter only, which is that of a side."""
    left, right = letters
    known = set(forms)
    return sum(len(form) > 2 and form[-1] == left and form[:-1] + right in known for form in known)


def _translate_sides(forms: Sequence[str]) -> tuple[str, ...]:
    """Move French sides of paired labels to the front, as English letters: `ELG` and `ELD` become `LEL` and `REL`."""
    known, (left, right) = set(forms), _FRENCH_SIDES
    english = {left: "L", right: "R"}
    return tuple(
        english[form[-1]] + form[:-1]
        if len(form) > 2 and form[-1] in english and {form[:-1] + left, form[:-1] + right} <= known
        else form
        for form in forms
    )
