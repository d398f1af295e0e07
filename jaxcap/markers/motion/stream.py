"""One frame of markers at a time, for live use."""

import dataclasses
from functools import cached_property, partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree

from ...arguments import checked
from ...body.pose import Pose, rest_pose
from ...energy.check_energies import UserTerms, sum_user_terms
from ...energy.energy import AbstractEnergy
from ...errors import InputError
from ..subject import Subject, marker_body
from .doubtful_solutions import FAR, MAX_RESIDUAL_SCALE, MIN_FAR_FRAMES, is_better
from .initial_pose import estimate_initial_poses
from .inverse_kinematics import LABELLED_SEARCH, MIN_MARKERS
from .solve_frame import SearchCriteria, solve_frame


class Streamer(eqx.Module):
    """A subject, and the stopping criteria of each frame."""

    subject: Subject
    search: SearchCriteria = SearchCriteria()
    #: energies of a user's own, which see the markers as vertices
    terms: AbstractEnergy | None = None

    @cached_property
    def call_arguments(self) -> "_CallArguments":
        """Divide the streamer for a plain `jax.jit` once, as `eqx.filter_jit` takes a fifth of a frame for it at each call."""
        leaves, structure = jax.tree.flatten(self)
        fixed = tuple(None if eqx.is_array(leaf) else leaf for leaf in leaves)
        arrays = [leaf if eqx.is_array(leaf) else None for leaf in leaves]
        with jax.ensure_compile_time_eval():
            none_far, none_lost = jnp.zeros(self.subject.num_markers, int), jnp.asarray(0)
        weighted = np.asarray(self.subject.weights) > 0
        return _CallArguments((fixed, structure), arrays, none_far, weighted, none_lost)

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields alone: a copied or pickled structure of a tree of modules cannot be used."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}


class _CallArguments(NamedTuple):
    """The arguments that the calls for all frames of one streamer share."""

    #: leaves that are not arrays, and the structure of the tree; hashable
    structure: tuple[tuple, Any]
    arrays: PyTree[Array]
    #: no far markers
    none_far: Int[Array, "M"]
    #: false for markers that are not used
    weighted: Bool[np.ndarray, "M"]
    #: the number of consecutive lost frames after a solved one
    none_lost: Int[Array, ""]


class StreamState(NamedTuple):
    """The state that one frame passes to the next."""

    pose: Pose
    #: median residual in standard deviations; infinite before the first frame
    residual_scale: Float[Array, ""]
    #: number of consecutive frames, up to this one, in which each marker is far from where the pose has it
    far_frames: Int[Array, "M"]
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
    nothing = np.full((count, 3), np.nan, dtype)
    shared = streamer.call_arguments
    state = StreamState(pose, jnp.asarray(jnp.inf, dtype), shared.none_far, shared.none_lost)
    jax.block_until_ready(_solve(streamer, pose, shared.none_far, nothing, search))
    jax.block_until_ready(_search(streamer, nothing))
    return streamer, state


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

    A frame with fewer than `MIN_MARKERS` visible markers keeps the last pose. The first frame, a frame that the search from the
    last pose does not solve, and one in which a marker stays far off for `MIN_FAR_FRAMES`, is solved from an initial guess, which
    takes several times as long.
    """
    subject = streamer.subject
    positions = np.asarray(positions)
    if len(positions) != subject.num_markers:
        raise InputError(
            f"stream_frame: there are positions of {len(positions)} markers, but the subject has "
            f"{subject.num_markers}; give one row for each marker, in the subject's order, with NaN where "
            "it is not visible."
        )
    visible = np.isfinite(positions).all(1) & streamer.call_arguments.weighted
    visible = visible if seen is None else visible & np.asarray(seen)
    if visible.sum() < MIN_MARKERS:
        return state._replace(num_lost=state.num_lost + 1), state.pose
    clean = np.where(visible[:, None], positions, np.nan).astype(subject.offsets.dtype)
    if not np.isfinite(state.residual_scale):
        found = _search(streamer, clean)
        return found, found.pose
    found = _solve(streamer, state.pose, state.far_frames, clean, streamer.search)
    far_frames = np.asarray(found.far_frames)
    if not float(found.residual_scale) < MAX_RESIDUAL_SCALE or far_frames.max() >= MIN_FAR_FRAMES:
        other = _search(streamer, clean)
        num_far = np.count_nonzero([[far_frames], [other.far_frames]], axis=2)
        better = is_better(num_far, np.array([[found.residual_scale], [other.residual_scale]])).all()
        # not again before as many frames
        found = other if better else found._replace(far_frames=streamer.call_arguments.none_far)
    return found, found.pose


def _search(streamer: Streamer, positions: Float[np.ndarray, "M 3"]) -> StreamState:
    """Solve a frame from an estimate of its pose alone."""
    visible = np.isfinite(positions[:, :1])
    clean = jnp.asarray(np.where(visible, positions, 0.0))
    poses = estimate_initial_poses(streamer.subject, clean[None], jnp.asarray(visible[None, :, 0]))
    start = jax.tree.map(lambda leaf: leaf[0], poses)
    return _solve(streamer, start, streamer.call_arguments.none_far, positions, LABELLED_SEARCH)


def _solve(
    streamer: Streamer,
    start: Pose,
    far_frames: Int[Array, "M"],
    positions: Float[np.ndarray, "M 3"],
    search: SearchCriteria,
) -> StreamState:
    """Solve a frame from a start; NaN marks what is not visible, so that one array reaches the device."""
    shared = streamer.call_arguments
    pose, scale, far = _solve_compiled(shared.structure, search, shared.arrays, start, far_frames, positions)
    return StreamState(pose, scale, far, shared.none_lost)


@partial(jax.jit, static_argnums=0)
def _solve_compiled(
    structure: tuple[tuple, Any],
    search: SearchCriteria,
    arrays: PyTree[Array],
    start: Pose,
    far_frames: Int[Array, "M"],
    positions: Float[Array, "M 3"],
) -> tuple[Pose, Float[Array, ""], Int[Array, "M"]]:
    fixed, tree = structure
    leaves = [one if array is None else array for one, array in zip(fixed, arrays, strict=True)]
    streamer = jax.tree.unflatten(tree, leaves)
    seen = jnp.isfinite(positions[:, 0])
    clean = jnp.where(seen[:, None], positions, 0.0)
    solved = solve_frame(streamer.subject, start, clean, seen, search, streamer.terms)
    far = seen & ~(solved.residuals <= FAR)
    return solved.pose, solved.residual_scale, jnp.where(far, far_frames + 1, 0)
