"""The last pairs of some frames, reused while neither the body nor the pose changes."""

from collections.abc import Callable, Container, Mapping

from ...body.body import Body
from ...body.pose import Pose
from ...fit.correspondence.correspond import PointPairs
from ...parallel import parallel_map
from .pose import are_equal_poses


class PairCache:
    """A cache of pairs by frame."""

    def __init__(self):
        self._known: dict[int, tuple[Body, Pose, PointPairs]] = {}

    def pairs(
        self, body: Body, poses: Mapping[int, Pose], find_pairs: Callable[[int, Pose], PointPairs]
    ) -> list[PointPairs]:
        """Return the pairs of a body in the poses of some frames; those not known are found on all cores."""
        new = {frame: pose for frame, pose in poses.items() if not self._is_current(frame, body, pose)}
        found = parallel_map(lambda each: find_pairs(*each), new.items())
        for (frame, pose), pairs in zip(new.items(), found, strict=True):
            self._known[frame] = body, pose, pairs
        return [self._known[frame][2] for frame in poses]

    def keep(self, frames: Container[int]) -> None:
        """Discard the pairs of all other frames."""
        self._known = {frame: known for frame, known in self._known.items() if frame in frames}

    def _is_current(self, frame: int, body: Body, pose: Pose) -> bool:
        known = self._known.get(frame)
        return known is not None and known[0] is body and are_equal_poses(known[1], pose)
