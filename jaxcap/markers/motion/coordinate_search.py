"""Generalised coordinates of one frame: from coordinates near by, and by a search from many rotations of the root."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...body.body import Body, pose_body
from ...body.coordinates.coordinate_model import (
    CoordinateModel,
    CoordinateTargets,
    follow_leaders,
    pose_from_coordinates,
)
from ...energy.data.landmarks import VertexLandmarks
from ...energy.energy import AbstractEnergy, Sum, terms_of
from ...fit.coordinate_problem import CoordinateProblem
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ...fit.solvers.minimise import minimise

#: largest number of steps from a start far away
SEARCH_STEPS = 60
#: lengths of each step that are tried; noisy markers bend the energy more, or less, than its linearisation
LENGTHS = (2.0, 1.0, 0.5)
#: angles at which the root starts, radians, about each of its axes of rotation
START_ANGLES = np.pi / 2 * np.arange(-1, 3)
#: number of starts that all coordinates continue from; a divisor of the number of rotations
NUM_STARTS = 8
#: distance of markers that does not matter in a choice among starts, metres; share by which the energy of a start is raised for each
#: square radian from rest
NEGLIGIBLE, TURN_PENALTY = 1e-3, 1e-3


class FrameMarkers(eqx.Module):
    """The markers of a frame: positions, and weights in inverse square metres, zero where a marker is not visible."""

    positions: Float[Array, "*frames M 3"]
    weights: Float[Array, "*frames M"]


class CoordinatePriors(eqx.Module):
    """Energies besides those of the markers."""

    terms: AbstractEnergy | None
    targets: CoordinateTargets | None


def solve_frame_coordinates(
    model: CoordinateModel,
    body: Body,
    start: Float[Array, "Q"],
    markers: FrameMarkers,
    free: Bool[Array, "Q"],
    priors: CoordinatePriors,
    max_steps: int,
) -> tuple[Float[Array, "Q"], Float[Array, ""]]:
    """Find the coordinates of a frame from a start near them; `body` has the markers as vertices. Also return their energy."""
    landmarks = VertexLandmarks(jnp.arange(len(markers.weights)), markers.positions, markers.weights)
    energy = Sum((landmarks, *(() if priors.terms is None else terms_of(priors.terms))))
    problem = CoordinateProblem(energy, model, body, free, priors.targets)
    found = minimise(
        problem, start, LevenbergMarquardt(1e-6, 1e-7, damping=1e-6, lengths=LENGTHS), max_steps
    ).y
    found = follow_leaders(model, found)
    return found, problem.value(found)


def search_coordinates(
    model: CoordinateModel, body: Body, markers: FrameMarkers, priors: CoordinatePriors
) -> Float[Array, "Q"]:
    """Find the coordinates of a frame without a start.

    First only the root moves, from many rotations and with the centre of its markers at the observed one. All coordinates continue
    from the best of these.
    """
    root, free = _floating_root(model), free_coordinates(model)
    rest = model.defaults

    def rank(values, energies):
        """Sort by energy, and nearly equal ones by the angles from rest: other angles may be the same rotations."""
        angles = np.array([coordinate.is_angle for coordinate in model.coordinates])
        nothing = NEGLIGIBLE**2 * markers.weights.sum()
        return jnp.argsort((energies + nothing) * (1.0 + TURN_PENALTY * ((values - rest) ** 2 @ angles)))

    starts = rest[None]
    if root is not None:
        starts = _turned_starts(model, root, body, markers)
        rigid = free & jnp.asarray(np.isin(np.arange(len(rest)), model.drivers[root]))
        # in parts of one size, which compile once
        parts = [
            _solve_each(model, body, part, markers, rigid, priors)
            for part in jnp.split(starts, len(starts) // NUM_STARTS)
        ]
        starts, energies = (jnp.concatenate(part) for part in zip(*parts, strict=True))
        starts = starts[rank(starts, energies)[:NUM_STARTS]]
    found, energies = _solve_each(model, body, starts, markers, free, priors)
    return wrap_angles(model, found[rank(found, energies)[0]], rest)


def free_coordinates(model: CoordinateModel) -> Bool[Array, "Q"]:
    """Return the mask of the coordinates that a solver may change."""
    return jnp.asarray(np.isin(np.arange(len(model.names)), model.free))


def wrap_angles(
    model: CoordinateModel, values: Float[Array, "*frames Q"], reference: Float[Array, "Q"]
) -> Float[Array, "*frames Q"]:
    """Shift angles by whole turns, where these change nothing, so that the first frame is within half a turn of a reference."""
    periodic = np.array([one.is_periodic and one.is_free and not one.is_clamped for one in model.coordinates])
    first = values if values.ndim == 1 else values[0]
    turns = jnp.round((first - reference) / (2 * jnp.pi))
    return values - jnp.where(periodic, 2 * jnp.pi * turns, 0.0)


def marker_vertices(model: CoordinateModel, body: Body, values: Float[Array, "Q"]) -> Float[Array, "M 3"]:
    """Compute the positions of the markers, the vertices of `body`, metres."""
    return pose_body(body, pose_from_coordinates(model, values)).vertices


def _turned_starts(
    model: CoordinateModel, root: int, body: Body, markers: FrameMarkers
) -> Float[Array, "S Q"]:
    """Make starts with many rotations of the root, and the centre of the markers at the observed one, within the ranges."""
    turns, shifts = (np.array(part) for part in (model.drivers[root][:3], model.drivers[root][3:]))
    angles = jnp.asarray(list(itertools.product(START_ANGLES, repeat=3)), model.defaults.dtype)
    starts = jnp.tile(model.defaults, (len(angles), 1)).at[:, turns].set(angles)
    starts = jnp.clip(starts, *model.bounds)
    share = markers.weights / jnp.maximum(markers.weights.sum(), 1e-12)
    middles = jnp.einsum("m,sma->sa", share, _all_vertices(model, body, starts))
    gaps = share @ markers.positions - middles
    return jnp.clip(starts.at[:, shifts].add(gaps @ model.axes[root, 3:].T), *model.bounds)


def _floating_root(model: CoordinateModel) -> int | None:
    """Find the root joint that moves freely in all six directions; None if there is none."""
    free = set(model.free.tolist())
    for joint, parent in enumerate(model.skeleton.parents):
        if parent < 0 and len({*model.drivers[joint]} & free) == 6:
            return joint
    return None


@eqx.filter_jit
def _solve_each(
    model: CoordinateModel,
    body: Body,
    starts: Float[Array, "S Q"],
    markers: FrameMarkers,
    free: Bool[Array, "Q"],
    priors: CoordinatePriors,
) -> tuple[Float[Array, "S Q"], Float[Array, "S"]]:
    """Solve one frame from several starts."""
    return jax.lax.map(
        lambda start: solve_frame_coordinates(model, body, start, markers, free, priors, SEARCH_STEPS), starts
    )


@eqx.filter_jit
def _all_vertices(model: CoordinateModel, body: Body, values: Float[Array, "S Q"]) -> Float[Array, "S M 3"]:
    return jax.lax.map(lambda one: marker_vertices(model, body, one), values)
