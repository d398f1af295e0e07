"""Subjects as `.npz`: a skeleton and the markers on it, in plain arrays, never pickled."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ...arguments import checked
from ...errors import InputError, user_message
from ...markers.subject import Subject, make_subject
from ..archives.npz import get_array, load_format, save_arrays, skeleton_arrays, skeleton_of
from ..system.reader_errors import reader_of

#: the format's name in the file
FORMAT = "jaxcap subject"


@checked
def save_subject(path: str | Path, subject: Subject) -> None:
    """Write a subject atomically.

    **Raises:** `InputError` if the file cannot be written.
    """
    save_arrays(path, FORMAT, subject_arrays(subject))


def subject_arrays(subject: Subject) -> dict[str, np.ndarray]:
    """Convert a subject to named arrays: those of its skeleton, those of its markers as `marker.*`, and its posture."""
    posture = {} if subject.posture is None else {"posture": np.asarray(subject.posture)}
    return {
        **skeleton_arrays(subject.skeleton),
        "marker.labels": np.array(subject.labels, dtype=str),
        "marker.models": np.array(subject.models, dtype=str),
        "marker.bones": np.asarray(subject.bones, np.int64),
        "marker.offsets": np.asarray(subject.offsets),
        "marker.weights": np.asarray(subject.weights),
        "marker.deviations": np.asarray(subject.deviations),
        **posture,
    }


@checked
@reader_of("a subject")
def load_subject(path: str | Path) -> Subject:
    """Read a subject that `save_subject` wrote.

    **Raises:** `InputError` if the file has another format, is damaged, or is inconsistent.
    """
    return subject_of(load_format(path, FORMAT), path)


def subject_of(arrays: Mapping[str, np.ndarray], path: str | Path) -> Subject:
    """Build the subject from the arrays of `subject_arrays`. Raises `InputError` if they are inconsistent."""
    labels = get_array(arrays, "marker.labels", path, (None,), "text").tolist()
    count = len(labels)
    models = get_array(arrays, "marker.models", path, (count,), "text").tolist()
    bones = get_array(arrays, "marker.bones", path, (count,), "whole")
    weights, deviations = (
        get_array(arrays, f"marker.{name}", path, (count,), row_name="marker")
        for name in ("weights", "deviations")
    )
    offsets = get_array(arrays, "marker.offsets", path, (count, 3), row_name="marker")
    skeleton = skeleton_of(arrays, path)
    posture = None
    if "posture" in arrays:
        posture = get_array(arrays, "posture", path, (skeleton.num_joints, 3), row_name="joint")
    try:
        return make_subject(
            skeleton,
            bones,
            offsets,
            labels,
            weights=weights,
            deviations=deviations,
            models=models,
            posture=posture,
        )
    except ValueError as error:
        raise InputError(f"{path}: {user_message(error)}") from None
