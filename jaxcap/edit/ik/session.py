"""An interactive session of inverse kinematics as a sequence of immutable values, without a window.

Every verb takes a session and returns the next one; changes of the state can be undone. A drag is one undo
step: `grab`, then `drag` for each movement of the hand, then `release`.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ...body.body import Body
from ...body.limits.limits import AbstractLimits
from ...body.people.anatomy import rest_deviations
from ...body.pose import Pose, project, rest_pose
from ...energy.energy import AbstractEnergy
from ...energy.priors.prior import RestPrior
from .constraints import Constraint, Place, Turn, check_constraints, describe, make_constraints
from .places import places_of
from .solve import SOLVERS, IkOptions, IkSolution, Solver, solve_ik

#: number of undo steps that a session keeps
HISTORY = 200


class IkSettings(NamedTuple):
    """The settings that a user switches."""

    solver: Solver = "levenberg-marquardt"
    keep_limits: bool = True
    use_prior: bool = False
    hold_root: bool = False


class IkState(NamedTuple):
    """The state that undo restores."""

    pose: Pose
    constraints: tuple[Constraint, ...] = ()
    settings: IkSettings = IkSettings()


class IkSession(NamedTuple):
    """One user's session with one body."""

    body: Body
    #: pose that a reset restores
    home: Pose
    limits: AbstractLimits | None
    prior: AbstractEnergy
    state: IkState
    past: tuple[IkState, ...] = ()
    future: tuple[IkState, ...] = ()
    #: state before the drag, during a drag
    grabbed: IkState | None = None
    #: result of the last solve
    solution: IkSolution | None = None


#: maps a session to the next one
Verb = Callable[[IkSession], IkSession]


def begin_session(
    body: Body,
    pose: Pose | None = None,
    limits: AbstractLimits | None = None,
    prior: AbstractEnergy | None = None,
    settings: IkSettings | None = None,
) -> IkSession:
    """Begin a session without constraints.

    **Arguments:** `pose` is the initial pose, rest if not given. `limits` and `prior` can be switched on and
    off. Without a prior, `RestPrior` with anatomical deviations is used, which is off at first; a given prior
    is on at first.
    """
    if settings is None:
        settings = IkSettings(use_prior=prior is not None)
    if prior is None:
        prior = RestPrior(jnp.asarray(rest_deviations(body.skeleton), body.vertices.dtype))
    pose = rest_pose(body.skeleton) if pose is None else project(body.skeleton, pose)
    return IkSession(body, pose, limits, prior, IkState(pose, (), settings))


def options_of(session: IkSession) -> IkOptions:
    """Collect the options of `solve_ik` from a session."""
    settings = session.state.settings
    return IkOptions(
        solver=settings.solver,
        limits=session.limits,
        prior=session.prior,
        keep_limits=settings.keep_limits,
        use_prior=settings.use_prior,
        hold_root=settings.hold_root,
    )


def constraint_at(session: IkSession, point: int | str) -> Constraint:
    """Find the constraint on a point. Raises `ValueError` if there is none."""
    for constraint in session.state.constraints:
        if constraint.point == point:
            return constraint
    raise ValueError(f"There is no constraint on {describe(point)}; add one first.")


def place_of(session: IkSession, point: int | str) -> Place:
    """Compute the current position of a vertex or a joint, metres. Raises `ValueError` if the body does not
    have it."""
    probe = (Constraint(point, (0.0, 0.0, 0.0)),)
    return places_of(session.body, session.state.pose, probe)[0]


def add_constraint(
    session: IkSession, point: int | str, weight: float = 1.0, pinned: bool = False
) -> IkSession:
    """Constrain a point to its current position; an existing constraint stays as it is.

    **Raises:** `ValueError` if the body does not have the point.
    """
    if any(constraint.point == point for constraint in session.state.constraints):
        return session
    added = Constraint(point, place_of(session, point), weight, pinned)
    return _set_constraints(session, (*session.state.constraints, added))


def remove_constraint(session: IkSession, point: int | str) -> IkSession:
    """Remove the constraint on a point; the pose stays. Raises `ValueError` if there is none."""
    gone = constraint_at(session, point)
    kept = tuple(constraint for constraint in session.state.constraints if constraint != gone)
    return _set_constraints(session, kept)


def remove_all(session: IkSession) -> IkSession:
    """Remove all constraints; the pose stays."""
    return _set_constraints(session, ()) if session.state.constraints else session


def grab(session: IkSession) -> IkSession:
    """Begin a drag: until `release`, all changes are one undo step, and the current pose is the reference
    pose."""
    return session if session.grabbed is not None else session._replace(grabbed=session.state)


def drag(
    session: IkSession, point: int | str, target: Place | None = None, orientation: Turn | None = None
) -> IkSession:
    """Move the target of a constraint, set its orientation, or both, and solve.

    Without `grab`, it does nothing. The same holds after `undo` or another step has ended the drag.

    **Raises:** `ValueError` if there is no such constraint.
    """
    if session.grabbed is None:
        return session
    constraint = constraint_at(session, point)
    if target is not None:
        constraint = constraint._replace(target=target)
    if orientation is not None:
        constraint = constraint._replace(orientation=orientation)
    return solved(session._replace(state=_with(session.state, constraint)))


def release(session: IkSession) -> IkSession:
    """End a drag."""
    begun = session.grabbed
    session = session._replace(grabbed=None)
    if begun is None or begun is session.state:
        return session
    return session._replace(past=(*session.past, begun)[-HISTORY:], future=())


def move_constraint(
    session: IkSession, point: int | str, target: Place | None = None, orientation: Turn | None = None
) -> IkSession:
    """Move a target in one step: `grab`, `drag`, `release`."""
    return release(drag(grab(session), point, target, orientation))


def free_orientation(session: IkSession, point: str) -> IkSession:
    """Remove the orientation from the constraint on a joint."""
    return _edited(session, _with(session.state, constraint_at(session, point)._replace(orientation=None)))


def pin(session: IkSession, point: int | str, pinned: bool = True) -> IkSession:
    """Pin a point at its current position, or unpin it; pinned points have precedence over the others."""
    target = place_of(session, point) if pinned else constraint_at(session, point).target
    changed = constraint_at(session, point)._replace(pinned=pinned, target=target)
    return _edited(session, _with(session.state, changed))


def weigh(session: IkSession, point: int | str, weight: float) -> IkSession:
    """Set the weight of a constraint, and solve. Raises `ValueError` if it is negative."""
    changed = _with(session.state, constraint_at(session, point)._replace(weight=weight))
    check_constraints(changed.constraints, session.body.skeleton, len(session.body.vertices))
    return solved(_edited(session, changed))


def change_settings(session: IkSession, settings: IkSettings) -> IkSession:
    """Switch limits, prior, root or solver, and solve. Raises `ValueError` for an unknown solver."""
    if settings.solver not in SOLVERS:
        raise ValueError(f"The solver '{settings.solver}' is unknown; give one of {', '.join(SOLVERS)}.")
    if settings == session.state.settings:
        return session
    return solved(_edited(session, session.state._replace(settings=settings)))


def reset_pose(session: IkSession) -> IkSession:
    """Restore the initial pose; constraints keep their points, with targets at the positions in that pose."""
    return set_pose(session, session.home)


def set_pose(session: IkSession, pose: Pose) -> IkSession:
    """Set another pose; constraints keep their points, with targets at the positions in that pose."""
    pose, held = project(session.body.skeleton, pose), session.state.constraints
    places = places_of(session.body, pose, held)
    moved = tuple(one._replace(target=place) for one, place in zip(held, places, strict=True))
    return _edited(session, session.state._replace(pose=pose, constraints=moved))


def set_constraints(session: IkSession, constraints: Sequence[Constraint]) -> IkSession:
    """Replace all constraints, and solve for the pose.

    **Raises:** `ValueError` as `make_constraints` does.
    """
    check_constraints(constraints, session.body.skeleton, len(session.body.vertices))
    return solved(_set_constraints(session, tuple(constraints)))


def undo(session: IkSession) -> IkSession:
    """Restore the state before the last step, and cancel a drag. The session is unchanged if there is no such
    state."""
    if session.grabbed is not None:
        return session._replace(state=session.grabbed, grabbed=None, solution=None)
    if not session.past:
        return session
    *past, before = session.past
    future = (session.state, *session.future)
    return session._replace(state=before, past=tuple(past), future=future, solution=None)


def redo(session: IkSession) -> IkSession:
    """Restore the state that `undo` left. The session is unchanged if there is none."""
    if not session.future or session.grabbed is not None:
        return session
    after, *future = session.future
    past = (*session.past, session.state)
    return session._replace(state=after, past=past, future=tuple(future), solution=None)


def solved(session: IkSession) -> IkSession:
    """Solve for the current constraints from the current pose.

    During a drag, the reference is the pose in which it began. A solve adds no undo step; the change before
    it does. If the result is not finite, the pose stays unchanged.
    """
    state, begun = session.state, session.grabbed
    arrays = make_constraints(session.body, state.constraints)
    reference = state.pose if begun is None else begun.pose
    solution = solve_ik(session.body, state.pose, arrays, options_of(session), reference)
    if not bool(jnp.isfinite(solution.pose.rotations).all() & jnp.isfinite(solution.pose.translations).all()):
        return session._replace(solution=solution)
    return session._replace(state=state._replace(pose=solution.pose), solution=solution)


def distances(session: IkSession) -> tuple[float, ...]:
    """Compute the distance of every constrained point from its target in the current pose, metres."""
    held = session.state.constraints
    places = places_of(session.body, session.state.pose, held)
    return tuple(
        float(np.linalg.norm(np.subtract(place, one.target))) for place, one in zip(places, held, strict=True)
    )


def _set_constraints(session: IkSession, constraints: tuple[Constraint, ...]) -> IkSession:
    return _edited(session, session.state._replace(constraints=constraints))


def _with(state: IkState, changed: Constraint) -> IkState:
    """Replace the constraint on a point in a state."""
    held = tuple(changed if one.point == changed.point else one for one in state.constraints)
    return state._replace(constraints=held)


def _edited(session: IkSession, state: IkState) -> IkSession:
    """Add a state as a new undo step; a current drag ends before it, as a step of its own."""
    session = release(session)
    past = (*session.past, session.state)[-HISTORY:]
    return session._replace(state=state, past=past, future=(), solution=None)
