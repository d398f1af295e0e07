"""OpenSim models as subjects of `jaxcap markers solve`."""

from pathlib import Path
from typing import NamedTuple

from ...body.coordinates.coordinate_model import CoordinateModel, CoordinateTargets
from ...errors import InputError
from ...io.markers.subject import load_subject
from ...io.opensim.osim import read_osim
from ...io.opensim.tasks import coordinate_targets, read_ik_tasks, weigh_markers
from ...markers.subject import Subject
from ..console.console import warn

SUFFIX = ".osim"


class SolvedModel(NamedTuple):
    """An OpenSim model, and targets of its coordinates."""

    model: CoordinateModel
    targets: CoordinateTargets | None


def load_subject_or_model(path: Path, tasks: Path | None) -> tuple[Subject, SolvedModel | None]:
    """Load a subject, or an OpenSim model with the tasks of its inverse kinematics. Raises `InputError`."""
    if path.suffix.lower() != SUFFIX:
        if tasks is not None:
            raise InputError(f"{tasks}: --tasks is for OpenSim models (.osim); {path.name} is none.")
        return load_subject(path), None
    model, subject = read_osim(path)
    if subject is None:
        raise InputError(f"{path}: the model has no markers; add those of the trials in OpenSim.")
    if tasks is None:
        return subject, SolvedModel(model, None)
    read = read_ik_tasks(tasks)
    unknown = [label for label in read.markers if label not in subject.labels]
    if unknown:
        warn(
            f"{tasks}: {len(unknown)} tasks are of markers that the model does not have: {', '.join(unknown[:10])}"
        )
    return weigh_markers(subject, read), SolvedModel(model, coordinate_targets(model, read))
