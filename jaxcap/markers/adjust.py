"""All poses, joint centres and places of markers at once: a bundle adjustment.

Levenberg-Marquardt on block-arrow normal equations, with weights that leave out what is far off and
variances of the markers that come from the data. These, the axes about which joints turn at all, and
how skin slides are renewed whenever the fit has got as good as they let it.
"""

import logging
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..body.pose import Pose, retract
from .eliminate import eliminate, pose_covariances, pose_steps
from .equations import Rows, all_rows, marker_deviations
from .robust import BOUND, MEDIAN, UNBOUNDED
from .shared import Trust, constraint_rows, prior_precision, shared_between, shift_subject
from .skin import Skin, find_skin, renewed, sliding, still
from .subject import Subject
from .turning import Drawn, Turning, drawn, free_turning, turning_of

_LOG = logging.getLogger(__name__)

#: below this no residual is believed, metres
EXACT = 2e-5
#: Marquardt's damping of the first step
FIRST_DAMPING = 1e-3
#: the share of what was expected of a step that shows that there is no valley
STRAIGHT = 0.95
#: from which renewal of variances on these are those of the noise, and no longer of the template
FIRM = 4
#: and after which the fit may end
SETTLED = 5
#: the share of the cost that may be left to gain, before and after the first renewals
ROUGH, TOLERANCE = 1e-2, 1e-4


class Problem(NamedTuple):
    """What was seen in the chosen frames, and what is asked of it."""

    template: Subject
    places: Float[Array, "F M 3"]
    seen: Bool[Array, "F M"]
    #: whose centres are solved for
    joints: tuple[int, ...]
    #: whose bones are equally long
    pairs: tuple[tuple[int, int], ...]
    trust: Trust
    robust: bool
    #: whether it may slide
    skin: bool
    #: at most
    steps: int


class State(NamedTuple):
    """All that is unknown."""

    subject: Subject
    poses: Pose
    skin: Skin


class Terms(NamedTuple):
    """What is renewed between steps: how far markers may be off, and which axes joints turn about."""

    deviations: Float[Array, "M"]
    turning: Turning
    #: of what is shared, about the template; not renewed
    prior: Float[np.ndarray, "S S"]


class Value(NamedTuple):
    """A state's residuals with derivatives, how far what is shared is from the template, and the cost."""

    rows: Rows
    prior: tuple[Float[np.ndarray, "T T"], Float[np.ndarray, "T"]]
    held: Drawn
    cost: float


class Fit(NamedTuple):
    """Where the steps ended."""

    state: State
    terms: Terms
    history: tuple[float, ...]
    converged: bool


def adjust(problem: Problem, subject: Subject, poses: Pose) -> Fit:
    """Steps at fixed variances until little is left to gain, then new variances, until these stay."""
    prior = prior_precision(problem.template, problem.joints, problem.trust)
    deviations = _first_deviations(problem, subject, poses)
    terms = Terms(deviations, free_turning(subject.skeleton), prior)
    state = State(subject, poses, still(poses, subject))
    value, history, settled, damping = evaluate(problem, terms, state), [], 0, FIRST_DAMPING
    history.append(value.cost)
    for renewal in range(1, problem.steps):
        # the first variances are those of the template's errors and only lead to better ones
        enough = TOLERANCE if renewal > 2 else ROUGH
        state, value, damping = descend(problem, terms, state, value, damping, enough, history)
        damping = min(damping, FIRST_DAMPING)
        if len(history) > problem.steps:
            break
        old, (terms, state, slid) = terms, _renewed(problem, terms, state, value, renewal)
        change = float(jnp.max(jnp.abs(terms.deviations / old.deviations - 1.0)))
        settled = settled + 1 if change < 0.05 and not slid else 0
        if settled and renewal > SETTLED:
            return Fit(state, terms, tuple(history), True)
        value = evaluate(problem, terms, state)
        history.append(value.cost)
    return Fit(state, terms, tuple(history), False)


def evaluate(problem: Problem, terms: Terms, state: State) -> Value:
    """Residuals, priors and the cost."""
    rows = _rows(problem, terms, state)
    held = drawn(state.subject.skeleton, terms.turning, state.poses)
    away = np.asarray(shared_between(problem.template, state.subject, problem.joints), float)
    matrix, away = state.skin.widened(terms.prior, away)
    return Value(rows, (matrix, away), held, float(rows.cost) + float(away @ matrix @ away) + held.cost)


def descend(
    problem: Problem,
    terms: Terms,
    state: State,
    value: Value,
    damping: float,
    enough: float,
    history: list[float],
) -> tuple[State, Value, float]:
    """Damped steps until a share `enough` of the cost is left to gain, or no step gains anything; every
    one that does adds to `history`."""
    growth, reduced = 4.0, None
    dtype = problem.places.dtype
    while damping <= 1e4 and len(history) <= problem.steps:
        if reduced is None:
            reduced = eliminate(value.rows, value.held, state.skin.features).with_prior(*value.prior)
            constraints, violation = constraint_rows(state.subject, problem.joints, problem.pairs)
            constraints = np.pad(constraints, ((0, 0), (0, state.skin.slides.size)))
            # what could be gained in all: a damped step gains little along flat valleys
            left = reduced.decrease(reduced.step(0.0, constraints, violation)[0])
        _LOG.info("fitting all frames together, step %d of at most %d", len(history), problem.steps)
        shared, by_frame = reduced.step(damping, constraints, violation)
        trial = _moved(state, problem.joints, shared, by_frame)
        # poses follow once more for themselves: valleys are curved, and steps along them longer
        after = evaluate(problem, terms, trial)
        if value.cost - after.cost < STRAIGHT * reduced.decrease(shared):
            nearer = trial._replace(
                poses=_posed(trial, jnp.asarray(pose_steps(after.rows, after.held), dtype))
            )
            closer = evaluate(problem, terms, nearer)
            trial, after = (nearer, closer) if closer.cost < after.cost else (trial, after)
        gained = value.cost - after.cost
        if gained >= 0:
            gain = gained / max(reduced.decrease(shared), 1e-12)
            state, value, reduced, growth = trial, after, None, 4.0
            # Nielsen's rule (1999): less damping the better the problem is linear
            damping *= max(0.1, 1.0 - (2.0 * min(gain, 1.0) - 1.0) ** 3)
            damping = damping if damping > 1e-9 else 0.0
            history.append(after.cost)
        else:
            gained, damping, growth = np.inf, growth * max(damping, 1e-6), 2.0 * growth
        if min(left, 3 * gained) < enough * value.cost:
            break
    return state, value, damping


def _rows(problem: Problem, terms: Terms, state: State) -> Rows:
    dtype = problem.places.dtype
    shifts, bound = jnp.asarray(state.skin.shifts(), dtype), _bound(problem)
    return all_rows(
        state.subject,
        state.poses,
        problem.places,
        problem.seen,
        terms.deviations,
        problem.joints,
        bound,
        shifts,
    )


def _bound(problem: Problem) -> Float[Array, ""]:
    return jnp.asarray(BOUND if problem.robust else UNBOUNDED, problem.places.dtype)


def _renewed(
    problem: Problem, terms: Terms, state: State, value: Value, renewal: int
) -> tuple[Terms, State, bool]:
    """Variances, stiff axes and skin as the state shows them, and whether skin has changed."""
    dtype = problem.places.dtype
    deviations = marker_deviations(
        state.subject,
        state.poses,
        problem.places,
        problem.seen,
        terms.deviations,
        jnp.asarray(EXACT, dtype),
        _bound(problem),
        jnp.asarray(state.skin.shifts(), dtype),
        jnp.asarray(value.held.matrix, dtype),
    )
    if renewal < 3:
        # one for all, so that no marker is let go for what its bone's length still lacks
        deviations = jnp.full_like(deviations, jnp.median(deviations))
    terms = terms._replace(deviations=deviations)
    if state.skin.slides.size:
        after = renewed(state.skin, state.subject)
        changed = abs(after.deviation / state.skin.deviation - 1.0) > 0.1
        return terms, state._replace(skin=after), changed
    rows = _rows(problem, terms, state)
    found = _look_for_skin(problem, state, rows, deviations) if problem.skin and renewal == FIRM else None
    if found is not None:
        return terms, state._replace(skin=found), True
    skeleton = state.subject.skeleton
    none = drawn(skeleton, free_turning(skeleton), state.poses)
    free = _posed(state, jnp.asarray(pose_steps(rows, none), dtype))
    turning = turning_of(skeleton, free, pose_covariances(rows, none))
    return terms._replace(turning=turning), state, False


def _look_for_skin(problem: Problem, state: State, rows: Rows, deviations) -> Skin | None:
    scale = np.asarray(deviations) / np.sqrt(np.maximum(np.asarray(state.subject.weights), 1e-9))
    residuals = np.asarray(rows.residual, float) * scale[:, None]
    return find_skin(sliding(state.subject, state.poses), residuals, np.asarray(problem.seen))


def _first_deviations(problem: Problem, subject: Subject, poses: Pose) -> Float[Array, "M"]:
    """One for all markers, by the median of what the template leaves."""
    ones = jnp.ones(subject.num_markers, problem.places.dtype)
    terms = Terms(ones, free_turning(subject.skeleton), np.zeros((0, 0)))
    rows = _rows(problem._replace(joints=()), terms, State(subject, poses, still(poses, subject)))
    middle = np.median(np.asarray(rows.squared)[np.asarray(problem.seen)])
    return max(float(np.sqrt(middle / MEDIAN)), EXACT) * ones


def _moved(
    state: State, joints: tuple[int, ...], shared: Float[np.ndarray, "T"], by_frame: Float[np.ndarray, "F D"]
) -> State:
    count, dtype = len(shared) - state.skin.slides.size, state.subject.offsets.dtype
    moved = shift_subject(state.subject, joints, jnp.asarray(shared[:count], dtype))
    poses = _posed(state._replace(subject=moved), jnp.asarray(by_frame, dtype))
    return State(moved, poses, state.skin.moved(shared[count:]))


def _posed(state: State, by_frame: Float[Array, "F D"]) -> Pose:
    return _retracted(state.subject, state.poses, by_frame)


@eqx.filter_jit
def _retracted(subject: Subject, poses: Pose, by_frame: Float[Array, "F D"]) -> Pose:
    return jax.vmap(retract, (None, 0, 0))(subject.skeleton, poses, by_frame)
