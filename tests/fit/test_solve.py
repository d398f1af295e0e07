"""The solvers against linear algebra, each other, and central differences of whole solves."""

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
import pytest
from helpers import SKINS, chain_body, random_pose
from jaxtyping import Array, Float

from jaxcap.body.body import pose_body
from jaxcap.body.pose import Pose, rest_pose
from jaxcap.body.retraction import difference, project, retract
from jaxcap.energy.data.landmarks import BoneLandmarks, VertexLandmarks
from jaxcap.energy.data.points import PointToPlane, PointToPoint
from jaxcap.energy.data.sufficient_statistics import rigid_moments
from jaxcap.energy.energy import Sum
from jaxcap.energy.priors.joint_limits import JointLimits
from jaxcap.energy.priors.reference_pose import PosePrior, RestPrior
from jaxcap.fit.linear_solvers.dense import DenseMatrix
from jaxcap.fit.linearise import linearise
from jaxcap.fit.solve import solve
from jaxcap.fit.solvers.descent import ConstrainedInfo
from jaxcap.fit.solvers.gauss_newton import GaussNewton, damped_step
from jaxcap.fit.solvers.least_squares_problem import AbstractDenseProblem
from jaxcap.fit.solvers.levenberg_marquardt import LevenbergMarquardt
from jaxcap.fit.solvers.minimise import minimise
from jaxcap.limits.ranges_and_cones import Cone, make_joint_ranges

BODY = chain_body()
SKELETON = BODY.skeleton
ALL = jnp.arange(len(BODY.vertices))
TIGHT = {"rtol": 1e-14, "atol": 1e-11}
LM, GN = LevenbergMarquardt(**TIGHT), GaussNewton(damping=1e-13, **TIGHT)
TRACES: list[int] = []


def counted(energy, body, start, solver):
    TRACES.append(1)
    return solve(energy, body, start, solver)


# few settings and shapes in this file, for each is compiled
solve_ = eqx.filter_jit(counted)
minimise_ = eqx.filter_jit(minimise)
pose_body_, linearise_ = eqx.filter_jit(pose_body), eqx.filter_jit(linearise)


def landmarks(pose: Pose, rng=None, noise: float = 0.0) -> VertexLandmarks:
    """Every vertex of the chain where `pose` puts it, or about there."""
    targets = pose_body_(BODY, pose).vertices
    if rng is not None:
        targets = targets + noise * rng.normal(size=targets.shape)
    return VertexLandmarks(ALL, targets, jnp.ones(len(ALL)))


def apart(a: Pose, b: Pose) -> float:
    return float(jnp.abs(difference(SKELETON, a, b)).max())


class Linear(AbstractDenseProblem[Array]):
    """`|A y - b|^2` over plain vectors, with unknowns in different units."""

    matrix: Float[Array, "R D"]
    target: Float[Array, "R"]
    units: Float[Array, "D"]

    def residual(self, y):
        return self.matrix @ y - self.target

    def linearise(self, y):
        return self.residual(y), self.matrix

    def information(self, y):
        residual, jacobian = self.linearise(y)
        scaled = jacobian * self.units
        return ConstrainedInfo(
            0.5 * (residual @ residual), scaled.T @ residual, DenseMatrix(scaled.T @ scaled)
        )

    def retract(self, y, d):
        return y + d

    def scales(self):
        return self.units


def test_a_linear_problem_takes_one_undamped_step(rng):
    problem = Linear(
        *(jnp.asarray(rng.normal(size=shape)) for shape in ((9, 4), 9)), jnp.asarray([0.3, 1, 1, 5])
    )
    best, least = np.linalg.lstsq(problem.matrix, problem.target)[:2]
    start = jnp.asarray(rng.normal(size=4))
    once = minimise_(problem, start, GaussNewton(damping=0.0), 1)
    np.testing.assert_allclose(once.y, best, atol=1e-12)
    # one step is all it had: there was none left to see that it is at rest
    assert once.result == optx.RESULTS.nonlinear_max_steps_reached
    damped = minimise_(problem, start, LM, 64)
    assert damped.result == optx.RESULTS.successful
    np.testing.assert_allclose(damped.y, best, atol=1e-9)
    history = np.asarray(damped.history)
    history = history[np.isfinite(history)]
    assert (np.diff(history) <= 1e-14).all()
    assert history[-1] == pytest.approx(float(least[0]), rel=1e-12)


def test_gauss_newton_converges_quadratically_where_nothing_is_left_over(rng):
    """At zero residual the error is squared with every step: the order of the last steps is two."""
    truth = random_pose(SKELETON, rng, 0.4)
    solution = solve_(landmarks(truth), BODY, rest_pose(SKELETON), GN)
    assert apart(solution.pose, truth) < 1e-12
    error = np.sqrt(np.asarray(solution.history)[: int(solution.num_steps)])
    # between the far steps and the rounding errors of float64
    asymptotic = np.flatnonzero((error < 0.3) & (error > 1e-13))
    orders = [np.log(error[k + 1]) / np.log(error[k]) for k in asymptotic if error[k + 1] > 1e-13]
    assert len(orders) >= 2
    assert orders[-1] > 1.75


def test_both_solvers_find_the_same_minimum_and_so_does_qr(rng):
    """Of landmarks that no pose reaches, at which the gradient vanishes."""
    energy = landmarks(random_pose(SKELETON, rng, 0.4), rng, 0.02)
    solvers = [LM, LevenbergMarquardt(linear_solver=lx.QR(), **TIGHT), GN]
    found = [solve_(energy, BODY, rest_pose(SKELETON), solver) for solver in solvers]
    for solution in found:
        assert solution.result == optx.RESULTS.successful
        residual, jacobian = linearise_(energy, BODY, solution.pose)
        np.testing.assert_allclose(jacobian.T @ residual, 0.0, atol=1e-7)
        assert float(solution.energies["VertexLandmarks"]) == pytest.approx(
            float(residual @ residual), rel=1e-12
        )
        history = np.asarray(solution.history)
        assert np.nanmin(history) == pytest.approx(float(residual @ residual), rel=1e-12)
        assert (np.diff(history[np.isfinite(history)]) <= 1e-15).all()
        assert apart(solution.pose, found[0].pose) < 1e-6


def test_a_large_damping_gives_the_direction_of_the_gradient(rng):
    residual, jacobian = jnp.asarray(rng.normal(size=12)), jnp.asarray(rng.normal(size=(12, 5)))
    downhill = -jacobian.T @ residual
    step, _ = damped_step(residual, jacobian, jnp.full(5, 1e9))
    np.testing.assert_allclose(step * 1e9, downhill, rtol=1e-7)
    newton, _ = damped_step(residual, jacobian, jnp.zeros(5))
    np.testing.assert_allclose(newton, np.linalg.lstsq(jacobian, -residual)[0], rtol=1e-11)


def dependent(rng, size: float) -> Linear:
    """Sixty unknowns of which five are determined, so heavy that a damping of one is less than rounding."""
    matrix = size * rng.normal(size=(200, 5)) @ rng.normal(size=(5, 60))
    return Linear(jnp.asarray(matrix), jnp.asarray(matrix @ rng.normal(size=60)), jnp.ones(60))


@pytest.mark.float32
def test_equations_that_rounding_makes_singular_are_damped_until_they_are_solved(rng):
    eps = float(jnp.finfo(jnp.result_type(float)).eps)
    problem, start = dependent(rng, eps**-0.5), jnp.zeros(60)
    assert not jnp.isfinite(jnp.linalg.cholesky(problem.matrix.T @ problem.matrix)).all()
    found = minimise_(problem, start, LevenbergMarquardt(), 64)
    assert found.result == optx.RESULTS.successful
    left = np.linalg.norm(problem.residual(found.y)) / np.linalg.norm(problem.target)
    assert left < 100 * eps


@pytest.mark.float32
def test_equations_that_nothing_solves_are_told(rng):
    """Columns whose squares overflow have no factors, whatever the processor's rounding."""
    size = float(jnp.sqrt(jnp.finfo(jnp.result_type(float)).max))
    matrix = size * jnp.asarray(rng.normal(size=(200, 60)))
    problem, start = Linear(matrix, jnp.asarray(rng.normal(size=200)), jnp.ones(60)), jnp.zeros(60)
    for solver in (LevenbergMarquardt(), GaussNewton()):
        found = minimise_(problem, start, solver, 64)
        assert found.result == optx.RESULTS.singular


def every_term(rng) -> Sum:
    """One of every energy, those over vertices first, some of them weighted, and sums in sums."""
    chosen = jnp.asarray(rng.integers(0, len(ALL), 10))
    points = BODY.vertices[chosen] + 0.1 * jnp.asarray(rng.normal(size=(10, 3)))
    normals, weights = jnp.asarray(rng.normal(size=(10, 3))), jnp.asarray(rng.uniform(size=10)).at[2].set(0)
    bones = BODY.skin.dominant_bones()[chosen]
    ranges = make_joint_ranges(
        SKELETON, {"elbow": (-0.1, 0.1)}, {"hand": Cone((1, 0, 0), 0.1, (0, 1, 0), 0.1)}
    )
    return (
        PointToPoint(chosen, points, weights)
        + 3.0 * PointToPlane(chosen, points, normals, weights)
        + 0.5 * VertexLandmarks(chosen, points, weights)
        + 0.3 * (PointToPlane(chosen, points, normals, weights) + PointToPoint(chosen, points, weights))
        + 0.2 * (0.1 * PointToPoint(chosen, points, weights))
        + 2.0 * BoneLandmarks(bones, BODY.vertices[chosen], points, weights)
        + rigid_moments(bones, BODY.vertices[chosen], points, weights, SKELETON.num_joints)
        + JointLimits(ranges)
        + PosePrior(random_pose(SKELETON, rng), jnp.full(SKELETON.num_dofs, 0.7))
        + RestPrior(jnp.full((SKELETON.num_joints, 3), 0.4))
    )


@eqx.filter_jit
def by_autodiff(energy, body, pose):
    def residual(d):
        return energy.residual(pose_body(body, retract(body.skeleton, pose, d)))

    zero = jnp.zeros(body.skeleton.num_dofs)
    return residual(zero), jax.jacfwd(residual)(zero)


@pytest.mark.parametrize("skin", SKINS)
def test_linearise_is_autodiff_of_the_whole_residual(rng, skin):
    body, energy = chain_body(skin), every_term(rng)
    if skin != "linear":
        energy = Sum(energy.terms[:7])
    for pose in (rest_pose(SKELETON), random_pose(SKELETON, rng, 0.8, scale=1.3)):
        found, expected = linearise_(energy, body, pose), by_autodiff(energy, body, pose)
        np.testing.assert_allclose(found[0], expected[0], atol=1e-12)
        np.testing.assert_allclose(found[1], expected[1], rtol=0, atol=1e-11)


WEIGHTS = jnp.asarray(np.random.default_rng(5).uniform(0.2, 2.0, len(ALL)))
READ = jnp.asarray(np.random.default_rng(6).normal(size=(SKELETON.num_joints, 7)))


def pose_of(parameters):
    """The energy and the body that the parameters make, and the pose of least energy."""
    # axes are directions: only what turns them counts
    axes = parameters["axes"]
    axes = axes / jnp.linalg.norm(axes, axis=-1, keepdims=True)
    body = eqx.tree_at(
        lambda body: (body.vertices, body.skeleton.centres, body.skeleton.axes),
        BODY,
        (parameters["vertices"], parameters["centres"], axes),
    )
    rest = RestPrior(jnp.full((SKELETON.num_joints, 3), 0.8))
    energy = (
        VertexLandmarks(ALL, parameters["targets"], parameters["weights"]) + parameters["strength"] * rest
    )
    return energy, body, solve(energy, body, rest_pose(SKELETON), LM).pose


def read(pose: Pose):
    return jnp.sum(READ * jnp.concatenate([pose.translations, pose.rotations], 1))


@eqx.filter_jit
def read_out(parameters):
    """A number made of the pose that the parameters lead to, and the gradient through `solve`.

    The number is that of a pose that is polished: a solver compares energies, which rounding
    blurs within 1e-8 of a minimum, too coarse for differences of its poses.
    """

    def plain(parameters):
        energy, body, pose = pose_of(parameters)

        def polish(_, pose):
            step, _ = damped_step(*linearise(energy, body, pose), jnp.zeros(SKELETON.num_dofs))
            return retract(body.skeleton, pose, step)

        return read(pose), read(jax.lax.fori_loop(0, 40, polish, jax.lax.stop_gradient(pose)))

    (_, polished), gradient = jax.value_and_grad(plain, has_aux=True)(parameters)
    return polished, gradient


@pytest.mark.slow
def test_gradients_through_solve_against_central_differences(rng):
    """By the implicit function theorem, to data, weights and the body, where much is left over."""
    parameters = {
        "targets": landmarks(random_pose(SKELETON, rng, 0.4), rng, 0.03).targets,
        "weights": WEIGHTS,
        "strength": jnp.asarray(0.05),
        "vertices": BODY.vertices,
        "centres": SKELETON.centres,
        "axes": SKELETON.axes,
    }
    _, gradient = read_out(parameters)
    step = 2e-5
    for name, value in parameters.items():
        direction = jnp.asarray(rng.normal(size=value.shape)) / np.sqrt(value.size)
        ahead, behind = (
            float(read_out({**parameters, name: value + side * step * direction})[0]) for side in (1, -1)
        )
        numeric, analytic = (ahead - behind) / (2 * step), float(jnp.sum(gradient[name] * direction))
        assert abs(numeric) > 1e-4, f"{name} has no influence here"
        assert analytic == pytest.approx(numeric, rel=1e-6, abs=1e-9), name


@pytest.mark.parametrize("solver", [LM, GN], ids=lambda solver: type(solver).__name__)
def test_a_failing_solve_is_told_and_raises_nothing(rng, solver):
    energy = landmarks(random_pose(SKELETON, rng, 0.4))
    good = solve_(energy, BODY, rest_pose(SKELETON), solver)
    assert good.result == optx.RESULTS.successful
    bad = eqx.tree_at(lambda e: e.targets, energy, energy.targets.at[3, 1].set(jnp.nan))
    assert solve_(bad, BODY, rest_pose(SKELETON), solver).result != optx.RESULTS.successful


def test_a_start_that_the_joints_do_not_allow_is_projected(rng):
    wild = jnp.asarray(rng.normal(size=(SKELETON.num_joints, 4)))
    wild = eqx.tree_at(lambda pose: pose.rotations, rest_pose(SKELETON), wild)
    solution = solve_(landmarks(random_pose(SKELETON, rng, 0.4)), BODY, wild, GN)
    assert apart(solution.pose, project(SKELETON, solution.pose)) < 1e-12
    fixed = SKELETON.index("tool")
    np.testing.assert_allclose(solution.pose.rotations[fixed], [1, 0, 0, 0], atol=1e-15)
    assert not np.any(solution.pose.translations[fixed])


def test_solves_of_the_same_shapes_are_traced_once(rng):
    traced = []
    for size in (0.1, 0.2, 0.3):
        target, start = (random_pose(SKELETON, rng, size) for _ in range(2))
        solve_(landmarks(target), chain_body(), start, GaussNewton(damping=1e-13, **TIGHT))
        traced.append(len(TRACES))
    assert traced[0] > 0
    assert traced[0] == traced[-1]
