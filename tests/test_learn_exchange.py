"""A joint too many for one too few: bodies with both wrong are put right."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcap as jc
from jaxcap.body.body import Body
from jaxcap.body.pose import Motion, Pose
from jaxcap.body.skin import LinearSkin, RigidSkin, SwingTwistSkin
from jaxcap.geometry import rotation
from jaxcap.geometry.laplacian import make_conformance
from jaxcap.learn.dissolve import find_removals
from jaxcap.learn.exchange import exchange, exchangeable
from jaxcap.learn.graft import Split, with_joint, without_joint
from jaxcap.learn.hang import bone_motions
from jaxcap.learn.objective import deform_all, objective
from jaxcap.learn.splits import find_splits
from jaxcap.learn.state import LearnState
from tests.helpers import chain_body
from tests.test_learn_parts import tube

FRAMES = 12
#: along the tube: where bones begin, in truth, and in the body that has one too many and lacks one
TRUE, WRONG = (0.16, 0.31, 0.56, 0.81), (0.16, 0.31, 0.43, 0.56)


def jointed_tube(starts, skin: str, turns: np.ndarray, shifts: np.ndarray) -> tuple[Body, Pose]:
    """A tube with rigid bones that begin at `starts`, in a chain, and its poses (F, J, 3) by rotation vectors."""
    vertices, faces = tube(1.0, 61, 8)
    count = len(starts)
    centres = np.array([[x, 0.0, 0.0] for x in starts])
    names = ["root", *(f"joint{j}" for j in range(1, count))]
    skeleton = jc.make_skeleton(names, range(-1, count - 1), ["free"] + ["ball"] * (count - 1), centres)
    labels = jnp.asarray(np.digitize(vertices[:, 0], starts[1:]))
    none = jnp.zeros((len(vertices), count))
    bound = {
        "rigid": RigidSkin(labels),
        "lbs": LinearSkin(none.at[jnp.arange(len(vertices)), labels].set(1.0)),
        "swing_twist": SwingTwistSkin(labels, none, none),
    }[skin]
    rotations = jax.vmap(jax.vmap(rotation.exp))(jnp.asarray(turns))
    translations = jnp.zeros(turns.shape).at[:, 0].set(shifts)
    body = Body(skeleton, bound, jnp.asarray(vertices), jnp.asarray(faces))
    return body, Pose(translations, rotations, jnp.ones(len(turns)))


@pytest.fixture
def wrong(rng):
    """Makes a body with a joint that does nothing and without the last one, its poses, and the true meshes."""

    def make(skin: str):
        turns, shifts = 0.4 * rng.normal(size=(FRAMES, 4, 3)), rng.normal(size=(FRAMES, 3))
        truth, poses = jointed_tube(TRUE, skin, turns, shifts)
        still = np.stack([turns[:, 0], turns[:, 1], np.zeros_like(turns[:, 1]), turns[:, 2]], 1)
        body, guess = jointed_tube(WRONG, skin, still, shifts)
        return body, guess, deform_all(truth, poses), np.asarray(truth.vertices)[:, 0]

    return make


@pytest.mark.parametrize("skin", ["rigid", "lbs", "swing_twist"])
def test_exchange_puts_the_tree_right(wrong, skin):
    body, poses, targets, along = wrong(skin)
    metric = make_conformance(np.asarray(body.faces), len(body.vertices), 10.0)

    def place(state, grafted):
        value = float(objective(grafted.body, grafted.poses, targets, metric))
        return state._replace(
            body=grafted.body,
            motion=Motion(grafted.poses),
            pairs=grafted.pairs,
            history=(*state.history, ("placed", value)),
        )

    before = float(objective(body, poses, targets, metric))
    state = LearnState(body, Motion(poses), np.array([[1, 3]]), 1e-3, (("start", before),), 0)
    after = exchange(state, targets, place)
    # the bones move rigidly: nothing has to be improved after the one exchange
    assert after.history[0] == state.history[0] and after.history[1][0] == "exchange"
    assert after.history[1][1] < 1e-12 * before
    skeleton = after.body.skeleton
    assert skeleton.num_joints == 4 and len(set(skeleton.names)) == 4
    assert skeleton.parents == (-1, 0, 1, 2)
    np.testing.assert_allclose(skeleton.centres[1:, 0], TRUE[1:], atol=2e-3)
    np.testing.assert_array_equal(after.body.skin.parts(), np.digitize(along, TRUE[1:]))
    assert len(after.pairs) == 0


def test_failed_exchanges_leave_all_as_it_was(wrong):
    body, poses, targets, _ = wrong("swing_twist")
    state = LearnState(body, Motion(poses), np.zeros((0, 2), int), 1e-3, (("start", 1.0),), 0)
    worse = lambda state, _: state._replace(body=None, history=(*state.history, ("round", 1.0)))  # noqa: E731
    after = exchange(state, targets, worse)
    assert after._replace(history=()) == state._replace(history=())
    assert set(after.history[1:]) == {("exchange", 1.0)}
    assert not exchangeable(chain_body())


def test_what_is_lost_and_gained(wrong):
    body, poses, targets, along = wrong("lbs")
    errors = np.asarray(targets - deform_all(body, poses))
    total = float(np.sum(errors**2))
    split, *others = find_splits(body, poses, errors)
    assert split.joint == 3 and all(other.gain < 1e-9 * total for other in others)
    np.testing.assert_array_equal(split.below, along > TRUE[3])
    # all that one rigid motion of the bone could not explain
    own = np.digitize(along, WRONG[1:]) == 3
    left = sum(_procrustes(np.asarray(body.vertices)[own], frame[own]) for frame in np.asarray(targets))
    np.testing.assert_allclose(split.gain, left, rtol=1e-6)
    removals = find_removals(body, poses, targets)
    # two bones move alike: either may go
    assert {removal.joint for removal in removals[:2]} == {1, 2} and removals[1].cost < 1e-9 * total
    assert removals[2].cost > 1e-3 * total
    np.testing.assert_allclose(removals[0].shares.sum(1), 1.0)


def test_other_bones_move_as_before(wrong, rng):
    body, poses, _, along = wrong("lbs")
    before = bone_motions(body.skeleton, poses)
    middle = np.array([0.7, 0.0, 0.0])
    turns = np.asarray(
        jax.vmap(rotation.to_matrix)(jax.vmap(rotation.exp)(jnp.asarray(0.3 * rng.normal(size=(FRAMES, 3)))))
    )
    still = np.broadcast_to(np.eye(3), turns.shape)
    split = Split(
        3,
        0.0,
        along > 0.7,
        (),
        np.stack([still, turns], 1),
        np.stack([np.zeros((FRAMES, 3)), middle - turns @ middle], 1),
        middle,
        0.06,
    )
    more = with_joint(body, poses, np.array([[1, 2]]), split)
    after = bone_motions(more.body.skeleton, more.poses)
    np.testing.assert_allclose(after.rotations[:, :4], before.rotations, atol=1e-8)
    np.testing.assert_allclose(after.translations[:, :4], before.translations, atol=1e-8)
    np.testing.assert_allclose(after.rotations[:, 4], before.rotations[:, 3] @ turns, atol=1e-8)
    np.testing.assert_array_equal(more.pairs, [[1, 2]])
    # and away again, by the blend that is best without it
    removals = find_removals(more.body, more.poses, deform_all(body, poses))
    gone = next(removal for removal in removals if removal.joint == 4)
    less = without_joint(*more, gone)
    assert less.body.skeleton.names == body.skeleton.names
    np.testing.assert_allclose(deform_all(less.body, less.poses), deform_all(body, poses), atol=1e-8)


def _procrustes(source, target) -> float:
    """The least sum of squares of a rigid motion, by the singular values."""
    p, x = source - source.mean(0), target - target.mean(0)
    u, s, vt = np.linalg.svd(x.T @ p)
    s[2] *= np.sign(np.linalg.det(u @ vt))
    return float(np.sum(p**2) + np.sum(x**2) - 2 * s.sum())
