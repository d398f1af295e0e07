"""Inverse kinematics without a window: targets are met, limits kept, and far ones borne."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, random_pose
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import jaxcap as jc
from jaxcap.body.body import pose_body
from jaxcap.edit.ik import session as ik
from jaxcap.edit.ik import solve_ik as inverse_kinematics
from jaxcap.edit.ik.constraints import Constraint, make_constraints
from jaxcap.edit.ik.solve_ik import POSITION_DEVIATION, SOLVERS, IkOptions, solve_ik
from jaxcap.fit.linear_solvers.cholesky import factorise
from jaxcap.geometry import rotation
from jaxcap.prior.pair_prior import successive_pairs

_pose_body = eqx.filter_jit(pose_body)


def constraints_of(body, pose, points, **fields) -> list[Constraint]:
    """Constraints whose targets are where the points are in a pose."""
    posed = _pose_body(body, pose)
    place = lambda p: posed.joints[body.skeleton.index(p)] if isinstance(p, str) else posed.vertices[p]  # noqa: E731
    return [Constraint(p, tuple(map(float, place(p))), **fields) for p in points]


@pytest.mark.parametrize("solver", SOLVERS)
def test_targets_of_another_pose_are_reached(arm, rng, solver):
    rest, there = jc.rest_pose(arm.skeleton), random_pose(arm.skeleton, rng, 0.5)
    wanted = constraints_of(arm, there, [3, 6, "elbow"])
    found = solve_ik(arm, rest, make_constraints(arm, wanted), IkOptions(solver=solver))
    posed = _pose_body(arm, found.pose)
    for one in wanted[:2]:
        assert np.linalg.norm(posed.vertices[one.point] - np.array(one.target)) < 1e-3
    assert np.linalg.norm(posed.joints[1] - np.array(wanted[2].target)) < 1e-3
    assert found.distances.max() < 1e-3


@pytest.mark.parametrize("skin", ["linear", "swing_twist"])
def test_all_skins_and_kinds_of_joints(rng, skin):
    body = chain_body(skin)
    there = random_pose(body.skeleton, rng, 0.2)
    wanted = constraints_of(body, there, [5, 20, 33, 44, "neck"])
    found = solve_ik(body, jc.rest_pose(body.skeleton), make_constraints(body, wanted))
    full = _pose_body(body, found.pose).vertices
    apart = [np.linalg.norm(full[one.point] - np.array(one.target)) for one in wanted[:4]]
    assert max(apart) < 1e-3
    # what was solved for is the body, not its reduced likeness
    np.testing.assert_allclose(found.distances[:4], apart, atol=1e-9)


def test_the_least_energy_is_that_of_scipy(arm, rng):
    """The same sum of squares in SciPy's own rotations and solver, from another start, out of reach and with weights."""
    targets, weights, stiffness = np.array([[0.2, 0.9, 0.4], [0.3, 0.2, -0.1]]), np.array([1.0, 3.0]), 50.0
    wanted = [Constraint(6, tuple(targets[0]), 1.0), Constraint(3, tuple(targets[1]), 3.0)]
    options, rest = IkOptions(stiffness=stiffness), jc.rest_pose(arm.skeleton)
    pose = rest
    for _ in range(3):
        pose = solve_ik(arm, pose, make_constraints(arm, wanted), options, rest).pose

    def residual(numbers):
        end, ends, turn = np.zeros(3), [], Rotation.identity()
        for vector in numbers.reshape(3, 3):
            turn = turn * Rotation.from_rotvec(vector)
            end = end + turn.apply([1 / 3, 0, 0])
            ends.append(end)
        apart = np.sqrt(weights)[:, None] * (np.array([ends[2], ends[1]]) - targets) / POSITION_DEVIATION
        return np.concatenate(
            [apart.ravel(), np.sqrt(stiffness) * numbers / inverse_kinematics.FREE_ROOT_DEVIATIONS[1] * scale]
        )

    # roots are stiffer than what hangs on them
    scale = np.repeat(
        [
            1.0,
            inverse_kinematics.FREE_ROOT_DEVIATIONS[1] / 0.5,
            inverse_kinematics.FREE_ROOT_DEVIATIONS[1] / 0.5,
        ],
        3,
    )
    best = least_squares(residual, 0.1 * rng.normal(size=9), xtol=1e-12, ftol=1e-12, gtol=1e-12)
    turns = Rotation.from_quat(np.asarray(pose.rotations), scalar_first=True).as_rotvec()
    ours = residual(turns.ravel())
    assert ours @ ours == pytest.approx(2 * best.cost, rel=1e-5)
    assert least_squares(residual, turns.ravel()).cost == pytest.approx(best.cost, rel=1e-5)


def test_out_of_reach_is_straight_towards_it_and_back_again(arm):
    """A hand pulled three metres away is on the line to its target, stays there, and comes back within 1 mm."""
    near, far = (0.3, 0.5, 0.2), (1.2, 2.6, -1.0)
    options, rest = IkOptions(), jc.rest_pose(arm.skeleton)
    pose, places = rest, []
    for share in [0, 0.1, 0.3, 0.6, *[1] * 8, 0.6, 0.3, 0.1, 0]:
        target = tuple((1 - share) * np.array(near) + share * np.array(far))
        found = solve_ik(arm, pose, make_constraints(arm, [Constraint(6, target)]), options, rest)
        pose = found.pose
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(pose))
        places.append(np.asarray(_pose_body(arm, pose).vertices[6]))
    # one metre of arm, in the target's direction
    np.testing.assert_allclose(places[11], np.array(far) / np.linalg.norm(far), atol=0.01)
    assert np.linalg.norm(places[11] - places[10]) < 1e-3
    assert np.linalg.norm(places[-1] - near) < 1e-3
    assert np.linalg.norm(places[-1] - places[0]) < 1e-3


@pytest.mark.parametrize("solver", ["levenberg-marquardt", "priorities"])
def test_pinned_points_come_first(arm, solver):
    rest = jc.rest_pose(arm.skeleton)
    held = constraints_of(arm, rest, [3], pinned=True)[0]
    # the last bone is free, and the rest of the arm would have to fold for the target
    found = solve_ik(
        arm, rest, make_constraints(arm, [held, Constraint(6, (0.0, 0.0, 0.1))]), IkOptions(solver)
    )
    places = _pose_body(arm, found.pose).vertices
    assert np.linalg.norm(places[3] - arm.vertices[3]) < {"priorities": 1e-5}.get(solver, 2e-3)
    loose = [held._replace(pinned=False), Constraint(6, (0.0, 0.0, 0.1))]
    yielded = solve_ik(arm, rest, make_constraints(arm, loose), IkOptions(solver))
    assert np.linalg.norm(_pose_body(arm, yielded.pose).vertices[3] - arm.vertices[3]) > 0.05
    assert found.distances[1] > yielded.distances[1]


def test_weights_share_what_cannot_be_met(arm):
    """Two vertices of one rigid bone are asked further apart than they are: the bone lies along the line of the
    targets, and what is left of each is as its inverse weight."""
    a, b = (0.0, 0.6, 0.0), (0.0, 0.6, 0.1)
    missing = 0.1 - float(np.linalg.norm(arm.vertices[7] - arm.vertices[6]))
    for first, second in ((3.0, 1.0), (1.0, 3.0)):
        wanted = [Constraint(6, a, first), Constraint(7, b, second)]
        left = solve_ik(arm, jc.rest_pose(arm.skeleton), make_constraints(arm, wanted)).distances
        np.testing.assert_allclose(left[:2], missing * np.array([second, first]) / 4, rtol=0.02)


def test_orientations_are_met(arm, rng):
    turn = Rotation.from_rotvec([0.3, 0.5, -0.4])
    wanted = Constraint("wrist", (0.3, 0.3, 0.1), 1.0, False, tuple(turn.as_quat(scalar_first=True)))
    found = solve_ik(arm, jc.rest_pose(arm.skeleton), make_constraints(arm, [wanted]))
    posed = _pose_body(arm, found.pose)
    np.testing.assert_allclose(posed.transforms.rotations[2], turn.as_matrix(), atol=2e-3)
    np.testing.assert_allclose(posed.joints[2], wanted.target, atol=1e-3)


@pytest.mark.parametrize("solver", SOLVERS)
def test_limits_hold_to_the_last(solver):
    """A knee that must not bend forwards and a hip that must not lift, with a target that wants both to."""
    axes = [[[1.0, 0, 0], [0, 0, 1]], [[1.0, 0, 0], [0, 1, 0]]]
    skeleton = jc.make_skeleton(
        ("hip", "knee"), (-1, 0), ("universal", "revolute"), [[0.0, 1, 0], [0.0, 0.5, 0]], axes=axes
    )
    sole = jnp.array([[0.0, 0, 0], [0, 0, 0.1], [0.05, 0, 0]])
    body = jc.Body(skeleton, jc.body.RigidSkin(jnp.array([1, 1, 1])), sole, jnp.array([[0, 1, 2]]))
    limits = jc.limits.make_joint_ranges(skeleton, {"knee": (0.0, 2.0), "hip": ((-0.5, 0.5), (-0.2, 0.2))})
    rest, wanted = jc.rest_pose(skeleton), make_constraints(body, [Constraint(0, (0.1, 0.6, 0.7))])
    options = IkOptions(solver=solver, limits=limits)
    kept = solve_ik(body, rest, wanted, options)
    assert jc.limits.allowed(limits, skeleton, kept.pose).all()
    off = eqx.tree_at(lambda o: o.keep_limits, options, jnp.array(False))
    broken = solve_ik(body, rest, wanted, off)
    assert not jc.limits.allowed(limits, skeleton, broken.pose).all()
    assert broken.distances[0] < kept.distances[0]
    # the nearest that the limits leave: all angles of a grid within them are further off, or as far
    angles = np.stack(
        np.meshgrid(np.linspace(-0.5, 0.5, 21), np.linspace(-0.2, 0.2, 9), np.linspace(0, 2, 21)), -1
    )
    x, z, knee = (
        Rotation.from_rotvec(np.outer(angles[..., i].ravel(), axis))
        for i, axis in enumerate(np.eye(3)[[0, 2, 0]])
    )
    feet = (x * z).apply(knee.apply([0.0, -0.5, 0]) + [0, -0.5, 0]) + [0, 1, 0]
    assert kept.distances[0] < np.linalg.norm(feet - [0.1, 0.6, 0.7], axis=1).min() + 1e-3


def test_held_roots_stay_and_others_follow():
    body = chain_body()
    pull = make_constraints(body, [Constraint("tool", (2.5, 0.3, 0.0))])
    rest = jc.rest_pose(body.skeleton)
    held = solve_ik(body, rest, pull, IkOptions(fix_root=True)).pose
    free = solve_ik(body, rest, pull, IkOptions()).pose
    assert np.linalg.norm(held.translations[0]) < 1e-3
    assert rotation.distance(held.rotations[0], rest.rotations[0]) < 1e-3
    assert np.linalg.norm(free.translations[0]) > 0.5


@pytest.mark.float32
@pytest.mark.parametrize("solver", ["levenberg-marquardt", "priorities"])
def test_a_root_that_is_held_goes_only_where_a_pin_on_it_says(arm, solver):
    """A pin on another point is no reason to leave, one on the root itself is; its turn stays while none is asked for."""
    skeleton = jc.make_skeleton(
        arm.skeleton.names, arm.skeleton.parents, ("free", "ball", "ball"), arm.skeleton.centres
    )
    body, options = eqx.tree_at(lambda b: b.skeleton, arm, skeleton), IkOptions(solver, fix_root=True)
    rest, place = jc.rest_pose(skeleton), (0.1, 0.3, -0.2)

    def moved(*wanted: Constraint):
        pose = solve_ik(body, rest, make_constraints(body, wanted), options).pose
        return np.asarray(pose.translations[0]), Rotation.from_quat(pose.rotations[0], scalar_first=True)

    far = Constraint(6, (2.0, 1.0, 0.0), pinned=True)
    for wanted in ((far,), (Constraint("shoulder", place),)):
        shift, turn = moved(*wanted)
        # the pin is a metre out of reach
        assert np.linalg.norm(shift) < 0.01
        assert turn.magnitude() < 0.01
    shift, turn = moved(Constraint("shoulder", place, pinned=True))
    np.testing.assert_allclose(shift, place, atol=1e-3)
    assert turn.magnitude() < 1e-3
    bend = Rotation.from_rotvec([0.2, -0.3, 0.5])
    wxyz = tuple(map(float, bend.as_quat(scalar_first=True)))
    shift, turn = moved(Constraint("shoulder", place, 1.0, True, wxyz))
    np.testing.assert_allclose(shift, place, atol=1e-3)
    assert (bend.inv() * turn).magnitude() < 2e-3


def test_wrong_constraints_are_told(arm):
    place = (0.0, 0.0, 0.0)
    wrong = [
        ([Constraint(9, place)], "vertex 9, but the body has vertices 0 to 8"),
        ([Constraint("knee", place)], "joint 'knee', but the skeleton has shoulder, elbow, wrist"),
        ([Constraint(3, place), Constraint(3, place)], "two constraints on vertex 3"),
        ([Constraint(3, (0.0, np.nan, 0.0))], "The target of vertex 3"),
        ([Constraint(3, place, -1.0)], "The weight of vertex 3 is -1"),
        ([Constraint(3, place, 1.0, False, (1.0, 0.0, 0.0, 0.0))], "only joints can have one"),
        ([Constraint("wrist", place, 1.0, False, (0.0, 0.0, 0.0, 0.0))], "The orientation of joint 'wrist'"),
    ]
    for constraints, sentence in wrong:
        with pytest.raises(ValueError, match=sentence.replace("(", r"\(")):
            make_constraints(arm, constraints)


@pytest.mark.float32
def test_very_different_stiffness_is_solved_in_single_precision(rng):
    """Against NumPy's SVD in double precision, where Cholesky of plain normal equations has no digits left."""
    jacobian = rng.normal(size=(60, 12)) * np.repeat([1.0, 3e3], 6)
    right = rng.normal(size=60)
    rows = jnp.asarray(jacobian, jnp.float32)
    found = factorise(rows.T @ rows).solve(rows.T @ jnp.asarray(right, jnp.float32))
    best = np.linalg.lstsq(jacobian, right)[0]
    np.testing.assert_allclose(
        np.asarray(found) * np.repeat([1.0, 3e3], 6), best * np.repeat([1.0, 3e3], 6), atol=1e-4
    )


@pytest.mark.float32
def test_a_human_reaches_with_what_is_natural(rng):
    """Ten constraints on 1,500 vertices; a prior of pairs; the way of a drag leaves no trace."""
    body = jc.human(resolution="low", joints="tracking")
    vertices, rest = np.asarray(body.vertices), jc.rest_pose(body.skeleton)
    hand, feet = int(np.argmax(vertices[:, 0])), np.argsort(vertices[:, 1])[:8]
    session = ik.begin_session(body, rest, prior=pair_prior(body.skeleton))
    for foot in feet:
        session = ik.set_pinned(ik.add_constraint(session, int(foot)), int(foot))
    session = ik.add_constraint(ik.add_constraint(session, hand), "Head")
    begun, target = ik.begin_drag(session), vertices[hand] + [-0.15, 0.35, 0.15]
    straight, winding = begun, begun
    for share in np.linspace(0.25, 1, 4):
        straight = ik.drag(
            straight, hand, tuple(map(float, vertices[hand] + share * (target - vertices[hand])))
        )
    for aside in ([0.3, 0, 0], [0.2, -0.2, 0.2], [0, 0.3, 0], [0.0, 0, 0], [0.0, 0, 0]):
        winding = ik.drag(winding, hand, tuple(map(float, target + np.array(aside))))
    for found in (straight, winding):
        assert max(ik.target_distances(found)) < 5e-3
    apart = rotation.distance(straight.state.pose.rotations, winding.state.pose.rotations)
    assert np.degrees(apart).max() < 3.0


def pair_prior(skeleton) -> jc.prior.MahalanobisPrior:
    """Of all successive joints: near rest, with half a radian about every axis."""
    pairs = successive_pairs(skeleton)
    frames = np.array([[skeleton.orientations[skeleton.index(name)] for name in pair] for pair in pairs])
    count = len(pairs)
    factors = np.tile(2.0 * np.eye(6), (count, 1, 1, 1))
    return jc.prior.MahalanobisPrior(
        jc.prior.make_pair_prior(pairs, frames, np.ones((count, 1)), np.zeros((count, 1, 6)), factors)
    )
