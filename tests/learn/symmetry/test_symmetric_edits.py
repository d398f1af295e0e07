"""Joints that are inserted and removed in pairs or on the middle."""

import jax.numpy as jnp
import numpy as np

from jaxcap.body.body import posed_vertices
from jaxcap.body.pose import Motion
from jaxcap.geometry.laplacian import make_conformance
from jaxcap.learn.joint_exchange.exchange_joints import exchange_joints
from jaxcap.learn.joint_exchange.insert_and_remove import Removal, Split
from jaxcap.learn.joint_exchange.symmetric_edits import group_removals, group_splits, mirror_point
from jaxcap.learn.objective import objective
from jaxcap.learn.state import LearnState
from jaxcap.learn.symmetry.judge_map import MapQuality
from jaxcap.learn.symmetry.surface_symmetry import SurfaceSymmetry
from tests.learn.test_learn_exchange import FRAMES, TRUE, WRONG, jointed_tube


def symmetry_of(mirrored: np.ndarray, sides: np.ndarray) -> SurfaceSymmetry:
    weights = np.repeat([[1.0, 0.0, 0.0]], len(mirrored), 0)
    return SurfaceSymmetry(
        np.repeat(mirrored[:, None], 3, 1), weights, sides, MapQuality(0.0, 0.0, 0.0, 1.0, 1.0, 1.0)
    )


def split_of(vertices, gain: float, joint: int = 0) -> Split:
    count = len(vertices)
    none = np.zeros((1, 2, 3))
    return Split(
        joint, gain, np.array(vertices), np.repeat([[0.0, 1.0]], count, 0), np.zeros((1, 2, 3, 3)), none,
        ((1, joint, np.zeros(3)),),
    )  # fmt: skip


def test_splits_are_grouped_with_their_images():
    line = np.arange(20)
    symmetry = symmetry_of(line[::-1], np.where(line < 10, 1, -1))
    left, right, middle, alone = (
        split_of(vertices, gain)
        for vertices, gain in (([0, 1, 2], 4.0), ([18, 19], 1.0), ([9, 10], 3.0), ([5, 6], 9.0))
    )
    groups = group_splits([alone, left, middle, right], symmetry)
    assert groups == [(middle,), (left, right)]
    assert group_splits([alone, left], None) == [(alone,), (left,)]


def test_removals_are_grouped_by_pairs():
    none = np.zeros(0, int), np.zeros((0, 5))
    removals = [Removal(joint, cost, *none) for joint, cost in ((3, 1.0), (2, 2.0), (4, 4.0), (1, 5.0))]
    joints = [
        tuple(removal.joint for removal in group) for group in group_removals(removals, np.array([[1, 3]]))
    ]
    assert joints == [(2,), (1, 3), (4,)]
    assert [group[0].joint for group in group_removals(removals, None)] == [3, 2, 4, 1]


def test_an_exchange_on_a_symmetric_tube_makes_pairs(rng):
    turns, shifts = 0.4 * rng.normal(size=(FRAMES, 5, 3)), rng.normal(size=(FRAMES, 3))
    truth, poses = jointed_tube(TRUE, "lbs", turns, shifts)
    still = np.zeros_like(turns[:, 0])
    guessed = np.stack([turns[:, 0], still, turns[:, 1], still, turns[:, 3]], 1)
    body, guess = jointed_tube(WRONG, "lbs", guessed, shifts)
    targets = posed_vertices(truth, poses)
    rest = np.asarray(body.vertices)
    mirrored = np.argmin(np.linalg.norm((rest * [-1, 1, 1] + [1, 0, 0])[:, None] - rest, axis=-1), 1)
    symmetry = symmetry_of(mirrored, np.sign(np.round(rest[:, 0] - 0.5, 6)).astype(int))
    metric = make_conformance(np.asarray(body.faces), len(rest), 10.0)

    def place(state, made):
        value = float(objective(made.body, made.poses, targets, metric))
        return state._replace(
            body=made.body,
            motion=Motion(made.poses),
            left_right_pairs=made.left_right_pairs,
            history=(*state.history, ("placed", value)),
        )

    before = float(objective(body, guess, targets, metric))
    state = LearnState(body, Motion(guess), np.zeros((0, 2), int), 1e-3, (("start", before),), 0)
    after = exchange_joints(state, targets, place, symmetry=symmetry)
    assert after.history[-1][1] < 1e-3 * before
    skeleton = after.body.skeleton
    assert len(after.left_right_pairs) == 2
    centres = np.asarray(skeleton.centres)[:, 0]
    for left, right in after.left_right_pairs:
        # the true joints are at 0.66 and 0.36, and at 0.86 and 0.16
        assert abs(centres[left] + centres[right] - 1.02) < 5e-3
    outer = [pair for pair in after.left_right_pairs if skeleton.parents[pair[0]] > 0]
    lengths = [abs(centres[joint] - centres[skeleton.parents[joint]]) for joint in outer[0]]
    assert abs(lengths[0] - lengths[1]) < 1e-6
    assert jnp.isfinite(after.body.vertices).all()


def test_points_are_mirrored_with_the_surface_around_them(rng):
    vertices = rng.normal(size=(200, 3))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn = turn * -np.sign(np.linalg.det(turn))
    points = vertices @ turn.T + [1.0, 2.0, 3.0]
    wanted = turn @ vertices[7] + [1.0, 2.0, 3.0]
    np.testing.assert_allclose(mirror_point(vertices[7], vertices, points), wanted, atol=1e-9)
