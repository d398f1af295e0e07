"""Sessions of inverse kinematics: drags, settings and steps, and all of it undone."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

import jaxcap as jc
from jaxcap.edit.ik import session as ik


def move_constraint(session, point, *to, **more):
    """Move a target in one step."""
    return ik.end_drag(ik.drag(ik.begin_drag(session), point, *to, **more))


class Counting(jc.AbstractEnergy):
    """A user's own prior, which counts how often it is traced."""

    value: Float[Array, ""] = eqx.field(default=0.0, converter=jnp.asarray)

    def residual(self, posed):
        TRACES.append(1)
        return self.value * posed.joints[0, :1]


TRACES: list[int] = []


def test_a_session_goes_back_and_forth(arm):
    start = ik.begin_session(arm, prior=Counting())
    added = ik.add_constraint(ik.add_constraint(start, 6), "elbow")
    assert ik.add_constraint(added, 6) is added
    assert ik.find_constraint(added, 6).target == pytest.approx((1.0, 0.0, 0.0))
    assert added.state.pose is start.state.pose
    dragging = ik.begin_drag(added)
    for height in np.linspace(0, 0.4, 5):
        dragging = ik.drag(dragging, 6, (0.7, float(height), 0.0))
    moved = ik.end_drag(dragging)
    assert len(moved.undo_states) == 3
    assert ik.point_position(moved, 6) == pytest.approx((0.7, 0.4, 0.0), abs=2e-3)
    # a whole drag is one step
    assert ik.undo(moved).state is added.state
    assert ik.redo(ik.undo(moved)).state is moved.state
    assert ik.undo(ik.undo(ik.undo(moved))).state is start.state
    assert ik.undo(start) is start
    assert ik.redo(moved) is moved
    # what was undone is gone once something else is done
    other = ik.remove_constraint(ik.undo(moved), "elbow")
    assert ik.redo(other) is other
    # a drag that is given up, and one in which nothing moved
    assert ik.undo(dragging).state is added.state
    assert ik.end_drag(ik.begin_drag(added)).undo_states == added.undo_states


def test_a_drag_that_was_undone_is_over_while_the_hand_goes_on(arm):
    session = ik.add_constraint(ik.begin_session(arm, prior=Counting()), 6)
    moved = move_constraint(session, 6, (0.7, 0.4, 0.0))
    undone = ik.undo(moved)
    given_up = ik.undo(ik.drag(ik.begin_drag(undone), 6, (0.2, 0.2, 0.0)))
    after = given_up
    for height in (0.1, 0.2, 0.3):
        after = ik.drag(after, 6, (0.2, height, 0.0))
    after = ik.end_drag(after)
    # neither steps, nor what could be done again is lost
    assert (after.state, after.undo_states) == (undone.state, undone.undo_states)
    assert ik.redo(after).state is moved.state
    # another step ends a drag, too: the drag is one, and that is one
    pinned = ik.set_pinned(ik.drag(ik.begin_drag(session), 6, (0.7, 0.4, 0.0)), 6)
    assert len(ik.drag(pinned, 6, (0.2, 0.2, 0.0)).undo_states) == len(session.undo_states) + 2
    # the next one is one again
    again = move_constraint(after, 6, (0.5, 0.5, 0.0))
    assert len(again.undo_states) == len(after.undo_states) + 1


def test_pins_weights_settings_and_resets_are_steps(arm):
    session = ik.add_constraint(ik.begin_session(arm, prior=Counting()), 6)
    session = move_constraint(session, 6, (0.2, 3.0, 0.0))
    pinned = ik.set_pinned(session, 6)
    assert ik.find_constraint(pinned, 6).pinned
    assert ik.target_distances(pinned)[0] < 1e-9
    assert ik.set_weight(session, 6, 0.25).state.constraints[0].weight == 0.25
    with pytest.raises(ValueError, match="at least 0"):
        ik.set_weight(session, 6, -1.0)
    back = ik.reset_pose(session)
    np.testing.assert_allclose(back.state.pose.rotations, session.initial_pose.rotations)
    assert ik.find_constraint(back, 6).target == pytest.approx((1.0, 0.0, 0.0))
    held = ik.change_settings(session, session.state.settings._replace(fix_root=True))
    assert held.state.settings.fix_root and len(held.undo_states) == len(session.undo_states) + 1
    assert ik.change_settings(held, held.state.settings) is held
    with pytest.raises(ValueError, match="solver 'newton' is unknown"):
        ik.change_settings(session, session.state.settings._replace(solver="newton"))
    with pytest.raises(ValueError, match="There is no constraint on vertex 3"):
        move_constraint(session, 3, (0.0, 0.0, 0.0))
    turned = move_constraint(ik.add_constraint(session, "wrist"), "wrist", orientation=(0.8, 0.0, 0.6, 0.0))
    assert ik.remove_orientation(turned, "wrist").state.constraints[-1].orientation is None
    assert ik.remove_constraints(turned).state.constraints == ()


def test_unfinished_numbers_leave_the_pose_as_it_was(arm):
    session = ik.add_constraint(ik.begin_session(arm, prior=Counting(jnp.nan)), 6)
    after = move_constraint(session, 6, (0.5, 0.5, 0.0))
    assert np.isfinite(after.state.pose.rotations).all()
    assert ik.find_constraint(after, 6).target == (0.5, 0.5, 0.0)


def test_nothing_is_traced_again_for_other_counts_targets_or_switches(arm):
    session = ik.add_constraint(ik.begin_session(arm, prior=Counting()), 6)
    session = move_constraint(session, 6, (0.5, 0.5, 0.0))
    first = len(TRACES)
    assert first
    for point in (3, 7, 8, "elbow"):
        session = ik.add_constraint(session, point)
    session = move_constraint(session, "elbow", (0.2, 0.2, 0.0), (0.8, 0.6, 0.0, 0.0))
    off = ik.IkSettings(keep_limits=False, use_prior=False, fix_root=True)
    ik.set_pinned(ik.change_settings(ik.remove_constraint(session, 3), off), 7)
    assert len(TRACES) == first
