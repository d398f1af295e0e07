"""A joint too many for one too few: bodies with both wrong are put right."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcap as jc
from jaxcap.body.body import Body, posed_vertices
from jaxcap.body.pose import Motion, Pose
from jaxcap.body.skin import LinearSkin, SwingTwistSkin
from jaxcap.geometry import rotation
from jaxcap.geometry.laplacian import make_conformance
from jaxcap.learn.joint_exchange.exchange_joints import exchange_joints, has_exchangeable_joints
from jaxcap.learn.joint_exchange.insert_and_remove import Split, insert_joint, remove_joint
from jaxcap.learn.joint_exchange.insertion_candidates import find_splits
from jaxcap.learn.joint_exchange.removal_candidates import find_removals
from jaxcap.learn.objective import objective
from jaxcap.learn.skeleton.reparent import bone_motions
from jaxcap.learn.state import LearnState
from tests.helpers import chain_body
from tests.learn.test_learn_parts import same_partition, tube

_exp = jax.jit(rotation.exp)
FRAMES = 12
#: bones of a tube, (parent, from, to, joint) along it: in truth; and with two of which both are the root's
#: and none for either end
TRUE = [
    (-1, 0.36, 0.66, 0.5),
    (0, 0.66, 0.86, 0.66),
    (1, 0.86, 2, 0.86),
    (0, 0.16, 0.36, 0.36),
    (3, -1, 0.16, 0.16),
]
WRONG = [
    (-1, 0.46, 0.56, 0.5),
    (0, 0.56, 0.66, 0.56),
    (1, 0.66, 2, 0.66),
    (0, 0.36, 0.46, 0.46),
    (3, -1, 0.36, 0.36),
]


def jointed_tube(bones, skin: str, turns: np.ndarray, shifts: np.ndarray) -> tuple[Body, Pose]:
    """A tube of rigid bones, and its poses by rotation vectors (F, J, 3) and the root's shifts (F, 3)."""
    vertices, faces = tube(1.0, 61, 8)
    parents, low, high, joints = np.array(bones).T
    count = len(bones)
    centres = joints[:, None] * np.eye(3)[0]
    names = ["root", *(f"joint{j}" for j in range(1, count))]
    kinds = ["free"] + ["ball"] * (count - 1)
    skeleton = jc.make_skeleton(names, parents.astype(int).tolist(), kinds, centres)
    along = vertices[:, :1]
    labels = jnp.asarray(np.argmax((along > low) & (along < high), 1))
    none = jnp.zeros((len(vertices), count))
    bound = {
        "lbs": LinearSkin(none.at[jnp.arange(len(vertices)), labels].set(1.0)),
        "swing_twist": SwingTwistSkin(labels, none, none),
    }[skin]
    translations = jnp.zeros(turns.shape).at[:, 0].set(shifts)
    poses = Pose(translations, _exp(jnp.asarray(turns)), jnp.ones(len(turns)))
    return Body(skeleton, bound, jnp.asarray(vertices), jnp.asarray(faces)), poses


@pytest.fixture
def wrong(rng):
    """Makes the wrong body, its poses, the true meshes, and the true body."""

    def make(skin: str):
        turns, shifts = 0.4 * rng.normal(size=(FRAMES, 5, 3)), rng.normal(size=(FRAMES, 3))
        truth, poses = jointed_tube(TRUE, skin, turns, shifts)
        still = np.zeros_like(turns[:, 0])
        guessed = np.stack([turns[:, 0], still, turns[:, 1], still, turns[:, 3]], 1)
        body, guess = jointed_tube(WRONG, skin, guessed, shifts)
        return body, guess, posed_vertices(truth, poses), truth

    return make


@pytest.mark.parametrize("skin", ["lbs", "swing_twist"])
def test_exchange_puts_the_tree_right(wrong, skin):
    body, poses, targets, truth = wrong(skin)
    metric = make_conformance(np.asarray(body.faces), len(body.vertices), 10.0)

    def place(state, grafted):
        value = float(objective(grafted.body, grafted.poses, targets, metric))
        return state._replace(
            body=grafted.body,
            motion=Motion(grafted.poses),
            left_right_pairs=grafted.left_right_pairs,
            history=(*state.history, ("placed", value)),
        )

    before = float(objective(body, poses, targets, metric))
    state = LearnState(body, Motion(poses), np.array([[1, 3], [2, 4]]), 1e-3, (("start", before),), 0)
    after = exchange_joints(state, targets, place)
    # the bones move rigidly: nothing has to be improved after either exchange
    assert after.history[0] == state.history[0] and after.history[-1][0] == "exchange"
    assert after.history[-1][1] < 1e-12 * before
    skeleton = after.body.skeleton
    assert skeleton.num_joints == len(set(skeleton.names)) == 5
    labels, true = np.asarray(after.body.skin.dominant_bones()), np.asarray(truth.skin.dominant_bones())
    assert same_partition(labels, true)
    # which of its bones is which of the truth's
    same = [int(true[labels == bone][0]) for bone in range(5)]
    above = [-1 if parent < 0 else same[parent] for parent in skeleton.parents]
    assert above == [truth.skeleton.parents[bone] for bone in same]
    centres = np.asarray(truth.skeleton.centres)[same]
    np.testing.assert_allclose(skeleton.centres[1:], centres[1:], atol=2e-3)
    assert len(after.left_right_pairs) == 0


def test_failed_exchanges_leave_all_as_it_was(wrong):
    body, poses, targets, _ = wrong("swing_twist")
    state = LearnState(body, Motion(poses), np.zeros((0, 2), int), 1e-3, (("start", 1.0),), 0)
    worse = lambda state, _: state._replace(history=(*state.history, ("round", 1.0)))  # noqa: E731
    after = exchange_joints(state, targets, worse)
    assert after._replace(history=()) == state._replace(history=())
    assert set(after.history[1:]) == {("exchange", 1.0)}
    assert not has_exchangeable_joints(chain_body())


def test_what_is_lost_and_gained(wrong):
    body, poses, targets, _ = wrong("lbs")
    errors = targets - posed_vertices(body, poses)
    total = float(jnp.sum(errors**2))
    splits = find_splits(body, poses, targets)
    along = np.asarray(body.vertices)[:, 0]
    ends = {2: along > 0.86, 4: along < 0.16}
    found = {joint: next(split for split in splits if split.joint == joint) for joint in ends}
    for joint, split in found.items():
        own = np.zeros(len(along), bool)
        own[split.vertices] = split.weights[:, -1] > 0.5
        np.testing.assert_array_equal(own, ends[joint])
        # most of what was left there, as the ends move rigidly: blends of others could mend a little
        left = float(jnp.sum(errors[:, own] ** 2))
        assert 0.8 * left < split.gain <= left
        np.testing.assert_allclose(split.weights.sum(1), 1.0)
    assert {split.joint for split in splits if split.gain > 1e-9 * total} == {2, 4}
    removals = find_removals(body, poses, targets)
    assert {removal.joint for removal in removals[:2]} == {1, 3} and removals[1].cost < 1e-9 * total
    assert removals[2].cost > 1e-3 * total
    np.testing.assert_allclose(removals[0].weights.sum(1), 1.0)


def test_a_bone_that_moves_nothing_costs_nothing(wrong):
    body, poses, targets, _ = wrong("lbs")
    weights = jnp.asarray(body.skin.bone_weights(body.skeleton.num_joints)).at[:, 2].set(0.0)
    weights = weights.at[:, 0].add(1.0 - weights.sum(1))
    idle = Body(body.skeleton, LinearSkin(weights), body.vertices, body.faces)
    removals = find_removals(idle, poses, targets)
    assert {removal.joint for removal in removals} == set(range(1, body.skeleton.num_joints))
    assert next(removal for removal in removals if removal.joint == 2).cost == 0.0


def test_other_bones_move_as_before(wrong, rng):
    body, poses, _, _ = wrong("lbs")
    along = np.asarray(body.vertices)[:, 0]
    before = bone_motions(body.skeleton, poses)
    middle = np.array([0.8, 0.0, 0.0])
    turns = np.asarray(rotation.to_matrix(_exp(jnp.asarray(0.3 * rng.normal(size=(FRAMES, 3))))))
    below = np.flatnonzero(along > 0.8)
    shares = np.zeros((len(below), 6))
    shares[:, 5] = 1.0
    shift = middle - turns @ middle
    bone = before.rotations[:, 2], before.translations[:, 2]
    rotations = np.stack([bone[0], bone[0] @ turns], 1)
    translations = np.stack([bone[1], np.einsum("fab,fb->fa", bone[0], shift) + bone[1]], 1)
    split = Split(2, 0.0, below, shares, rotations, translations, ((5, 2, middle),))
    more = insert_joint(body, poses, np.array([[1, 2]]), split)
    after = bone_motions(more.body.skeleton, more.poses)
    np.testing.assert_allclose(after.rotations[:, :5], before.rotations, atol=1e-8)
    np.testing.assert_allclose(after.translations[:, :5], before.translations, atol=1e-8)
    np.testing.assert_allclose(after.rotations[:, 5], before.rotations[:, 2] @ turns, atol=1e-8)
    np.testing.assert_array_equal(more.left_right_pairs, [[1, 2]])
    # and away again, by the blend that is best without it
    removals = find_removals(more.body, more.poses, posed_vertices(body, poses))
    gone = next(removal for removal in removals if removal.joint == 5)
    less = remove_joint(*more, gone)
    assert less.body.skeleton.names == body.skeleton.names
    np.testing.assert_allclose(posed_vertices(less.body, less.poses), posed_vertices(body, poses), atol=1e-8)
