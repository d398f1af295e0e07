"""Pairs of a body with the scans of a task, and the poses and distances from them (Adaptation, 4.1.2)."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from ...body.body import Body
from ...body.pose import Pose
from ...fit.correspondence.correspond import IndexedScan, PointPairs
from ...geometry.stacking import stack_trees
from ...parallel import parallel_map
from ..objective import Terms, mean_squared_distance, motion_energy, pose_energy, symmetry_energy
from ..shape.reference import shape_prior_of
from ..shape.shape_prior import shape_energy
from ..task import AdaptState, AdaptTask
from .known_pairs import PairCache
from .pose import fit_pose, pairs_of


def pairs_at(task: AdaptTask, body: Body, pose: Pose, scan: IndexedScan) -> PointPairs:
    """Find the pairs of a posed body with a scan, of vertices that the task's cameras see."""
    return pairs_of(body, pose, scan, task.settings.matching, task.cameras)


def pose_at(task: AdaptTask, state: AdaptState, scan: IndexedScan, start: Pose, *, steps: int) -> Pose:
    """Fit the pose of the body to a scan from an initial pose."""
    return fit_pose(
        state.body,
        scan,
        start,
        task.pose_terms(state.pose_weight),
        task.settings.matching,
        steps=steps,
        cameras=task.cameras,
    ).pose


def poses_at(
    task: AdaptTask, state: AdaptState, scans: Iterable[IndexedScan], starts: Iterable[Pose], *, steps: int
) -> Iterator[Pose]:
    """Fit the poses of the body to several scans, each by itself, on all cores."""
    both = zip(scans, starts, strict=True)
    return parallel_map(lambda each: pose_at(task, state, *each, steps=steps), both)


class TaskPairs:
    """A cache of the scans of some frames and of their last pairs, valid for the same body and pose."""

    def __init__(self, task: AdaptTask):
        self._task = task
        self._scans: dict[int, IndexedScan] = {}
        self._known = PairCache()

    def scans(self, frames: Sequence[int]) -> list[IndexedScan]:
        """Return the scans of some frames, and discard all others from the cache."""
        for gone in set(self._scans) - set(frames):
            del self._scans[gone]
        self._known.keep(frames)
        for frame in frames:
            if frame not in self._scans:
                self._scans[frame] = self._task.scan(frame)
        return [self._scans[frame] for frame in frames]

    def pairs(self, body: Body, frames: Sequence[int], poses: Sequence[Pose]) -> list[PointPairs]:
        """Find the pairs of a body with the scans of some frames, on all cores."""
        scans = dict(zip(frames, self.scans(frames), strict=True))
        posed = dict(zip(frames, poses, strict=True))
        return self._known.pairs(body, posed, lambda n, pose: pairs_at(self._task, body, pose, scans[n]))


def append_history(
    task: AdaptTask, state: AdaptState, name: str, frames: Sequence[int], pair_cache: TaskPairs | None = None
) -> AdaptState:
    """Append a stage's terms in some frames to the state's history; `pair_cache` may cache their pairs."""
    body, poses = state.body, [state.motion[n] for n in frames]
    pairs = (TaskPairs(task) if pair_cache is None else pair_cache).pairs(body, frames, poses)
    squares = [mean_squared_distance(body, pose, some) for pose, some in zip(poses, pairs, strict=True)]
    terms = Terms(
        data=float(np.mean(squares)),
        pose=pose_energy(task.prior, body, stack_trees(poses)),
        temporal=0.0 if task.settings.unordered else motion_energy(body.skeleton, state.motion),
        shape=shape_energy(shape_prior_of(task, state), body),
        symmetry=symmetry_energy(body.skeleton, task.mirrored),
        user=0.0 if task.terms is None else pose_energy(task.terms, body, stack_trees(poses)),
    )
    reached = (name, 1000 * float(np.sqrt(terms.data)))
    return state._replace(history=(*state.history, reached), terms=(*state.terms, terms))


def select_evenly(frames: Sequence[int], count: int = 8) -> list[int]:
    """Select at most `count` frames, spread evenly."""
    rows = np.linspace(0, len(frames) - 1, min(len(frames), count)).astype(int)
    return [frames[row] for row in np.unique(rows)]
