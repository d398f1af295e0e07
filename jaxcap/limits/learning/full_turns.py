"""Joints that turn through a full turn, and have no limits."""

from collections.abc import Mapping

from ...arguments import checked
from ...errors import InputError
from .fit_chart import FullTurnError, find_chart
from .samples import JointSamples


@checked
def find_full_turns(samples: Mapping[str, JointSamples]) -> dict[str, float]:
    """Find the joints that rotate through (almost) a full turn, with the range of each, radians.

    Every rotation of such a joint is allowed, so `learn_limits` leaves it out.
    """
    found = {}
    for name, one in samples.items():
        try:
            find_chart(one)
        except FullTurnError as error:
            found[name] = error.span
    return found


def without_full_turns(samples: Mapping[str, JointSamples]) -> dict[str, JointSamples]:
    """Remove the joints that turn through a full turn, as joints and as parents.

    **Raises:** `InputError` where no joint is left.
    """
    parents = {one.parent.joint: one.parent for one in samples.values() if one.parent is not None}
    turning = find_full_turns({**parents, **samples})
    kept = {
        name: one._replace(parent=None) if one.parent is not None and one.parent.joint in turning else one
        for name, one in samples.items()
        if name not in turning
    }
    if not kept:
        raise InputError(
            f"The joints {', '.join(turning)} rotate through a full turn each, so there are no limits to learn; name other joints."
        )
    return kept
