"""Tasks of OpenSim's inverse kinematics: weights of markers, and targets of coordinates."""

from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ...arguments import checked
from ...body.coordinates.coordinate_model import CoordinateModel, CoordinateTargets
from ...errors import InputError
from ...markers.subject import DEFAULT_DEVIATION, Subject, make_subject
from ..system.reader_errors import reader_of
from .document import parse_document
from .functions import numbers


class InverseKinematicsTasks(NamedTuple):
    """The tasks of an inverse kinematics."""

    #: label -> weight
    markers: dict[str, float]
    #: name -> (weight for each square metre or radian, value, or None for the default value)
    coordinates: dict[str, tuple[float, float | None]]


@checked
@reader_of("tasks of inverse kinematics")
def read_ik_tasks(path: str | Path) -> InverseKinematicsTasks:
    """Read the tasks of a setup of OpenSim's inverse kinematics, or of a set of tasks (`.xml`).

    **Raises:** `InputError` if the file has no tasks, a weight is negative, or a coordinate follows a file.
    """
    root = parse_document(Path(path), ("OpenSimDocument", "IKTaskSet"))
    markers: dict[str, float] = {}
    coordinates: dict[str, tuple[float, float | None]] = {}
    for element in root.iter():
        if element.tag not in ("IKMarkerTask", "IKCoordinateTask"):
            continue
        name = element.get("name", "")
        where = f"{path}: task '{name}'"
        if (element.findtext("apply") or "true").strip().lower() == "false":
            if element.tag == "IKMarkerTask":
                markers.setdefault(name, 0.0)
            continue
        weight = numbers(element, "weight", where, 1)[0] if element.find("weight") is not None else 1.0
        if weight < 0:
            raise InputError(f"{where} has the weight {weight:g}; expected at least 0.")
        if element.tag == "IKMarkerTask":
            markers[name] = weight
            continue
        kind = (element.findtext("value_type") or "default_value").strip()
        if kind not in ("default_value", "manual_value"):
            raise InputError(f"{where} takes its value '{kind}'; expected default_value or manual_value.")
        value = numbers(element, "value", where, 1)[0] if kind == "manual_value" else None
        coordinates[name] = weight, value
    if not any(markers.values()):
        raise InputError(
            f"{path}: there is no task of a marker with a weight; give a setup of inverse kinematics."
        )
    return InverseKinematicsTasks(markers, coordinates)


@checked
def coordinate_targets(model: CoordinateModel, tasks: InverseKinematicsTasks) -> CoordinateTargets | None:
    """Make targets of the tasks of coordinates, with weights relative to the largest weight of a marker; None if there is none.

    **Raises:** `InputError` if the model has no such coordinate.
    """
    unknown = [name for name in tasks.coordinates if name not in model.names]
    if unknown:
        raise InputError(
            f"coordinate_targets: the model has no coordinate '{unknown[0]}'; give the tasks of this model."
        )
    if not tasks.coordinates:
        return None
    values, weights = np.array(model.defaults), np.zeros(len(model.names))
    for name, (weight, value) in tasks.coordinates.items():
        number = model.index(name)
        weights[number] = weight / max(tasks.markers.values()) / DEFAULT_DEVIATION**2
        values[number] = values[number] if value is None else value
    return CoordinateTargets(jnp.asarray(values), jnp.asarray(weights))


@checked
def weigh_markers(subject: Subject, tasks: InverseKinematicsTasks) -> Subject:
    """Give markers the weights of their tasks, relative to the largest; markers without a task get none.

    **Raises:** `InputError` if no marker of the subject has a task.
    """
    weights = np.array([tasks.markers.get(label, 0.0) for label in subject.labels])
    if not weights.any():
        raise InputError(
            f"weigh_markers: none of the tasks ({', '.join(list(tasks.markers)[:5])}, ...) is of a marker of the model "
            f"({', '.join(subject.labels[:5])}, ...); give the tasks of this model."
        )
    return make_subject(
        subject.skeleton,
        np.asarray(subject.bones),
        np.asarray(subject.offsets),
        subject.labels,
        weights=weights / max(tasks.markers.values()),
        deviations=np.asarray(subject.deviations),
        models=subject.models,
    )
