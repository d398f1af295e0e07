"""A step of a window against dense equations of all its frames, and that it never makes them worse."""

import os
import weakref

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, random_pairs, random_pose

from jaxcap.adapt.objective import PoseTerms, temporal_energy, window_problem
from jaxcap.adapt.poses.sliding_window import smooth_poses
from jaxcap.body.pose import rest_pose
from jaxcap.body.retraction import retract
from jaxcap.energy.data.pairs import PairDistances
from jaxcap.energy.priors.reference_pose import RestPrior
from jaxcap.fit.linearise import linearise
from jaxcap.fit.pose_problem import pose_scales
from jaxcap.fit.solvers.bounded_least_squares import solve_bounded
from jaxcap.fit.solvers.descent import NormalDescent
from jaxcap.geometry import rotation
from jaxcap.limits.rotation_vector_boxes import PoseBoxes, make_box_chart, make_pose_boxes
from jaxcap.stacking import stack_trees

BODY = chain_body()
SKELETON, DOFS = BODY.skeleton, BODY.skeleton.num_dofs
PRIOR = RestPrior(jnp.full((SKELETON.num_joints, 3), 0.7))
WEIGHT, TEMPORAL = jnp.asarray(1e-3), jnp.asarray(0.3)


@eqx.filter_jit
def energy(poses, pairs, since=None):
    """Q of the poses of some frames (eq. 4.3)."""
    times = np.arange(len(poses.scale)) if since is None else np.append(0, np.cumsum(since))
    problem = window_problem(BODY, pairs, PoseTerms(PRIOR, WEIGHT), TEMPORAL, times)
    return 2.0 * problem.value(problem.start(poses))


@eqx.filter_jit
def step_of(poses, pairs, boxes, held, since):
    """The bounds of a step, and the step with a little damping."""
    times = jnp.append(0.0, jnp.cumsum(since))
    problem = window_problem(BODY, pairs, PoseTerms(PRIOR, WEIGHT, boxes), TEMPORAL, times, held)
    info = problem.information(problem.start(poses))
    descent = NormalDescent(relative=True)
    (step, _), _ = descent.step(jnp.asarray(1e4), descent.query(None, info, None))
    x = problem.scales()[0]
    return (info.constraints.low[0] * x, info.constraints.high[0] * x), step * x


def scene(rng, frames: int):
    """Poses about one, each elsewhere, and pairs that pull all at random."""
    middle = random_pose(SKELETON, rng, 0.3)
    poses = [retract(SKELETON, middle, jnp.asarray(0.1 * rng.normal(size=DOFS))) for _ in range(frames)]
    return poses, [random_pairs(BODY, rng, 60) for _ in range(frames)]


def some_boxes(poses, share: float) -> PoseBoxes:
    """Boxes of a share of the range that the poses use."""
    names = [name for name, kind in zip(SKELETON.names, SKELETON.kinds, strict=True) if kind == "ball"]
    boxes = make_pose_boxes(names, np.zeros((len(names), 3)), np.zeros((len(names), 3)))
    joints = boxes.indices(SKELETON)
    own = np.stack([rotation.rotate(rotation.conjugate(SKELETON.orientations[joints]), rotation.log(pose.rotations[joints])) for pose in poses])  # fmt: skip
    middle, reach = (own.max(0) + own.min(0)) / 2, (own.max(0) - own.min(0)) / 2
    return make_pose_boxes(names, middle - share * reach, middle + share * reach)


@eqx.filter_jit
def dense_step(poses, pairs, boxes, held, since):
    """The step of one system of all numbers of all frames."""
    frames = len(poses.scale)

    def of_frame(frame):
        apart, rows = linearise(PairDistances(frame[1]), BODY, frame[0])
        residual, slope = linearise(PRIOR, BODY, frame[0])
        count = jnp.sum(frame[1].weights > 0)
        side = -rows.T @ apart / count - WEIGHT * slope.T @ residual
        return rows.T @ rows / count + WEIGHT * slope.T @ slope, side

    own, sides = jax.lax.map(of_frame, (poses, pairs))

    def rough(d):
        q = jax.vmap(retract, (None, 0, 0))(SKELETON, poses, d.reshape(frames, DOFS)).rotations
        back = rotation.conjugate(q[1:-1])
        slopes = [
            rotation.log(rotation.multiply(back, there)) / gap[:, None, None]
            for there, gap in ((q[:-2], since[:-1]), (q[2:], since[1:]))
        ]
        # half the second derivative, by how the slopes change from the middle of one gap to that of the next
        apart = (slopes[0] + slopes[1]) / (since[:-1] + since[1:])[:, None, None]
        return apart.reshape(-1) / jnp.sqrt(apart.shape[0] * apart.shape[1])

    zero = jnp.zeros(frames * DOFS)
    slope = jax.jacrev(rough)(zero)
    matrix = jax.scipy.linalg.block_diag(*own) / frames + TEMPORAL * slope.T @ slope
    side = sides.reshape(-1) / frames - TEMPORAL * slope.T @ rough(zero)
    charts = jax.vmap(make_box_chart, (None, None, 0))(boxes, SKELETON, poses)
    turn = jax.scipy.linalg.block_diag(*charts.basis)
    low, high = (jnp.where(held & (jnp.arange(frames) < 1)[:, None], 0.0, end) for end in charts[1:])
    # a held frame's bounds leave it no room
    units = jnp.tile(pose_scales(SKELETON), frames)
    matrix = turn.T @ matrix @ turn
    # each curvature grows by a share, and a little of the largest of its frame in the solver's units
    diagonal = (jnp.diag(matrix) * units**2).reshape(frames, DOFS)
    floor = jnp.finfo(diagonal.dtype).eps * diagonal.max(1, keepdims=True)
    matrix = matrix + jnp.diag((1e-4 * diagonal + floor).reshape(-1) / units**2)
    step = solve_bounded(matrix, turn.T @ side, low.reshape(-1), high.reshape(-1))
    return step.reshape(frames, DOFS)


@pytest.mark.parametrize(("held", "gaps"), [(False, [1, 1, 1, 1, 1]), (True, [1, 3, 1, 1, 2])])
def test_the_step_is_that_of_dense_equations(rng, held, gaps):
    poses, pairs = scene(rng, 6)
    boxes = some_boxes(poses, 1.0)
    for bounds in (
        boxes,
        eqx.tree_at(lambda b: (b.lower, b.upper), boxes, (boxes.lower - 9, boxes.upper + 9)),
    ):
        args = stack_trees(poses), stack_trees(pairs), bounds, jnp.asarray(held), jnp.asarray(gaps, float)
        (low, high), step = step_of(*args[:3], int(held), args[4])
        expected = np.asarray(dense_step(*args))
        np.testing.assert_allclose(step, expected, atol=1e-9 * np.abs(expected).max())
        at = (np.isclose(step, low, atol=1e-12) | np.isclose(step, high, atol=1e-12))[1:]
        assert at.any() == (bounds is boxes)
        assert (np.asarray(step[0]) == 0).all() == held


@pytest.mark.parametrize("boxed", [False, True])
def test_no_window_is_left_worse_than_it_was(rng, boxed):
    """Far from the solution, where whole steps go too far; pairs are the same all along."""
    poses, pairs = scene(rng, 6)
    poses = [retract(SKELETON, pose, jnp.asarray(0.5 * rng.normal(size=DOFS))) for pose in poses]
    boxes = some_boxes(poses, 1.0) if boxed else make_pose_boxes((), np.zeros((0, 3)), np.zeros((0, 3)))
    told = [poses]
    for _ in range(4):
        told.append(smooth_poses(BODY, told[-1], lambda n, _: pairs[n], PoseTerms(PRIOR, WEIGHT, boxes), float(TEMPORAL), frames=6, steps=1))  # fmt: skip
    values = [float(energy(stack_trees(poses), stack_trees(pairs))) for poses in told]
    assert (np.diff(values) <= 1e-12).all()
    assert values[-1] < 0.5 * values[0]


def test_the_best_poses_are_kept_where_new_pairs_are_worse(rng):
    """Pairs that are further apart with every step, as no step can foresee."""
    poses, pairs = scene(rng, 4)
    asked = []

    def pairs_at(frame, pose):
        asked.append(frame)
        round = asked.count(frame) - 1
        return eqx.tree_at(lambda p: p.points, pairs[frame], pairs[frame].points + 5.0 * round)

    kept = smooth_poses(BODY, poses, pairs_at, PoseTerms(PRIOR, WEIGHT), float(TEMPORAL), frames=4, steps=5)
    for one, other in zip(kept, poses, strict=True):
        np.testing.assert_array_equal(one.rotations, other.rotations)
    # and some more steps were tried
    assert [asked.count(frame) for frame in range(4)] == [4] * 4


def test_windows_ask_for_pairs_of_frames_that_moved_and_forget_those_behind(rng):
    """One compilation for all windows, and in memory the pairs of one."""
    poses, pairs = scene(rng, 8)
    asked, given, traces = [], [], []

    class Counted(RestPrior):
        def residual(self, posed):
            traces.append(posed)
            return super().residual(posed)

    def pairs_at(frame, _):
        # those of a window, and one on each core
        assert sum(each() is not None for each in given) <= 4 + (os.cpu_count() or 1)
        asked.append(frame)
        own = eqx.tree_at(lambda p: p.weights, pairs[frame], pairs[frame].weights)
        given.append(weakref.ref(own))
        return own

    def smooth(poses):
        prior = Counted(PRIOR.deviations)
        return smooth_poses(BODY, poses, pairs_at, PoseTerms(prior, 1e-3), 0.3, frames=4, stride=2, steps=1)

    smooth(poses[:4])
    count = len(traces)
    asked.clear()
    found = smooth(poses)
    assert len(traces) == count
    # three windows; the first frame of a later one is held
    ends = np.cumsum([4, 4, 2, 3, 2, 3])
    rounds = [
        sorted(asked[end - count : end]) for end, count in zip(ends, np.diff(ends, prepend=0), strict=True)
    ]
    assert rounds == [[0, 1, 2, 3], [0, 1, 2, 3], [4, 5], [3, 4, 5], [6, 7], [5, 6, 7]]
    rough = [float(temporal_energy(SKELETON, stack_trees(each))) for each in (poses, found)]
    assert rough[1] < 0.2 * rough[0]


def test_an_even_motion_with_a_gap_stays_as_it_is(rng):
    """With nothing but smoothness to say: poses stay where times are told, and move where they are not."""
    times, rest = [0, 1, 4, 5, 6, 8], rest_pose(SKELETON)
    ball = np.array([kind == "ball" for kind in SKELETON.kinds])
    way = jnp.asarray(np.where(ball[:, None], 0.05 * rng.normal(size=(len(ball), 3)), 0.0))
    turned = [rotation.multiply(rest.rotations, rotation.exp(time * way)) for time in times]
    poses = [eqx.tree_at(lambda p: p.rotations, rest, rotations) for rotations in turned]
    pairs = random_pairs(BODY, rng, 60)
    none = eqx.tree_at(lambda p: p.weights, pairs, jnp.zeros_like(pairs.weights))
    moves = []
    for told in (times, None):
        found = smooth_poses(
            BODY, poses, lambda *_: none, PoseTerms(PRIOR, 0.0), 1.0, frames=4, stride=2, times=told
        )
        moves.append(max(float(jnp.abs(there.rotations - pose.rotations).max()) for there, pose in zip(found, poses, strict=True)))  # fmt: skip
    assert moves[0] < 1e-9
    assert moves[1] > 1e-3
