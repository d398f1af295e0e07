"""A subject from frames: all poses, joint centres and marker places together (the global technique).

Levenberg-Marquardt on block-arrow normal equations, with weights that leave out what is far off and
variances of the markers that come from the data, both renewed as the fit gets better.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..body.pose import Motion, Pose, retract
from ..body.symmetry import bones_of, length_differences
from ..observe import MarkerFrames
from .choose import choose_frames
from .eliminate import eliminate, pose_covariances, pose_steps
from .equations import all_rows, marker_deviations
from .gauge import gauge_rows
from .matched import match_markers
from .null_space import describe_precision, shared_covariance
from .robust import BOUND, MEDIAN, UNBOUNDED
from .shared import Trust, followers, prior_precision, shared_between, shift_subject, solved_joints
from .solve import solve_markers
from .subject import Subject
from .turning import Turning, drawn, free_turning, turning_of

#: below this no residual is believed, metres
EXACT = 2e-5


class Calibration(NamedTuple):
    """A calibrated subject, its motion through all frames, and how well it is known.

    Markers are in the subject's order; `s` are the shared unknowns of `jaxcap.markers.shared`.
    """

    subject: Subject
    motion: Motion
    #: metres, NaN where not seen
    residuals: Float[np.ndarray, "F M"]
    #: of `s`, metres squared, with what the template was trusted
    covariance: Float[np.ndarray, "S S"]
    #: what the data do not tell, or hardly, in sentences
    told: tuple[str, ...]
    #: robust cost after every step, in squared standard deviations; a rise marks new variances
    history: tuple[float, ...]
    #: the joints whose centres were solved for, in the order of `s`
    joints: tuple[int, ...]
    #: the frames that the subject was made of
    frames: Float[np.ndarray, "C"]
    converged: bool


class _Fit(NamedTuple):
    subject: Subject
    poses: Pose
    deviations: Float[Array, "M"]
    turning: Turning
    history: tuple[float, ...]
    converged: bool


def calibrate(
    frames: MarkerFrames,
    subject: Subject,
    motion: Motion | None = None,
    *,
    robust: bool = True,
    symmetry: Sequence[tuple[str, str]] = (),
    count: int = 100,
    trust: Trust = Trust(),  # noqa: B008
    steps: int = 80,
) -> Calibration:
    """The performer's skeleton and the places of the markers on it, from a template.

    **Arguments:** `frames` with the template's labels in any order; `subject`, the template, whose
    bones may be a tenth too long or short and whose markers centimetres off; `motion` of the template
    through the frames, solved for where not given; `robust`: what is far off counts little;
    `symmetry`, pairs of names of joints whose bones are equally long, kept exactly; `count` frames are
    chosen, as different as can be, and all are solved in the end; `trust` in the template, which
    decides what the frames do not tell; `steps` at most.

    **Raises:** `ValueError` where frames and template share no label, fewer than three markers are ever
    seen, or a name in `symmetry` is not a joint's.
    """
    matched = match_markers(subject, frames)
    used = np.asarray(matched.seen) & (np.asarray(subject.weights) > 0)
    if used.any(0).sum() < 3:
        raise ValueError(
            f"Only {int(used.any(0).sum())} markers are ever seen; a body takes three at the least, and several a bone."
        )
    pairs = _pairs(subject, symmetry)
    if motion is None:
        start = solve_markers(subject, frames)
        motion, usable = start.motion, ~start.lost
    else:
        usable = used.sum(1) >= 3
    chosen = choose_frames(subject, motion.poses, used, usable, count)
    joints = solved_joints(subject, np.asarray(used[chosen].any(0)))
    poses = jax.tree.map(lambda leaf: leaf[chosen], motion.poses)
    places, seen = matched.places[chosen], jnp.asarray(used[chosen])
    fit = _fit(subject, poses, places, seen, joints, pairs, trust, robust, steps)
    best = eqx.tree_at(lambda s: s.deviations, fit.subject, fit.deviations)
    known = shared_covariance(best, fit.poses, places, seen, joints, trust, pairs, fit.turning)
    solved = solve_markers(best, frames)
    told = tuple(describe_precision(best, known, fit.poses, joints)) + solved.told
    if not fit.converged:
        told += (f"The fit had not converged after {steps} steps; allow more.",)
    return Calibration(
        best,
        solved.motion,
        solved.residuals,
        known.covariance,
        told,
        fit.history,
        joints,
        chosen,
        fit.converged,
    )


def _fit(template: Subject, poses, places, seen, joints, pairs, trust, robust, steps) -> _Fit:
    """Steps at fixed variances until what is left is small beside what is not known anyway, then new
    variances, until these stay."""
    dtype, skeleton = places.dtype, template.skeleton
    precision = prior_precision(template, joints, trust)
    subject, floor = template, jnp.asarray(EXACT, dtype)
    bound = jnp.asarray(BOUND if robust else UNBOUNDED, dtype)
    deviations = _first_deviations(subject, poses, places, seen, bound)
    damping, growth, history, renewed, settled = 1e-3, 4.0, [], 0, 0

    turning = free_turning(skeleton)

    def evaluate(subject, poses):
        held = drawn(subject.skeleton, turning, poses)
        rows = all_rows(subject, poses, places, seen, deviations, joints, bound)
        away = np.asarray(shared_between(template, subject, joints), float)
        return rows, away, float(rows.cost) + float(away @ precision @ away) + held.cost, held

    state = evaluate(subject, poses)
    history.append(state[2])
    reduced = None
    for _ in range(steps):
        rows, away, value, held = state
        if reduced is None:
            reduced = eliminate(rows, held).with_prior(precision, away)
        constraints, violation = constraint_rows(subject, joints, pairs)
        shared, by_frame = reduced.step(damping, constraints, violation)
        trial = _moved(subject, poses, joints, jnp.asarray(shared, dtype), jnp.asarray(by_frame, dtype))
        # poses follow once more for themselves: valleys are curved, and steps along them longer
        after = evaluate(*trial)
        nearer = _posed(*trial, jnp.asarray(pose_steps(after[0], after[3]), dtype))
        closer = evaluate(trial[0], nearer)
        trial, after = ((trial[0], nearer), closer) if closer[2] < after[2] else (trial, after)
        expected = reduced.decrease(shared)
        if after[2] <= value:
            gain = (value - after[2]) / max(expected, 1e-12)
            (subject, poses), state, reduced, growth = trial, after, None, 4.0
            # Nielsen's rule (1999): less damping the better the problem is linear
            damping *= max(0.1, 1.0 - (2.0 * min(gain, 1.0) - 1.0) ** 3)
            damping = damping if damping > 1e-9 else 0.0
            history.append(after[2])
        else:
            damping, growth = growth * max(damping, 1e-6), 2.0 * growth
        # the first variances are those of the template's errors and only lead to better ones
        done = expected < (1.0 if renewed > 1 else 1e-2 * value)
        if done or damping > 1e4:
            renewed += 1
            old, damping = deviations, min(damping, 1e-3)
            deviations = marker_deviations(subject, poses, places, seen, deviations, floor, bound)
            if renewed < 3:
                # one for all, so that no marker is let go for what its bone's length still lacks
                deviations = jnp.full_like(deviations, jnp.median(deviations))
            else:
                # by now variances are those of the noise, and no longer of the template
                rows = all_rows(subject, poses, places, seen, deviations, joints, bound)
                uncertain = pose_covariances(rows, state[3])
                turning = turning_of(skeleton, turning, poses, uncertain)
            settled = settled + 1 if float(jnp.max(jnp.abs(deviations / old - 1.0))) < 0.05 else 0
            if settled and renewed > 5:
                return _Fit(subject, poses, deviations, turning, tuple(history), True)
            state, reduced = evaluate(subject, poses), None
            history.append(state[2])
    return _Fit(subject, poses, deviations, turning, tuple(history), False)


def _first_deviations(subject: Subject, poses, places, seen, bound) -> Float[Array, "M"]:
    """One for all markers, by the median of what the template leaves."""
    ones = jnp.ones(subject.num_markers, places.dtype)
    squared = np.asarray(all_rows(subject, poses, places, seen, ones, (), bound).squared)
    middle = np.median(squared[np.asarray(seen)])
    return max(float(np.sqrt(middle / MEDIAN)), EXACT) * ones


@eqx.filter_jit
def _moved(subject: Subject, poses: Pose, joints, shared, by_frame) -> tuple[Subject, Pose]:
    return shift_subject(subject, joints, shared), _posed(subject, poses, by_frame)


@eqx.filter_jit
def _posed(subject: Subject, poses: Pose, by_frame) -> Pose:
    return jax.vmap(retract, (None, 0, 0))(subject.skeleton, poses, by_frame)


def constraint_rows(
    subject: Subject, joints: tuple[int, ...], pairs: tuple[tuple[int, int], ...]
) -> tuple[Float[np.ndarray, "B S"], Float[np.ndarray, "B"]]:
    """Rows over `s` and what they have to make up for: paired bones stay equally long, and no bone
    turns at rest as no marker could tell, which would only send the search along curved valleys."""
    still = gauge_rows(subject, joints)
    if not pairs:
        return still, np.zeros(len(still))
    differences, slopes = length_differences(subject.skeleton, np.array(pairs, int))
    by_centre = np.einsum("bja,jk->bka", np.asarray(slopes, float), followers(subject.skeleton, joints))
    rows = np.pad(by_centre.reshape(len(slopes), -1), ((0, 0), (0, 3 * subject.num_markers)))
    return np.vstack([rows, still]), np.append(-np.asarray(differences, float), np.zeros(len(still)))


def _pairs(subject: Subject, symmetry: Sequence[tuple[str, str]]) -> tuple[tuple[int, int], ...]:
    """The pairs that end bones of which both ends are told apart by motion."""
    skeleton = subject.skeleton
    for name in (name for pair in symmetry for name in pair):
        if name not in skeleton.names:
            raise ValueError(
                f"There is no joint '{name}' to be symmetrical; the skeleton has {', '.join(skeleton.names)}."
            )
    pairs = [(skeleton.index(left), skeleton.index(right)) for left, right in symmetry]
    kept = bones_of(skeleton, np.array(pairs, int).reshape(-1, 2))
    # nothing tells where along its line the centre of a joint lies that does not turn
    stiff = np.isin(np.array(skeleton.kinds), ["fixed", "translate"])
    ends = np.array([stiff[j] or stiff[skeleton.parents[j]] for j in range(skeleton.num_joints)])
    return tuple((int(a), int(b)) for a, b in kept if not ends[a] and not ends[b])
