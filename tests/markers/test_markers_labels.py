"""Labels by a subject: unlabelled points with ghosts, partly labelled files, exchanges, and what is refused."""

from itertools import pairwise

import numpy as np
import pytest

import jaxcap as jc
from jaxcap.markers.labels.match_points import match_points
from jaxcap.markers.labels.rigid_matches import match_rigid_bone
from jaxcap.markers.labels.tracks import Track, cut_tracks
from jaxcap.markers.labels.vote import vote_on_tracks
from jaxcap.markers.segments.gaps import find_runs
from tests.markers_limb import moving, seen_by, truth

SUBJECT = truth()
RATE = 100.0


@pytest.fixture(scope="module")
def scene():
    """Frames of the limb; 5 % of the places are missing, in bursts."""
    rng = np.random.default_rng(3)
    motion = moving(rng, 120)
    frames = seen_by(SUBJECT, motion, rng)
    seen = np.ones(frames.visible.shape, bool)
    for marker in range(18):
        begin = int(rng.integers(5, 105))
        seen[begin : begin + 8, marker] = False
    return jc.MarkerFrames(np.where(seen[..., None], frames.positions, 0), seen, SUBJECT.labels, RATE), motion


def hidden(frames, rng, ghosts=3):
    """Each piece of a trajectory as a column without a label, in random order, with ghosts that stay or jump about; and the
    marker of each column, -1 for ghosts."""
    places, seen = np.asarray(frames.positions), np.asarray(frames.visible)
    columns, owners = [], []
    for marker in range(places.shape[1]):
        for begin, end in find_runs(seen[:, marker]):
            column = np.full((len(places), 3), np.nan)
            column[begin:end] = places[begin:end, marker]
            columns.append(column)
            owners.append(marker)
    low, high = places[seen].min(0), places[seen].max(0)
    for _ in range(ghosts):
        column = np.full((len(places), 3), np.nan)
        begin = int(rng.integers(0, 60))
        column[begin : begin + 40] = rng.uniform(low, high)
        columns.append(column)
        owners.append(-1)
    order = rng.permutation(len(columns))
    labels = [f"*{i}" for i in range(len(order))]
    return jc.make_markers(np.stack([columns[i] for i in order], 1), labels, RATE), np.array(owners)[order]


def test_unlabelled_markers_get_their_labels_and_ghosts_none(scene, rng):
    frames, _ = scene
    raw, owners = hidden(frames, rng)
    found = jc.markers.label_markers(SUBJECT, raw)
    assert found.frames.labels == SUBJECT.labels
    np.testing.assert_array_equal(found.frames.visible, frames.visible)
    np.testing.assert_array_equal(found.frames.positions, frames.positions)
    for one in found.tracks:
        owner = owners[raw.labels.index(one.name)]
        assert one.label == (None if owner < 0 else SUBJECT.labels[owner])
    assert not found.doubtful.any()


def test_given_labels_stay_unless_the_poses_contradict_them(scene, rng):
    frames, _ = scene
    places, seen = np.asarray(frames.positions), np.asarray(frames.visible)
    labels = list(SUBJECT.labels)
    # two names are exchanged throughout, and a third of the names are not known
    labels[0], labels[5] = labels[5], labels[0]
    for marker in (1, 4, 7, 10, 13, 16):
        labels[marker] = f"C_{marker}"
    found = jc.markers.label_markers(SUBJECT, jc.MarkerFrames(places, seen, tuple(labels), RATE))
    np.testing.assert_array_equal(found.frames.positions, places)
    sentences = [one for one in found.messages if "contradicted" in one]
    assert len(sentences) == 2
    assert any(
        f"'{SUBJECT.labels[0]}'" in one and f"it is {SUBJECT.labels[5]} there" in one for one in sentences
    )


def test_a_track_that_changes_marker_is_cut(scene):
    frames, _ = scene
    places = np.array(frames.positions)
    places[60:, [8, 9]] = places[60:, [9, 8]]
    seen = np.array(frames.visible)
    seen[60:, [8, 9]] = seen[60:, [9, 8]]
    raw = jc.MarkerFrames(places, seen, tuple(f"*{i}" for i in range(18)), RATE)
    found = jc.markers.label_markers(SUBJECT, raw)
    np.testing.assert_array_equal(found.frames.positions, frames.positions)


def test_a_pose_that_a_reflection_pulled_away_does_not_cut_a_track():
    """The marker rests at zero; the prediction is at a reflection, six centimetres away, while that is visible."""

    def vote(begin: int, end: int):
        positions = np.zeros((60, 2, 3))
        positions[:, 1, 0] = 0.06
        predicted = np.zeros((60, 1, 3))
        predicted[begin:end, 0, 0] = 0.055
        tracks = (Track(0, 0, 60), Track(1, begin, end))
        known, gates = np.ones(60, bool), np.array([0.025])
        return vote_on_tracks(tracks, positions, predicted, known, gates, np.full(2, -1))

    # the track is the marker in most frames, so it is the marker in all
    assert [(one.track.begin, one.track.end, one.marker) for one in vote(20, 40)] == [
        (0, 60, 0),
        (20, 40, -1),
    ]
    # another point is the marker in most frames
    found = [(one.track.begin, one.track.end, one.marker) for one in vote(5, 55)]
    assert (5, 55, 0) in found and (0, 60, 0) not in found


def test_another_object_is_refused(rng):
    box = rng.uniform(-0.5, 0.5, (12, 3))
    path = np.cumsum(0.002 * rng.normal(size=(60, 1, 3)), 0)
    raw = jc.make_markers(box + path, [f"*{i}" for i in range(12)], RATE)
    with pytest.raises(ValueError, match="does not explain the points|In no frame do three points"):
        jc.markers.label_markers(SUBJECT, raw)


def test_a_subject_with_few_markers_is_refused(scene):
    frames, _ = scene
    few = jc.markers.make_subject(SUBJECT.skeleton, [0, 0, 1], np.eye(3), ["a", "b", "c"])
    with pytest.raises(ValueError, match="at most 2 markers on one bone"):
        jc.markers.label_markers(few, frames)


def test_exchanged_labels_are_corrected_by_the_poses(scene):
    """A pair on one bone, a pair on two bones, a cycle of three, and a label on a marker that has a gap elsewhere."""
    frames, _ = scene
    places, seen = np.array(frames.positions), np.array(frames.visible)
    for span, before, after in (
        (slice(10, 30), [0, 2], [2, 0]),
        (slice(40, 41), [5, 14], [14, 5]),
        (slice(70, 90), [1, 5, 12], [5, 12, 1]),
    ):
        places[span, before], seen[span, before] = places[span, after], seen[span, after]
    # marker 17 is seen under the label 6, whose own marker is hidden
    truly, shown = np.array(frames.positions), np.array(frames.visible)
    shown[100:110, 6] = False
    truly[100:110, 6] = 0
    places[100:110, 6], seen[100:110, 6] = places[100:110, 17], seen[100:110, 17]
    places[100:110, 17], seen[100:110, 17] = 0, False
    mixed = jc.MarkerFrames(places, seen, SUBJECT.labels, RATE)
    solved = jc.markers.solve_markers(SUBJECT, mixed)
    mended = jc.markers.mend_labels(SUBJECT, solved.motion, mixed, lost=solved.lost)
    np.testing.assert_array_equal(mended.frames.visible, shown)
    np.testing.assert_array_equal(mended.frames.positions, truly)
    assert any("in a cycle" in one for one in mended.messages)
    assert any("'trunk_0' and 'trunk_2' were swapped" in one for one in mended.messages)
    # nothing is exchanged twice
    again = jc.markers.solve_markers(SUBJECT, mended.frames)
    assert not jc.markers.mend_labels(SUBJECT, again.motion, mended.frames).changed.any()


def test_tracks_end_at_gaps_and_jumps():
    at = np.zeros((40, 1, 3))
    at[:, 0, 0] = np.linspace(0, 1, 40)
    at[25:, 0, 1] = 0.4
    seen = np.ones((40, 1), bool)
    seen[10:12] = False
    assert [track[1:] for track in cut_tracks(at, seen, RATE)] == [(0, 10), (12, 25), (25, 40)]


def test_assignment_is_that_of_all_permutations(rng):
    from itertools import permutations

    predicted, points = rng.normal(size=(4, 3)), rng.normal(size=(4, 3))
    found = match_points(predicted, points, np.full((4, 1), 100.0))
    costs = {
        p: sum(np.sum((predicted[i] - points[j]) ** 2) for i, j in enumerate(p))
        for p in permutations(range(4))
    }
    assert tuple(found.tolist()) == min(costs, key=costs.__getitem__)
    assert (match_points(predicted, points + 50.0, np.full((4, 1), 0.1)) == -1).all()


def test_a_bone_is_found_by_its_distances_and_not_mirrored(rng):
    shape = 0.15 * rng.normal(size=(5, 3))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    points = np.concatenate([shape @ turn.T + 1.0, rng.uniform(0, 2, (30, 3))])
    away = np.linalg.norm(points[:, None] - points, axis=2)
    found = match_rigid_bone(shape, points, away, np.ones_like(away, bool), 0.01)
    assert found.points[0].tolist() == [0, 1, 2, 3, 4]
    np.testing.assert_allclose(found.rotations[0], turn, atol=1e-6)
    mirrored = points * np.array([-1.0, 1.0, 1.0])
    assert match_rigid_bone(shape, mirrored, away, np.ones_like(away, bool), 0.01).scores.max(initial=0) < 4.5
    assert all(a >= b for a, b in pairwise(found.scores.tolist()))
