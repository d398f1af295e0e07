"""Strict priorities against slow lexicographic least squares, SciPy's constrained optima, and `solve`."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
import scipy.linalg
import scipy.optimize
from helpers import chain_body, random_pose
from jaxtyping import Array, Float

from jaxcap.body.body import Body, pose_body
from jaxcap.body.pose import Pose, rest_pose, stack_poses
from jaxcap.body.retraction import difference, retract
from jaxcap.body.skeleton import make_skeleton
from jaxcap.body.skin import RigidSkin
from jaxcap.energy.data.landmarks import BoneLandmarks, JointLandmarks
from jaxcap.energy.energy import AbstractEnergy
from jaxcap.energy.priors.joint_limits import JointLimits
from jaxcap.energy.priors.reference_pose import PosePrior
from jaxcap.errors import InputError
from jaxcap.fit.linearise import linearise
from jaxcap.fit.solve import solve
from jaxcap.fit.solvers.hierarchical_least_squares import (
    Damping,
    LinearSystem,
    constrained_step,
    hierarchical_step,
)
from jaxcap.fit.solvers.levenberg_marquardt import LevenbergMarquardt
from jaxcap.fit.strict_priorities import priority_step, solve_in_order
from jaxcap.limits.ranges_and_cones import Cone, make_joint_ranges

BODY = chain_body("rigid")
SKELETON = BODY.skeleton
REST = rest_pose(SKELETON)
TIGHT = {"rtol": 1e-13, "atol": 1e-11, "damping": 1e-10}
TRACES: list[int] = []

pose_body_, linearise_ = eqx.filter_jit(pose_body), eqx.filter_jit(linearise)
LM = LevenbergMarquardt(rtol=1e-15, atol=1e-11)
solve_ = eqx.filter_jit(solve)
step_ = eqx.filter_jit(priority_step)


def sliding_body(joints: int = 4) -> Body:
    """A chain of joints that only slide: all places are linear in the pose."""
    names = [f"joint{k}" for k in range(joints)]
    centres = np.arange(3.0 * joints).reshape(-1, 3) / 10
    skeleton = make_skeleton(names, range(-1, joints - 1), ["translate"] * joints, centres)
    skin = RigidSkin(jnp.arange(joints))
    return Body(skeleton, skin, jnp.asarray(centres), jnp.zeros((0, 3), int))


class Bound(AbstractEnergy):
    """`max(0, A d - b)` of the tangent from rest: walls."""

    walls: Float[Array, "W D"]
    places: Float[Array, "W"]

    def residual(self, posed):
        d = difference(posed.body.skeleton, rest_pose(posed.body.skeleton), posed.pose)
        return jnp.maximum(self.walls @ d - self.places, 0.0)


class Linear(AbstractEnergy):
    """`A d - b` of the tangent from rest."""

    matrix: Float[Array, "R D"]
    target: Float[Array, "R"]

    def residual(self, posed):
        d = difference(posed.body.skeleton, rest_pose(posed.body.skeleton), posed.pose)
        return self.matrix @ d - self.target


def tangent(body: Body, pose: Pose) -> np.ndarray:
    return np.asarray(difference(body.skeleton, rest_pose(body.skeleton), pose))


def values(groups, body: Body, pose: Pose) -> np.ndarray:
    posed = pose_body_(body, pose)
    return np.array([float(jnp.sum(group.residual(posed) ** 2)) for group in groups])


def lexicographic(systems, size: int) -> np.ndarray:
    """Least squares in order, by orthonormal bases of null spaces: `|A x - b|` of each system."""
    x, basis = np.zeros(size), np.eye(size)
    for matrix, target in systems:
        reduced = matrix @ basis
        if basis.shape[1] == 0:
            break
        x = x + basis @ np.linalg.lstsq(reduced, target - matrix @ x, rcond=1e-10)[0]
        basis = basis @ scipy.linalg.null_space(reduced, rcond=1e-10)
    return x


def joints(chosen: dict[str, float], target: Pose, off=0.0) -> JointLandmarks:
    """Centres of named joints where `target` has them, `off` metres away, with weights."""
    weights = jnp.zeros(SKELETON.num_joints)
    for name, weight in chosen.items():
        weights = weights.at[SKELETON.index(name)].set(weight)
    return JointLandmarks(pose_body_(BODY, target).joints + jnp.asarray(off), weights)


@pytest.mark.parametrize("ranks", [(5, 4, 9), (2, 4, 3)], ids=str)
def test_linear_groups_end_where_lexicographic_least_squares_does(rng, ranks):
    """Also where a group is of lower rank than rows, and asks in part for what a higher one decided."""
    body = sliding_body()
    size = body.skeleton.num_dofs
    systems = []
    for number, rows in enumerate(ranks):
        matrix = rng.normal(size=(rows, size))
        if number == 1:
            # half of it repeats the first group, with other targets; one row stands twice
            matrix[0], matrix[2] = systems[0][0][0], matrix[1]
        systems.append((matrix, rng.normal(size=rows)))
    systems.append((np.eye(size), rng.normal(size=size)))
    groups = tuple(Linear(jnp.asarray(a), jnp.asarray(b)) for a, b in systems)
    solution = solve_in_order(groups, body, rest_pose(body.skeleton), **TIGHT)
    assert solution.result == optx.RESULTS.successful
    np.testing.assert_allclose(tangent(body, solution.pose), lexicographic(systems, size), atol=1e-7)


def test_landmarks_on_sliding_joints_and_a_prior(rng):
    """The root's two landmarks disagree, the tip follows as far as no one else asks."""
    body = sliding_body()
    skeleton, size = body.skeleton, body.skeleton.num_dofs
    tips = jnp.asarray(rng.normal(size=(4, 3)))
    rest = skeleton.centres[jnp.array([1, 1, 3, 3])]
    pair = lambda a, b: BoneLandmarks(jnp.array([1, 1, 3, 3])[a:b], rest[a:b], tips[a:b], jnp.ones(b - a))  # noqa: E731
    prior = PosePrior(random_pose(skeleton, rng), jnp.asarray(rng.uniform(0.5, 2.0, size)))
    groups = (pair(0, 2), pair(2, 3), prior)
    solution = solve_in_order(groups, body, rest_pose(skeleton), **TIGHT)
    systems = []
    for group in groups:
        residual, jacobian = linearise_(group, body, rest_pose(skeleton))
        systems.append((np.asarray(jacobian), -np.asarray(residual)))
    np.testing.assert_allclose(tangent(body, solution.pose), lexicographic(systems, size), atol=1e-8)
    places = np.asarray(pose_body_(body, solution.pose).joints)
    np.testing.assert_allclose(places[1], tips[:2].mean(0), atol=1e-9)
    np.testing.assert_allclose(places[3], tips[2], atol=1e-9)


def test_of_two_in_conflict_the_higher_ends_as_if_alone(rng):
    """And of three levels each is as low as the ones above let it."""
    target, other = random_pose(SKELETON, rng, 0.3), random_pose(SKELETON, rng, 0.3)
    off = [[0.0, 0.0, 0.05 * k] for k in range(SKELETON.num_joints)]
    higher = joints({"hand": 1.0, "tool": 1.0}, target, off)
    groups = (higher, joints({"hand": 2.0, "jaw": 1.0}, other), PosePrior(REST, jnp.ones(SKELETON.num_dofs)))
    alone = solve_in_order((higher,), BODY, REST, **TIGHT)
    solution = solve_in_order(groups, BODY, REST, max_steps=128, **TIGHT)
    ends = values(groups, BODY, solution.pose)
    # the tool is as far from the hand as it was built
    assert ends[0] > 1e-5
    assert abs(ends[0] - values(groups, BODY, alone.pose)[0]) < 1e-10
    assert ends[1] > 1e-3
    history = np.asarray(solution.history)[: int(solution.num_steps)]
    assert (np.diff(history[:, 0]) <= 1e-15).all()
    np.testing.assert_allclose(history[-1], ends, rtol=1e-9, atol=1e-16)
    # no move that leaves the higher ones alone betters a lower one
    basis = np.eye(SKELETON.num_dofs)
    for group in groups:
        residual, jacobian = (np.asarray(x) for x in linearise_(group, BODY, solution.pose))
        np.testing.assert_allclose(basis.T @ jacobian.T @ residual, 0.0, atol=2e-5)
        basis = basis @ scipy.linalg.null_space(jacobian @ basis, rcond=1e-6)


def test_a_lower_group_does_not_disturb_what_can_be_had(rng):
    target, other = random_pose(SKELETON, rng, 0.4), random_pose(SKELETON, rng, 0.6)
    last = PosePrior(other, jnp.ones(SKELETON.num_dofs))
    groups = (joints({"hand": 1.0}, target), joints({"jaw": 1.0}, target), last)
    solution = solve_in_order(groups, BODY, REST, max_steps=128, **TIGHT)
    assert (np.sqrt(values(groups, BODY, solution.pose)[:2]) < 1e-8).all()
    assert values(groups, BODY, solution.pose)[2] < values(groups, BODY, REST)[2]
    # where it is only as good as asked for, it is the same
    plain = solve_in_order(groups, BODY, REST, max_steps=128)
    assert plain.result == optx.RESULTS.successful
    np.testing.assert_allclose(
        values(groups, BODY, plain.pose), values(groups, BODY, solution.pose), rtol=1e-4, atol=1e-16
    )


@pytest.mark.parametrize("seed", range(6))
def test_inequalities_above_least_squares_end_at_the_constrained_optimum(seed):
    """Walls that the free optimum passes, of which some hold and others let go."""
    rng = np.random.default_rng(seed)
    body = sliding_body(2)
    walls, places = rng.normal(size=(5, 6)), rng.uniform(0.0, 0.3, 5)
    places[:2] = 0.0
    matrix, target = rng.normal(size=(8, 6)), 2 * rng.normal(size=8)
    groups = (
        Bound(jnp.asarray(walls), jnp.asarray(places)),
        Linear(jnp.asarray(matrix), jnp.asarray(target)),
    )
    solution = solve_in_order(groups, body, rest_pose(body.skeleton), **TIGHT)
    expected = scipy.optimize.minimize(
        lambda x: np.sum((matrix @ x - target) ** 2),
        np.zeros(6),
        jac=lambda x: 2 * matrix.T @ (matrix @ x - target),
        constraints={"type": "ineq", "fun": lambda x: places - walls @ x, "jac": lambda x: -walls},
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    found = tangent(body, solution.pose)
    assert (walls @ found - places).max() < 1e-8
    np.testing.assert_allclose(found, expected.x, atol=1e-5)


def limits(wider: float = 1.0) -> JointLimits:
    w = wider
    return JointLimits(
        make_joint_ranges(
            SKELETON,
            {
                "elbow": (-0.2 * w, 0.2 * w),
                "spine": ((-0.1 * w, 0.2 * w), (-0.2 * w, 0.1 * w)),
                "jaw": (-0.1 * w, 0.1 * w),
            },
            {
                "chest": Cone((1, 0, 0), 0.2 * w, (0, 1, 0), 0.2 * w),
                "hand": Cone((1, 0, 0), 0.3 * w, (0, 1, 0), 0.3 * w),
            },
        )
    )


def landmarks_and_rest(target: Pose, off=0.0) -> AbstractEnergy:
    """Landmarks that turning joints are to reach, for the others are held."""
    slides = jnp.ones(SKELETON.num_dofs).at[:6].set(1e-2).at[11:14].set(1e-2)
    return joints({"hand": 1.0, "tool": 1.0, "jaw": 1.0}, target, off) + 1e-3 * PosePrior(REST, slides)


@pytest.mark.parametrize("seed", range(3))
def test_limits_above_landmarks_hold_and_the_landmarks_are_as_near_as_can_be(seed):
    """From rest, and from a pose out of the limits; SLSQP finds nothing better next to the end."""
    rng = np.random.default_rng(seed)
    start = REST if seed else random_pose(SKELETON, rng, 0.4)
    groups = (limits(), landmarks_and_rest(random_pose(SKELETON, rng, 0.5)))
    solution = solve_in_order(groups, BODY, start, max_steps=200, **TIGHT)
    ends = values(groups, BODY, solution.pose)
    assert np.sqrt(ends[0]) < 1e-8

    @jax.jit
    def both(d):
        posed = pose_body(BODY, retract(SKELETON, solution.pose, d))
        # a room of a micro-radian, for squares have no slope at their bound
        return jnp.sum(groups[1].residual(posed) ** 2), 1e-12 - groups[0].residual(posed) ** 2

    slopes = jax.jit(jax.jacfwd(both))
    better = scipy.optimize.minimize(
        lambda d: float(both(d)[0]),
        np.zeros(SKELETON.num_dofs),
        jac=lambda d: np.asarray(slopes(d)[0]),
        constraints={
            "type": "ineq",
            "fun": lambda d: np.asarray(both(d)[1]),
            "jac": lambda d: np.asarray(slopes(d)[1]),
        },
        method="SLSQP",
        options={"ftol": 1e-12, "maxiter": 300},
    )
    free = solve_(groups[1], BODY, REST, LM)
    assert values(groups, BODY, free.pose)[0] > 1e-3, "no limit was in the way"
    assert ends[1] <= better.fun * (1 + 1e-3)


def test_without_an_active_limit_it_is_the_plain_solve(rng):
    energy = landmarks_and_rest(random_pose(SKELETON, rng, 0.2))
    plain = solve_(energy, BODY, REST, LM)
    ordered = solve_in_order((limits(8.0), energy), BODY, REST, max_steps=200, **TIGHT)
    np.testing.assert_allclose(tangent(BODY, ordered.pose), tangent(BODY, plain.pose), atol=1e-5)
    assert set(ordered.energies) == {"JointLimits", "JointLandmarks", "PosePrior"}


def test_groups_of_no_weight_are_not_there(rng):
    body = sliding_body(2)
    matrix, target = jnp.asarray(rng.normal(size=(8, 6))), jnp.asarray(rng.normal(size=8))
    energy, nothing = Linear(matrix, target), Linear(jnp.zeros((8, 6)), jnp.zeros(8))
    groups = (nothing, 0.0 * Bound(matrix, target), energy, nothing)
    solution = solve_in_order(groups, body, rest_pose(body.skeleton), **TIGHT)
    np.testing.assert_allclose(tangent(body, solution.pose), np.linalg.lstsq(matrix, target)[0], atol=1e-7)
    still = solve_in_order(
        (nothing, 0.0 * Bound(matrix, target), nothing, nothing), body, rest_pose(body.skeleton)
    )
    assert still.result == optx.RESULTS.successful
    np.testing.assert_array_equal(tangent(body, still.pose), 0.0)


def test_a_target_out_of_reach_does_not_blow_up(rng):
    """A stretched limb has no slope along its length."""
    groups = (limits(8.0), landmarks_and_rest(REST, [2.0, 0.0, 0.0]))
    solution = solve_in_order(groups, BODY, REST)
    assert np.isfinite(tangent(BODY, solution.pose)).all()
    ends, before = (values(groups, BODY, pose) for pose in (solution.pose, REST))
    assert ends[0] < 1e-12
    assert ends[1] < before[1]


class Counted(AbstractEnergy):
    """An energy that counts how often it is traced."""

    energy: AbstractEnergy

    def residual(self, posed):
        TRACES.append(1)
        return self.energy.residual(posed)


def walls_and_pull(rng) -> tuple[AbstractEnergy, AbstractEnergy]:
    pull = Linear(jnp.asarray(rng.normal(size=(8, 6))), jnp.asarray(2 * rng.normal(size=8)))
    return Bound(jnp.asarray(rng.normal(size=(5, 6))), jnp.asarray(rng.uniform(0.0, 0.3, 5))), pull


def test_other_numbers_are_not_traced_again(rng):
    body, traced = sliding_body(2), []
    for size in (0.1, 0.3):
        walls, pull = walls_and_pull(rng)
        solve_in_order([walls, Counted(pull)], body, random_pose(body.skeleton, rng, 0.1), damping=size)
        traced.append(len(TRACES))
    assert traced[0] > 0
    assert traced[0] == traced[1]


def test_a_step_is_one_of_the_solver_and_maps_over_poses(rng):
    body, groups = sliding_body(2), walls_and_pull(rng)
    starts = [random_pose(body.skeleton, rng, 0.1) for _ in range(4)]
    mapped = eqx.filter_jit(jax.vmap(lambda pose: priority_step(groups, body, pose)))(
        stack_poses(starts).poses
    )
    for k, start in enumerate(starts):
        once = step_(groups, body, start)
        np.testing.assert_allclose(mapped.translations[k], once.translations, atol=1e-9)
        solution = solve_in_order(groups, body, start, max_steps=1)
        np.testing.assert_allclose(solution.pose.translations, once.translations, atol=1e-12)
        before, after = values(groups, body, start), values(groups, body, once)
        assert after[0] <= before[0] + 1e-15
        assert after[0] < before[0] - 1e-15 or after[1] < before[1]


def test_single_precision_ends_there_too(rng):
    """Within 2e-4 of float64, which float64 constants around it do not change."""
    body, groups = sliding_body(2), walls_and_pull(rng)
    start = rest_pose(body.skeleton)
    low = jax.tree.map(
        lambda x: x.astype(jnp.float32) if eqx.is_inexact_array(x) else x, (groups, body, start)
    )
    single, double = solve_in_order(*low), solve_in_order(groups, body, start, **TIGHT)
    assert single.pose.translations.dtype == single.history.dtype == jnp.float32
    np.testing.assert_allclose(single.pose.translations, double.pose.translations, atol=2e-4)


def test_nothing_to_solve_and_what_is_not_a_number_are_told():
    with pytest.raises(ValueError, match="`groups` is empty"):
        solve_in_order((), BODY, REST)
    bad = landmarks_and_rest(REST, np.nan)
    with pytest.raises(ValueError, match="JointLandmarks: `targets` has NaN"):
        solve_in_order((limits(), bad), BODY, REST, max_steps=200)
    # where values are not known
    solved = eqx.filter_jit(lambda terms: solve_in_order(terms, BODY, REST, max_steps=200))((limits(), bad))
    assert solved.result == optx.RESULTS.nonfinite


def test_the_step_of_a_hierarchy_is_its_closed_form(rng):
    """Undamped, and so near that no step is shortened."""
    rows = [
        LinearSystem(jnp.asarray(1e-7 * rng.normal(size=r)), jnp.asarray(rng.normal(size=(r, 7))))
        for r in (2, 3, 9)
    ]
    systems = [(np.asarray(a), -np.asarray(r)) for r, a in rows]
    none = Damping(jnp.zeros(()), jnp.zeros(()))
    step = hierarchical_step(rows, none)
    np.testing.assert_allclose(step, lexicographic(systems, 7), rtol=1e-6, atol=1e-13)
    upper = LinearSystem(*(jnp.concatenate(arrays) for arrays in zip(*rows[:2], strict=True)))
    same, _ = constrained_step(
        rows, lambda d: LinearSystem(upper.residual + upper.jacobian @ d, upper.jacobian), none
    )
    np.testing.assert_allclose(same, step, atol=1e-15)


def test_a_derivative_is_refused(rng):
    target = random_pose(SKELETON, rng, 0.2)
    with pytest.raises(InputError, match="strict priorities have no derivative"):
        jax.grad(lambda w: solve_in_order([w * landmarks_and_rest(target)], BODY, REST).pose.scale)(1.0)
