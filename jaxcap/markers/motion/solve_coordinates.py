"""Generalised coordinates of a model through frames of markers: inverse kinematics as in biomechanics."""

import itertools
import logging
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...arguments import checked
from ...body.body import Body, pose_body
from ...body.coordinates.coordinate_model import (
    CoordinateModel,
    CoordinateTargets,
    follow_leaders,
    motion_from_coordinates,
    pose_from_coordinates,
)
from ...body.skeleton import has_same_joints
from ...energy.check_energies import UserTerms, sum_user_terms
from ...energy.data.landmarks import VertexLandmarks
from ...energy.energy import AbstractEnergy, Sum, terms_of
from ...errors import InputError
from ...fit.coordinate_problem import CoordinateProblem
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ...fit.solvers.minimise import minimise
from ...observe.markers import MarkerFrames
from ...parallel import parallel_map
from ..subject import Subject, marker_body
from .inverse_kinematics import MIN_MARKERS, MarkerSolution, describe_solution
from .label_matching import match_markers

_LOG = logging.getLogger(__name__)

#: frames solved in sequence in one call
CHUNK_SIZE = 256
#: largest numbers of steps from the previous frame, and from a start far away
STEPS, FIRST_STEPS = 20, 60
#: lengths of each step that are tried; noisy markers bend the energy more, or less, than its linearisation
LENGTHS = (2.0, 1.0, 0.5)
#: angles at which the root starts, radians, about each of its axes of rotation
START_ANGLES = np.pi / 2 * np.arange(-1, 3)
#: number of starts that all coordinates continue from; a divisor of the number of rotations
NUM_STARTS = 8
#: distance of markers that does not matter in a choice among starts, metres; share by which the energy of a start is raised for each
#: square radian from rest
NEGLIGIBLE, TURN_PENALTY = 1e-3, 1e-3
#: a frame is lost if the root mean square distance of its markers exceeds this, metres
MAX_DISTANCE = 0.2
#: share of frames at the end of a range that is told
MANY = 0.1


class _Priors(eqx.Module):
    """What is known apart from the markers."""

    terms: AbstractEnergy | None
    targets: CoordinateTargets | None


class CoordinateSolution(NamedTuple):
    """The coordinates of every frame, and the motion that they make."""

    #: radians and metres, in the order of the model
    values: Float[np.ndarray, "F Q"]
    #: the motion of the skeleton, with residuals and lost frames
    markers: MarkerSolution


@checked
def solve_coordinates(
    model: CoordinateModel,
    subject: Subject,
    frames: MarkerFrames,
    *,
    targets: CoordinateTargets | None = None,
    terms: UserTerms = (),
) -> CoordinateSolution:
    """Find the coordinates of every frame that bring a model's markers nearest to the observed ones.

    It minimises `sum_m w_m |x_m - y_m|^2 / s_m^2` within the ranges of clamped coordinates, with weights and standard deviations of
    the markers, as the inverse kinematics of OpenSim does (Delp et al. 2007; Lu and O'Connor 1999). Each frame starts from the
    one before. Locked coordinates do not change.

    **Arguments:** `subject`, the model's skeleton with its markers (`read_osim`); `frames` with its labels in any order: other
    markers are ignored, missing ones do not count; `targets` of the coordinates; `terms`, energies of your own, in units of a
    log-likelihood, which see the skeleton with its markers as vertices.

    A frame with fewer than three markers, or that no coordinates fit, is lost and keeps the last coordinates.

    **Raises:** `InputError` if the subject has another skeleton than the model, if nothing is free, or no label is shared.
    """
    if not has_same_joints(model.skeleton, subject.skeleton):
        raise InputError(
            "solve_coordinates: `subject` has another skeleton than the model; expected markers on its joints."
        )
    if not len(model.free):
        raise InputError(
            "solve_coordinates: all coordinates of the model are locked; unlock those that move."
        )
    matched = match_markers(subject, frames)
    weights = matched.seen * subject.weights / subject.deviations**2
    enough = np.asarray((weights > 0).sum(1)) >= MIN_MARKERS
    body = marker_body(subject)
    priors = _Priors(sum_user_terms("solve_coordinates", terms, body), targets)
    _LOG.info("solving %d frames", len(frames))
    values = _solve_in_chunks(model, body, matched.positions, weights * enough[:, None], priors)
    lengths = np.asarray(_distances(model, body, values, matched.positions), float)
    values = np.asarray(values, float)
    used = np.asarray(weights) > 0
    mean_square = (used * lengths**2).sum(1) / np.maximum(used.sum(1), 1)
    lost = ~enough | ~(np.sqrt(mean_square) < MAX_DISTANCE)
    seen = np.asarray(matched.seen)
    solution = MarkerSolution(
        motion_from_coordinates(model, values, frames.rate),
        np.where(seen, lengths, np.nan),
        1.0 * (used & ~lost[:, None]),
        lost,
        (*describe_solution(subject, frames, seen, lost), *_describe_bounds(model, values)),
    )
    return CoordinateSolution(values, solution)


def _solve_in_chunks(
    model: CoordinateModel, body: Body, positions, weights, priors: _Priors
) -> Float[Array, "F Q"]:
    """Solve chunks of frames in parallel threads, each from a search in its first frame with markers."""
    count = len(positions)
    size = CHUNK_SIZE if count > CHUNK_SIZE else max(8, 1 << (count - 1).bit_length())
    chunks = -(-count // size)
    extra = chunks * size - count
    positions = jnp.pad(positions, ((0, extra), (0, 0), (0, 0)), mode="edge").reshape(chunks, size, -1, 3)
    weights = jnp.pad(weights, ((0, extra), (0, 0))).reshape(chunks, size, -1)

    def run(chunk: int) -> Float[Array, "N Q"]:
        places, shares = positions[chunk], weights[chunk]
        first = int(jnp.argmax((shares > 0).any(1)))
        start = _search(model, body, places[first], shares[first], priors)
        return jax.block_until_ready(_follow(model, body, start, places, shares, priors))

    return jnp.concatenate(list(parallel_map(run, range(chunks))))[:count]


@eqx.filter_jit
def _follow(
    model: CoordinateModel, body: Body, start, positions, weights, priors: _Priors
) -> Float[Array, "N Q"]:
    """Solve successive frames, each from the one before."""
    free = _free(model)

    def follow(values, frame):
        found = _solve(model, body, values, frame[0], frame[1], free, priors, STEPS)[0]
        kept = jnp.where((frame[1] > 0).any() & jnp.isfinite(found).all(), found, values)
        return kept, kept

    return jax.lax.scan(follow, start, (positions, weights))[1]


def _search(model: CoordinateModel, body: Body, positions, weights, priors: _Priors) -> Float[Array, "Q"]:
    """Find the coordinates of a frame without a previous one.

    First only the root moves, from many rotations and with the centre of its markers at the observed one. All coordinates continue
    from the best of these.
    """
    root, free = _floating_root(model), _free(model)
    rest = jnp.asarray(model.defaults, positions.dtype)

    def rank(values, energies):
        """Sort by energy, and nearly equal ones by the angles from rest: other angles may be the same rotations."""
        angles = np.array([coordinate.is_angle for coordinate in model.coordinates])
        nothing = NEGLIGIBLE**2 * weights.sum()
        return jnp.argsort((energies + nothing) * (1.0 + TURN_PENALTY * ((values - rest) ** 2 @ angles)))

    starts = rest[None]
    if root is not None:
        starts = _turned_starts(model, root, body, positions, weights)
        rigid = free & jnp.asarray(np.isin(np.arange(len(rest)), model.drivers[root]))
        # in parts of one size, which compile once
        parts = [
            _solve_each(model, body, part, positions, weights, rigid, priors)
            for part in jnp.split(starts, len(starts) // NUM_STARTS)
        ]
        starts, energies = (jnp.concatenate(part) for part in zip(*parts, strict=True))
        starts = starts[rank(starts, energies)[:NUM_STARTS]]
    found, energies = _solve_each(model, body, starts, positions, weights, free, priors)
    return _wrap(model, found[rank(found, energies)[0]])


def _wrap(model: CoordinateModel, values: Float[Array, "Q"]) -> Float[Array, "Q"]:
    """Wrap angles to within half a turn of rest, where a whole turn changes nothing."""
    periodic = np.array(
        [
            coordinate.is_periodic and coordinate.is_free and not coordinate.is_clamped
            for coordinate in model.coordinates
        ]
    )
    gap = values - jnp.asarray(model.defaults, values.dtype)
    return jnp.where(periodic, values - 2 * jnp.pi * jnp.round(gap / (2 * jnp.pi)), values)


def _turned_starts(model: CoordinateModel, root: int, body: Body, positions, weights) -> Float[Array, "S Q"]:
    """Make starts with many rotations of the root, and the centre of the markers at the observed one."""
    turns, shifts = (np.array(part) for part in (model.drivers[root][:3], model.drivers[root][3:]))
    angles = jnp.asarray(list(itertools.product(START_ANGLES, repeat=3)), positions.dtype)
    starts = jnp.tile(jnp.asarray(model.defaults, positions.dtype), (len(angles), 1)).at[:, turns].set(angles)
    share = weights / jnp.maximum(weights.sum(), 1e-12)
    middles = jnp.einsum("m,sma->sa", share, _all_vertices(model, body, starts))
    gaps = share @ positions - middles
    return starts.at[:, shifts].add(gaps @ model.axes[root, 3:].T)


def _floating_root(model: CoordinateModel) -> int | None:
    """Find the root joint that moves freely in all six directions; None if there is none."""
    free = set(model.free.tolist())
    for joint, parent in enumerate(model.skeleton.parents):
        if parent < 0 and len({*model.drivers[joint]} & free) == 6:
            return joint
    return None


def _free(model: CoordinateModel) -> Bool[Array, "Q"]:
    return jnp.asarray(np.isin(np.arange(len(model.names)), model.free))


@eqx.filter_jit
def _solve_each(
    model: CoordinateModel, body: Body, starts: Float[Array, "S Q"], positions, weights, free, priors: _Priors
) -> tuple[Float[Array, "S Q"], Float[Array, "S"]]:
    """Solve one frame from several starts."""
    return jax.lax.map(
        lambda start: _solve(model, body, start, positions, weights, free, priors, FIRST_STEPS), starts
    )


def _solve(
    model: CoordinateModel,
    body: Body,
    start: Float[Array, "Q"],
    positions: Float[Array, "M 3"],
    weights: Float[Array, "M"],
    free: Bool[Array, "Q"],
    priors: _Priors,
    steps: int,
) -> tuple[Float[Array, "Q"], Float[Array, ""]]:
    """Solve one frame; also return its energy."""
    landmarks = VertexLandmarks(jnp.arange(len(weights)), positions, weights)
    energy = Sum((landmarks, *(() if priors.terms is None else terms_of(priors.terms))))
    problem = CoordinateProblem(energy, model, body, free, priors.targets)
    found = minimise(problem, start, LevenbergMarquardt(1e-6, 1e-7, damping=1e-6, lengths=LENGTHS), steps).y
    found = follow_leaders(model, found)
    return found, problem.value(found)


@eqx.filter_jit
def _all_vertices(model: CoordinateModel, body: Body, values: Float[Array, "S Q"]) -> Float[Array, "S M 3"]:
    return jax.lax.map(lambda one: _vertices(model, body, one), values)


def _vertices(model: CoordinateModel, body: Body, values: Float[Array, "Q"]) -> Float[Array, "M 3"]:
    return pose_body(body, pose_from_coordinates(model, values)).vertices


@eqx.filter_jit
def _distances(model: CoordinateModel, body: Body, values, positions) -> Float[Array, "F M"]:
    def of_frame(frame):
        return jnp.linalg.norm(_vertices(model, body, frame[0]) - frame[1], axis=1)

    return jax.lax.map(of_frame, (values, positions))


def _describe_bounds(model: CoordinateModel, values: Float[np.ndarray, "F Q"]) -> tuple[str, ...]:
    """Describe the coordinates that end at their range in many frames."""
    low, high = model.bounds
    at_end = ((values <= low + 1e-6) | (values >= high - 1e-6)).mean(0)
    named = [
        f"{model.names[number]} in {100 * at_end[number]:.0f} %"
        for number in model.free
        if at_end[number] > MANY
    ]
    if not named:
        return ()
    return (
        f"coordinates end at their ranges in the frames: {', '.join(named)}; the ranges may be too narrow.",
    )
