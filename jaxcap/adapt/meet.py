"""How a body meets the scans of a task: pairs, the poses they lead to, and distances (Adaptation, 4.1.2)."""

from collections.abc import Sequence

import numpy as np

from ..body.body import Body
from ..body.pose import Pose
from ..fit.correspond import Pairs, Scan
from .objective import mean_square, stack, stack_pairs
from .pose import fit_pose, pairs_of
from .reference import shape_prior_of
from .shape_prior import shape_energy
from .task import AdaptState, Task
from .terms import Terms, motion_energy, pose_energy, symmetry_energy


def pairs_at(task: Task, body: Body, pose: Pose, scan: Scan) -> Pairs:
    """The pairs of a posed body with a scan, of vertices that the task's cameras see."""
    return pairs_of(body, pose, scan, task.settings.matching, task.cameras)


def pose_at(task: Task, state: AdaptState, scan: Scan, start: Pose, *, steps: int) -> Pose:
    """The pose of the body in a scan, from one near it."""
    return fit_pose(
        state.body,
        scan,
        start,
        task.prior,
        task.settings.matching,
        weight=state.weight,
        steps=steps,
        cameras=task.cameras,
        boxes=task.boxes,
        terms=task.terms,
    ).pose


def stacked_pairs(task: Task, body: Body, poses: Sequence[Pose], scans: Sequence[Scan]) -> Pairs:
    """The pairs of several frames."""
    return stack_pairs([pairs_at(task, body, p, s) for p, s in zip(poses, scans, strict=True)])


def told(
    task: Task, state: AdaptState, name: str, frames: Sequence[int], scans: Sequence[Scan] | None = None
) -> AdaptState:
    """With what a stage has reached in some frames, whose scans may be at hand."""
    scans = [task.scan(n) for n in frames] if scans is None else scans
    body, poses = state.body, [state.motion[n] for n in frames]
    squares = [mean_square(body, p, pairs_at(task, body, p, s)) for p, s in zip(poses, scans, strict=True)]
    terms = Terms(
        data=float(np.mean(squares)),
        pose=pose_energy(task.prior, body, stack(poses)),
        temporal=0.0 if task.settings.unordered else motion_energy(body.skeleton, state.motion),
        shape=shape_energy(shape_prior_of(task, state), body),
        symmetry=symmetry_energy(body.skeleton, task.mirrored),
        own=0.0 if task.terms is None else pose_energy(task.terms, body, stack(poses)),
    )
    reached = (name, 1000 * float(np.sqrt(terms.data)))
    return state._replace(history=(*state.history, reached), terms=(*state.terms, terms))


def some_of(frames: Sequence[int], count: int = 8) -> list[int]:
    """A few of them, spread over all."""
    rows = np.linspace(0, len(frames) - 1, min(len(frames), count)).astype(int)
    return [frames[row] for row in np.unique(rows)]
