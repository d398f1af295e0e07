"""Fitting of a body model to registered meshes: coefficients and poses together."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int, PyTree

from ..arguments import checked
from ..body.body import Body, pose_body, take_vertices
from ..body.body_model import BodyModel, shape_from_template
from ..body.pose import Motion, Pose, take_poses
from ..energy.check_energies import UserTerms, check_finite_residuals, sum_user_terms
from ..energy.data.landmarks import VertexLandmarks
from ..energy.energy import AbstractEnergy, Sum, terms_of
from ..energy.stacked import NormalPrior, Stacked
from ..geometry.sampling import even_indices
from ..observe.meshes import MeshSequence
from ..parallel import parallel_map
from .fit_meshes import DATA_WEIGHT, check_mesh_sequence, poses_of_meshes, procrustes_poses
from .linear_solvers.float64 import in_float64
from .sequences.sequence_problem import SequenceEstimate, SequenceProblem
from .sequences.unknowns import ShapeCoefficients, model_coefficients
from .solvers.levenberg_marquardt import LevenbergMarquardt
from .solvers.minimise import minimise

#: number of vertices of the first fit, and least number of those of each bone
NUM_SAMPLES, NUM_OF_BONE = 100, 4
#: standard deviation of the coefficients at which they weigh as much as a root mean square distance of a millimetre
COEFFICIENT_DEVIATION = 1e3
#: least change of half the energy, in square millimetres: a thousandth of a millimetre
ENERGY_TOLERANCE = 1e-6
#: steps with all vertices after the first fit, if the root mean square distance exceeds this after it, metres: data without
#: errors are then fitted already
LAST_STEPS, EXACT = 3, 1e-5
#: steps in single precision
SINGLE_STEPS = 8
#: largest number of meshes of one chunk of a parallel fit, and its step: other numbers compile again
CHUNK, CHUNK_STEP = 16, 4


class ModelFit(eqx.Module):
    """The result of `fit_model` over F meshes."""

    motion: Motion
    #: one row of coefficients for each mesh, all equal for meshes of one person
    coefficients: Float[Array, "F K"]
    #: root mean square distance of the vertices from their targets, metres; NaN if no target is known
    rmse: Float[Array, "F"]
    num_steps: Int[Array, "F"]
    #: true if a mesh was fitted: it has finite vertices, and the solver converged to a finite pose
    converged: Bool[Array, "F"]


class _Samples(NamedTuple):
    """A body of some vertices, with the unknown of its coefficients and their numbers."""

    body: Body
    shape: ShapeCoefficients
    vertices: Int[Array, "S"]


@checked
def fit_model(
    model: BodyModel,
    sequence: MeshSequence,
    *,
    same_person: bool = True,
    start: Pose | Motion | None = None,
    max_steps: int = 40,
    terms: UserTerms = (),
) -> ModelFit:
    """Fit the coefficients and the poses of a body model to registered meshes, from `procrustes_poses`.

    Coefficients and poses are unknowns of one least-squares problem. It is first solved for some vertices, and then for all
    if these have errors.

    **Arguments:** `same_person`, all meshes have the same coefficients; otherwise each mesh has its own, and is fitted alone.
    `start` poses stacked over the meshes; a vertex that is not finite in a mesh does not count there; `terms` are further
    energies of the posed body, in units of `fit_meshes`.

    It has no derivatives; those of the minimum are of `solve_sequence` with `model_coefficients`.

    **Raises:** `InputError` where the meshes have other vertices than the model, or no mesh is given.
    """
    check_mesh_sequence(model.template, sequence)
    dtype = model.template.vertices.dtype
    positions = sequence.vertices.astype(dtype)
    poses = (
        procrustes_poses(model.template, sequence) if start is None else poses_of_meshes(start, len(sequence))
    )
    own = sum_user_terms("fit_model", terms, model.template)
    if own is not None:
        check_finite_residuals("fit_model", own, model.template, Motion(poses)[0])
    few = _take_samples(model)
    if same_person:
        begun = _begin_in_both(_begin_together, few, poses, positions[:, few.vertices], max_steps)
        found = _finish_together(model, begun, poses, positions, own, max_steps)
    else:
        found = _fit_each(model, few, poses, positions, own, max_steps)
    return ModelFit(
        motion=Motion(found.poses, sequence.rate),
        coefficients=found.coefficients + model.template_coefficients,
        rmse=found.rmse,
        num_steps=found.num_steps,
        converged=found.converged,
    )


def _take_samples(model: BodyModel) -> _Samples:
    """Take vertices spread over the surface, and enough of each bone."""
    bones = np.asarray(model.template.skin.dominant_bones())
    rows = [even_indices(len(bones), NUM_SAMPLES)]
    for bone in np.unique(bones):
        members = np.flatnonzero(bones == bone)
        rows.append(members[even_indices(len(members), NUM_OF_BONE)])
    chosen = jnp.asarray(np.unique(np.concatenate(rows)))
    shape = eqx.tree_at(
        lambda s: s.modes.vertices, model_coefficients(model), model.modes.vertices[:, chosen]
    )
    return _Samples(take_vertices(model.template, chosen), shape, chosen)


class _Fits(NamedTuple):
    """The fits of F meshes; coefficients are relative to the template's."""

    poses: Pose
    coefficients: Float[Array, "F K"]
    rmse: Float[Array, "F"]
    num_steps: Int[Array, "F"]
    converged: Bool[Array, "F"]


class _Begun(NamedTuple):
    """The fit of some vertices."""

    estimate: SequenceEstimate
    num_steps: Int[Array, "*chunk"]
    successful: Bool[Array, "*chunk"]


def _fit_each(
    model: BodyModel,
    few: _Samples,
    starts: Pose,
    positions: Float[Array, "F V 3"],
    extra: AbstractEnergy | None,
    max_steps: int,
) -> _Fits:
    """Fit each mesh alone, on all cores."""
    count = len(positions)
    # chunks of about one size, with few repeated meshes in the last one
    size = -(-count // -(-count // CHUNK))
    size = min(CHUNK, CHUNK_STEP * -(-size // CHUNK_STEP))
    chunks = [np.arange(first, first + size) % count for first in range(0, count, size)]

    def fit(chunk: Int[np.ndarray, "C"]) -> _Fits:
        poses, places = take_poses(starts, chunk), positions[chunk]
        begun = _begin_in_both(_begin_chunk, few, poses, places[:, few.vertices], max_steps)
        return jax.block_until_ready(_finish_chunk(model, begun, poses, places, extra, max_steps))

    parts = list(parallel_map(fit, chunks))
    return jax.tree.map(lambda *some: jnp.concatenate(some)[:count], *parts)


def _begin_in_both(
    begin: Callable[..., _Begun],
    few: _Samples,
    starts: Pose,
    places: Float[Array, "F S 3"],
    max_steps: int,
) -> _Begun:
    """Fit some vertices in single precision, and go on in float64 where weak directions of the shape do not converge there."""
    found = begin(few, starts, places, min(SINGLE_STEPS, max_steps), None)
    if bool(found.successful.all()) or max_steps <= SINGLE_STEPS:
        return found
    more = in_float64(begin, few, starts, places, max_steps - SINGLE_STEPS, found.estimate)
    return more._replace(num_steps=found.num_steps + more.num_steps)


@eqx.filter_jit
def _begin_chunk(
    few: _Samples,
    starts: Pose,
    places: Float[Array, "F S 3"],
    max_steps: int,
    estimates: SequenceEstimate | None,
) -> _Begun:
    def one(frame):
        starts, places = _stacked(frame[:2])
        return _begin(few, starts, places, max_steps, frame[2])

    return jax.lax.map(one, (starts, places, estimates))


@eqx.filter_jit
def _finish_chunk(model, begun: _Begun, starts: Pose, positions, extra, max_steps: int) -> _Fits:
    def one(frame):
        begun, (starts, positions) = frame[0], _stacked(frame[1:])
        found = _finish(model, begun, starts, positions, extra, max_steps)
        return jax.tree.map(lambda x: x[0], found)

    return jax.lax.map(one, (begun, starts, positions))


def _stacked(frame: PyTree) -> PyTree:
    """Make one frame a stack of frames."""
    return jax.tree.map(lambda x: x[None], frame)


def _solver() -> LevenbergMarquardt:
    return LevenbergMarquardt(rtol=1e-3, atol=1e-4, damping=1e-2, energy_atol=ENERGY_TOLERANCE)


def _begin(
    few: _Samples,
    starts: Pose,
    places: Float[Array, "F S 3"],
    max_steps: int,
    estimate: SequenceEstimate | None,
) -> _Begun:
    """Fit some vertices of F meshes with the same coefficients, from `estimate` if there is one."""
    problem = _problem(few.body, few.shape, places, None)
    found = minimise(problem, problem.start(starts) if estimate is None else estimate, _solver(), max_steps)
    return _Begun(found.y, found.num_steps, found.result == optx.RESULTS.successful)


def _finish(
    model: BodyModel,
    begun: _Begun,
    starts: Pose,
    positions: Float[Array, "F V 3"],
    extra: AbstractEnergy | None,
    max_steps: int,
) -> _Fits:
    """Fit all vertices of F meshes if they have errors, with the same coefficients."""
    rmse = _root_mean_squares(model, begun.estimate, positions)

    def refine(y: SequenceEstimate):
        # further terms may name vertices of the whole body
        whole = _problem(model.template, model_coefficients(model), positions, extra)
        found = minimise(whole, y, _solver(), LAST_STEPS if extra is None else max_steps)
        # a few steps after a solution need no success of their own
        successful = (found.result == optx.RESULTS.successful) | (extra is None)
        return found.y, found.num_steps, _root_mean_squares(model, found.y, positions), successful

    estimate, more, rmse, successful = jax.lax.cond(
        jnp.any(rmse > EXACT) | (extra is not None),
        refine,
        lambda y: (y, jnp.zeros_like(begun.num_steps), rmse, jnp.array(True)),
        begun.estimate,
    )
    count, finite = len(positions), jnp.isfinite(rmse)
    poses = jax.tree.map(
        lambda new, old: jnp.where(finite.reshape(-1, *[1] * (new.ndim - 1)), new, old),
        estimate.poses,
        starts,
    )
    z = estimate.values["shape"]
    return _Fits(
        poses,
        jnp.broadcast_to(z, (count, len(z))),
        rmse,
        jnp.full(count, begun.num_steps + more),
        begun.successful & successful & finite,
    )


_begin_together, _finish_together = eqx.filter_jit(_begin), eqx.filter_jit(_finish)


def _root_mean_squares(
    model: BodyModel, estimate: SequenceEstimate, positions: Float[Array, "F V 3"]
) -> Float[Array, "F"]:
    """Compute the root mean square distances of all vertices; NaN if none is known."""
    body = shape_from_template(model, estimate.values["shape"])

    def of_mesh(mesh):
        pose, place = mesh
        known = jnp.isfinite(place).all(1)
        gaps = jnp.sum((pose_body(body, pose).vertices - jnp.where(known[:, None], place, 0.0)) ** 2, 1)
        return jnp.sqrt(jnp.sum(jnp.where(known, gaps, 0.0)) / known.sum())

    return jax.lax.map(of_mesh, (estimate.poses, positions))


def _problem(
    body: Body, shape: ShapeCoefficients, positions: Float[Array, "F V 3"], extra: AbstractEnergy | None
) -> SequenceProblem:
    known = jnp.isfinite(positions).all(2)
    places = jnp.where(known[..., None], positions, 0.0)
    weights = known.astype(places.dtype)
    weights = DATA_WEIGHT * weights / jnp.maximum(weights.sum(1, keepdims=True), 1.0)
    frames, count = known.shape
    landmarks = Stacked(jax.vmap(lambda *of: VertexLandmarks(jnp.arange(count), *of))(places, weights))
    energy = Sum((landmarks, *(() if extra is None else terms_of(extra))))
    size, dtype = shape.size(body), body.vertices.dtype
    prior = NormalPrior("shape", jnp.zeros(size, dtype), jnp.full(size, COEFFICIENT_DEVIATION, dtype))
    times = jnp.arange(frames, dtype=dtype)
    return SequenceProblem(body, energy, times, {"shape": shape}, shared=(prior,))
