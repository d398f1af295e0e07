"""What a user does with constraints, one value after the other: no window is needed, and nothing is changed in place.

Every verb takes a session and gives the next one; what changes the state can be undone. A drag is one step:
`grab`, `drag` as often as the hand moves, `release`.
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

#: how many steps back a session remembers
HISTORY = 200


class IkSettings(NamedTuple):
    """What a user switches."""

    solver: Solver = "levenberg-marquardt"
    keep_limits: bool = True
    use_prior: bool = False
    hold_root: bool = False


class IkState(NamedTuple):
    """What undoing brings back."""

    pose: Pose
    constraints: tuple[Constraint, ...] = ()
    settings: IkSettings = IkSettings()


class IkSession(NamedTuple):
    """One user's work on one body."""

    body: Body
    #: the pose that a reset goes back to
    home: Pose
    limits: AbstractLimits | None
    prior: AbstractEnergy
    state: IkState
    past: tuple[IkState, ...] = ()
    future: tuple[IkState, ...] = ()
    #: the state in which a drag began, while it lasts
    grabbed: IkState | None = None
    #: of the last solve
    solution: IkSolution | None = None


#: what leads from one session to the next
Verb = Callable[[IkSession], IkSession]


def begin_session(
    body: Body,
    pose: Pose | None = None,
    limits: AbstractLimits | None = None,
    prior: AbstractEnergy | None = None,
    settings: IkSettings | None = None,
) -> IkSession:
    """A session without constraints.

    **Arguments:** `pose` to begin with, rest where not given; `limits` and `prior` that can be switched on and off:
    without a prior, poses near rest are likely (`RestPrior`, by the anatomy), which is off at first, and a
    prior that is given is on.
    """
    if settings is None:
        settings = IkSettings(use_prior=prior is not None)
    if prior is None:
        prior = RestPrior(jnp.asarray(rest_deviations(body.skeleton), body.vertices.dtype))
    pose = rest_pose(body.skeleton) if pose is None else project(body.skeleton, pose)
    return IkSession(body, pose, limits, prior, IkState(pose, (), settings))


def options_of(session: IkSession) -> IkOptions:
    """What `solve_ik` takes of a session."""
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
    """The constraint on a point. Raises `ValueError` where there is none."""
    for constraint in session.state.constraints:
        if constraint.point == point:
            return constraint
    raise ValueError(f"There is no constraint on {describe(point)}; add one first.")


def place_of(session: IkSession, point: int | str) -> Place:
    """Where a vertex or a joint is now, metres. Raises `ValueError` where the body does not have it."""
    probe = (Constraint(point, (0.0, 0.0, 0.0)),)
    return places_of(session.body, session.state.pose, probe)[0]


def add_constraint(
    session: IkSession, point: int | str, weight: float = 1.0, pinned: bool = False
) -> IkSession:
    """Hold a point where it is; one that is held already stays as it is.

    **Raises:** `ValueError` where the body does not have the point.
    """
    if any(constraint.point == point for constraint in session.state.constraints):
        return session
    added = Constraint(point, place_of(session, point), weight, pinned)
    return _set_constraints(session, (*session.state.constraints, added))


def remove_constraint(session: IkSession, point: int | str) -> IkSession:
    """Let a point go; the pose stays. Raises `ValueError` where there is no constraint on it."""
    gone = constraint_at(session, point)
    kept = tuple(constraint for constraint in session.state.constraints if constraint != gone)
    return _set_constraints(session, kept)


def remove_all(session: IkSession) -> IkSession:
    """Let all points go; the pose stays."""
    return _set_constraints(session, ()) if session.state.constraints else session


def grab(session: IkSession) -> IkSession:
    """Begin a drag: until `release`, what happens is one step back, and poses are held near the one now."""
    return session if session.grabbed is not None else session._replace(grabbed=session.state)


def drag(
    session: IkSession, point: int | str, target: Place | None = None, orientation: Turn | None = None
) -> IkSession:
    """Move a target, turn a joint's, or both, and solve. Without `grab`, or after a drag was given up by `undo` or ended
    by another step while the hand goes on, it does nothing.

    **Raises:** `ValueError` where there is no such constraint.
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
    """Move a target in one go: `grab`, `drag`, `release`."""
    return release(drag(grab(session), point, target, orientation))


def free_orientation(session: IkSession, point: str) -> IkSession:
    """Let a joint turn as it likes again."""
    return _edited(session, _with(session.state, constraint_at(session, point)._replace(orientation=None)))


def pin(session: IkSession, point: int | str, pinned: bool = True) -> IkSession:
    """Hold a point where it is now, before all that are not pinned; or let it be like these again."""
    target = place_of(session, point) if pinned else constraint_at(session, point).target
    changed = constraint_at(session, point)._replace(pinned=pinned, target=target)
    return _edited(session, _with(session.state, changed))


def weigh(session: IkSession, point: int | str, weight: float) -> IkSession:
    """Change how much a constraint counts, and solve. Raises `ValueError` where it is below zero."""
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
    """The pose that the session began with; constraints hold their points where they are then."""
    return set_pose(session, session.home)


def set_pose(session: IkSession, pose: Pose) -> IkSession:
    """Another pose; constraints hold their points where they are in it."""
    pose, held = project(session.body.skeleton, pose), session.state.constraints
    places = places_of(session.body, pose, held)
    moved = tuple(one._replace(target=place) for one, place in zip(held, places, strict=True))
    return _edited(session, session.state._replace(pose=pose, constraints=moved))


def set_constraints(session: IkSession, constraints: Sequence[Constraint]) -> IkSession:
    """Other constraints in place of all there are, and the pose that meets them.

    **Raises:** `ValueError` as `make_constraints` does.
    """
    check_constraints(constraints, session.body.skeleton, len(session.body.vertices))
    return solved(_set_constraints(session, tuple(constraints)))


def undo(session: IkSession) -> IkSession:
    """The state before the last step; a drag that goes on is given up. The same session where there is none."""
    if session.grabbed is not None:
        return session._replace(state=session.grabbed, grabbed=None, solution=None)
    if not session.past:
        return session
    *past, before = session.past
    future = (session.state, *session.future)
    return session._replace(state=before, past=tuple(past), future=future, solution=None)


def redo(session: IkSession) -> IkSession:
    """The state that `undo` left. The same session where there is none."""
    if not session.future or session.grabbed is not None:
        return session
    after, *future = session.future
    past = (*session.past, session.state)
    return session._replace(state=after, past=past, future=tuple(future), solution=None)


def solved(session: IkSession) -> IkSession:
    """Solve for the constraints as they are, from the pose as it is; during a drag near the pose in which it
    began. It is no step of its own: what led to it is. A solve that ends in numbers that are not finite leaves the
    pose as it was."""
    state, begun = session.state, session.grabbed
    arrays = make_constraints(session.body, state.constraints)
    reference = state.pose if begun is None else begun.pose
    solution = solve_ik(session.body, state.pose, arrays, options_of(session), reference)
    if not bool(jnp.isfinite(solution.pose.rotations).all() & jnp.isfinite(solution.pose.translations).all()):
        return session._replace(solution=solution)
    return session._replace(state=state._replace(pose=solution.pose), solution=solution)


def distances(session: IkSession) -> tuple[float, ...]:
    """How far every constrained point is from its target in the pose as it is, metres."""
    held = session.state.constraints
    places = places_of(session.body, session.state.pose, held)
    return tuple(
        float(np.linalg.norm(np.subtract(place, one.target))) for place, one in zip(places, held, strict=True)
    )


def _set_constraints(session: IkSession, constraints: tuple[Constraint, ...]) -> IkSession:
    return _edited(session, session.state._replace(constraints=constraints))


def _with(state: IkState, changed: Constraint) -> IkState:
    """A state in which the constraint on a point is another one."""
    held = tuple(changed if one.point == changed.point else one for one in state.constraints)
    return state._replace(constraints=held)


def _edited(session: IkSession, state: IkState) -> IkSession:
    """Another state, one step further; a drag that goes on ends before it, as a step of its own."""
    session = release(session)
    past = (*session.past, session.state)[-HISTORY:]
    return session._replace(state=state, past=past, future=(), solution=None)
