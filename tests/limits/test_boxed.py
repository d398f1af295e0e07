"""Hard boxes: least squares within bounds, rotation vectors as coordinates, poses and windows that stay inside."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_skeleton, random_pose
from scipy.optimize import lsq_linear

import jaxcap as jc
from jaxcap.adapt.objective import PoseTerms, mean_squared_distance, temporal_energy
from jaxcap.adapt.poses.fit_frame import fit_pose, pairs_of
from jaxcap.adapt.poses.sliding_window import smooth_poses
from jaxcap.body.pose import local_rotation_vectors
from jaxcap.body.retraction import project, retract
from jaxcap.body.skeleton import dof_layout
from jaxcap.energy.priors.reference_pose import RestPrior
from jaxcap.fit.correspondence.find_pairs import Matching
from jaxcap.fit.correspondence.nearest_assignment import make_scan
from jaxcap.fit.solvers.bounded_least_squares import solve_bounded
from jaxcap.geometry import rotation
from jaxcap.geometry.mesh import sample_surface
from jaxcap.limits.rotation_vector_boxes import (
    make_box_chart,
    retract_within,
    rotating_joints,
)
from jaxcap.stacking import stack_trees

SKELETON = chain_skeleton()
solve, own_of = jax.jit(solve_bounded), eqx.filter_jit(local_rotation_vectors)
chart_of, move = eqx.filter_jit(make_box_chart), eqx.filter_jit(retract_within)


def random_system(rng, count: int, rows: int):
    """Normal equations, bounds about zero, and the value of a solution."""
    jacobian = rng.normal(size=(rows, count))
    matrix = jacobian.T @ jacobian / rows
    matrix += np.diag(1e-3 * np.diag(matrix))
    side = matrix @ rng.normal(size=count)
    low, high = -rng.uniform(0, 1.0, count), rng.uniform(0, 1.0, count)
    return matrix, side, low, high, lambda x: x @ matrix @ x / 2 - side @ x


def by_scipy(matrix, side, low, high):
    root = np.linalg.cholesky(matrix)
    return lsq_linear(root.T, np.linalg.solve(root, side), (low, high), method="bvls", tol=1e-14).x


@pytest.mark.parametrize(("count", "rows"), [(1, 3), (2, 3), (2, 8)])
def test_one_and_two_numbers_at_their_bounds_are_exact(rng, count, rows):
    active = set()
    for _ in range(60):
        *system, _ = random_system(rng, count, rows)
        expected = by_scipy(*system)
        np.testing.assert_allclose(solve(*system), expected, atol=1e-9)
        active.add(int(np.sum((expected <= system[2]) | (expected >= system[3]))))
    assert active == set(range(count + 1))


@pytest.mark.parametrize(("count", "rows"), [(6, 20), (20, 60), (20, 24), (66, 80)])
def test_many_numbers_are_those_of_bounded_least_squares(rng, count, rows):
    """Inside always; the value at most two per cent above the least one, and nearly always the least one."""
    losses = []
    for _ in range(12):
        *system, value = random_system(rng, count, rows)
        found, expected = np.asarray(solve(*system)), by_scipy(*system)
        assert ((found >= system[2]) & (found <= system[3])).all()
        losses.append((value(found) - value(expected)) / -value(expected))
    assert max(losses) < 0.02
    assert np.median(losses) < 1e-9


def test_without_bounds_and_with_nowhere_to_go(rng):
    matrix, side, low, high, _ = random_system(rng, 8, 20)
    free = solve(matrix, side, np.full(8, -np.inf), np.full(8, np.inf))
    np.testing.assert_allclose(free, np.linalg.solve(matrix, side), atol=1e-10)
    np.testing.assert_array_equal(solve(matrix, side, high, high), high)
    # some are held, the rest is the solution of what is left
    held = np.arange(8) < 3
    found = solve(matrix, side, np.where(held, low, -np.inf), np.where(held, low, np.inf))
    left = np.linalg.solve(matrix[3:, 3:], side[3:] - matrix[3:, :3] @ low[:3])
    np.testing.assert_allclose(found, [*low[:3], *left], atol=1e-10)


@pytest.mark.parametrize("count", [2, 8])
def test_the_slope_of_the_solution_against_differences(rng, count):
    """By all arguments at once along a random way, in both modes, where the same numbers are fixed on both sides."""
    slope, h, seen = jax.jit(lambda x, d: jax.jvp(solve_bounded, x, d)[1]), 1e-6, set()
    pulled = jax.jit(lambda x, g: jax.vjp(solve_bounded, *x)[1](g))
    for _ in range(12):
        *system, _ = random_system(rng, count, 3 * count)
        ways = [rng.normal(size=part.shape) for part in system]
        ways[0] = ways[0] + ways[0].T
        there, back = (
            np.asarray(solve(*(x + sign * h * d for x, d in zip(system, ways, strict=True))))
            for sign in (1, -1)
        )
        found = np.asarray(slope(tuple(system), tuple(ways)))
        np.testing.assert_allclose(found, (there - back) / (2 * h), atol=1e-5 * (1 + np.abs(found).max()))
        weights = rng.normal(size=count)
        by_reverse = sum(np.sum(g * d) for g, d in zip(pulled(tuple(system), weights), ways, strict=True))
        assert by_reverse == pytest.approx(weights @ found, rel=1e-8, abs=1e-10)
        step = np.asarray(solve(*system))
        seen.add(int(np.sum((step == system[2]) | (step == system[3]))))
    # none would be a system without bounds
    assert len(seen) > 1


def test_the_slope_without_bounds_is_that_of_a_linear_solve(rng):
    matrix, side, *_ = random_system(rng, 5, 20)
    wide = np.full(5, np.inf)
    slope = jax.jit(jax.jacrev(solve_bounded, 1))(matrix, side, -wide, wide)
    np.testing.assert_allclose(slope, np.linalg.inv(matrix), rtol=1e-8, atol=1e-9)


def chain_boxes(rng, margin: float = 0.0):
    """Boxes of what some random poses did, and of the root."""
    poses = [random_pose(SKELETON, rng, 0.3) for _ in range(20)]
    boxes = jc.prior.learn_ranges(SKELETON, jc.stack_poses(poses).poses, margin)
    lower, upper = (np.concatenate([x, [side * np.ones(3)]]) for x, side in ((boxes.lower, -1), (boxes.upper, 1)))  # fmt: skip
    return jc.limits.make_pose_boxes((*boxes.joints, "root"), lower, upper), poses


@pytest.mark.parametrize("size", [1e-4, 0.5, 1.2])
def test_the_chart_against_differences(rng, size):
    """A change of the chart's numbers is the change of rotation vectors in the joints' own frames."""
    pose, layout, h = random_pose(SKELETON, rng, size), dof_layout(SKELETON), 1e-6
    chart = chart_of(chain_boxes(rng)[0], SKELETON, pose)
    there = eqx.filter_jit(
        lambda x: local_rotation_vectors(SKELETON, retract(SKELETON, pose, chart.basis @ x))
    )
    slope = np.stack([(there(h * e) - there(-h * e)) / (2 * h) for e in np.eye(SKELETON.num_dofs)], -1)
    for name in ("root", "chest", "hand", "neck"):
        joint = SKELETON.index(name)
        expected = np.eye(SKELETON.num_dofs)[layout.rotations[joint]]
        np.testing.assert_allclose(slope[joint], expected, atol=1e-7)
    for name in ("elbow", "jaw"):
        joint = SKELETON.index(name)
        axis = rotation.rotate(rotation.conjugate(SKELETON.orientations[joint]), SKELETON.axes[joint, 0])
        along = np.eye(SKELETON.num_dofs)[layout.rotations[joint, 0]]
        np.testing.assert_allclose(slope[joint], np.outer(axis, along), atol=1e-7)


def test_poses_of_every_kind_of_joint_stay_in_boxes_and_on_their_axes(rng):
    boxes, poses = chain_boxes(rng)
    joints = boxes.indices(SKELETON)
    for pose in poses[:6]:
        chart = chart_of(boxes, SKELETON, pose)
        assert (chart.lower <= 1e-12).all() and (chart.upper >= -1e-12).all()
        moved = move(boxes, SKELETON, pose, chart, jnp.asarray(rng.normal(size=SKELETON.num_dofs)))
        own = np.asarray(own_of(SKELETON, moved))[joints]
        assert (own >= boxes.lower - 1e-9).all() and (own <= boxes.upper + 1e-9).all()
        on_axes = rotation.distance(project(SKELETON, moved).rotations, moved.rotations)
        assert float(on_axes.max()) < 0.01
        np.testing.assert_allclose(np.delete(on_axes, SKELETON.index("spine")), 0.0, atol=1e-6)
    still = move(boxes, SKELETON, poses[0], chart_of(boxes, SKELETON, poses[0]), jnp.zeros(SKELETON.num_dofs))
    np.testing.assert_allclose(still.rotations, poses[0].rotations, atol=1e-12)


def test_a_number_at_its_bound_arrives_there_in_one_step(rng):
    """Steps are straight in rotation vectors, so that a whole step is at the bounds that it was given."""
    boxes, poses = chain_boxes(rng)
    chart = chart_of(boxes, SKELETON, poses[0])
    slots = dof_layout(SKELETON).rotations[SKELETON.index("hand")]
    x = jnp.zeros(SKELETON.num_dofs).at[slots].set(chart.upper[slots])
    moved = own_of(SKELETON, move(boxes, SKELETON, poses[0], chart, x))[SKELETON.index("hand")]
    np.testing.assert_allclose(moved, boxes.upper[boxes.joints.index("hand")], atol=1e-12)


def test_boxes_that_reach_past_half_a_turn_end_there(rng):
    boxes = jc.limits.make_pose_boxes(("hand",), np.array([[-4.0, 1.5, 0.0]]), np.array([[4.0, 2.0, 0.0]]))
    hand = SKELETON.index("hand")
    pose = jc.rest_pose(SKELETON)
    own = jnp.array([3.0, 0.0, 0.0])
    turned = rotation.exp(rotation.rotate(SKELETON.orientations[hand], own))
    back = boxes.project(
        SKELETON, jc.Pose(pose.translations, pose.rotations.at[hand].set(turned), pose.scale)
    )
    found = np.asarray(own_of(SKELETON, back)[hand])
    np.testing.assert_allclose(found, np.clip(found, boxes.lower[0], boxes.upper[0]), atol=1e-9)
    assert found[0] > 2.5


def test_boxes_that_are_infinite_leave_tangents_alone(rng):
    joints = tuple(name for name, kind in zip(SKELETON.names, SKELETON.kinds, strict=True) if kind != "fixed")
    wide = np.full((len(joints), 3), np.inf)
    pose = random_pose(SKELETON, rng, 1.0)
    x = jnp.asarray(rng.normal(size=SKELETON.num_dofs))
    expected = eqx.filter_jit(retract)(SKELETON, pose, x)
    none = jc.limits.make_pose_boxes((), np.zeros((0, 3)), np.zeros((0, 3)))
    for boxes in (jc.limits.make_pose_boxes(joints, -wide, wide), none):
        chart = chart_of(boxes, SKELETON, pose)
        np.testing.assert_array_equal(chart.basis, np.eye(SKELETON.num_dofs))
        assert not np.isfinite(chart.lower).any() and not np.isfinite(chart.upper).any()
        np.testing.assert_allclose(
            move(boxes, SKELETON, pose, chart, x).rotations, expected.rotations, atol=1e-15
        )


ELBOW = "LeftForeArm"


@pytest.fixture(scope="module")
def scene():
    """A body, six poses with an elbow that bends from 0.2 to 1.1 radians, and their scans."""
    body = jc.human(resolution="low", joints="tracking")
    skeleton, rng = body.skeleton, np.random.default_rng(3)
    elbow = skeleton.index(ELBOW)
    posed, poses, scans = eqx.filter_jit(jc.pose_body), [], []
    for bend in np.linspace(0.2, 1.1, 6):
        pose = retract(skeleton, jc.rest_pose(skeleton), jnp.full(skeleton.num_dofs, 0.02))
        turned = rotation.exp(rotation.rotate(skeleton.orientations[elbow], jnp.array([0.05, bend, 0.0])))
        pose = jc.Pose(pose.translations, pose.rotations.at[elbow].set(turned), pose.scale)
        vertices = np.asarray(posed(body, pose).vertices, float)
        points, normals = sample_surface(vertices, np.asarray(body.faces), 2500, rng)
        poses.append(pose)
        scans.append(make_scan(jc.make_cloud(points + 0.001 * rng.normal(size=points.shape), normals)))
    return body, poses, scans, RestPrior(jnp.full((skeleton.num_joints, 3), 0.7))


def elbow_box(most: float):
    return jc.limits.make_pose_boxes((ELBOW,), np.array([[-0.3, -0.2, -0.3]]), np.array([[0.3, most, 0.3]]))


def infinite_boxes(skeleton):
    names = tuple(skeleton.names[joint] for joint in rotating_joints(skeleton))
    wide = np.full((len(names), 3), np.inf)
    return jc.limits.make_pose_boxes(names, -wide, wide)


def shaken(rng, skeleton, pose, size: float):
    return retract(skeleton, pose, jnp.asarray(size * rng.normal(size=skeleton.num_dofs)))


def test_an_elbow_that_is_bent_too_far_ends_at_its_bound(scene, rng):
    body, poses, scans, prior = scene
    skeleton, elbow = body.skeleton, body.skeleton.index(ELBOW)
    start = shaken(rng, skeleton, poses[5], 0.04)
    free = fit_pose(body, scans[5], start, PoseTerms(prior), steps=15).pose
    boxes = elbow_box(0.5)
    held = fit_pose(body, scans[5], start, PoseTerms(prior, boxes=boxes), steps=15)
    bends = [np.asarray(own_of(skeleton, pose))[elbow] for pose in (free, held.pose)]
    assert bends[0][1] > 0.95
    assert bends[1][1] == pytest.approx(0.5, abs=1e-6)
    assert (bends[1] >= boxes.lower - 1e-6).all() and (bends[1] <= boxes.upper + 1e-6).all()
    # the arm makes up for some of it, and the others are where they were without a box
    alone = boxes.project(skeleton, free)
    misses = [
        mean_squared_distance(body, p, pairs_of(body, p, scans[5], Matching())) for p in (alone, held.pose)
    ]
    assert misses[1] < 0.8 * misses[0]
    joints = [np.asarray(eqx.filter_jit(jc.pose_body)(body, p).joints) for p in (held.pose, poses[5])]
    off = np.linalg.norm(joints[0] - joints[1], axis=1)
    arm = np.array([name.startswith(("LeftArm", "LeftForeArm", "LeftHand", "LThumb", "LeftFinger")) for name in skeleton.names])  # fmt: skip
    assert off[~arm].mean() < 0.005


def test_infinite_boxes_change_nothing_and_bounds_are_not_compiled_in(scene, rng):
    body, poses, scans, _ = scene
    traces = []

    class Counted(RestPrior):
        def residual(self, posed):
            traces.append(posed)
            return super().residual(posed)

    prior = Counted(jnp.full((body.skeleton.num_joints, 3), 0.7))
    start = shaken(rng, body.skeleton, poses[2], 0.04)
    free = fit_pose(body, scans[2], start, PoseTerms(prior), steps=4)
    boxed = fit_pose(body, scans[2], start, PoseTerms(prior, boxes=infinite_boxes(body.skeleton)), steps=4)
    np.testing.assert_allclose(boxed.pose.rotations, free.pose.rotations, atol=1e-12)
    np.testing.assert_allclose(boxed.pose.translations, free.pose.translations, atol=1e-12)
    fit_pose(body, scans[2], start, PoseTerms(prior, boxes=elbow_box(0.4)), steps=2)
    count = len(traces)
    fit_pose(body, scans[2], start, PoseTerms(prior, boxes=elbow_box(0.5)), steps=2)
    assert len(traces) == count


def test_a_window_stays_in_its_boxes(scene, rng):
    body, poses, scans, prior = scene
    skeleton, elbow = body.skeleton, body.skeleton.index(ELBOW)
    rough = [shaken(rng, skeleton, pose, 0.02) for pose in poses]

    def smooth(boxes):
        pairs_at = lambda n, pose: pairs_of(body, pose, scans[n], Matching())  # noqa: E731
        return smooth_poses(body, rough, pairs_at, PoseTerms(prior, 1e-6, boxes), 1e-3, frames=4, stride=2)

    boxes = elbow_box(0.6)
    free, wide, held = smooth(None), smooth(infinite_boxes(skeleton)), smooth(boxes)
    np.testing.assert_allclose(stack_trees(wide).rotations, stack_trees(free).rotations, atol=1e-12)
    own = np.stack([np.asarray(own_of(skeleton, pose))[elbow] for pose in held])
    assert (own >= boxes.lower - 1e-6).all() and (own <= boxes.upper + 1e-6).all()
    # bent less than the bound as the scans say, then held at it
    assert (own[:3, 1] < 0.55).all()
    np.testing.assert_allclose(own[4:, 1], 0.6, atol=1e-6)
    assert float(temporal_energy(skeleton, stack_trees(held))) < float(
        temporal_energy(skeleton, stack_trees(rough))
    )
    others = np.array([not name.startswith(("LeftArm", ELBOW)) for name in skeleton.names])
    apart = rotation.distance(stack_trees(held).rotations, stack_trees(poses).rotations)
    assert float(np.mean(np.asarray(apart)[:, others])) < 0.05
