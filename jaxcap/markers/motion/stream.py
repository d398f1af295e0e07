"""One frame of markers at a time, for live use."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...arguments import checked
from ...body.pose import Pose, rest_pose
from ...energy.check import OwnTerms, own_terms
from ...energy.energy import AbstractEnergy
from ...errors import InputError
from ..subject import Subject, marker_body
from .initial_pose import guess_poses
from .inverse_kinematics import DOUBT, FAR, LEAST
from .solve_frame import Search, solve_frame

#: search of a frame in real time
LIVE = Search(iterations=6)


class Streamer(eqx.Module):
    """A subject, and the stopping criteria of each frame."""

    subject: Subject
    search: Search = LIVE
    #: energies of a user's own, which see the markers as vertices
    terms: AbstractEnergy | None = None


class StreamState(NamedTuple):
    """The state that one frame passes to the next."""

    pose: Pose
    #: median residual in standard deviations; infinite before the first frame
    spread: Float[Array, ""]
    #: number of consecutive lost frames; zero after a solved frame
    lost: Int[Array, ""]


@checked
def make_streamer(
    subject: Subject, search: Search = LIVE, terms: OwnTerms = ()
) -> tuple[Streamer, StreamState]:
    """Build a compiled streamer and the state before the first frame; `terms` as in `solve_markers`."""
    energy = own_terms("make_streamer", terms, marker_body(subject))
    streamer = Streamer(subject, search, energy)
    pose = rest_pose(subject.skeleton)
    count, dtype = subject.num_markers, subject.offsets.dtype
    nothing = jnp.zeros((count, 3), dtype), jnp.zeros(count, bool)
    jax.block_until_ready(_follow(streamer, pose, *nothing))
    jax.block_until_ready(_find(streamer, pose, *nothing))
    jax.block_until_ready(guess_poses(subject, nothing[0][None], nothing[1][None]))
    return streamer, StreamState(pose, jnp.asarray(jnp.inf, dtype), jnp.asarray(0))


@checked
def stream_frame(
    streamer: Streamer,
    state: StreamState,
    places: Float[np.ndarray, "M 3"] | Float[Array, "M 3"],
    seen: Bool[np.ndarray, "M"] | Bool[Array, "M"] | None = None,
) -> tuple[StreamState, Pose]:
    """Solve the pose of the next frame, and return it after the state for the frame after it.

    **Arguments:** `places (M, 3)` metres in the order of the subject's markers, NaN where not visible; `seen
    (M,)`, if given, also masks markers.

    A frame with fewer than `LEAST` visible markers keeps the last pose. The first frame, and a frame that
    the search from the last pose does not solve, is solved from an initial guess, which takes several times
    as long.
    """
    subject = streamer.subject
    places = np.asarray(places)
    if len(places) != subject.num_markers:
        raise InputError(
            f"stream_frame: there are positions of {len(places)} markers, but the subject has "
            f"{subject.num_markers}; give one row for each marker, in the subject's order, with NaN where "
            "it is not visible."
        )
    there = np.isfinite(places).all(1) & (np.asarray(subject.weights) > 0)
    there = there if seen is None else there & np.asarray(seen)
    if there.sum() < LEAST:
        return state._replace(lost=state.lost + 1), state.pose
    dtype = subject.offsets.dtype
    clean, shown = jnp.asarray(np.where(there[:, None], places, 0.0), dtype), jnp.asarray(there)
    solved, new = None, bool(np.isinf(state.spread))
    if not new:
        solved = _follow(streamer, state.pose, clean, shown)
    if solved is None or not float(solved.spread) < DOUBT:
        guess = jax.tree.map(lambda leaf: leaf[0], guess_poses(subject, clean[None], shown[None]))
        other = _find(streamer, guess, clean, shown)
        if solved is None or not float(solved.spread) <= float(other.spread):
            solved = other
    return StreamState(solved.pose, solved.spread, jnp.asarray(0)), solved.pose


@eqx.filter_jit
def _follow(streamer: Streamer, pose: Pose, places, seen):
    return solve_frame(streamer.subject, pose, places, seen, streamer.search, streamer.terms)


@eqx.filter_jit
def _find(streamer: Streamer, pose: Pose, places, seen):
    return solve_frame(streamer.subject, pose, places, seen, FAR, streamer.terms)
