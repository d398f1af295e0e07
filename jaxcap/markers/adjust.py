"""All poses, joint centres and places of markers at once: a bundle adjustment.

Levenberg-Marquardt on block-arrow normal equations, with weights that leave out what is far off and
variances of the markers that come from the data. These, the axes about which joints turn at all, and
how skin slides are renewed whenever the fit has got as good as they let it.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..body.pose import Pose, retract
from ..body.symmetry import length_differences
from .eliminate import eliminate, pose_covariances, pose_steps
from .equations import Rows, all_rows, marker_deviations
from .robust import BOUND, MEDIAN, UNBOUNDED
from .shared import Trust, followers, prior_precision, shared_between, shift_subject
from .skin import Skin, find_skin, renewed, sliding, still
from .subject import Subject
from .turning import Drawn, Turning, drawn, free_turning, turning_of

#: below this no residual is believed, metres
EXACT = 2e-5
#: from which renewal of variances on these are those of the noise, and no longer of the template
FIRM = 4
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


class _Value(NamedTuple):
    """A state's residuals with derivatives, how far what is shared is from the template, and the cost."""

    rows: Rows
    prior: tuple[Float[np.ndarray, "T T"], Float[np.ndarray, "T"]]
    held: Drawn
    cost: float


class Fit(NamedTuple):
    """Where the steps ended."""

    state: State
    deviations: Float[Array, "M"]
    turning: Turning
    history: tuple[float, ...]
    converged: bool


def adjust(problem: Problem, subject: Subject, poses: Pose) -> Fit:
    """Steps at fixed variances until little is left to gain, then new variances, until these stay."""
    template, places, seen, joints, pairs, trust, robust, skin, steps = problem
    dtype, skeleton = places.dtype, template.skeleton
    precision = prior_precision(template, joints, trust)
    floor = jnp.asarray(EXACT, dtype)
    bound = jnp.asarray(BOUND if robust else UNBOUNDED, dtype)
    deviations = _first_deviations(subject, poses, places, seen, bound)
    damping, growth, history, renewals, settled = 1e-3, 4.0, [], 0, 0
    turning = free_turning(skeleton)

    def rows_of(state: State) -> Rows:
        shifts = jnp.asarray(state.skin.shifts(), dtype)
        return all_rows(state.subject, state.poses, places, seen, deviations, joints, bound, shifts)

    def evaluate(state: State) -> _Value:
        rows, held = rows_of(state), drawn(skeleton, turning, state.poses)
        away = np.asarray(shared_between(template, state.subject, joints), float)
        prior = state.skin.widened(precision, away)
        return _Value(rows, prior, held, float(rows.cost) + float(prior[1] @ prior[0] @ prior[1]) + held.cost)

    state = State(subject, poses, still(poses, subject))
    value, reduced = evaluate(state), None
    history.append(value.cost)
    for _ in range(steps):
        if reduced is None:
            reduced = eliminate(value.rows, value.held, state.skin.features).with_prior(*value.prior)
            constraints, violation = constraint_rows(state.subject, joints, pairs)
            constraints = np.pad(constraints, ((0, 0), (0, state.skin.slides.size)))
            # what could be gained in all: a damped step gains little along flat valleys
            left = reduced.decrease(reduced.step(0.0, constraints, violation)[0])
        shared, by_frame = reduced.step(damping, constraints, violation)
        trial = _moved(state, joints, shared, by_frame)
        # poses follow once more for themselves: valleys are curved, and steps along them longer
        after = evaluate(trial)
        nearer = trial._replace(poses=_posed(trial, jnp.asarray(pose_steps(after.rows, after.held), dtype)))
        closer = evaluate(nearer)
        trial, after = (nearer, closer) if closer.cost < after.cost else (trial, after)
        expected = reduced.decrease(shared)
        if after.cost <= value.cost:
            gain = (value.cost - after.cost) / max(expected, 1e-12)
            gained = value.cost - after.cost
            state, value, reduced, growth = trial, after, None, 4.0
            # Nielsen's rule (1999): less damping the better the problem is linear
            damping *= max(0.1, 1.0 - (2.0 * min(gain, 1.0) - 1.0) ** 3)
            damping = damping if damping > 1e-9 else 0.0
            history.append(after.cost)
        else:
            gained, damping, growth = np.inf, growth * max(damping, 1e-6), 2.0 * growth
        # the first variances are those of the template's errors and only lead to better ones
        done = min(left, 3 * gained) < (TOLERANCE if renewals > 1 else ROUGH) * value.cost
        if done or damping > 1e4:
            renewals += 1
            old, damping = deviations, min(damping, 1e-3)
            shifts = jnp.asarray(state.skin.shifts(), dtype)
            deviations = marker_deviations(
                state.subject,
                state.poses,
                places,
                seen,
                deviations,
                floor,
                bound,
                shifts,
                jnp.asarray(value.held.matrix, dtype),
            )
            if renewals < 3:
                # one for all, so that no marker is let go for what its bone's length still lacks
                deviations = jnp.full_like(deviations, jnp.median(deviations))
            rows, slid = rows_of(state), False
            if skin and renewals >= FIRM:
                state, slid = _slid(problem, state, rows, deviations, first=renewals == FIRM)
                settled = 0 if slid else settled
            if not state.skin.slides.size:
                none = drawn(skeleton, free_turning(skeleton), state.poses)
                free = _posed(state, jnp.asarray(pose_steps(rows, none), dtype))
                turning = turning_of(skeleton, free, pose_covariances(rows, none))
            settled = settled + 1 if float(jnp.max(jnp.abs(deviations / old - 1.0))) < 0.05 else 0
            if settled and renewals > 5:
                return Fit(state, deviations, turning, tuple(history), True)
            value, reduced = evaluate(state), None
            history.append(value.cost)
    return Fit(state, deviations, turning, tuple(history), False)


def _slid(problem: Problem, state: State, rows: Rows, deviations, first: bool) -> tuple[State, bool]:
    """The state with skin as its residuals have it, looked for at `first`, and whether that has changed."""
    subject, poses, skin = state
    if first:
        scale = np.asarray(deviations) / np.sqrt(np.maximum(np.asarray(subject.weights), 1e-9))
        residuals = np.asarray(rows.residual, float) * scale[:, None]
        found = find_skin(sliding(subject, poses), residuals, np.asarray(problem.seen))
        return (state, False) if found is None else (state._replace(skin=found), True)
    if not skin.slides.size:
        return state, False
    after = renewed(skin, subject)
    return state._replace(skin=after), abs(after.deviation / skin.deviation - 1.0) > 0.1


def _first_deviations(subject: Subject, poses, places, seen, bound) -> Float[Array, "M"]:
    """One for all markers, by the median of what the template leaves."""
    ones = jnp.ones(subject.num_markers, places.dtype)
    none = jnp.zeros_like(places)
    squared = np.asarray(all_rows(subject, poses, places, seen, ones, (), bound, none).squared)
    middle = np.median(squared[np.asarray(seen)])
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


def constraint_rows(
    subject: Subject, joints: tuple[int, ...], pairs: tuple[tuple[int, int], ...]
) -> tuple[Float[np.ndarray, "B S"], Float[np.ndarray, "B"]]:
    """Rows over `s` and what they have to make up for: paired bones stay equally long."""
    size = 3 * (len(joints) + subject.num_markers)
    if not pairs:
        return np.zeros((0, size)), np.zeros(0)
    differences, slopes = length_differences(subject.skeleton, np.array(pairs, int))
    by_centre = np.einsum("bja,jk->bka", np.asarray(slopes, float), followers(subject.skeleton, joints))
    rows = np.pad(by_centre.reshape(len(slopes), -1), ((0, 0), (0, 3 * subject.num_markers)))
    return rows, -np.asarray(differences, float)
