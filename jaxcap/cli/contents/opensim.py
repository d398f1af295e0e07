"""Descriptions of OpenSim's models and tables."""

from pathlib import Path

import numpy as np

from ...body.coordinates.coordinate_model import Coordinate, CoordinateModel
from ...io.opensim.osim import read_osim
from ...io.opensim.storage import ANGLES_TITLE, read_storage
from ..console.console import pluralise, print_table, say
from .bodies import describe_skeleton


def describe_osim(path: Path) -> str:
    """Print a description of an OpenSim model."""
    model, markers = read_osim(path)
    describe_skeleton(model.skeleton)
    free, clamped = len(model.free), sum(coordinate.is_clamped for coordinate in model.coordinates)
    say(
        f"coordinates: {pluralise(len(model.names), 'coordinate')}, {free} free, {clamped} with a range; "
        f"{pluralise(0 if markers is None else markers.num_markers, 'marker')}"
    )
    rows = [
        [
            coordinate.name,
            "angle" if coordinate.is_angle else "length" if coordinate.leader < 0 else "",
            *(_shown(coordinate, float(value)) for value in (model.defaults[k], model.low[k], model.high[k])),
            _state(model, coordinate),
        ]
        for k, coordinate in enumerate(model.coordinates)
    ]
    print_table(["coordinate", "kind", "at rest", "from", "to", ""], rows)
    if markers is None:
        say("the model has no markers, which `jaxcap markers solve` needs")
        return "osim without markers"
    say(f"markers: {', '.join(markers.labels)}")
    return "osim"


def _state(model: CoordinateModel, coordinate: Coordinate) -> str:
    """Describe what bounds or determines a coordinate; empty if nothing does."""
    if coordinate.leader >= 0:
        return f"follows {model.names[coordinate.leader]}"
    return "locked" if coordinate.is_locked else "clamped" if coordinate.is_clamped else ""


def _shown(coordinate: Coordinate, value: float) -> str:
    """Format a value of a coordinate in degrees or metres."""
    return f"{np.degrees(value):.1f}" if coordinate.is_angle else f"{value:.3f}"


def describe_storage(path: Path) -> str:
    """Print a description of a table of OpenSim."""
    table = read_storage(path)
    named = ", ".join(table.names[:6]) + (", ..." if len(table.names) > 6 else "")
    say(
        f"table: {pluralise(len(table.values), 'row')} at {table.rate:g} a second, from {table.start:g} s, "
        f"{pluralise(len(table.names), 'column')} ({named}), angles in {'degrees' if table.in_degrees else 'radians'}"
    )
    return "joint angles" if table.title == ANGLES_TITLE else "storage"
