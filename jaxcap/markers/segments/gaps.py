"""Gaps in trajectories, and trajectories that continue under another label after each gap.

A capture program that loses a marker and finds it again may treat it as a new marker. Such pieces never
overlap, and the next one starts near the predicted position of the last one. The markers around it predict
that position: those with a nearly constant distance to it carry it rigidly through the gap (Kabsch 1976).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from ...arguments import checked
from ...errors import join_names
from ...geometry.procrustes import rigid_fit
from ...geometry.sampling import even_indices
from ...observe.markers import MarkerFrames

#: number of markers that carry another through a gap, and of frames compared to choose them
NUM_PREDICTORS, FRAMES_COMPARED = 6, 50
#: highest speed of a marker to be considered as another's continuation, metres a second
MAX_SPEED = 10.0
#: uncertainty of a marker position, metres
POSITION_NOISE = 0.002
#: largest movement of any marker in a static take, metres
STATIC_TOLERANCE = 1e-6
#: number of runs of frames in a sentence
MAX_LISTED = 8


class GapStatistics(NamedTuple):
    """Gap statistics of each marker. A gap is a run of frames without the marker, also at the ends."""

    #: fraction of the frames with the marker visible
    visible_fraction: Float[np.ndarray, "M"]
    num_gaps: Int[np.ndarray, "M"]
    #: number of frames of the longest gap
    longest_gap: Int[np.ndarray, "M"]


def gap_statistics(frames: MarkerFrames) -> GapStatistics:
    """Compute the visible fraction, the number of gaps and the longest gap of each marker."""
    seen = np.asarray(frames.visible)
    lengths = [[end - begin for begin, end in find_runs(~column)] for column in seen.T]
    return GapStatistics(
        seen.mean(0),
        np.array([len(some) for some in lengths], int),
        np.array([max(some, default=0) for some in lengths], int),
    )


def find_runs(mask: Bool[np.ndarray, "F"]) -> list[tuple[int, int]]:
    """Find the runs of true values as `(begin, end)`, the end exclusive."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def list_runs(mask: Bool[np.ndarray, "F"]) -> str:
    """List the runs of true frames, such as "3, 10 to 20"."""
    spans = [f"{a}" if b - a == 1 else f"{a} to {b - 1}" for a, b in find_runs(mask)]
    return ", ".join(spans[:MAX_LISTED]) + (", ..." if len(spans) > MAX_LISTED else "")


def never_visible(frames: MarkerFrames) -> tuple[str, ...]:
    """List the labels of markers that are visible in no frame."""
    seen = np.any(np.asarray(frames.visible), axis=0)
    return tuple(label for i, label in enumerate(frames.labels) if not seen[i])


def is_static(frames: MarkerFrames) -> bool:
    """Test if all frames are equal: no marker moves by more than a micrometre."""
    seen = np.asarray(frames.visible)[..., None]
    positions = np.asarray(frames.positions, float)
    spread = np.where(seen, positions, -np.inf).max(0) - np.where(seen, positions, np.inf).min(0)
    return bool(np.all(spread <= STATIC_TOLERANCE))


def describe_problems(frames: MarkerFrames) -> tuple[str, ...]:
    """Describe the problems of a marker recording, one sentence each.

    The problems are: no visible marker, markers that are never visible, equal frames, empty frames, and
    fragmented trajectories.
    """
    seen, messages = np.asarray(frames.visible), []
    if not seen.any():
        return ("No marker is visible in any frame.",)
    if lost := never_visible(frames):
        messages.append(f"{_format_labels(lost)} never visible; leave out markers that were not worn.")
    if len(frames) > 1 and is_static(frames):
        messages.append(f"All {len(frames)} frames are equal: nothing moves, so no joint can be determined.")
    if empty := int((~seen.any(1)).sum()):
        messages.append(f"{empty} of {len(frames)} frames have no visible marker.")
    for chain in find_pieces(frames):
        names = [frames.labels[i] for i in chain]
        messages.append(
            f"{join_names(names)} look like one trajectory in {len(names)} pieces; join "
            "them by join_pieces, or by --pieces join of fit and solve."
        )
    return tuple(messages)


def find_pieces(
    frames: MarkerFrames, max_gap: float = 2.0, max_error: float = 0.04
) -> tuple[tuple[int, ...], ...]:
    """Find chains of markers that look like one fragmented trajectory, each in the order of time.

    A marker can follow another if it begins after the other's end, by at most `max_gap` seconds, and less
    than `max_error` metres from the predicted position. Each has at most one successor. The matching minimises
    the total cost (linear assignment).
    """
    seen, positions = np.array(frames.visible), np.array(frames.positions, float)
    chains: dict[int, tuple[int, ...]] = {i: (int(i),) for i in np.flatnonzero(seen.any(0)).tolist()}
    # joined trajectories can carry others through gaps that their pieces could not
    while follows := _successors(
        positions, seen, list(chains), max_gap * frames.rate, MAX_SPEED / frames.rate, max_error
    ):
        for head in [i for i in chains if i in follows and i not in follows.values()]:
            piece = head
            while (piece := follows.get(piece, -1)) >= 0:
                chains[head] += chains.pop(piece)
                positions[:, head] += positions[:, piece]
                seen[:, head] |= seen[:, piece]
    return tuple(sorted(chain for chain in chains.values() if len(chain) > 1))


@checked
def join_pieces(frames: MarkerFrames, chains: tuple[tuple[int, ...], ...] | None = None) -> MarkerFrames:
    """Join each chain of pieces to one marker at the index of its first piece.

    Without `chains` those of `find_pieces` are joined. The label is the first in the chain that does not
    begin with a star.

    **Raises:** `ValueError` where a marker is in two chains, or pieces of a chain are visible in the same
    frame.
    """
    chains = find_pieces(frames) if chains is None else chains
    seen, positions = np.array(frames.visible), np.array(frames.positions)
    labels, used, joined = list(frames.labels), set(), set()
    for chain in chains:
        if used & set(chain) or len(set(chain)) < len(chain):
            raise ValueError(
                f"Marker '{labels[chain[0]]}' is in two chains of pieces; a marker can be in one chain only."
            )
        index = list(chain)
        if (seen[:, index].sum(1) > 1).any():
            names = ", ".join(frames.labels[i] for i in chain)
            raise ValueError(
                f"{names} are visible in the same frame, so they are not pieces of one trajectory."
            )
        head = min(chain)
        positions[:, head] = positions[:, index].sum(1)
        seen[:, head] = seen[:, index].any(1)
        labels[head] = next(
            (frames.labels[i] for i in chain if frames.labels[i][0] != "*"), frames.labels[chain[0]]
        )
        used |= set(chain)
        joined |= set(chain) - {head}
    kept = [i for i in range(len(labels)) if i not in joined]
    return MarkerFrames(positions[:, kept], seen[:, kept], tuple(labels[i] for i in kept), frames.rate)


def split_unlabelled(frames: MarkerFrames) -> MarkerFrames:
    """Split each marker with a label such as `*32` at its gaps, into `*32.1`, `*32.2`, ...

    A capture program keeps unlabelled trajectories under a name with a star, often several of them in
    sequence. Such a name does not identify a marker across a gap. `join_pieces` joins the pieces that belong
    together.
    """
    seen, positions = np.asarray(frames.visible), np.asarray(frames.positions)
    columns: list[tuple[str, int, np.ndarray]] = []
    for i, label in enumerate(frames.labels):
        pieces = find_runs(seen[:, i])
        if not label.startswith("*") or len(pieces) < 2:
            columns.append((label, i, seen[:, i]))
            continue
        at = np.arange(len(seen))
        columns += [
            (f"{label}.{n}", i, (at >= begin) & (at < end)) for n, (begin, end) in enumerate(pieces, 1)
        ]
    kept = np.stack([column for _, _, column in columns], 1)
    moved = np.where(kept[..., None], positions[:, [i for _, i, _ in columns]], 0)
    return MarkerFrames(moved, kept, tuple(label for label, _, _ in columns), frames.rate)


def _successors(
    positions: Float[np.ndarray, "F M 3"],
    seen: Bool[np.ndarray, "F M"],
    markers: list[int],
    max_gap: float,
    max_speed: float,
    max_error: float,
) -> dict[int, int]:
    """Match markers to their successors; `max_gap` in frames, `max_speed` in metres a frame."""
    indices = np.asarray(markers)
    first, last = seen.argmax(0), len(seen) - 1 - seen[::-1].argmax(0)
    # rows are ends, columns beginnings
    between = first[None, indices] - last[indices, None]
    cost = np.full(between.shape, np.inf)
    for row, column in np.argwhere((between > 0) & (between <= max_gap)):
        end, begin, gap = int(indices[row]), int(indices[column]), between[row, column]
        if (
            np.linalg.norm(positions[last[end], end] - positions[first[begin], begin])
            > max_error + max_speed * gap
        ):
            continue
        miss = _prediction_error(positions, seen, end, begin, int(last[end]), int(first[begin]))
        if miss < max_error:
            # prefer the shorter gap where two fit equally well
            cost[row, column] = miss / max_error + 0.5 * gap / max_gap
    return {int(indices[row]): int(indices[column]) for row, column in _minimum_cost_matching(cost).items()}


def _prediction_error(
    positions: Float[np.ndarray, "F M 3"],
    seen: Bool[np.ndarray, "F M"],
    end: int,
    begin: int,
    last_frame: int,
    first_frame: int,
) -> float:
    """Compute the mean of the forward and backward prediction errors across a gap, metres.

    Forward, `end` is predicted at the first frame of `begin`. Backward, `begin` is predicted at the last
    frame of `end`.
    """
    forward = _predict_rigidly(positions, seen, end, last_frame, first_frame)
    backward = _predict_rigidly(positions, seen, begin, first_frame, last_frame)
    ahead = _extrapolate(positions, seen, end, last_frame, first_frame) if forward is None else forward
    behind = _extrapolate(positions, seen, begin, first_frame, last_frame) if backward is None else backward
    misses = (
        np.linalg.norm(ahead - positions[first_frame, begin]),
        np.linalg.norm(behind - positions[last_frame, end]),
    )
    # without surrounding markers on both sides, take the smaller error
    return float(np.mean(misses) if forward is not None and backward is not None else np.min(misses))


def _predict_rigidly(
    positions: Float[np.ndarray, "F M 3"],
    seen: Bool[np.ndarray, "F M"],
    marker: int,
    source_frame: int,
    target_frame: int,
) -> Float[np.ndarray, "3"] | None:
    """Predict a marker at frame `target_frame` by the rigid motion of its neighbours since frame `source_frame`.

    None where fewer than three neighbours are visible in both.
    """
    both = seen[source_frame] & seen[target_frame]
    both[marker] = False
    others = np.flatnonzero(both)
    if len(others) < 3:
        return None
    shown = np.flatnonzero(seen[:, marker])
    shown = shown[even_indices(len(shown), FRAMES_COMPARED)]
    away = np.linalg.norm(positions[shown][:, others] - positions[shown, marker][:, None], axis=2)
    away[~seen[shown][:, others]] = np.nan
    spread = np.sqrt(np.nanmean((away - away[shown == source_frame]) ** 2, axis=0))
    near = np.linalg.norm(positions[source_frame, others] - positions[source_frame, marker], axis=1)
    # short pieces show little variation; then the nearest markers are most probably on the same bone
    doubt = spread**2 + (0.02 * near) ** 2 + POSITION_NOISE**2
    chosen = np.argsort(doubt)[:NUM_PREDICTORS]
    weights = 1 / doubt[chosen] ** 2
    weights /= weights.sum()
    turn, shift = rigid_fit(
        positions[source_frame, others[chosen]], positions[target_frame, others[chosen]], weights
    )
    return turn @ positions[source_frame, marker] + shift


def _extrapolate(
    positions: Float[np.ndarray, "F M 3"],
    seen: Bool[np.ndarray, "F M"],
    marker: int,
    source_frame: int,
    target_frame: int,
) -> Float[np.ndarray, "3"]:
    """Extrapolate a marker at constant velocity from frame `source_frame` to frame `target_frame`."""
    earlier = source_frame - 1 if target_frame > source_frame else source_frame + 1
    if not (0 <= earlier < len(seen) and seen[earlier, marker]):
        return positions[source_frame, marker]
    return positions[source_frame, marker] + (
        positions[source_frame, marker] - positions[earlier, marker]
    ) * abs(target_frame - source_frame)


def _minimum_cost_matching(cost: Float[np.ndarray, "R R"]) -> dict[int, int]:
    """Match rows to columns with the most links, and among these the lowest cost; infinite costs are
    excluded."""
    none = 1.0 + 2.0 * len(cost)
    rows, columns = linear_sum_assignment(np.where(np.isfinite(cost), cost, none))
    return {int(r): int(c) for r, c in zip(rows, columns, strict=True) if np.isfinite(cost[r, c])}


def _format_labels(labels: tuple[str, ...]) -> str:
    some = ", ".join(labels[:8]) + (f" and {len(labels) - 8} more" if len(labels) > 8 else "")
    return f"Marker {some} is" if len(labels) == 1 else f"Markers {some} are"
