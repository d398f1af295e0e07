"""Tracks that fit a label as well as another one get none, and the better of two tracks keeps it."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcap.geometry import rotation
from jaxcap.markers.labels.rival_tracks import _frame_costs, decide_rivals
from jaxcap.markers.labels.tracks import Track
from jaxcap.markers.labels.vote import LabelledTrack
from jaxcap.markers.subject import make_subject
from tests.markers_limb import moving, seen_by, truth

FRAMES, HAND, TRUNK = 24, 15, 2


@pytest.fixture(scope="module")
def scene():
    """The limb with a single marker on its right hand; the motion, and the positions of its markers."""
    whole, rng = truth(), np.random.default_rng(1)
    some = slice(HAND + 1)
    subject = make_subject(
        whole.skeleton,
        np.asarray(whole.bones)[some],
        whole.offsets[some],
        whole.labels[some],
        deviations=whole.deviations[some],
    )
    motion = moving(rng, FRAMES)
    return subject, motion, np.asarray(seen_by(subject, motion, rng, noise=5e-4).positions)


def decide(scene, path, marker: int, is_labelled: bool) -> list[int]:
    """The labels of a marker's own track and of a reflection on a `path`, one of which had the label before."""
    subject, _, places = scene
    positions = np.concatenate([places, path[:, None]], 1)
    count = subject.num_markers
    own, other = (marker, -1) if is_labelled else (-1, marker)
    labels = [*range(count), other]
    labels[marker] = own
    labelled = [LabelledTrack(Track(column, 0, FRAMES), label) for column, label in enumerate(labels)]
    columns = np.tile(np.arange(count), (FRAMES, 1))
    columns[:, marker] = marker if is_labelled else count
    predicted = np.take_along_axis(positions, columns[..., None], 1)
    found = decide_rivals(subject, labelled, positions, predicted, columns, np.full(count, 0.025))
    assert [one.marker for one in found[:marker]] == labels[:marker]
    return [found[marker].marker, found[count].marker]


@pytest.mark.parametrize("is_labelled", [True, False])
def test_a_reflection_where_the_only_marker_of_a_bone_could_be_leaves_both_without_a_label(
    scene, is_labelled
):
    subject, motion, _ = scene
    turned = rotation.multiply(
        motion.poses.rotations[:, 4], rotation.exp(jnp.tile(jnp.asarray([0.0, 0.25, 0.15]), (FRAMES, 1)))
    )
    elsewhere = eqx.tree_at(lambda m: m.poses.rotations, motion, motion.poses.rotations.at[:, 4].set(turned))
    path = np.asarray(seen_by(subject, elsewhere, np.random.default_rng(0), 5e-4).positions)[:, HAND]
    assert np.linalg.norm(path - scene[2][:, HAND], axis=1).min() > 0.015
    assert decide(scene, path, HAND, is_labelled) == [-1, -1]


@pytest.mark.parametrize("is_labelled", [True, False])
def test_a_marker_that_others_determine_keeps_or_gets_its_label(scene, is_labelled):
    path = scene[2][:, TRUNK] + [0.02, 0.03, 0.0]
    assert decide(scene, path, TRUNK, is_labelled) == [TRUNK, -1]


def test_a_frame_with_two_markers_does_not_start_from_the_frame_of_another_pair(scene):
    """The frame before shows the subject three metres away, turned by half a turn."""
    subject, _, places = scene
    positions = places[[0, 20]].copy()
    positions[0] = positions[0] @ np.diag([-1.0, 1.0, -1.0]) + [3.0, 0.0, 0.0]
    columns = np.tile(np.arange(subject.num_markers), (2, 1))
    columns[1] = np.where(np.isin(columns[1], [TRUNK, HAND]), columns[1], -1)
    # a line through two markers fits exactly
    costs = _frame_costs(subject, positions, columns, np.full(subject.num_markers, 0.025))
    assert costs[1] < 1e-6
