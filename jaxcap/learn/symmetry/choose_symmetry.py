"""The symmetry with which learning pairs joints."""

import logging
from typing import NamedTuple

from ...observe.meshes import MeshSequence
from .find_symmetry import find_symmetry
from .surface_symmetry import SurfaceSymmetry

_LOG = logging.getLogger(__name__)


#: how joints are paired without a symmetry
OTHERWISE = " Joints are paired by lengths and areas."


class FoundSymmetry(NamedTuple):
    """A symmetry by which joints are paired, or None, and a sentence about it."""

    symmetry: SurfaceSymmetry | None
    sentence: str


def choose_symmetry(meshes: MeshSequence) -> FoundSymmetry:
    """Find the symmetry of the surface, and say how joints are paired with it or without it."""
    _LOG.info("looking for left and right on the surface")
    found, sentence = find_symmetry(meshes)
    if found is None:
        sentence += OTHERWISE
    _LOG.info(sentence)
    return FoundSymmetry(found, sentence)


def judge_motion(found: FoundSymmetry, cost: float, max_cost: float) -> FoundSymmetry:
    """Return no symmetry if the two sides move differently: if parts in pairs raise the error by a share `cost` above `max_cost`."""
    if found.symmetry is None or cost <= max_cost:
        return found
    sentence = (
        f"{found.sentence} The two sides move differently: parts in pairs would raise the error by {100 * cost:.0f} %."
        + OTHERWISE
    )
    _LOG.info(sentence)
    return FoundSymmetry(None, sentence)
