"""An interactive session of inverse kinematics as a sequence of immutable values, without a window.

Every verb takes a session and returns the next one; changes of the state can be undone. A drag is one undo
step: `begin_drag`, then `drag` for each movement of the hand, then `end_drag`.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ...body.body import Body
from ...body.people.anatomy import rest_deviations
from ...body.pose import Pose, rest_pose
from ...body.retraction import project
from ...energy.energy import AbstractEnergy
from ...energy.priors.reference_pose import RestPrior
from ...limits.abstract_limits import AbstractLimits
from .constraints import Constraint, Position, Quaternion, check_constraints, describe_point, make_constraints
from .point_positions import point_positions
from .solve_ik import SOLVERS, IkOptions, IkSolution, Solver, solve_ik

#: number of undo steps that a session keeps
MAX_UNDO_STEPS = 200


class IkSettings(NamedTuple):
    """The settings that a user switches."""

    solver: Solver = "levenberg-marquardt"
    keep_limits: bool = True
    use_prior: bool = False
    fix_root: bool = False


class IkState(NamedTuple):
    """The state that undo restores."""

    pose: Pose
    constraints: tuple[Constraint, ...] = ()
    settings: IkSettings = IkSettings()


class IkSession(NamedTuple):
    """One user's session with one body."""

    body: Body
    #: pose that a reset restores
    initial_pose: Pose
    limits: AbstractLimits | None
    prior: AbstractEnergy
    state: IkState
    undo_states: tuple[IkState, ...] = ()
    redo_states: tuple[IkState, ...] = ()
    #: state before the drag, during a drag
    drag_start: IkState | None = None
    #: result of the last solve
    solution: IkSolution | None = None


#: maps a session to the next one
Edit = Callable[[IkSession], IkSession]


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


def solver_options(session: IkSession) -> IkOptions:
    """Collect the options of `solve_ik` from a session."""
    settings = session.state.settings
    return IkOptions(
        solver=settings.solver,
        limits=session.limits,
        prior=session.prior,
        keep_limits=settings.keep_limits,
        use_prior=settings.use_prior,
        fix_root=settings.fix_root,
    )


def find_constraint(session: IkSession, point: int | str) -> Constraint:
    """Find the constraint on a point. Raises `ValueError` if there is none."""
    for constraint in session.state.constraints:
        if constraint.point == point:
            return constraint
    raise ValueError(f"There is no constraint on {describe_point(point)}; add one first.")


def point_position(session: IkSession, point: int | str) -> Position:
    """Compute the current position of a vertex or a joint, metres. Raises `ValueError` if the body does not
    have it."""
    probe = (Constraint(point, (0.0, 0.0, 0.0)),)
    return point_positions(session.body, session.state.pose, probe)[0]


def add_constraint(
    session: IkSession, point: int | str, weight: float = 1.0, pinned: bool = False
) -> IkSession:
    """Constrain a point to its current position; an existing constraint stays as it is.

    **Raises:** `ValueError` if the body does not have the point.
    """
    if any(constraint.point == point for constraint in session.state.constraints):
        return session
    added = Constraint(point, point_position(session, point), weight, pinned)
    return _set_constraints(session, (*session.state.constraints, added))


def remove_constraint(session: IkSession, point: int | str) -> IkSession:
    """Remove the constraint on a point; the pose stays. Raises `ValueError` if there is none."""
    gone = find_constraint(session, point)
    kept = tuple(constraint for constraint in session.state.constraints if constraint != gone)
    return _set_constraints(session, kept)


def remove_constraints(session: IkSession) -> IkSession:
    """Remove all constraints; the pose stays."""
    return _set_constraints(session, ()) if session.state.constraints else session


def begin_drag(session: IkSession) -> IkSession:
    """Begin a drag: until `end_drag`, all changes are one undo step, and the current pose is the reference
    pose."""
    return session if session.drag_start is not None else session._replace(drag_start=session.state)


def drag(
    session: IkSession,
    point: int | str,
    target: Position | None = None,
    orientation: Quaternion | None = None,
) -> IkSession:
    """Move the target of a constraint, set its orientation, or both, and solve.

    Without `begin_drag`, it does nothing. The same holds after `undo` or another step has ended the drag.

    **Raises:** `ValueError` if there is no such constraint.
    """
    if session.drag_start is None:
        return session
    constraint = find_constraint(session, point)
    if target is not None:
        constraint = constraint._replace(target=target)
    if orientation is not None:
        constraint = constraint._replace(orientation=orientation)
    return solve_session(session._replace(state=_replace_constraint(session.state, constraint)))


def end_drag(session: IkSession) -> IkSession:
    """End a drag."""
    begun = session.drag_start
    session = session._replace(drag_start=None)
    if begun is None or begun is session.state:
        return session
    return session._replace(undo_states=(*session.undo_states, begun)[-MAX_UNDO_STEPS:], redo_states=())


def remove_orientation(session: IkSession, point: str) -> IkSession:
    """Remove the orientation from the constraint on a joint."""
    return _add_undo_step(
        session,
        _replace_constraint(session.state, find_constraint(session, point)._replace(orientation=None)),
    )


def set_pinned(session: IkSession, point: int | str, pinned: bool = True) -> IkSession:
    """Pin a point at its current position, or unpin it; pinned points have precedence over the others."""
    target = point_position(session, point) if pinned else find_constraint(session, point).target
    changed = find_constraint(session, point)._replace(pinned=pinned, target=target)
    return _add_undo_step(session, _replace_constraint(session.state, changed))


def set_weight(session: IkSession, point: int | str, weight: float) -> IkSession:
    """Set the weight of a constraint, and solve. Raises `ValueError` if it is negative."""
    changed = _replace_constraint(session.state, find_constraint(session, point)._replace(weight=weight))
    check_constraints(changed.constraints, session.body.skeleton, len(session.body.vertices))
    return solve_session(_add_undo_step(session, changed))


def change_settings(session: IkSession, settings: IkSettings) -> IkSession:
    """Switch limits, prior, root or solver, and solve. Raises `ValueError` for an unknown solver."""
    if settings.solver not in SOLVERS:
        raise ValueError(f"The solver '{settings.solver}' is unknown; give one of {', '.join(SOLVERS)}.")
    if settings == session.state.settings:
        return session
    return solve_session(_add_undo_step(session, session.state._replace(settings=settings)))


def reset_pose(session: IkSession) -> IkSession:
    """Restore the initial pose; constraints keep their points, with targets at the positions in that pose."""
    return set_pose(session, session.initial_pose)


def set_pose(session: IkSession, pose: Pose) -> IkSession:
    """Set another pose; constraints keep their points, with targets at the positions in that pose."""
    pose, constraints = project(session.body.skeleton, pose), session.state.constraints
    positions = point_positions(session.body, pose, constraints)
    moved = tuple(one._replace(target=place) for one, place in zip(constraints, positions, strict=True))
    return _add_undo_step(session, session.state._replace(pose=pose, constraints=moved))


def set_constraints(session: IkSession, constraints: Sequence[Constraint]) -> IkSession:
    """Replace all constraints, and solve for the pose.

    **Raises:** `ValueError` as `make_constraints` does.
    """
    check_constraints(constraints, session.body.skeleton, len(session.body.vertices))
    return solve_session(_set_constraints(session, tuple(constraints)))


def undo(session: IkSession) -> IkSession:
    """Restore the state before the last step, and cancel a drag. The session is unchanged if there is no such
    state."""
    if session.drag_start is not None:
        return session._replace(state=session.drag_start, drag_start=None, solution=None)
    if not session.undo_states:
        return session
    *past, before = session.undo_states
    future = (session.state, *session.redo_states)
    return session._replace(state=before, undo_states=tuple(past), redo_states=future, solution=None)


def redo(session: IkSession) -> IkSession:
    """Restore the state that `undo` left. The session is unchanged if there is none."""
    if not session.redo_states or session.drag_start is not None:
        return session
    after, *future = session.redo_states
    past = (*session.undo_states, session.state)
    return session._replace(state=after, undo_states=past, redo_states=tuple(future), solution=None)


def solve_session(session: IkSession) -> IkSession:
    """Solve for the current constraints from the current pose.

    During a drag, the reference is the pose in which it began. A solve adds no undo step; the change before
    it does. If the result is not finite, the pose stays unchanged.
    """
    state, begun = session.state, session.drag_start
    arrays = make_constraints(session.body, state.constraints)
    reference = state.pose if begun is None else begun.pose
    solution = solve_ik(session.body, state.pose, arrays, solver_options(session), reference)
    if not bool(jnp.isfinite(solution.pose.rotations).all() & jnp.isfinite(solution.pose.translations).all()):
        return session._replace(solution=solution)
    return session._replace(state=state._replace(pose=solution.pose), solution=solution)


def target_distances(session: IkSession) -> tuple[float, ...]:
    """Compute the distance of every constrained point from its target in the current pose, metres."""
    constraints = session.state.constraints
    positions = point_positions(session.body, session.state.pose, constraints)
    return tuple(
        float(np.linalg.norm(np.subtract(place, one.target)))
        for place, one in zip(positions, constraints, strict=True)
    )


def _set_constraints(session: IkSession, constraints: tuple[Constraint, ...]) -> IkSession:
    return _add_undo_step(session, session.state._replace(constraints=constraints))


def _replace_constraint(state: IkState, changed: Constraint) -> IkState:
    """Replace the constraint on a point in a state."""
    constraints = tuple(changed if one.point == changed.point else one for one in state.constraints)
    return state._replace(constraints=constraints)


def _add_undo_step(session: IkSession, state: IkState) -> IkSession:
    """Add a state as a new undo step; a current drag ends before it, as a step of its own."""
    session = end_drag(session)
    past = (*session.undo_states, session.state)[-MAX_UNDO_STEPS:]
    return session._replace(state=state, undo_states=past, redo_states=(), solution=None)
