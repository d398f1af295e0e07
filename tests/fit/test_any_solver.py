"""Other programs' solvers as independent checks of a minimum: optimistix by `solver=`, jaxopt and optax through a flat problem."""

import contextlib
import logging

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optax
import optimistix as optx
import pytest
from helpers import chain_body, random_pose

from jaxcap.body.body import pose_body
from jaxcap.body.pose import Motion
from jaxcap.energy.data.landmarks import VertexLandmarks
from jaxcap.energy.priors.reference_pose import RestPrior
from jaxcap.errors import InputError
from jaxcap.fit.flat_problems import flat_problem
from jaxcap.fit.pose_problem import PoseProblem
from jaxcap.fit.sequences.sequence_problem import SequenceEstimate, SequenceProblem
from jaxcap.fit.sequences.solve_sequence import solve_sequence
from jaxcap.fit.sequences.unknowns import Size
from jaxcap.fit.solve import solve
from jaxcap.fit.solvers.levenberg_marquardt import LevenbergMarquardt
from jaxcap.fit.uncertainty import uncertainty

with pytest.warns(DeprecationWarning, match="JAXopt is no longer maintained"):
    import jaxopt

BODY = chain_body()


@contextlib.contextmanager
def count_compiled():
    """The messages of JAX about programs that are compiled meanwhile."""
    found, handler = [], logging.Handler()
    handler.emit = lambda record: (
        found.append(record.getMessage()) if "Compiling" in record.getMessage() else None
    )
    logger = logging.getLogger("jax")
    logger.addHandler(handler)
    try:
        yield found
    finally:
        logger.removeHandler(handler)


TIGHT = {"rtol": 1e-12, "atol": 1e-12}


@pytest.fixture(scope="module")
def scene():
    """Noisy places of all vertices in a pose near enough for solvers without a trust region."""
    rng = np.random.default_rng(5)
    truth = random_pose(BODY.skeleton, rng, 0.3)
    places = pose_body(BODY, truth).vertices + 0.01 * rng.normal(size=BODY.vertices.shape)
    energy = VertexLandmarks(jnp.arange(len(places)), places, jnp.ones(len(places))) + 0.1 * RestPrior(
        jnp.ones((BODY.skeleton.num_joints, 3))
    )
    start = random_pose(BODY.skeleton, rng, 0.1)
    found = eqx.filter_jit(solve)(energy, BODY, start, LevenbergMarquardt(rtol=0.0, atol=1e-13))
    return energy, start, found


def energy_of(energy, pose) -> float:
    r = energy.residual(pose_body(BODY, pose))
    return float(r @ r)


@pytest.mark.parametrize(
    "solver",
    [optx.Dogleg(**TIGHT), optx.LevenbergMarquardt(**TIGHT), optx.GaussNewton(**TIGHT), optx.BFGS(**TIGHT)],
    ids=lambda solver: type(solver).__name__,
)
def test_solvers_of_optimistix_find_the_minimum(scene, solver):
    energy, start, known = scene
    found = eqx.filter_jit(solve)(energy, BODY, start, solver, 1000)
    assert energy_of(energy, found.pose) == pytest.approx(energy_of(energy, known.pose), rel=1e-8)
    np.testing.assert_allclose(
        pose_body(BODY, found.pose).joints, pose_body(BODY, known.pose).joints, atol=1e-5
    )


@pytest.mark.parametrize("name", ["LevenbergMarquardt", "LBFGS"])
def test_solvers_of_jaxopt_find_the_minimum_in_a_flat_problem(scene, name):
    energy, start, known = scene
    flat = flat_problem(PoseProblem(energy, BODY), start)

    @eqx.filter_jit
    def run(flat):
        if name == "LevenbergMarquardt":
            solver = jaxopt.LevenbergMarquardt(flat.residual, maxiter=40, tol=1e-12)
        else:
            solver = jaxopt.LBFGS(flat.value, maxiter=150, tol=1e-12)
        return flat.recentred(solver.run(flat.start).params)

    for _ in range(2):
        flat = run(flat)
    assert energy_of(energy, flat.centre) == pytest.approx(energy_of(energy, known.pose), rel=1e-7)


def test_optax_finds_the_minimum_in_a_flat_problem(scene):
    energy, start, known = scene
    flat = flat_problem(PoseProblem(energy, BODY), start)
    solver = optax.lbfgs()

    @jax.jit
    def run(flat):
        function = optax.value_and_grad_from_state(flat.value)

        def step(carry, _):
            d, state = carry
            value, slope = function(d, state=state)
            change, state = solver.update(slope, state, d, value=value, grad=slope, value_fn=flat.value)
            return (optax.apply_updates(d, change), state), None

        (d, _), _ = jax.lax.scan(step, (flat.start, solver.init(flat.start)), length=120)
        return flat.recentred(d)

    for _ in range(3):
        flat = run(flat)
    assert energy_of(energy, flat.centre) == pytest.approx(energy_of(energy, known.pose), rel=1e-7)


def test_a_sequence_is_solved_by_another_solver(scene):
    energy, start, _ = scene
    problem = SequenceProblem(BODY, energy, jnp.arange(1.0), {"size": Size()})
    poses = jax.tree.map(lambda leaf: leaf[None], start)
    ours, theirs = (
        solve_sequence(problem, poses, solver, 200)
        for solver in (LevenbergMarquardt(rtol=0.0, atol=1e-12), optx.LevenbergMarquardt(**TIGHT))
    )
    assert float(theirs.energy) == pytest.approx(float(ours.energy), rel=1e-9)
    np.testing.assert_allclose(theirs.values["size"], ours.values["size"], atol=1e-6)


@pytest.mark.parametrize("linear_solver", [lx.CG(1e-9, 1e-9), lx.Cholesky()], ids=["CG", "Cholesky"])
def test_a_sequence_is_solved_by_linear_solvers_of_lineax(scene, linear_solver):
    energy, start, _ = scene
    problem = SequenceProblem(BODY, energy, jnp.arange(1.0), {"size": Size()})
    poses = jax.tree.map(lambda leaf: leaf[None], start)
    ours, theirs = (
        solve_sequence(problem, poses, LevenbergMarquardt(1e-10, 1e-9, linear_solver=chosen), 60)
        for chosen in (None, linear_solver)
    )
    assert float(theirs.energy) == pytest.approx(float(ours.energy), rel=1e-8)
    bounded = SequenceProblem(BODY, energy, jnp.arange(1.0), {"size": Size(0.9, 1.02)})
    with pytest.raises(InputError, match="LevenbergMarquardt does not support constraints"):
        solve_sequence(bounded, poses, LevenbergMarquardt(linear_solver=linear_solver))
    still = SequenceProblem(BODY, energy, jnp.arange(1.0), {"size": Size()}, fixed=jnp.ones(1, bool))
    with pytest.raises(InputError, match="solves equations without constraints"):
        solve_sequence(still, poses, LevenbergMarquardt(linear_solver=linear_solver))
    with pytest.raises(InputError, match="`relative` damps normal equations, which QR"):
        LevenbergMarquardt(linear_solver=lx.QR(), relative=True)
    with pytest.raises((InputError, TypeError), match="linear_solver"):
        LevenbergMarquardt(linear_solver="cg")


def test_a_class_in_place_of_an_unknown_and_a_wrong_variance_are_refused(scene):
    energy, start, found = scene
    poses = jax.tree.map(lambda leaf: leaf[None], start)
    with pytest.raises((InputError, TypeError), match="Size"):
        solve_sequence(SequenceProblem(BODY, energy, jnp.arange(1.0), {"size": Size}), poses)
    with pytest.raises(InputError, match="`variance` is -1; expected a finite number above 0"):
        uncertainty(energy, BODY, found.pose, variance=-1.0)


def test_a_start_without_an_unknown_is_refused(scene):
    energy, start, _ = scene
    poses = jax.tree.map(lambda leaf: leaf[None], start)
    problem = SequenceProblem(BODY, energy, jnp.arange(1.0), {"size": Size()})
    for solve_or_flatten in (solve_sequence, flat_problem):
        with pytest.raises(
            InputError, match="the values are of nothing; expected those of the unknowns size"
        ):
            solve_or_flatten(problem, SequenceEstimate(poses, {}))
        with pytest.raises(InputError, match=r"the value of 'size' has the shape \(2,\); expected \(\)"):
            solve_or_flatten(problem, SequenceEstimate(poses, {"size": jnp.zeros(2)}))


def test_a_flat_sequence_starts_from_a_motion(scene):
    energy, start, _ = scene
    problem = SequenceProblem(BODY, energy, jnp.arange(1.0), {"size": Size()})
    poses = jax.tree.map(lambda leaf: leaf[None], start)
    ours = solve_sequence(problem, poses, LevenbergMarquardt(rtol=0.0, atol=1e-12))
    flat = flat_problem(problem, Motion(poses, 30.0))
    assert flat.value(flat.start) == flat_problem(problem, poses).value(flat.start)
    solver = jaxopt.LBFGS(flat.value, maxiter=300, tol=1e-12)
    found = flat.to_manifold(eqx.filter_jit(solver.run)(flat.start).params)
    np.testing.assert_allclose(found.values["size"], ours.values["size"], atol=1e-4)
    with pytest.raises(InputError, match="1 in `times`"):
        flat_problem(problem, jax.tree.map(lambda leaf: jnp.stack([leaf] * 2), start))


def test_a_pose_is_solved_on_divided_devices(scene):
    energy, start, known = scene
    starts = jax.tree.map(lambda leaf: leaf[None], start)
    mesh = jax.sharding.Mesh(np.array(jax.devices()[:1]), ("batch",))
    part = jax.sharding.PartitionSpec("batch")

    def of_device(starts):
        return jax.lax.map(lambda one: solve(energy, BODY, one).pose, starts)

    found = jax.jit(jax.shard_map(of_device, mesh=mesh, in_specs=part, out_specs=part, check_vma=False))(
        starts
    )
    np.testing.assert_allclose(found.rotations[0], known.pose.rotations, atol=1e-4)


def test_what_is_no_solver_is_told(scene):
    energy, start, _ = scene
    with pytest.raises((InputError, TypeError), match="Newton"):
        solve(energy, BODY, start, optx.Newton(**TIGHT))


def test_flat_problems_refuse_what_they_would_ignore(scene):
    energy, start, _ = scene
    poses = jax.tree.map(lambda leaf: leaf[None], start)
    bounded = SequenceProblem(BODY, energy, jnp.arange(1.0), {"size": Size(0.9, 1.02)})
    with pytest.raises(InputError, match="bounds of the unknown 'size', which a flat problem would ignore"):
        flat_problem(bounded, poses)
    beyond = VertexLandmarks(jnp.array([99999]), jnp.zeros((1, 3)), jnp.ones(1))
    with pytest.raises(InputError, match="`vertices` has 99999"):
        flat_problem(PoseProblem(beyond, BODY), start)
    with pytest.raises(InputError, match="not the pose of one frame"):
        flat_problem(PoseProblem(energy, BODY), poses)


def test_a_sequence_is_compiled_once(scene):
    energy, start, _ = scene
    poses = jax.tree.map(lambda leaf: leaf[None], start)
    problem = SequenceProblem(BODY, energy, jnp.arange(1.0), {"size": Size()})
    solve_sequence(problem, poses)
    with jax.log_compiles(), count_compiled() as compiled:
        solve_sequence(eqx.tree_at(lambda p: p.times, problem, jnp.ones(1)), poses)
    assert compiled == []


def test_stacked_starts_and_no_steps_are_refused(scene):
    energy, start, _ = scene
    with pytest.raises(InputError, match="`start` has 1 frames"):
        solve(energy, BODY, jax.tree.map(lambda leaf: leaf[None], start))
    with pytest.raises(InputError, match="`max_steps` is 0"):
        solve(energy, BODY, start, max_steps=0)


def test_data_of_another_precision_are_converted(scene):
    energy, start, known = scene
    single = jax.tree.map(
        lambda leaf: leaf.astype(jnp.float32) if eqx.is_inexact_array(leaf) else leaf, energy
    )
    found = solve(single, BODY, start)
    assert found.pose.rotations.dtype == BODY.vertices.dtype
    assert energy_of(energy, found.pose) == pytest.approx(energy_of(energy, known.pose), rel=1e-4)
