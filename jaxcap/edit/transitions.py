"""Transitions between motions: the similarity of short windows.

The distance of Kovar, Gleicher and Pighin, *Motion Graphs* (2002), section 3: joint positions of a window of
frames, which include velocities, after the best rotation about the vertical and translation along the floor.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..arguments import checked
from ..body.kinematics import joint_paths
from ..body.pose import Motion
from ..body.skeleton import Skeleton


class Transition(NamedTuple):
    """Two similar windows, by their first frames."""

    first: int
    second: int
    #: root mean square distance of the joints over the window, metres
    distance: float


@checked
def transition_distances(skeleton: Skeleton, a: Motion, b: Motion, window: int) -> Float[np.ndarray, "N M"]:
    """Compute the distances between all windows of `window` frames of `a` and of `b`.

    They are root mean squares over joints and frames, metres; row and column are the windows' first frames.

    **Raises:** `ValueError` if a motion is shorter than the window or has other joints.
    """
    for motion in (a, b):
        if not 1 <= window <= len(motion):
            raise ValueError(
                f"A window of {window} frames does not fit into a motion of {len(motion)} frames; give a shorter one, "
                "of at least one frame."
            )
    (xa, ya, za), (xb, yb, zb) = (_windows(skeleton, motion, window) for motion in (a, b))
    flat = [np.sum(x**2, 1) + np.sum(z**2, 1) for x, z in ((xa, za), (xb, zb))]
    along, across = xa @ xb.T + za @ zb.T, xa @ zb.T - za @ xb.T
    level = flat[0][:, None] + flat[1][None] - 2.0 * np.hypot(along, across)
    upright = np.sum(ya**2, 1)[:, None] + np.sum(yb**2, 1)[None] - 2.0 * ya @ yb.T
    return np.sqrt(np.maximum(level + upright, 0.0) / xa.shape[1])


@checked
def find_transitions(
    skeleton: Skeleton, a: Motion, b: Motion, window: int, count: int = 1
) -> list[Transition]:
    """Find the `count` best windows for a transition from `a` to `b`, the best first.

    They are local minima of the distance, none within a window of a better one. Raises as
    `transition_distances` does.
    """
    return _best_transitions(transition_distances(skeleton, a, b, window), window, count)


@checked
def find_loops(
    skeleton: Skeleton,
    motion: Motion,
    window: int,
    min_length: int,
    max_length: int | None = None,
    count: int = 1,
) -> list[Transition]:
    """Find the best frames to close a loop, for `make_loop`.

    A loop goes from frame `first + window` to frame `second + window`, and the windows before these frames
    are similar.

    **Arguments:** `min_length` and `max_length` are the shortest and longest lengths of a loop, frames.

    **Raises:** `ValueError` if no loop of these lengths fits into the motion.
    """
    max_length = len(motion) if max_length is None else max_length
    if not 1 <= min_length <= max_length or min_length + window >= len(motion):
        raise ValueError(
            f"A loop of {min_length} to {max_length} frames with {window} before it does not fit into a motion of "
            f"{len(motion)} frames; give a shorter one."
        )
    # the window includes the frame at which a loop begins, so it is one frame longer
    distances = transition_distances(skeleton, motion, motion, window + 1)
    length = np.arange(len(distances))[None] - np.arange(len(distances))[:, None]
    allowed = np.where((length >= min_length) & (length <= max_length), distances, np.inf)
    # several cycles of a periodic motion are as similar as one: the shortest of loops that are equal to a micrometre
    return _best_transitions(allowed, window, count, np.round(allowed, 6) + 1e-9 * length)


def _windows(skeleton: Skeleton, motion: Motion, window: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stack x, y and z of all joints of each window, (N, window J); x and z about their mean."""
    paths = np.asarray(joint_paths(skeleton, motion.poses), float)
    count, joints = len(paths) - window + 1, paths.shape[1]
    frames = np.arange(count)[:, None] + np.arange(window)[None]
    x, y, z = np.moveaxis(paths[frames].reshape(count, window * joints, 3), 2, 0)
    return x - x.mean(1, keepdims=True), y, z - z.mean(1, keepdims=True)


def _best_transitions(
    distances: np.ndarray, min_separation: int, count: int, ranks: np.ndarray | None = None
) -> list[Transition]:
    """Select transitions in the order of `ranks`, by default of the distances."""
    ranks, found = np.array(distances if ranks is None else ranks), []
    while len(found) < count and np.isfinite(ranks).any():
        row, column = np.unravel_index(int(np.argmin(ranks)), ranks.shape)
        found.append(Transition(int(row), int(column), float(distances[row, column])))
        near = [slice(max(0, int(i) - min_separation), int(i) + min_separation + 1) for i in (row, column)]
        ranks[near[0], near[1]] = np.inf
    return found
