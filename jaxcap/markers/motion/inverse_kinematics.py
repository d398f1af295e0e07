"""The motion of a known subject through frames of markers."""

import logging
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.ndimage import binary_opening

from ...arguments import checked
from ...body.pose import Motion, Pose
from ...energy.check_energies import UserTerms, check_finite_residuals, sum_user_terms
from ...energy.energy import AbstractEnergy
from ...observe.markers import MarkerFrames
from ...parallel import parallel_map
from ...stacking import concatenate, put_rows, take_rows
from ..calibration.residuals import marker_residuals
from ..subject import Subject, marker_body
from .doubtful_solutions import MAX_RESIDUAL_SCALE, MIN_FAR_FRAMES, far_markers, is_better
from .initial_pose import estimate_initial_poses
from .label_matching import match_markers
from .solve_frame import SearchCriteria, SolvedFrame, solve_frame
from .unexplained_bones import describe_unexplained, unexplained_bones

_LOG = logging.getLogger(__name__)

#: least number of visible markers in a frame; with fewer the pose of the whole body is undetermined
MIN_MARKERS = 3
#: number of frames solved in sequence in one call; sequences are padded to multiples of it
CHUNK_SIZE = 256
#: the same for frames that do not depend on each other
SEPARATE_SIZE = 32
#: search of a frame from an initial guess
INITIAL_SEARCH = SearchCriteria(max_iterations=40, tolerance=1e-4)
#: the same for markers whose labels are right
LABELLED_SEARCH = SearchCriteria(max_iterations=40, tolerance=1e-4, least_deviation=0.03)


class MarkerSolution(NamedTuple):
    """A motion and its residuals. Markers are in the subject's order."""

    motion: Motion
    #: distance between observed and predicted position of each marker, metres; NaN where not visible
    residuals: Float[np.ndarray, "F M"]
    #: robust weight of each marker, 0 to 1: 0 where not visible, small where it may be swapped
    weights: Float[np.ndarray, "F M"]
    #: frames with too few markers or without a pose that fits; they keep the last pose
    lost: Bool[np.ndarray, "F"]
    #: messages to the user, in sentences
    messages: tuple[str, ...]


@checked
def solve_markers(
    subject: Subject,
    frames: MarkerFrames,
    search: SearchCriteria = SearchCriteria(),
    *,
    terms: UserTerms = (),
) -> MarkerSolution:
    """Solve the pose of every frame, starting from the pose of the previous frame.

    **Arguments:** `frames` with the subject's labels in any order; markers with other labels are ignored,
    and missing ones are never visible. `search`: the stopping criteria in each frame. `terms`: energies of
    your own, in units of a log-likelihood, which see the subject's skeleton with its markers as vertices.

    Joints that the markers do not determine stay as in the previous frame. A frame with fewer than `MIN_MARKERS`
    visible markers keeps the last pose and is marked `lost`, as is a frame without a pose that fits; the
    frames after it are solved.

    **Raises:** `ValueError` where frames and subject share no label.
    """
    matched = match_markers(subject, frames)
    positions, seen = matched.positions, np.asarray(matched.seen)
    used = seen & (np.asarray(subject.weights) > 0)
    enough = used.sum(1) >= MIN_MARKERS
    _LOG.info("solving %d frames", len(positions))
    energy = sum_user_terms("solve_markers", terms, marker_body(subject))
    solved = _solve_in_chunks(subject, positions, jnp.asarray(used & enough[:, None]), search, energy)
    if energy is not None:
        for frame in (0, len(positions) - 1):
            check_finite_residuals("solve_markers", energy, marker_body(subject), Motion(solved.pose)[frame])
    _LOG.info("solving poorly fitted frames again")
    solved = solve_doubtful_frames(subject, positions, used, enough, solved, energy)
    lost = (
        ~enough
        | ~np.isfinite(np.asarray(solved.residuals)).all(1)
        | _poorly_fitted_frames(subject, used, solved)
    )
    lengths = np.linalg.norm(np.asarray(marker_residuals_of_frames(subject, solved.pose, positions)), axis=2)
    residuals = np.where(seen, lengths, np.nan)
    unexplained = unexplained_bones(subject, used & ~lost[:, None], lengths)
    messages = (
        *describe_unexplained(subject, unexplained),
        *describe_solution(subject, frames, seen, lost),
    )
    weights = np.asarray(solved.weights) * ~lost[:, None]
    return MarkerSolution(Motion(solved.pose, frames.rate), residuals, weights, lost, messages)


def solve_from_poses(
    subject: Subject,
    starts: Pose,
    positions: Float[Array, "F M 3"],
    seen: Bool[Array, "F M"],
    search: SearchCriteria = SearchCriteria(),
    energy: AbstractEnergy | None = None,
) -> SolvedFrame:
    """Solve each frame from a pose of its own, independently of the other frames and on all cores."""
    count = len(positions)

    def run(first: int) -> SolvedFrame:
        rows = np.minimum(np.arange(first, first + SEPARATE_SIZE), count - 1)
        start, places, visible = take_rows((starts, positions, seen), rows)
        return jax.block_until_ready(solve_each_frame(subject, start, places, visible, search, energy))

    parts = parallel_map(run, range(0, count, SEPARATE_SIZE))
    return jax.tree.map(lambda *leaves: concatenate(leaves)[:count], *parts)


def _solve_in_chunks(subject: Subject, positions, seen, search: SearchCriteria, energy) -> SolvedFrame:
    """Solve chunks of frames in parallel threads, each from an initial guess of its first frame.

    While one chunk is computed, Python is free for the next.
    """
    count = len(positions)
    size = CHUNK_SIZE if count > CHUNK_SIZE else max(8, 1 << (count - 1).bit_length())
    chunks = -(-count // size)
    extra = chunks * size - count
    positions = jnp.pad(positions, ((0, extra), (0, 0), (0, 0)), mode="edge").reshape(chunks, size, -1, 3)
    # frames of the padding have no visible markers and cost next to nothing
    seen = jnp.pad(seen, ((0, extra), (0, 0))).reshape(chunks, size, -1)
    first = np.asarray(jnp.argmax(seen.sum(2) >= MIN_MARKERS, 1))
    rows = np.arange(chunks)
    starts = estimate_initial_poses(subject, positions[rows, first], seen[rows, first])

    def run(chunk: int) -> SolvedFrame:
        start = jax.tree.map(lambda leaf: leaf[chunk], starts)
        return jax.block_until_ready(
            _solve_chunk(subject, start, positions[chunk], seen[chunk], search, energy)
        )

    parts = parallel_map(run, range(chunks))
    return jax.tree.map(lambda *leaves: concatenate(leaves)[:count], *parts)


@eqx.filter_jit
def _solve_chunk(
    subject: Subject, start: Pose, positions, seen, search: SearchCriteria, energy
) -> SolvedFrame:
    far = solve_frame(subject, start, positions[0], seen[0], LABELLED_SEARCH, energy)

    def follow(pose, frame):
        solved = solve_frame(subject, pose, frame[0], frame[1], search, energy)
        kept = jax.tree.map(lambda new, old: jnp.where(frame[1].any(), new, old), solved.pose, pose)
        return kept, solved._replace(pose=kept)

    return jax.lax.scan(follow, far.pose, (positions, seen))[1]


def solve_doubtful_frames(
    subject: Subject, positions, used, enough, solved: SolvedFrame, energy
) -> SolvedFrame:
    """Solve doubtful frames again from an initial guess, and keep the better solution (`is_better`).

    A frame is doubtful if its residuals are large, if all markers of a bone are far from where the pose has them, or if any marker
    stays far off for `MIN_FAR_FRAMES`: the pose of a limb that follows a wrong minimum leaves one or two of its markers there.
    """
    is_poor = ~(np.asarray(solved.residual_scale) < MAX_RESIDUAL_SCALE)
    distances = np.asarray(solved.residuals)
    stays_far = binary_opening(far_markers(used, distances), np.ones((MIN_FAR_FRAMES, 1)))
    unexplained = stays_far.any(1) | unexplained_bones(subject, used, distances).any(1)
    doubtful = np.flatnonzero(enough & (is_poor | unexplained))
    if not len(doubtful):
        return solved
    size = 1 << (len(doubtful) - 1).bit_length()
    padded = np.pad(doubtful, (0, size - len(doubtful)), mode="edge")
    places, seen = take_rows((positions, used), padded)
    starts = estimate_initial_poses(subject, places, seen)
    places, seen = take_rows((positions, used), doubtful)
    other = solve_from_poses(subject, starts, places, seen, LABELLED_SEARCH, energy)
    some = take_rows(solved, doubtful), other
    num_far = np.stack([far_markers(used[doubtful], np.asarray(one.residuals)).sum(1) for one in some])
    better = np.flatnonzero(is_better(num_far, np.stack([one.residual_scale for one in some])))
    return put_rows(solved, doubtful[better], take_rows(other, better))


@eqx.filter_jit
def solve_each_frame(
    subject: Subject, starts: Pose, positions, seen, search: SearchCriteria, energy=None
) -> SolvedFrame:
    """Solve each frame from a pose of its own, in one compiled loop; `solve_from_poses` takes any number of frames."""
    return jax.lax.map(
        lambda frame: solve_frame(subject, frame[0], frame[1], frame[2], search, energy),
        (starts, positions, seen),
    )


@eqx.filter_jit
def marker_residuals_of_frames(subject: Subject, poses: Pose, positions) -> Float[Array, "F M 3"]:
    """Compute the residuals of all markers in every frame, metres in the rest frames of their bones."""
    return jax.lax.map(lambda frame: marker_residuals(subject, *frame), (poses, positions))


def _poorly_fitted_frames(subject: Subject, used, solved: SolvedFrame) -> np.ndarray:
    """Find frames with a median residual above a decimetre: no pose of this subject fits."""
    lengths = np.where(used, np.asarray(solved.residuals), np.nan)
    middle = np.zeros(len(used))
    some = used.any(1)
    middle[some] = np.nanmedian(lengths[some], 1)
    return middle > 0.1


def describe_lost(lost: Bool[np.ndarray, "F"]) -> tuple[str, ...]:
    """Describe lost frames in a sentence; none if there are none."""
    if not lost.any():
        return ()
    numbers = ", ".join(map(str, np.flatnonzero(lost)[:20]))
    return (
        f"{int(lost.sum())} of {len(lost)} frames are lost (fewer than {MIN_MARKERS} markers, or no pose fits) "
        f"and keep the previous pose: {numbers}.",
    )


def describe_solution(subject: Subject, frames: MarkerFrames, seen, lost) -> tuple[str, ...]:
    """Describe markers that are never visible or unknown, and lost frames."""
    messages = []
    never = [label for label, visible in zip(subject.labels, seen.any(0), strict=True) if not visible]
    if never:
        messages.append(f"{len(never)} of the subject's markers are never visible: {', '.join(never[:10])}.")
    others = [label for label in frames.labels if label not in subject.labels]
    if others:
        messages.append(
            f"{len(others)} markers do not belong to the subject and are left out: {', '.join(others[:10])}."
        )
    return (*messages, *describe_lost(np.asarray(lost)))
