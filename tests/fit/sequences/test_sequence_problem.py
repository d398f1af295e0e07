"""Sequences with shared unknowns against dense problems, and their derivatives against central differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from helpers import chain_body, random_pose
from jax.flatten_util import ravel_pytree

from jaxcap.body.body import Posed, pose_body
from jaxcap.body.pose import Pose, rest_pose
from jaxcap.energy.data.landmarks import VertexLandmarks, joint_landmarks
from jaxcap.energy.energy import AbstractEnergy
from jaxcap.energy.priors.reference_pose import RestPrior
from jaxcap.energy.stacked import SmoothRotations, Stacked, stack_energies
from jaxcap.errors import InputError
from jaxcap.fit.sequences.sequence_problem import SequenceEstimate, SequenceProblem
from jaxcap.fit.sequences.solve_sequence import solve_sequence
from jaxcap.fit.sequences.uncertainty import describe_sequence, sequence_uncertainty
from jaxcap.fit.sequences.unknowns import JointCentres, RestVertices, Size
from jaxcap.fit.solvers.gauss_newton import GaussNewton
from jaxcap.fit.solvers.levenberg_marquardt import LevenbergMarquardt

BODY = chain_body()
FRAMES = 5
TIGHT = LevenbergMarquardt(rtol=0.0, atol=1e-13)


class NearHeight(AbstractEnergy):
    """Some vertices that are to be at a height: a user's own term."""

    vertices: jax.Array
    height: jax.Array

    def residual(self, posed: Posed):
        return posed.vertices[self.vertices, 1] - self.height


def stacked(poses: list[Pose]) -> Pose:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *poses)


@pytest.fixture(scope="module")
def scene():
    """Noisy landmarks of a chain that is 10 % larger, with a joint elsewhere, in five poses."""
    rng = np.random.default_rng(3)
    poses = [random_pose(BODY.skeleton, rng, 0.4) for _ in range(FRAMES)]
    unknowns = {"size": Size(), "centres": JointCentres(joints=(1, 2))}
    truth = {"size": jnp.asarray(0.1), "centres": jnp.asarray(0.02 * rng.normal(size=(2, 3)))}
    body = SequenceProblem(
        BODY, RestPrior(jnp.ones((BODY.skeleton.num_joints, 3))), jnp.arange(5.0), unknowns
    ).body_at(truth)
    marks = []
    for pose in poses:
        places = pose_body(body, pose).vertices
        places = places + 0.003 * rng.normal(size=places.shape)
        weights = jnp.asarray(rng.uniform(0.5, 1.5, len(places)))
        marks.append(VertexLandmarks(jnp.arange(len(places)), places, weights))
    frames = stack_energies(marks) + 0.01 * NearHeight(jnp.array([0, 3]), jnp.asarray(0.1))
    between = (SmoothRotations(jnp.asarray(0.003)),)
    problem = SequenceProblem(
        BODY,
        frames,
        jnp.asarray([0.0, 1, 2, 4, 5]),
        unknowns,
        between,
        (0.01 * NearHeight(jnp.array([1]), jnp.asarray(0.0)),),
    )
    return problem, stacked(poses), truth


solve_ = eqx.filter_jit(solve_sequence)


def test_normal_equations_are_those_of_the_dense_rows(scene):
    problem, poses, _ = scene
    y = problem.start(poses)
    residual, jacobian = problem.linearise(y)
    value, gradient, hessian = eqx.filter_jit(problem.normal_equations)(y)
    np.testing.assert_allclose(value, 0.5 * residual @ residual, rtol=1e-12)
    np.testing.assert_allclose(problem.value(y), value, rtol=1e-12)
    np.testing.assert_allclose(ravel_pytree(gradient)[0], jacobian.T @ residual, atol=1e-10)
    np.testing.assert_allclose(hessian.as_matrix(), jacobian.T @ jacobian, atol=1e-9)
    x = jax.tree.map(lambda leaf: jnp.cos(jnp.arange(leaf.size * 1.0)).reshape(leaf.shape), gradient)
    damped = hessian.add_diagonal(jax.tree.map(lambda d: 0.01 * jnp.ones_like(d), hessian.diagonal()))
    expected = np.linalg.solve(
        np.asarray(jacobian.T @ jacobian) + 0.01 * np.eye(jacobian.shape[1]), ravel_pytree(x)[0]
    )
    np.testing.assert_allclose(ravel_pytree(damped.factorise().solve(x))[0], expected, rtol=1e-7, atol=1e-9)


def test_minimum_is_that_of_a_dense_solver(scene):
    problem, poses, truth = scene
    found = solve_(problem, problem.start(poses), TIGHT)
    dense = solve_(problem, problem.start(poses), GaussNewton(damping=1e-12, rtol=0.0, atol=1e-13))
    assert found.result == optx.RESULTS.successful and found.trustworthy
    np.testing.assert_allclose(found.energy, dense.energy, rtol=1e-8)
    np.testing.assert_allclose(ravel_pytree(found.values)[0], ravel_pytree(dense.values)[0], atol=1e-7)
    assert abs(float(found.values["size"] - truth["size"])) < 0.01
    assert not solve_(problem, problem.start(poses), TIGHT, 1).trustworthy


def test_a_term_of_ones_own_moves_what_it_should(scene):
    problem, poses, _ = scene
    low = solve_(problem, poses, TIGHT)
    high = solve_(
        eqx.tree_at(lambda p: p.frames.terms[1].energy.height, problem, jnp.asarray(0.5)), poses, TIGHT
    )
    rise = jax.vmap(lambda body, pose: pose_body(body, pose).vertices[jnp.array([0, 3]), 1], (None, 0))
    assert (rise(high.body, high.poses).mean() - rise(low.body, low.poses).mean()) > 1e-4


def test_derivatives_by_weights_data_and_body_against_differences(scene):
    problem, poses, _ = scene
    start = problem.start(poses)

    @eqx.filter_jit
    def value(numbers):
        weight, datum, gap, corner = numbers
        there = eqx.tree_at(
            lambda p: (
                p.frames.terms[1].weight,
                p.frames.terms[0].energy.targets,
                p.between[0].weight,
                p.body.vertices,
            ),
            problem,
            (
                weight,
                problem.frames.terms[0].energy.targets.at[2, 1, 0].add(datum),
                gap,
                problem.body.vertices.at[4, 1].add(corner),
            ),
        )
        solution = solve_sequence(there, start, TIGHT)
        return jnp.stack(
            [
                solution.values["size"],
                solution.values["centres"][0, 1],
                solution.poses.rotations[1, 1, 0],
                10 * solution.energy,
            ]
        )

    numbers = jnp.asarray([0.01, 0.0, 0.003, 0.0])
    forward = jax.jacfwd(value)(numbers)
    reverse = jax.jacrev(value)(numbers)
    # of fourth order, so that steps may be long: a minimum is known to about 1e-11
    steps = jnp.diag(jnp.asarray([1e-3, 1e-3, 1e-4, 1e-3]))
    differences = [
        (8 * (value(numbers + h) - value(numbers - h)) - value(numbers + 2 * h) + value(numbers - 2 * h))
        / (12 * h.sum())
        for h in steps
    ]
    scale = np.abs(forward).max(0)
    np.testing.assert_allclose(np.asarray(forward) / scale, np.stack(differences, 1) / scale, atol=1e-6)
    np.testing.assert_allclose(reverse, forward, rtol=1e-7, atol=1e-9 * scale.max())


def test_rest_vertices_are_found(scene):
    _, poses, _ = scene
    shifted = eqx.tree_at(
        lambda b: b.vertices, BODY, BODY.vertices.at[3].add(jnp.asarray([0.01, -0.02, 0.03]))
    )
    marks = [
        VertexLandmarks(
            jnp.arange(len(BODY.vertices)), pose_body(shifted, pose).vertices, jnp.ones(len(BODY.vertices))
        )
        for pose in [jax.tree.map(lambda leaf, i=i: leaf[i], poses) for i in range(FRAMES)]
    ]
    # without noise, from rest
    asked = SequenceProblem(
        BODY, stack_energies(marks), jnp.arange(5.0), {"rest": RestVertices(vertices=(3,))}
    )
    found = solve_(asked, stacked([rest_pose(BODY.skeleton)] * FRAMES), TIGHT)
    np.testing.assert_allclose(found.values["rest"], [[0.01, -0.02, 0.03]], atol=1e-6)


def test_what_does_not_go_together_is_a_sentence(scene):
    problem, poses, _ = scene
    with pytest.raises(InputError, match="4 in `poses`, 5 in `times`, and 5 in stacked energies"):
        solve_sequence(problem, jax.tree.map(lambda leaf: leaf[:4], poses))
    few = jax.tree.map(lambda leaf: leaf[:2], poses)
    with pytest.raises(InputError, match="2 frames were given, but an energy between frames needs 3"):
        solve_sequence(
            SequenceProblem(
                BODY, RestPrior(jnp.ones((BODY.skeleton.num_joints, 3))), jnp.arange(2.0), {}, problem.between
            ),
            few,
        )
    with pytest.raises(InputError, match="`solver` is a Newton; expected"):
        solve_sequence(problem, poses, optx.Newton(1e-3, 1e-3))
    for unknown, sentence in (
        (JointCentres(joints=(2,)), "no energy depends on the unknown 'part'"),
        (Size(1.2, 0.9), "bounds of the unknown 'part' are crossed: .* component 0 is at least"),
    ):
        near = RestPrior(jnp.ones((BODY.skeleton.num_joints, 3)))
        near = (
            near if isinstance(unknown, JointCentres) else near + NearHeight(jnp.array([1]), jnp.asarray(0.0))
        )
        with pytest.raises(InputError, match=sentence):
            solve_sequence(SequenceProblem(BODY, near, jnp.arange(5.0), {"part": unknown}), poses)
    with pytest.raises(InputError, match="differs from that of frame 0"):
        stack_energies(
            [RestPrior(jnp.ones((BODY.skeleton.num_joints, 3))), NearHeight(jnp.array([1]), jnp.asarray(0.0))]
        )
    with pytest.raises(InputError, match="expected one energy for each frame"):
        stack_energies([])
    with pytest.raises(InputError, match="the data of VertexLandmarks belong to several frames"):
        problem.frames.terms[0].residual(pose_body(BODY, rest_pose(BODY.skeleton)))
    assert isinstance(problem.frames.terms[0], Stacked)


def test_uncertainty_is_the_inverse_of_all_equations(scene):
    """Block by block, where everything is held."""
    problem, poses, _ = scene
    found = solve_(problem, poses, TIGHT)
    known = sequence_uncertainty(problem, found, variance=0.5)
    dense = 0.5 * np.linalg.inv(np.asarray(_hessian(problem, found)))
    dofs = BODY.skeleton.num_dofs
    last = FRAMES * dofs
    np.testing.assert_allclose(known.shared, dense[last:, last:], rtol=1e-6, atol=1e-12)
    for frame in range(FRAMES):
        block = slice(frame * dofs, (frame + 1) * dofs)
        np.testing.assert_allclose(known.poses[frame], dense[block, block], rtol=1e-6, atol=1e-12)
    assert describe_sequence(problem, known) == []
    assert known.names == ("centres[0]", *(f"centres[{n}]" for n in range(1, 6)), "size[0]")


def test_what_nothing_shows_is_described(scene):
    """The size where joints may go anywhere and only they are seen; a joint in one frame."""
    problem, poses, _ = scene
    joints = tuple(range(1, BODY.skeleton.num_joints))
    centres = pose_body(BODY, rest_pose(BODY.skeleton)).joints
    free = SequenceProblem(
        BODY,
        joint_landmarks(centres),
        problem.times,
        {"size": Size(), "centres": JointCentres(joints=joints)},
    )
    found = solve_sequence(free, poses, LevenbergMarquardt(), 5)
    lines = describe_sequence(free, sequence_uncertainty(free, found))
    assert any("size[0]" in line for line in lines)
    assert any(line.endswith("in any frame.") and BODY.skeleton.names[-1] in line for line in lines)


@eqx.filter_jit
def _hessian(problem, found):
    return problem.normal_equations(SequenceEstimate(found.poses, found.values))[2].as_matrix()
