"""Sizes of learned limits that are given, and those that are chosen, with the motion that is left out to choose them."""

from typing import NamedTuple

from .held_out import HeldOut, widest_held_out
from .samples import JointSamples

#: shares of motion outside the training samples that are to be allowed: of other blocks of a take, whose neighbours
#: were seen, and of other takes or people
BLOCK_COVERAGE, COVERAGE = 0.98, 0.99


class Sizes(NamedTuple):
    """Sizes that are given, and None for those to choose; of any unit."""

    voxel: float | None
    keyframe: float | None
    margin: float | None


class Choice(NamedTuple):
    """The sizes of one joint that are chosen, by leaving out motion in turn."""

    #: unit of the motion that is left out
    left_out: HeldOut
    #: share of it that the rest allows
    coverage: float
    #: fields of `Sizes`
    chosen: tuple[str, ...]


def find_choice(
    samples: JointSamples, given: Sizes, held_out: HeldOut | None = None, coverage: float | None = None
) -> Choice:
    """Find the sizes to choose for a joint.

    Where takes or people are left out, voxels have a fixed size and margins are chosen. Where blocks are left out, or where
    the size of the voxels is given, the size of the voxels is chosen, and there is no margin that is not given.
    """
    left_out = "blocks" if given.voxel is not None else held_out or widest_held_out(samples)
    wanted = ["voxel" if left_out == "blocks" else "margin"]
    if samples.parent is not None:
        wanted.append("keyframe")
    chosen = tuple(name for name in wanted if getattr(given, name) is None)
    return Choice(left_out, coverage or (BLOCK_COVERAGE if left_out == "blocks" else COVERAGE), chosen)
