"""Two people with equal labels and a prop in one recording without labels."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcap as jc
from jaxcap.body.pose import Motion, Pose
from jaxcap.markers.labels.describe_labels import TrackLabel
from jaxcap.markers.labels.label_markers import Labelling
from jaxcap.markers.subjects.label_subjects import (
    describe_identities,
    exchange_subjects,
    find_exchanges,
    identity_misfits,
)
from jaxcap.markers.subjects.prop import fit_prop
from tests.markers_limb import CENTRES, moving, seen_by, truth

FRAMES = 40
SIZES = {"Anna": 1.0, "Ben": 1.2}


def of_size(size: float):
    """The limb with all lengths scaled."""
    subject = truth()
    return eqx.tree_at(
        lambda s: (s.skeleton.centres, s.offsets),
        subject,
        (jnp.asarray(size * CENTRES), size * subject.offsets),
    )


@pytest.fixture(scope="module")
def scene():
    """The subjects, and the markers of each in one recording: Ben stands a metre from Anna, the box between them turns."""
    rng = np.random.default_rng(4)
    subjects, parts = {name: of_size(size) for name, size in SIZES.items()}, {}
    for number, (name, subject) in enumerate(subjects.items()):
        motion = moving(rng, FRAMES)
        away = jnp.zeros((5, 3)).at[0].set(jnp.array([0.3, 0.0, 1.1 * number]))
        motion = Motion(
            Pose(motion.poses.translations + away, motion.poses.rotations, motion.poses.scale), 100.0
        )
        parts[name] = seen_by(subject, motion, rng)
    turn = np.linspace(0, 2, FRAMES)
    shape = np.array([[0.0, 0, 0], [0.25, 0, 0], [0, 0.15, 0], [0.1, 0.05, 0.2]])
    c, s = np.cos(turn), np.sin(turn)
    turns = np.stack([c, 0 * c, s, 0 * c, 1 + 0 * c, 0 * c, -s, 0 * c, c], 1).reshape(-1, 3, 3)
    places = np.einsum("fab,mb->fma", turns, shape) + [0.3, -0.4, 0.5]
    parts["Box"] = jc.make_markers(places, [str(k) for k in range(4)], 100.0)
    subjects["Box"] = fit_prop(parts["Box"], "Box").subject
    return subjects, parts


def recording(parts, named=True):
    places = np.concatenate([np.asarray(part.positions) for part in parts.values()], 1)
    labels = [f"{name}:{label}" for name, part in parts.items() for label in part.labels]
    order = np.random.default_rng(8).permutation(len(labels))
    labels = [labels[k] for k in order] if named else [f"*{k}" for k in range(len(order))]
    return jc.make_markers(places[:, order], labels, 100.0)


def test_points_of_several_subjects_get_labels_at_once(scene):
    """Every label is right, whichever subject it is of, without a single given one."""
    subjects, parts = scene
    found = jc.markers.label_subjects(subjects, recording(parts, named=False))
    right = recording(parts)
    for column, label in enumerate(found.frames.labels):
        seen = np.asarray(found.frames.visible)[:, column]
        assert seen.mean() > 0.9, label
        truth_at = np.asarray(right.positions)[:, right.labels.index(label)]
        np.testing.assert_allclose(
            np.asarray(found.frames.positions)[seen, column], truth_at[seen], atol=1e-6, err_msg=label
        )
    assert not found.doubtful.any() and not any("check who" in one for one in found.messages)


def test_people_of_equal_bones_are_not_told_apart_silently(scene):
    subjects, parts = scene
    named = recording(parts)
    own = identity_misfits(subjects, named)
    assert own[0, 0] < 2e-3 and own[0, 1] > 5e-3 and np.isinf(own[0, 2])
    assert describe_identities(list(subjects), own) == []
    twins = {"Anna": subjects["Anna"], "Ben": subjects["Anna"]}
    both = {"Anna": parts["Anna"], "Ben": parts["Anna"]}
    said = describe_identities(["Anna", "Ben"], identity_misfits(twins, recording(both)))
    assert len(said) == 1 and "check who is who" in said[0]


def test_exchanged_people_get_their_own_labels_next_to_a_prop(scene):
    """Labels, tracks and sentences of Anna and Ben are exchanged back; a quoted label is one of the input."""
    subjects, parts = scene
    joined = jc.markers.join_subjects(subjects)
    swapped = recording({"Anna": parts["Ben"], "Ben": parts["Anna"], "Box": parts["Box"]})
    order = find_exchanges(identity_misfits(subjects, swapped))
    np.testing.assert_array_equal(order, [1, 0, 2])
    track = TrackLabel("*1", 0, FRAMES, "Anna:trunk_0")
    said = "The label 'Ben:trunk_0' is contradicted; it is Anna:trunk_0 there.", "No points for Box:1, Ben:trunk_1."  # fmt: skip
    found = Labelling(swapped, moving(np.random.default_rng(0), 1), (track,), np.zeros(FRAMES, bool), said)
    fixed = exchange_subjects(joined, found, {"Anna": "Ben", "Ben": "Anna"})
    right = recording(parts)
    for column, label in enumerate(fixed.frames.labels):
        truth_at = np.asarray(right.positions)[:, right.labels.index(label)]
        np.testing.assert_array_equal(np.asarray(fixed.frames.positions)[:, column], truth_at)
    assert fixed.tracks[0].label == "Ben:trunk_0" and fixed.tracks[0].name == "*1"
    assert fixed.messages == (
        "The label 'Ben:trunk_0' is contradicted; it is Ben:trunk_0 there.",
        "No points for Box:1, Anna:trunk_1.",
    )
    first = jax.tree.map(lambda leaf: leaf[0], fixed.motion.poses)
    predicted = np.asarray(jc.markers.marker_positions(joined, first))
    assert np.abs(predicted - np.asarray(fixed.frames.positions)[0]).max() < 0.01


def test_each_exchange_is_decided_by_itself():
    """A bad prop or a doubtful pair neither prevents nor causes the exchange of others."""
    misfits = np.full((5, 5), np.inf)
    misfits[:2, :2] = [[8e-3, 1e-3], [1e-3, 8e-3]]
    misfits[2:4, 2:4] = [[5e-3, 4e-3], [4.5e-3, 5e-3]]
    misfits[4, 4] = 0.05
    np.testing.assert_array_equal(find_exchanges(misfits), [1, 0, 2, 3, 4])
    said = describe_identities(list("abcde"), misfits[:, find_exchanges(misfits)])
    assert len(said) == 1 and "better than their own" in said[0]
    assert "4.2 mm from each other's" in said[0] and "5.0 mm from their own" in said[0]
    cycle = np.full((3, 3), 9e-3)
    cycle[[0, 1, 2], [1, 2, 0]] = 1e-3
    np.testing.assert_array_equal(find_exchanges(cycle), [1, 2, 0])


def test_joined_subjects_move_as_each_by_itself(scene):
    """The markers of a pose of the joined skeleton are those of the parts."""
    subjects, _ = scene
    joined = jc.markers.join_subjects(subjects)
    assert joined.skeleton.parents.count(-1) == 3 and "Ben:left_arm" in joined.skeleton.names
    rng = np.random.default_rng(1)
    motions = [moving(rng, 1) for _ in range(2)]
    rest = jc.rest_pose(subjects["Box"].skeleton)
    pose = Pose(
        jnp.concatenate([*(m.poses.translations[0] for m in motions), rest.translations]),
        jnp.concatenate([*(m.poses.rotations[0] for m in motions), rest.rotations]),
        jnp.ones(()),
    )
    places = np.asarray(jc.markers.marker_positions(joined, pose))
    alone = np.concatenate(
        [
            np.asarray(jc.markers.marker_positions(subjects[name], motion[0]))
            for name, motion in zip(SIZES, motions, strict=True)
        ]
    )
    np.testing.assert_allclose(places[: len(alone)], alone, atol=1e-12)
