"""Variable projection against finite differences, known bodies, and improvements made in turns."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcap as jc
from jaxcap.body.body import deform_all
from jaxcap.geometry.laplacian import make_conformance
from jaxcap.learn import projection
from jaxcap.learn.adapt import adapt_vertices
from jaxcap.learn.hang import all_bones
from jaxcap.learn.joints import improve_joints, make_curvature, shared_slots
from jaxcap.learn.projection import improve_all, spread_vertices
from jaxcap.learn.vertices import VertexSolver
from jaxcap.learn.weights import improve_weights
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
    skin = jc.LinearSkin(jnp.eye(3)[body.skin.parts()])
    start = eqx.tree_at(lambda b: (b.skin, b.skeleton.centres), body, (skin, centres))
    turned = 0.05 * rng.normal(size=(len(poses.scale), body.skeleton.num_dofs))
    return start, jax.vmap(jc.retract, (None, 0, 0))(body.skeleton, poses, jnp.asarray(turned))


def rmse(body, poses, targets) -> float:
    return float(jnp.sqrt(jnp.mean(jnp.sum((deform_all(body, poses) - targets) ** 2, -1))))


def in_turns(body, poses, targets, rounds: int):
    metric = make_conformance(np.asarray(body.faces), len(body.vertices), 0.0)
    curvature, solver, damping = make_curvature(metric), VertexSolver(metric), 1e-3
    value = np.inf
    for _ in range(rounds):
        body = improve_weights(body, poses, targets, metric, sweeps=4, coarse=False).body
        body = eqx.tree_at(lambda b: b.vertices, body, solver.solve(body, poses, targets))
        value = rmse(body, poses, targets) ** 2 * targets.size / 3
        step = improve_joints(body, poses, targets, metric, curvature, NONE, damping, value)
        body, poses, damping = step.body, step.poses, step.damping
    return body, poses


def test_reaches_the_body_where_turns_creep(rng):
    body, poses = arm(rng)
    targets = deform_all(body, poses)
    start, moved = astray(body, poses, rng)
    found = improve_all(start, moved, targets, NONE, steps=14)
    crept = rmse(*in_turns(start, moved, targets, 14), targets)
    left = rmse(found.body, found.poses, targets)
    assert found.value < found.before
    np.testing.assert_allclose(found.value, left**2 * targets.size / 3, rtol=1e-6, atol=1e-20)
    assert left < 1e-4 and left < 0.2 * crept, (left, crept)


def test_the_matrix_is_that_of_the_reduced_function(rng):
    """Near a body that fits exactly, `r(p) = d^T H d` to the third order, with the inner minimum in r."""
    body, poses = arm(rng, 5)
    # weights at no bound, so that none comes or goes
    soft = jc.LinearSkin((body.skin.weights + 0.2) / 1.6)
    body = eqx.tree_at(lambda b: b.skin, body, soft)
    targets, slots = deform_all(body, poses), shared_slots(body)
    bones = all_bones(body.skeleton, poses)
    lower, side, _ = projection._equations(body, poses, bones, targets, slots)
    matrix = np.tril(lower) + np.tril(lower, -1).T
    np.testing.assert_allclose(side, 0, atol=1e-10)
    direction = 1e-4 * rng.normal(size=len(side))
    skeleton, there = projection._move(
        body.skeleton, poses, *projection._cut(direction, targets, body.skeleton), slots
    )
    trial = eqx.tree_at(lambda b: b.skeleton, body, skeleton)
    left = float(jnp.sum((deform_all(adapt_vertices(trial, there, targets), there) - targets) ** 2))
    np.testing.assert_allclose(left, direction @ matrix @ direction, rtol=0.02)


def test_spreads_vertices_over_small_parts():
    labels = np.repeat([0, 2, 3], [1000, 5, 95])
    picked = spread_vertices(labels, 100)
    assert len(np.unique(picked)) == len(picked)
    counts = np.bincount(labels[picked])
    assert counts[2] == 5 and counts[3] >= 12 and counts[0] < 100


def test_says_what_it_cannot_do(rng):
    body, poses = arm(rng, 2)
    targets = deform_all(body, poses)
    rigid = eqx.tree_at(lambda b: b.skin, body, jc.RigidSkin(body.skin.parts()))
    with pytest.raises(ValueError, match="LinearSkin"):
        improve_all(rigid, poses, targets, NONE)
    many = jax.tree.map(lambda leaf: jnp.repeat(leaf, 1000, 0), poses)
    with pytest.raises(ValueError, match="fewer meshes"):
        improve_all(body, many, jnp.repeat(targets, 1000, 0), NONE)
