"""One frame of markers at a time, for live use."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...arguments import checked
from ...body.pose import Pose, rest_pose
from ...energy.check_energies import UserTerms, sum_user_terms
from ...energy.energy import AbstractEnergy
from ...errors import InputError
from ..subject import Subject, marker_body
from .initial_pose import estimate_initial_poses
from .inverse_kinematics import INITIAL_SEARCH, MAX_RESIDUAL_SCALE, MIN_MARKERS
from .solve_frame import SearchCriteria, solve_frame


class Streamer(eqx.Module):
    """A subject, and the stopping criteria of each frame."""

    subject: Subject
    search: SearchCriteria = SearchCriteria()
    #: energies of a user's own, which see the markers as vertices
    terms: AbstractEnergy | None = None


class StreamState(NamedTuple):
    """The state that one frame passes to the next."""

    pose: Pose
    #: median residual in standard deviations; infinite before the first frame
    residual_scale: Float[Array, ""]
    #: number of consecutive lost frames; zero after a solved frame
    num_lost: Int[Array, ""]


@checked
def make_streamer(
    subject: Subject, search: SearchCriteria = SearchCriteria(), terms: UserTerms = ()
) -> tuple[Streamer, StreamState]:
    """Build a compiled streamer and the state before the first frame; `terms` as in `solve_markers`."""
    energy = sum_user_terms("make_streamer", terms, marker_body(subject))
    streamer = Streamer(subject, search, energy)
    pose = rest_pose(subject.skeleton)
    count, dtype = subject.num_markers, subject.offsets.dtype
    nothing = np.zeros((count, 3), dtype), np.zeros(count, bool)
    jax.block_until_ready(_solve_from_last_pose(streamer, pose, *nothing))
    jax.block_until_ready(_solve_from_guess(streamer, pose, *nothing))
    jax.block_until_ready(estimate_initial_poses(subject, *(jnp.asarray(part)[None] for part in nothing)))
    return streamer, StreamState(pose, jnp.asarray(jnp.inf, dtype), jnp.asarray(0))


@checked
def stream_frame(
    streamer: Streamer,
    state: StreamState,
    positions: Float[np.ndarray, "M 3"] | Float[Array, "M 3"],
    seen: Bool[np.ndarray, "M"] | Bool[Array, "M"] | None = None,
) -> tuple[StreamState, Pose]:
    """Solve the pose of the next frame, and return it after the state for the frame after it.

    **Arguments:** `positions (M, 3)` metres in the order of the subject's markers, NaN where not visible;
    `seen (M,)`, if given, also masks markers.

    A frame with fewer than `MIN_MARKERS` visible markers keeps the last pose. The first frame, and a frame that
    the search from the last pose does not solve, is solved from an initial guess, which takes several times
    as long.
    """
    subject = streamer.subject
    positions = np.asarray(positions)
    if len(positions) != subject.num_markers:
        raise InputError(
            f"stream_frame: there are positions of {len(positions)} markers, but the subject has "
            f"{subject.num_markers}; give one row for each marker, in the subject's order, with NaN where "
            "it is not visible."
        )
    visible = np.isfinite(positions).all(1) & (np.asarray(subject.weights) > 0)
    visible = visible if seen is None else visible & np.asarray(seen)
    if visible.sum() < MIN_MARKERS:
        return state._replace(num_lost=state.num_lost + 1), state.pose
    clean = np.where(visible[:, None], positions, 0.0).astype(subject.offsets.dtype)
    found = None
    if np.isfinite(state.residual_scale):
        found = _solve_from_last_pose(streamer, state.pose, clean, visible)
    if found is None or not float(found.residual_scale) < MAX_RESIDUAL_SCALE:
        guess = jax.tree.map(
            lambda leaf: leaf[0],
            estimate_initial_poses(subject, jnp.asarray(clean)[None], jnp.asarray(visible)[None]),
        )
        other = _solve_from_guess(streamer, guess, clean, visible)
        if found is None or not float(found.residual_scale) <= float(other.residual_scale):
            found = other
    return found, found.pose


@eqx.filter_jit
def _solve_from_last_pose(streamer: Streamer, pose: Pose, positions, seen) -> StreamState:
    return _solve(streamer, pose, positions, seen, streamer.search)


@eqx.filter_jit
def _solve_from_guess(streamer: Streamer, pose: Pose, positions, seen) -> StreamState:
    return _solve(streamer, pose, positions, seen, INITIAL_SEARCH)


def _solve(streamer: Streamer, pose: Pose, positions, seen, search: SearchCriteria) -> StreamState:
    solved = solve_frame(streamer.subject, pose, positions, seen, search, streamer.terms)
    return StreamState(solved.pose, solved.residual_scale, jnp.asarray(0))
