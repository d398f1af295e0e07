"""Poses, joints and vertices in one step: against dense least squares, its slope against differences."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from adapt_scene import make_scene, task_of
from helpers import chain_body, random_pairs, random_pose

import jaxcap as jc
from jaxcap.adapt.adapt_round import adapt_round, gauss_newton_step
from jaxcap.adapt.objective import PAIRS_PER_MEASUREMENT, CoefficientPrior, PoseTerms, shared_problem
from jaxcap.adapt.poses.pair_cache import make_pair_cache
from jaxcap.adapt.shape.shape_prior import body_shape_prior
from jaxcap.adapt.shape.vertex_adaptation import adapt_shape, adapt_together
from jaxcap.adapt.task import AdaptSettings, AdaptState, Stage
from jaxcap.body.retraction import retract
from jaxcap.body.shape_modes import apply_modes, joint_modes
from jaxcap.body.symmetry import length_differences
from jaxcap.energy.data.pairs import PairDistances, num_pairs, pair_directions, pair_positions, stack_pairs
from jaxcap.energy.priors.reference_pose import RestPrior
from jaxcap.geometry.mesh import mesh_edges
from jaxcap.stacking import stack_trees, unstack_trees

FRAMES = 3
BODY = chain_body("linear")
SKELETON = BODY.skeleton
JOINTS, DOFS, COUNT = SKELETON.num_joints, SKELETON.num_dofs, len(BODY.vertices)
PRIOR = RestPrior(jnp.full((JOINTS, 3), 0.7))
MODES = joint_modes(BODY, move_surface=False)
#: as if the bones to elbow and jaw, and those to hand and neck, were of two sides
MIRRORED = ((4, 8), (5, 7))


class Weights(NamedTuple):
    """Of the pose prior and the shape, a pair's deviation, and of the hold."""

    pose: jnp.ndarray
    shape: jnp.ndarray
    deviation: jnp.ndarray
    hold: jnp.ndarray


WEIGHTS = Weights(*(jnp.asarray(x) for x in (1e-2, 0.7, 0.003, 1e-3)))


def problem(rng, corners: int = 3):
    """Poses, pairs, a shape that is not the body's own, and where joints are believed to be."""
    poses = stack_trees([random_pose(SKELETON, rng, 0.3) for _ in range(FRAMES)])
    pairs = stack_trees([random_pairs(BODY, rng, 200, corners) for _ in range(FRAMES)])
    other = eqx.tree_at(lambda b: b.vertices, BODY, BODY.vertices + 0.005 * rng.normal(size=(COUNT, 3)))
    coefficient_prior = CoefficientPrior(
        jnp.asarray(0.01 * rng.normal(size=3 * JOINTS)), jnp.full(3 * JOINTS, 0.005)
    )
    return poses, pairs, body_shape_prior(other, 2), coefficient_prior


def step(poses, pairs, shape, coefficient_prior, body=BODY, weights=WEIGHTS, prior=PRIOR, tolerance=1e-13):
    problem = shared_problem(
        body, pairs, PoseTerms(prior, weights.pose), MODES, coefficient_prior, MIRRORED, weights.deviation
    )
    return adapt_together(problem, poses, pairs, shape, weights.shape, weights.hold, tolerance)


def test_a_body_of_single_precision_meets_scans_of_double(rng):
    poses, pairs, shape, coefficient_prior = problem(rng)
    single = jax.tree.map(lambda leaf: leaf.astype(jnp.float32) if eqx.is_inexact_array(leaf) else leaf, BODY)
    double, _ = step(poses, pairs, shape, coefficient_prior)
    body, moved_poses = step(poses, pairs, shape, coefficient_prior, body=single, tolerance=1e-6)
    assert body.vertices.dtype == moved_poses.rotations.dtype == jnp.float32
    np.testing.assert_allclose(body.vertices, double.vertices, atol=1e-4)


def test_a_step_is_the_dense_least_squares_solution(rng):
    """All residuals of all unknowns in one Jacobian by autodiff, and the constraint by Lagrange's multipliers."""
    poses, pairs, shape, coefficient_prior = problem(rng)
    laplacian = jnp.asarray(shape.laplacian.toarray())
    each = unstack_trees(pairs, FRAMES)

    def parts(x):
        d, z, e = jnp.split(x, [FRAMES * DOFS, FRAMES * DOFS + 3 * JOINTS])
        body = apply_modes(BODY, MODES, z)
        body = eqx.tree_at(lambda b: b.vertices, body, BODY.vertices + e.reshape(-1, 3))
        turned = [
            retract(SKELETON, p, own)
            for p, own in zip(unstack_trees(poses, FRAMES), d.reshape(FRAMES, -1), strict=True)
        ]
        data, beside = [], []
        for pose, some in zip(turned, each, strict=True):
            apart = pair_positions(some, jc.pose_body(body, pose).vertices) - some.points
            data.append(jnp.einsum("cra,ca->cr", pair_directions(some), apart).reshape(-1))
            beside.append(jnp.sqrt(WEIGHTS.pose * num_pairs(some)) * PRIOR.residual(jc.pose_body(BODY, pose)))
        meshes = jnp.stack([jc.pose_body(body, pose).vertices for pose in unstack_trees(shape.poses, 2)])
        rough = jnp.sqrt(WEIGHTS.shape / 2) * (jnp.einsum("uv,mva->mua", laplacian, meshes) - shape.vectors)
        believed = (
            jnp.sqrt(PAIRS_PER_MEASUREMENT)
            * WEIGHTS.deviation
            / coefficient_prior.deviation
            * (z - coefficient_prior.mean)
        )
        every = [jnp.concatenate(data + beside), rough.reshape(-1), believed, jnp.sqrt(WEIGHTS.hold) * e]
        return jnp.concatenate(every)

    zero = jnp.zeros(FRAMES * DOFS + 3 * JOINTS + 3 * COUNT)
    slope, apart = (np.asarray(x) for x in jax.jit(lambda x: (jax.jacfwd(parts)(x), parts(x)))(zero))
    # damping is a share of each curvature
    damping = np.diag(1e-3 * np.sum(slope**2, 0))
    differences, by_centre = length_differences(SKELETON, np.array(MIRRORED))
    assert np.abs(differences).max() > 0.01
    equal = np.zeros((len(differences), len(zero)))
    equal[:, FRAMES * DOFS : FRAMES * DOFS + 3 * JOINTS] = np.asarray(by_centre).reshape(len(differences), -1)
    system = np.block([[slope.T @ slope + damping, equal.T], [equal, np.zeros((len(equal), len(equal)))]])
    expected = np.linalg.solve(system, np.concatenate([-slope.T @ apart, -np.asarray(differences)]))
    d, z, e, _ = np.split(expected, np.cumsum([FRAMES * DOFS, 3 * JOINTS, 3 * COUNT]))

    body, turned = step(poses, pairs, shape, coefficient_prior)
    np.testing.assert_allclose(body.vertices - BODY.vertices, e.reshape(-1, 3), atol=1e-9)
    np.testing.assert_allclose(body.skeleton.centres - SKELETON.centres, z.reshape(-1, 3), atol=1e-9)
    there = jax.vmap(retract, (None, 0, 0))(SKELETON, poses, jnp.asarray(d.reshape(FRAMES, DOFS)))
    np.testing.assert_allclose(turned.rotations, there.rotations, atol=1e-8)
    np.testing.assert_allclose(turned.translations, there.translations, atol=1e-8)
    for part in (d, z, e):
        assert np.abs(part).max() > 1e-3


def test_the_slope_of_a_step_against_differences(rng):
    """What comes out, by the scans' points, their directions, the body and the weights, along a way through all of them."""
    poses, pairs, shape, coefficient_prior = problem(rng)
    given = (
        pairs.points,
        pairs.normals,
        BODY.vertices,
        SKELETON.centres,
        coefficient_prior.mean,
        WEIGHTS.shape,
    )
    ways = [jnp.asarray(0.1 * rng.normal(size=part.shape)) for part in given]
    weigh = [jnp.asarray(rng.normal(size=shape)) for shape in ((COUNT, 3), (JOINTS, 3), (FRAMES, JOINTS, 4))]

    def value(points, normals, vertices, centres, expected, weight):
        body = eqx.tree_at(lambda b: (b.vertices, b.skeleton.centres), BODY, (vertices, centres))
        some = eqx.tree_at(lambda p: (p.points, p.normals), pairs, (points, normals))
        there, turned = step(poses, some, shape, CoefficientPrior(expected, coefficient_prior.deviation), body, WEIGHTS._replace(shape=weight))  # fmt: skip
        found = there.vertices, there.skeleton.centres, turned.rotations
        return sum(jnp.sum(by * part) for by, part in zip(weigh, found, strict=True))

    slopes, h = jax.grad(value, tuple(range(len(given))))(*given), 1e-4
    for number, (slope, way) in enumerate(zip(slopes, ways, strict=True)):
        # of fourth order, as rounding shows at the steps that two values ask for
        far, near = (
            [
                value(*(x + sign * k * h * ways[n] * (n == number) for n, x in enumerate(given)))
                for sign in (1, -1)
            ]
            for k in (2, 1)
        )
        expected = float(8 * (near[0] - near[1]) - (far[0] - far[1])) / (12 * h)
        assert float(jnp.sum(slope * way)) == pytest.approx(expected, rel=1e-6)
        assert abs(expected) > 1e-4


def test_other_numbers_are_not_traced_anew(rng):
    traces = []

    class Counted(RestPrior):
        def residual(self, posed):
            traces.append(posed)
            return super().residual(posed)

    for weight, tolerance in ((1e-2, 1e-3), (1e-1, 1e-4)):
        prior = Counted(jnp.full((JOINTS, 3), 0.5 + weight))
        weights = WEIGHTS._replace(pose=weight, shape=10 * weight)
        step(*problem(rng), weights=weights, prior=prior, tolerance=tolerance)
        count = len(traces) if weight == 1e-2 else count
    assert len(traces) == count > 0


def test_pairs_across_the_body_are_refused(rng):
    poses, pairs, shape, coefficient_prior = problem(rng)
    edges = {frozenset(edge) for edge in mesh_edges(np.asarray(BODY.faces)).tolist()}
    far = next(v for v in range(1, COUNT) if frozenset((0, v)) not in edges)
    across = jnp.array([0, far, 0], jnp.int32)
    pairs = eqx.tree_at(lambda p: p.vertices, pairs, pairs.vertices.at[1, 9].set(across))
    with pytest.raises(ValueError, match=f"Pair 9 of frame 1 couples vertices 0 and {far}"):
        step(poses, pairs, shape, coefficient_prior)


def test_some_steps_on_all_at_once_leave_less_than_as_many_in_turn(rng):
    """Where pairs are right, from poses, joints and vertices that are off: what is told by all at once needs fewer turns."""
    poses, pairs, _, _ = problem(rng)
    actor = apply_modes(BODY, MODES, jnp.asarray(0.02 * rng.normal(size=3 * JOINTS)))
    actor = eqx.tree_at(lambda b: b.vertices, actor, BODY.vertices + 0.01 * rng.normal(size=(COUNT, 3)))
    true = [
        retract(SKELETON, p, jnp.asarray(0.1 * rng.normal(size=DOFS))) for p in unstack_trees(poses, FRAMES)
    ]
    points = [pair_positions(some, jc.pose_body(actor, pose).vertices) for some, pose in zip(unstack_trees(pairs, FRAMES), true, strict=True)]  # fmt: skip
    pairs = eqx.tree_at(lambda p: p.points, pairs, jnp.stack(points))
    shape, coefficient_prior = (
        body_shape_prior(BODY, 2),
        CoefficientPrior(jnp.zeros(3 * JOINTS), jnp.full(3 * JOINTS, 0.02)),
    )
    weights = WEIGHTS._replace(pose=1e-8, shape=1e-2, hold=1e-4)
    terms = PoseTerms(PRIOR, weights.pose)

    def left(body, turned):
        each = zip(unstack_trees(turned, FRAMES), unstack_trees(pairs, FRAMES), strict=True)
        return sum(float(energy(body, pose, some)) for pose, some in each)

    @eqx.filter_jit
    def energy(body, pose, pairs):
        r = PairDistances(pairs).residual(jc.pose_body(body, pose))
        return r @ r

    one, two, told = (BODY, poses), (BODY, poses), [[left(BODY, poses)] * 2]
    for _ in range(4):
        one = step(one[1], pairs, shape, coefficient_prior, one[0], weights)
        body, turned, _ = gauss_newton_step(
            shared_problem(two[0], pairs, terms, MODES, coefficient_prior, MIRRORED, weights.deviation),
            two[1],
        )
        two = adapt_shape(body, turned, pairs, shape, 1e-2), turned
        told.append([left(*one), left(*two)])
    assert told[4][0] < 1e-4 * told[0][0]
    assert told[4][0] < 0.6 * told[4][1]


def test_a_round_takes_one_step_where_it_is_told_to():
    scene = make_scene()
    task = task_of(scene, settings=AdaptSettings(num_frames=3, shape_weights=(1.0, 1.0), simultaneous=True))
    rng, template = np.random.default_rng(2), scene[0]
    poses = [retract(template.skeleton, p, jnp.asarray(0.02 * rng.normal(size=DOFS))) for p in scene[2]]
    state = AdaptState(0, template, 1.1, jc.stack_poses(poses, 10.0), chosen=(0, 2, 5), pose_weight=1e-6)
    pair_cache = make_pair_cache(task)
    starts = {n: state.motion[n] for n in state.chosen}
    pairs = stack_pairs(pair_cache.pairs(template, starts))
    # they hold where nothing has changed, and are found anew where a pose has
    assert pair_cache.pairs(template, starts)[1] is pair_cache.pairs(template, starts)[1]
    assert pair_cache.pairs(template, {5: starts[0]})[0] is not pair_cache.pairs(template, {5: starts[2]})[0]
    told = []
    for number in (2, 3):
        state = adapt_round(task, state, pair_cache, Stage("adapt", 1, number))
        told.append(state.terms[-1].data)
    assert pairs.vertices.shape[-1] == 3
    assert told[1] < told[0]
    for here, there in (
        (state.body.vertices, template.vertices),
        (state.body.skeleton.centres, SKELETON.centres),
    ):
        assert np.abs(np.asarray(here) - np.asarray(there)).max() > 0.005
