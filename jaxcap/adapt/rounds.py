"""A round of an adaptation: proportions, or joints and vertices, with some poses (Adaptation, 4.1.4)."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..body.body import Body
from ..body.people.sample import unlike_poses
from ..body.pose import Motion, Pose, stack_poses
from ..body.shape_modes import Modes, joint_modes
from ..fit.correspondence.correspond import Pairs
from ..fit.sequences.problem import SequenceProblem
from ..fit.solvers.descent import NormalDescent
from ..fit.solvers.minimise import take_step
from .poses.pose import move_within_boxes
from .poses.task_pairs import TaskPairs, poses_at, told
from .problems import Belief, shared_problem, stack, stack_pairs, unstack
from .shape.joint_regressor import make_joint_regressor, regress_joints
from .shape.reference import reference, shape_prior_of
from .shape.shape_space import People, person, traits_like
from .shape.surface import adapt_shape, adapt_together
from .task import AdaptSettings, AdaptState, AdaptTask, Stage

#: finds the stacked pairs of a body in its poses in a round's frames
PairsOfAll = Callable[[Body, list[Pose]], Pairs]
#: weight of squared distances along the surface while shape coefficients are estimated, as another person's
#: skin slides
SLIDING = 0.005
#: damping of a step on all poses and modes, as a share of each curvature
DAMPING = 1e-3


def adapt_round(task: AdaptTask, state: AdaptState, meetings: TaskPairs, stage: Stage) -> AdaptState:
    """Take one round on shared unknowns and the chosen frames' poses; `meetings` caches their scans."""
    settings = task.settings
    if stage.number == 0 and stage.round == 1 and task.people is not None:
        state = _as_person(task.people, state)
    chosen = state.chosen or spread_frames(state, settings.frames, stage.frames)
    poses = [state.motion[n] for n in chosen]
    if stage.round == 1:
        poses = list(poses_at(task, state, meetings.scans(chosen), poses, steps=6))

    def pairs_of_all(body: Body, poses: list[Pose]) -> Pairs:
        return stack_pairs(meetings.pairs(body, chosen, poses))

    if stage.number == 0:
        body, poses, traits = _proportions(task, state, poses, pairs_of_all)
        # choose new frames for the adaptation of vertices
        chosen_next = () if stage.round == settings.alone else chosen
    else:
        body, poses = _surface(task, state, poses, pairs_of_all, stage)
        traits, chosen_next = state.traits, chosen
    if task.boxes is not None:
        poses = [move_within_boxes(task.boxes, body.skeleton, pose) for pose in poses]
    every = [state.motion[n] for n in range(len(state.motion))]
    for n, pose in zip(chosen, poses, strict=True):
        every[n] = pose
    state = state._replace(body=body, motion=stack_poses(every, task.rate), chosen=chosen_next, traits=traits)
    return told(task, state, str(stage), chosen, meetings)


def spread_frames(state: AdaptState, count: int, among: int | None = None) -> tuple[int, ...]:
    """Choose `count` frames with dissimilar poses among the first `among` ones by farthest-point sampling.

    Lost frames are excluded.
    """
    there = [n for n in range(len(state.motion))[:among] if n not in state.lost] or [0]
    some = jax.tree.map(lambda leaf: leaf[np.array(there)], state.motion.poses)
    return tuple(there[n] for n in unlike_poses(state.body.skeleton, some, count))


def _as_person(people: People, state: AdaptState) -> AdaptState:
    """Replace the body by the most similar person of the shape space, in the same poses."""
    traits = traits_like(people, state.body)
    body = person(people, traits)
    # keep the world position of a root with another rest position
    shift = state.body.skeleton.centres[0] - body.skeleton.centres[0]
    poses = state.motion.poses
    poses = Pose(poses.translations.at[:, 0].add(shift), poses.rotations, poses.scale)
    return state._replace(body=body, motion=Motion(poses, state.motion.rate), traits=tuple(traits.tolist()))


def _proportions(
    task: AdaptTask, state: AdaptState, poses: list[Pose], pairs_of_all: PairsOfAll
) -> tuple[Body, list[Pose], tuple[float, ...]]:
    """Estimate proportions by shape coefficients, or without a shape space by joints that move their skin."""
    if task.people is None:
        modes, belief = joint_modes(state.body), _joints_beside(task, state)
        body, together, _ = _step(task, state, poses, pairs_of_all, modes, belief, task.mirrored)
        return body, unstack(together, len(poses)), state.traits
    standing = task.people.standing + jnp.asarray(state.traits)
    # the error of the shape space is the same in all frames, which therefore count as one
    belief = Belief(-standing, jnp.full_like(standing, len(poses) ** -0.5))
    body, together, amounts = _step(task, state, poses, pairs_of_all, task.people.modes, belief, (), SLIDING)
    traits = np.array(state.traits) + np.asarray(amounts, float)
    return body, unstack(together, len(poses)), tuple(traits.tolist())


def _surface(
    task: AdaptTask, state: AdaptState, poses: list[Pose], pairs_of_all: PairsOfAll, stage: Stage
) -> tuple[Body, list[Pose]]:
    """Adapt joints within the skin and then vertices, or both in one step."""
    modes, belief = joint_modes(state.body, follow=False), _joints_beside(task, state)
    shape, weight = shape_prior_of(task, state), shape_weight(task.settings, stage)
    if task.settings.together:
        pairs = pairs_of_all(state.body, poses)
        problem = _problem(task, state, pairs, modes, belief, task.mirrored)
        body, together = adapt_together(problem, stack(poses), pairs, shape, weight)
        return body, unstack(together, len(poses))
    body, together, _ = _step(task, state, poses, pairs_of_all, modes, belief, task.mirrored)
    poses = unstack(together, len(poses))
    return adapt_shape(body, together, pairs_of_all(body, poses), shape, weight), poses


def _step(
    task: AdaptTask,
    state: AdaptState,
    poses: list[Pose],
    pairs_of_all: PairsOfAll,
    modes: Modes,
    belief: Belief,
    mirrored: tuple[tuple[int, int], ...],
    sliding: float = 1.0,
) -> tuple[Body, Pose, Float[Array, "K"]]:
    """Take one step on poses and modes; return the body, stacked poses and the modes' coefficients.

    `sliding` is the largest weight of squared distances along the surface.
    """
    pairs = pairs_of_all(state.body, poses)
    pairs = eqx.tree_at(lambda p: p.along, pairs, jnp.minimum(pairs.along, sliding))
    return step_of(_problem(task, state, pairs, modes, belief, mirrored), stack(poses))


@eqx.filter_jit
def step_of(problem: SequenceProblem, poses: Pose) -> tuple[Body, Pose, Float[Array, "K"]]:
    """Take one Gauss-Newton step on all poses and the coefficients of modes, even if it raises the energy.

    Return the body, the poses and the coefficients.
    """
    found = take_step(problem, problem.start(poses), NormalDescent(relative=True), DAMPING)
    return problem.body_at(found.values), found.poses, found.values["modes"]


def _problem(
    task: AdaptTask, state: AdaptState, pairs, modes: Modes, belief: Belief, mirrored
) -> SequenceProblem:
    weights = (jnp.asarray(x, float) for x in (state.weight, task.settings.deviation))
    return shared_problem(state.body, pairs, task.prior, modes, belief, mirrored, *weights, terms=task.terms)


def _joints_beside(task: AdaptTask, state: AdaptState) -> Belief:
    """Make the prior of joints at their positions regressed from the surface."""
    body = state.body
    beside = regress_joints(make_joint_regressor(reference(task, state)), np.asarray(body.vertices, float))
    shifts = jnp.asarray(beside - np.asarray(body.skeleton.centres, float), body.vertices.dtype).reshape(-1)
    return Belief(shifts, jnp.full_like(shifts, task.settings.joint))


def shape_weight(settings: AdaptSettings, stage: Stage) -> float:
    """Interpolate the weight of the shape term geometrically over a pass.

    The first pass begins with the first weight; later ones begin with the geometric mean of the first and the
    last.
    """
    first, last = settings.shape
    first = first if stage.number == 1 else np.sqrt(first * last)
    share = (stage.round - 1) / max(settings.rounds[stage.number - 1] - 1, 1)
    return float(first ** (1 - share) * last**share)
