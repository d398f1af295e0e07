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


def choose_symmetry(meshes: MeshSequence, is_exact: bool = False) -> FoundSymmetry:
    """Find the symmetry of the surface, and say how joints are paired with it or without it.

    If the meshes are to be fitted as exactly as possible (`is_exact`), none is used: one joint without a partner can lower the
    error of such meshes by a large factor.
    """
    if is_exact:
        sentence = (
            "Left and right are not searched on the surface for linear skins with a small alpha." + OTHERWISE
        )
        _LOG.info(sentence)
        return FoundSymmetry(None, sentence)
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
