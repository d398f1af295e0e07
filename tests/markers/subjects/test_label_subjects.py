"""Two people with equal labels and a prop in one recording without labels."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcap as jc
from jaxcap.body.pose import Motion, Pose
from jaxcap.markers.subjects.label_subjects import describe_identities, identity_misfits
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
