"""Several takes of one subject as one."""

from collections.abc import Sequence

import numpy as np

from ...arguments import checked
from ...observe.markers import MarkerFrames


@checked
def merge_takes(takes: Sequence[MarkerFrames]) -> MarkerFrames:
    """Concatenate the frames of several takes, matching markers by label.

    A marker that a take does not have is not visible in it. Labels are in the order of their first
    appearance. The rate is that of the first take.

    **Raises:** `ValueError` where there are no takes, or one shares no label with those before it.
    """
    if not takes:
        raise ValueError("There are no takes to merge; give at least one.")
    labels: dict[str, int] = {}
    for number, take in enumerate(takes):
        if number and not set(take.labels) & set(labels):
            raise ValueError(
                f"Take {number + 1} has no marker ({_format_labels(take.labels)}) in common with the previous takes "
                f"({_format_labels(tuple(labels))}); merge takes of the same markers only."
            )
        for label in take.labels:
            labels.setdefault(label, len(labels))
    count = sum(len(take) for take in takes)
    dtype = np.result_type(*(np.asarray(take.positions).dtype for take in takes))
    positions, seen = np.zeros((count, len(labels), 3), dtype), np.zeros((count, len(labels)), bool)
    begin = 0
    for take in takes:
        rows, columns = slice(begin, begin + len(take)), [labels[label] for label in take.labels]
        positions[rows, columns], seen[rows, columns] = np.asarray(take.positions), np.asarray(take.visible)
        begin += len(take)
    return MarkerFrames(positions, seen, tuple(labels), takes[0].rate)


def _format_labels(labels: tuple[str, ...]) -> str:
    return ", ".join(labels[:4]) + (", ..." if len(labels) > 4 else "")
