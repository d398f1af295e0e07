"""Generalised coordinates of a model through frames of markers: inverse kinematics as in biomechanics."""

import logging
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...arguments import checked
from ...body.body import Body
from ...body.coordinates.coordinate_model import (
    CoordinateModel,
    CoordinateTargets,
    motion_from_coordinates,
)
from ...body.skeleton import has_same_joints
from ...energy.check_energies import UserTerms, sum_user_terms
from ...errors import InputError
from ...observe.markers import MarkerFrames
from ...parallel import parallel_map
from ..subject import Subject, marker_body
from .coordinate_search import (
    CoordinatePriors,
    FrameMarkers,
    free_coordinates,
    marker_vertices,
    search_coordinates,
    solve_frame_coordinates,
    wrap_angles,
)
from .inverse_kinematics import MIN_MARKERS, MarkerSolution, describe_solution
from .label_matching import match_markers

_LOG = logging.getLogger(__name__)

#: frames solved in sequence in one call
CHUNK_SIZE = 256
#: largest number of steps from the previous frame
STEPS = 20
#: angle or length between chunks from which the second one is solved again from the first one, radians or metres
MAX_JUMP = 0.3
#: a frame is lost if the root mean square distance of its markers exceeds this, metres
MAX_DISTANCE = 0.2
#: share of frames at the end of a range that is reported
REPORTED_SHARE = 0.1


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
    priors = CoordinatePriors(sum_user_terms("solve_coordinates", terms, body), targets)
    markers = FrameMarkers(matched.positions, jnp.asarray(weights * enough[:, None]))
    _LOG.info("solving %d frames", len(frames))
    values = _solve_in_chunks(model, body, markers, priors)
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
    model: CoordinateModel, body: Body, markers: FrameMarkers, priors: CoordinatePriors
) -> Float[Array, "F Q"]:
    """Solve chunks of frames in parallel threads, each from a search in its first frame with markers, and join them."""
    count = len(markers.positions)
    size = CHUNK_SIZE if count > CHUNK_SIZE else max(8, 1 << (count - 1).bit_length())
    chunks = -(-count // size)
    extra = chunks * size - count
    positions = jnp.pad(markers.positions, ((0, extra), (0, 0), (0, 0)), mode="edge")
    weights = jnp.pad(markers.weights, ((0, extra), (0, 0)))
    parts = [
        FrameMarkers(positions[first : first + size], weights[first : first + size])
        for first in range(0, chunks * size, size)
    ]

    def run(part: FrameMarkers) -> Float[Array, "N Q"]:
        first = int(jnp.argmax((part.weights > 0).any(1)))
        frame = FrameMarkers(part.positions[first], part.weights[first])
        start = search_coordinates(model, body, frame, priors)
        return jax.block_until_ready(_follow(model, body, start, part, priors))

    joined: list[Float[Array, "N Q"]] = []
    for part, values in zip(parts, parallel_map(run, parts), strict=True):
        joined.append(_join(model, body, joined[-1][-1], values, part, priors) if joined else values)
    return jnp.concatenate(joined)[:count]


def _join(
    model: CoordinateModel,
    body: Body,
    before: Float[Array, "Q"],
    values: Float[Array, "N Q"],
    markers: FrameMarkers,
    priors: CoordinatePriors,
) -> Float[Array, "N Q"]:
    """Continue from the last frame of the previous chunk: by whole turns, and by a solution from there if that fits as well."""
    values = wrap_angles(model, values, before)
    if not float(jnp.abs(values[0] - before)[model.free].max()) > MAX_JUMP:
        return values
    again = _follow(model, body, before, markers, priors)
    energies = [_sum_squares(model, body, one, markers) for one in (again, values)]
    return again if float(energies[0]) <= (1 + MAX_JUMP) * float(energies[1]) else values


@eqx.filter_jit
def _follow(
    model: CoordinateModel, body: Body, start, markers: FrameMarkers, priors: CoordinatePriors
) -> Float[Array, "N Q"]:
    """Solve successive frames, each from the one before."""
    free = free_coordinates(model)

    def follow(values, frame):
        found = solve_frame_coordinates(model, body, values, frame, free, priors, STEPS)[0]
        kept = jnp.where((frame.weights > 0).any() & jnp.isfinite(found).all(), found, values)
        return kept, kept

    return jax.lax.scan(follow, start, markers)[1]


@eqx.filter_jit
def _sum_squares(model: CoordinateModel, body: Body, values, markers: FrameMarkers) -> Float[Array, ""]:
    """Sum the weighted squared distances of markers in all frames."""
    return jnp.sum(markers.weights * _distances(model, body, values, markers.positions) ** 2)


@eqx.filter_jit
def _distances(model: CoordinateModel, body: Body, values, positions) -> Float[Array, "F M"]:
    def of_frame(frame):
        return jnp.linalg.norm(marker_vertices(model, body, frame[0]) - frame[1], axis=1)

    return jax.lax.map(of_frame, (values, positions))


def _describe_bounds(model: CoordinateModel, values: Float[np.ndarray, "F Q"]) -> tuple[str, ...]:
    """Describe the coordinates that end at their range in many frames."""
    low, high = model.bounds
    at_end = ((values <= low + 1e-6) | (values >= high - 1e-6)).mean(0)
    named = [
        f"{model.names[number]} in {100 * at_end[number]:.0f} %"
        for number in model.free
        if at_end[number] > REPORTED_SHARE
    ]
    if not named:
        return ()
    return (
        f"coordinates end at their ranges in the frames: {', '.join(named)}; the ranges may be too narrow.",
    )
