"""The last pairs of a body with the scans of some frames, reused while neither body nor pose changes."""

from collections.abc import Callable, Container, Mapping, Sequence
from typing import Generic, TypeVar

import jax
import numpy as np

from ...body.body import Body
from ...body.pose import Pose
from ...energy.data.pairs import PointPairs
from ...fit.correspondence.nearest_assignment import IndexedScan
from ...parallel import parallel_map
from ..task import AdaptTask
from .fit_frame import pairs_of

AnyScan = TypeVar("AnyScan")


class PairCache(Generic[AnyScan]):
    """A cache of scans and of the last pairs of a body with them, by frame.

    **Arguments:** `scan_at(frame)` returns the scan of a frame; `find_pairs(body, pose, scan)` returns pairs.
    """

    def __init__(
        self, scan_at: Callable[[int], AnyScan], find_pairs: Callable[[Body, Pose, AnyScan], PointPairs]
    ):
        self._scan_at, self._find_pairs = scan_at, find_pairs
        self._scans: dict[int, AnyScan] = {}
        self._known: dict[int, tuple[Body, Pose, PointPairs]] = {}

    def scan(self, frame: int) -> AnyScan:
        """Return the scan of a frame."""
        if frame not in self._scans:
            self._scans[frame] = self._scan_at(frame)
        return self._scans[frame]

    def pairs(self, body: Body, poses: Mapping[int, Pose]) -> list[PointPairs]:
        """Return the pairs of a body in the poses of some frames, and discard scans and pairs of all others.

        Pairs that are not known are found on all cores.
        """
        self.keep(poses)
        new = [frame for frame, pose in poses.items() if not self._is_current(frame, body, pose)]
        found = parallel_map(
            lambda item: self._find_pairs(body, *item), ((poses[frame], self.scan(frame)) for frame in new)
        )
        for frame, pairs in zip(new, found, strict=True):
            self._known[frame] = body, poses[frame], pairs
        return [self._known[frame][2] for frame in poses]

    def record(self, frame: int, body: Body, pose: Pose, pairs: PointPairs) -> None:
        """Keep pairs of a frame that are known."""
        self._known[frame] = body, pose, pairs

    def keep(self, frames: Container[int]) -> None:
        """Discard the scans and pairs of all other frames."""
        self._scans = {frame: scan for frame, scan in self._scans.items() if frame in frames}
        self._known = {frame: known for frame, known in self._known.items() if frame in frames}

    def _is_current(self, frame: int, body: Body, pose: Pose) -> bool:
        known = self._known.get(frame)
        return known is not None and known[0] is body and _are_equal(known[1], pose)


def make_pair_cache(task: AdaptTask, frames: Sequence[int] | None = None) -> PairCache[IndexedScan]:
    """Make a cache of the pairs with a task's scans, of vertices that the task's cameras see.

    **Arguments:** `frames`, the task's frames that are numbered from 0 in the cache; None numbers them as the task
    does.
    """
    matching = task.settings.matching
    return PairCache(
        lambda number: task.scan(number if frames is None else frames[number]),
        lambda body, pose, scan: pairs_of(body, pose, scan, matching, task.cameras),
    )


def _are_equal(a: Pose, b: Pose) -> bool:
    """Test if two poses are bitwise equal."""
    return all(np.array_equal(x, y) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))
