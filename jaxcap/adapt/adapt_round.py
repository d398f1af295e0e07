"""A round of an adaptation: proportions, or joints and vertices, with some poses (Adaptation, 4.1.4)."""

import logging
from collections.abc import Iterable, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..body.body import Body
from ..body.body_model import BodyModel, shape_from_template
from ..body.pose import Motion, Pose, stack_poses
from ..body.shape_modes import ShapeModes, joint_modes
from ..energy.data.pairs import stack_pairs
from ..fit.correspondence.nearest_assignment import IndexedScan
from ..fit.sequences.sequence_problem import SequenceProblem
from ..fit.solvers.descent import NormalDescent
from ..fit.solvers.minimise import take_step
from ..stacking import stack_trees, unstack_trees
from .history import append_history
from .objective import CoefficientPrior, shared_problem
from .poses.fit_frame import clamp_pose, fit_task_poses
from .poses.pair_cache import PairCache
from .poses.select_frames import spread_frames
from .shape.choose_shape_weight import choose_shape_weight
from .shape.joint_regressor import make_joint_regressor, regress_joints
from .shape.reference import reference_body, shape_prior_of
from .shape.shape_prior import ShapePrior
from .shape.shape_space import fit_coefficients
from .shape.vertex_adaptation import adapt_shape, adapt_together
from .task import AdaptSettings, AdaptState, AdaptTask, Stage

#: weight of squared distances along the surface while shape coefficients are estimated, as another person's
#: skin slides
TANGENTIAL_WEIGHT = 0.005
#: damping of a step on all poses and modes, as a share of each curvature
DAMPING = 1e-3
#: steps of each chosen frame's own pose before the first round; each round takes one more, on all unknowns
STEPS = 2
#: number of weights of the shape prior that the last round chooses from
NUM_WEIGHTS = 4

_LOG = logging.getLogger(__name__)


def adapt_round(
    task: AdaptTask, state: AdaptState, pair_cache: PairCache[IndexedScan], stage: Stage
) -> AdaptState:
    """Take one round on shared unknowns and the chosen frames' poses; `pair_cache` caches their scans."""
    settings = task.settings
    if stage.pass_number == 0 and stage.round == 1 and task.shape_space is not None:
        state = _replace_by_person(task.shape_space, state)
    chosen = state.chosen or spread_frames(state, settings.num_frames, stage.frames)
    poses = {n: state.motion[n] for n in chosen}
    if stage.round == 1 and not state.chosen:
        pair_cache.keep(chosen)
        found = fit_task_poses(task, state, map(pair_cache.scan, chosen), list(poses.values()), steps=STEPS)
        for n, fit in zip(chosen, found, strict=True):
            poses[n] = fit.pose
            pair_cache.record(n, state.body, fit.pose, fit.pairs)
    if stage.pass_number == 0:
        body, poses, coefficients = _proportions(task, state, poses, pair_cache)
        # choose new frames for the adaptation of vertices, if there are others
        is_last, others = stage.round == settings.proportion_rounds, set(task.scanned) - set(chosen)
        chosen_next = () if is_last and others else chosen
    else:
        body, poses = _surface(task, state, poses, pair_cache, stage)
        coefficients, chosen_next = state.coefficients, chosen
    if task.boxes is not None:
        poses = {n: clamp_pose(task.boxes, body.skeleton, pose) for n, pose in poses.items()}
    every = [poses.get(n, state.motion[n]) for n in range(len(state.motion))]
    state = state._replace(
        body=body, motion=stack_poses(every, task.rate), chosen=chosen_next, coefficients=coefficients
    )
    return append_history(task, state, str(stage), chosen, pair_cache)


def _replace_by_person(shape_space: BodyModel, state: AdaptState) -> AdaptState:
    """Replace the body by the most similar person of the shape space, in the same poses."""
    coefficients = fit_coefficients(shape_space, state.body)
    body = shape_from_template(shape_space, coefficients)
    # keep the world position of a root with another rest position
    shift = state.body.skeleton.centres[0] - body.skeleton.centres[0]
    poses = state.motion.poses
    poses = Pose(poses.translations.at[:, 0].add(shift), poses.rotations, poses.scale)
    return state._replace(
        body=body, motion=Motion(poses, state.motion.rate), coefficients=tuple(coefficients.tolist())
    )


def _proportions(
    task: AdaptTask, state: AdaptState, poses: dict[int, Pose], pair_cache: PairCache
) -> tuple[Body, dict[int, Pose], tuple[float, ...]]:
    """Estimate proportions by shape coefficients, or without a shape space by joints that move their skin."""
    if task.shape_space is None:
        modes, coefficient_prior = joint_modes(state.body), _regressed_joint_prior(task, state)
        body, stacked, _ = _step(
            task, state, poses, pair_cache, modes, coefficient_prior, task.left_right_pairs
        )
        return body, _unstack(stacked, poses), state.coefficients
    from_mean = task.shape_space.template_coefficients + jnp.asarray(state.coefficients)
    # the error of the shape space is the same in all frames, which therefore count as one
    coefficient_prior = CoefficientPrior(-from_mean, jnp.full_like(from_mean, len(poses) ** -0.5))
    body, stacked, changes = _step(
        task, state, poses, pair_cache, task.shape_space.modes, coefficient_prior, (), TANGENTIAL_WEIGHT
    )
    coefficients = np.array(state.coefficients) + np.asarray(changes, float)
    return body, _unstack(stacked, poses), tuple(coefficients.tolist())


def _surface(
    task: AdaptTask, state: AdaptState, poses: dict[int, Pose], pair_cache: PairCache, stage: Stage
) -> tuple[Body, dict[int, Pose]]:
    """Adapt joints within the skin and then vertices, or both in one step."""
    modes = joint_modes(state.body, move_surface=False)
    coefficient_prior = _regressed_joint_prior(task, state)
    shape, weights = shape_prior_of(task, state), shape_weights(task.settings, stage)
    if task.settings.simultaneous:
        pairs = stack_pairs(pair_cache.pairs(state.body, poses))
        weight = _choose_weight(state.body, _stack(poses), pairs, shape, weights)
        problem = _problem(task, state, pairs, modes, coefficient_prior, task.left_right_pairs)
        body, stacked = adapt_together(problem, _stack(poses), pairs, shape, weight)
        return body, _unstack(stacked, poses)
    body, stacked, _ = _step(task, state, poses, pair_cache, modes, coefficient_prior, task.left_right_pairs)
    poses = _unstack(stacked, poses)
    pairs = stack_pairs(pair_cache.pairs(body, poses))
    weight = _choose_weight(body, stacked, pairs, shape, weights)
    return adapt_shape(body, stacked, pairs, shape, weight), poses


def _choose_weight(body: Body, poses: Pose, pairs, shape: ShapePrior, weights: Sequence[float]) -> float:
    """Choose one of the weights of the shape prior, and log it."""
    weight = choose_shape_weight(body, poses, pairs, shape, weights)
    if len(weights) > 1:
        _LOG.info("weight of the shape prior: %.3g, from %s", weight, ", ".join(f"{w:.3g}" for w in weights))
    return weight


def _step(
    task: AdaptTask,
    state: AdaptState,
    poses: dict[int, Pose],
    pair_cache: PairCache,
    modes: ShapeModes,
    coefficient_prior: CoefficientPrior,
    left_right_pairs: tuple[tuple[int, int], ...],
    max_tangential_weight: float = 1.0,
) -> tuple[Body, Pose, Float[Array, "K"]]:
    """Take one step on poses and modes; return the body, stacked poses and the modes' coefficients.

    `max_tangential_weight` is the largest weight of squared distances along the surface.
    """
    pairs = stack_pairs(pair_cache.pairs(state.body, poses))
    pairs = eqx.tree_at(
        lambda p: p.tangential_weights, pairs, jnp.minimum(pairs.tangential_weights, max_tangential_weight)
    )
    return gauss_newton_step(
        _problem(task, state, pairs, modes, coefficient_prior, left_right_pairs), _stack(poses)
    )


def _stack(poses: dict[int, Pose]) -> Pose:
    return stack_trees(list(poses.values()))


def _unstack(stacked: Pose, frames: Iterable[int]) -> dict[int, Pose]:
    frames = list(frames)
    return dict(zip(frames, unstack_trees(stacked, len(frames)), strict=True))


@eqx.filter_jit
def gauss_newton_step(problem: SequenceProblem, poses: Pose) -> tuple[Body, Pose, Float[Array, "K"]]:
    """Take one Gauss-Newton step on all poses and the coefficients of modes, even if it raises the energy.

    Return the body, the poses and the coefficients.
    """
    found = take_step(problem, problem.start(poses), NormalDescent(relative=True), DAMPING)
    return problem.body_at(found.values), found.poses, found.values["modes"]


def _problem(
    task: AdaptTask,
    state: AdaptState,
    pairs,
    modes: ShapeModes,
    coefficient_prior: CoefficientPrior,
    left_right_pairs,
) -> SequenceProblem:
    weight, deviation = (jnp.asarray(x, float) for x in (state.pose_weight, task.settings.pair_deviation))
    return shared_problem(
        state.body, pairs, task.pose_terms(weight), modes, coefficient_prior, left_right_pairs, deviation
    )


def _regressed_joint_prior(task: AdaptTask, state: AdaptState) -> CoefficientPrior:
    """Make the prior of joints at their positions regressed from the surface."""
    body = state.body
    regressor = make_joint_regressor(reference_body(task, state))
    regressed = regress_joints(regressor, np.asarray(body.vertices, float))
    shifts = (regressed - np.asarray(body.skeleton.centres, float)).reshape(-1)
    shifts = jnp.asarray(shifts, body.vertices.dtype)
    return CoefficientPrior(shifts, jnp.full_like(shifts, task.settings.joint_deviation))


def shape_weights(settings: AdaptSettings, stage: Stage) -> tuple[float, ...]:
    """Return the weights of the shape term that a round chooses from.

    A round has a single one, interpolated geometrically over a pass. The first pass begins with the first weight; later ones begin
    with the geometric mean of the first and the last. The last round of the last pass chooses between the last and the first.
    """
    first, last = settings.shape_weights
    is_last = (stage.pass_number, stage.round) == (len(settings.rounds), settings.rounds[-1])
    if is_last and stage.frames is None and first > last:
        return tuple(np.geomspace(last, first, NUM_WEIGHTS).tolist())
    first = first if stage.pass_number == 1 else np.sqrt(first * last)
    share = (stage.round - 1) / max(settings.rounds[stage.pass_number - 1] - 1, 1)
    return (float(first ** (1 - share) * last**share),)
