"""Variable projection against finite differences, known bodies, and improvements made in turns."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcap as jc
from jaxcap.body.body import posed_vertices
from jaxcap.fit.solvers.equalities import Equalities
from jaxcap.geometry.laplacian import make_conformance
from jaxcap.learn.learn_body import learn_body
from jaxcap.learn.skeleton.joints import improve_joints, make_curvature
from jaxcap.learn.skeleton.limbs import (
    bone_derivatives,
    bone_transforms,
    make_bone_state,
    move_bones,
    read_bone_state,
)
from jaxcap.learn.skeleton.reparent import bone_motions
from jaxcap.learn.variable_projection.blend_problem import Blend, BlendProblem, optimise_blend
from jaxcap.learn.variable_projection.solve_blend_problem import (
    improve_body,
    optimise_all_vertices,
    sample_vertices,
)
from jaxcap.learn.weights.improve_weights import improve_weights
from jaxcap.learn.weights.rest_vertices import solve_rest_vertices
from jaxcap.observe.meshes import MeshSequence
from tests.helpers import random_pose

NONE = np.zeros((0, 2), int)


def arm(rng, frames: int = 14):
    """A tube of three bones, blended softly at its joints, and poses of it."""
    rings, around = 25, 6
    along, angles = np.linspace(0, 0.9, rings), np.linspace(0, 2 * np.pi, around, endpoint=False)
    circle = np.stack([0 * angles, 0.05 * np.cos(angles), 0.05 * np.sin(angles)], 1)
    places = (circle[None] + along[:, None, None] * [1.0, 0, 0]).reshape(-1, 3)
    ring, corner = np.meshgrid(np.arange(rings - 1), np.arange(around), indexing="ij")
    a, b = ring * around + corner, ring * around + (corner + 1) % around
    faces = np.concatenate([np.stack([a, b, a + around], -1), np.stack([b, b + around, a + around], -1)])
    below = np.clip((places[:, :1] - [0.3, 0.6]) / 0.2 + 0.5, 0, 1)
    weights = np.stack([1 - below[:, 0], below[:, 0] - below[:, 1], below[:, 1]], 1)
    centres = [[0.0, 0, 0], [0.3, 0, 0], [0.6, 0, 0]]
    skeleton = jc.make_skeleton(["root", "elbow", "hand"], [-1, 0, 1], ["free", "ball", "ball"], centres)
    faces = jnp.asarray(faces.reshape(-1, 3))
    body = jc.Body(skeleton, jc.LinearSkin(jnp.asarray(weights)), jnp.asarray(places), faces)
    poses = jc.stack_poses([random_pose(skeleton, rng, 0.6) for _ in range(frames)]).poses
    return body, poses


def astray(body, poses, rng):
    """The body as it may start: rigid parts, joints 1 cm off, poses a few degrees off."""
    centres = body.skeleton.centres + 0.01 * rng.normal(size=(3, 3))
    skin = jc.LinearSkin(jnp.eye(3)[body.skin.dominant_bones()])
    start = eqx.tree_at(lambda b: (b.skin, b.skeleton.centres), body, (skin, centres))
    turned = 0.05 * rng.normal(size=(len(poses.scale), body.skeleton.num_dofs))
    return start, jax.vmap(jc.retract, (None, 0, 0))(body.skeleton, poses, jnp.asarray(turned))


def rmse(body, poses, targets) -> float:
    return float(jnp.sqrt(jnp.mean(jnp.sum((posed_vertices(body, poses) - targets) ** 2, -1))))


def in_turns(body, poses, targets, rounds: int):
    metric = make_conformance(np.asarray(body.faces), len(body.vertices), 0.0)
    curvature, damping = make_curvature(metric), 1e-3
    value = np.inf
    for _ in range(rounds):
        body = improve_weights(body, poses, targets, metric, sweeps=4, coarse=False).body
        body = eqx.tree_at(lambda b: b.vertices, body, solve_rest_vertices(body, poses, targets, metric))
        value = rmse(body, poses, targets) ** 2 * targets.size / 3
        step = improve_joints(body, poses, targets, metric, curvature, NONE, damping, value)
        body, poses, damping = step.body, step.poses, step.damping
    return body, poses


def test_reaches_the_body_where_turns_creep(rng):
    body, poses = arm(rng)
    targets = posed_vertices(body, poses)
    start, moved = astray(body, poses, rng)
    found = improve_body(start, moved, targets, NONE)
    crept = rmse(*in_turns(start, moved, targets, 14), targets)
    left = rmse(found.body, found.poses, targets)
    assert found.value < found.before
    np.testing.assert_allclose(found.value, left**2 * targets.size / 3, rtol=1e-6, atol=1e-20)
    assert left < 1e-4 and left < 0.2 * crept, (left, crept)


def test_bones_as_arrays_are_those_of_the_skeleton(rng):
    body, poses = arm(rng, 4)
    tree, limbs = make_bone_state(body.skeleton, poses)
    bones = bone_motions(body.skeleton, poses)
    np.testing.assert_allclose(bone_transforms(tree, limbs)[:, :3, :, :3], bones.rotations, atol=1e-14)
    np.testing.assert_allclose(bone_transforms(tree, limbs)[:, :3, :, 3], bones.translations, atol=1e-14)
    skeleton, again = read_bone_state(body.skeleton, limbs)
    np.testing.assert_allclose(bone_motions(skeleton, again).translations, bones.translations, atol=1e-14)
    count = len(tree.parents)
    d = jnp.asarray(rng.normal(size=(4, 3 * count + 3))), jnp.asarray(rng.normal(size=3 * count))

    def moved(step):
        return bone_transforms(tree, move_bones(tree, limbs, jax.tree.map(lambda x: step * x, d)))

    differences = (moved(1e-6) - moved(-1e-6)) / 2e-6
    np.testing.assert_allclose(bone_derivatives(tree, limbs, d), differences, atol=1e-8)


def test_the_matrix_is_that_of_the_reduced_function(rng):
    """Near a body that fits exactly, `r(p) = d^T H d` to the third order, with the inner minimum in r; and conjugate gradients
    solve with it as a dense solver does, in the space of equations."""
    body, poses = arm(rng, 5)
    # weights at no bound, so that none comes or goes
    soft = (body.skin.weights + 0.2) / 1.6
    body = eqx.tree_at(lambda b: b.skin, body, jc.LinearSkin(soft))
    targets = posed_vertices(body, poses)
    tree, limbs = make_bone_state(body.skeleton, poses)
    count = len(tree.parents)
    aims = jnp.swapaxes(targets, 0, 1).reshape(len(soft), -1)
    near = jnp.broadcast_to(jnp.arange(3), soft.shape)
    units = jnp.ones((5, 3 * count + 3)), jnp.ones(3 * count)
    problem = BlendProblem(tree, near, aims, jnp.zeros((2, 4), jnp.int32), units)
    y = Blend(limbs, jnp.pad(soft, ((0, 0), (0, count - 3))), body.vertices)
    info = problem.information(y)
    assert max(float(jnp.abs(part).max()) for part in info.grad) < 1e-10
    d = jax.tree.map(lambda u: 1e-4 * jnp.asarray(rng.normal(size=u.shape)), units)
    left = optimise_blend(Blend(move_bones(tree, limbs, d), y.weights, y.rest), tree, near, aims, 20)
    expected = sum(jnp.vdot(a, b) for a, b in zip(d, info.hessian.mv(d), strict=True))
    np.testing.assert_allclose(2 * problem.value(left), expected, rtol=0.02)

    matrix = info.hessian.add_diagonal(jax.tree.map(lambda u: 0.1 * u, units))
    matrix = eqx.tree_at(lambda m: (m.tolerance, m.steps), matrix, (jnp.asarray(1e-13), jnp.asarray(2000)))
    side = jax.tree.map(lambda u: jnp.asarray(rng.normal(size=u.shape)), units)
    rows = jnp.asarray(rng.normal(size=(2, 3 * count)))
    found = matrix.factorise().solve(side, Equalities(rows, jnp.array([0.1, -0.2])))
    dense, flat = np.asarray(matrix.as_matrix()), np.concatenate([np.ravel(part) for part in side])
    wide = np.pad(np.asarray(rows), ((0, 0), (len(flat) - 3 * count, 0)))
    whole = np.block([[dense, wide.T], [wide, np.zeros((2, 2))]])
    oracle = np.linalg.solve(whole, np.concatenate([flat, [0.1, -0.2]]))[: len(flat)]
    np.testing.assert_allclose(np.concatenate([np.ravel(part) for part in found]), oracle, atol=1e-8)


def test_promising_bones_are_those_that_lower_the_squares(rng):
    """Priced bones let vertices settle as well as all of them do."""
    body, poses = arm(rng, 8)
    targets = posed_vertices(body, poses)
    start = eqx.tree_at(lambda b: b.skin, body, jc.LinearSkin(jnp.eye(3)[body.skin.dominant_bones()]))
    _, left = optimise_all_vertices(start, poses, targets)
    assert left < 1e-6 * float(jnp.sum((posed_vertices(start, poses) - targets) ** 2))


def test_spreads_vertices_over_small_parts():
    labels = np.repeat([0, 2, 3], [1000, 5, 95])
    picked = sample_vertices(labels, 100)
    assert len(np.unique(picked)) == len(picked)
    counts = np.bincount(labels[picked])
    assert len(picked) == 100
    assert counts[3] >= 12
    assert 0 < counts[2] <= 5


def test_says_what_it_cannot_do(rng):
    body, poses = arm(rng, 2)
    targets = posed_vertices(body, poses)
    rigid = eqx.tree_at(lambda b: b.skin, body, jc.body.RigidSkin(body.skin.dominant_bones()))
    with pytest.raises(ValueError, match="LinearSkin"):
        improve_body(rigid, poses, targets, NONE)
    kinds = ["free", "revolute", "ball"]
    bent = jc.make_skeleton(body.skeleton.names, body.skeleton.parents, kinds, body.skeleton.centres)
    hinge = jc.Body(bent, body.skin, body.vertices, body.faces)
    with pytest.raises(ValueError, match="ball joints"):
        improve_body(hinge, poses, targets, NONE)


def test_learning_goes_on_from_a_round_to_the_same_bits(rng):
    body, poses = arm(rng, 10)
    meshes = MeshSequence(posed_vertices(body, poses), body.faces, 30.0)
    options = {"skin": "lbs", "alpha": 0.0, "joints": 2, "symmetry": False, "rounds": 3}
    states = []
    whole = learn_body(meshes, **options, on_round=states.append)
    again = learn_body(meshes, **options, resume=states[0])
    assert again.history == whole.history
    for mine, own in zip(jax.tree.leaves((again.body, again.motion)), jax.tree.leaves((whole.body, whole.motion)), strict=True):  # fmt: skip
        np.testing.assert_array_equal(mine, own)
    assert rmse(whole.body, whole.motion.poses, meshes.vertices) < 1e-4
