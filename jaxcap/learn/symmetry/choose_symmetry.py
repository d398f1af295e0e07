"""The symmetry with which learning pairs joints."""

import logging

from ...observe.meshes import MeshSequence
from .find_symmetry import find_symmetry
from .surface_symmetry import SurfaceSymmetry

_LOG = logging.getLogger(__name__)


def choose_symmetry(meshes: MeshSequence) -> tuple[SurfaceSymmetry | None, str]:
    """Find the symmetry of the surface, and say how joints are paired with it or without it."""
    _LOG.info("looking for left and right on the surface")
    found, sentence = find_symmetry(meshes)
    if found is None:
        sentence += " Joints are paired by lengths and areas."
    _LOG.info(sentence)
    return found, sentence
