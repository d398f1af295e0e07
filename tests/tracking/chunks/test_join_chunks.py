"""Chunks of a sequence, joined: the poses of one sequential run that begins anew before each chunk."""

from itertools import pairwise

import equinox as eqx
import numpy as np
import pytest
from limb_scene import SKELETON, TRACKER, joints, pose_of, run_here, scan_frames

from jaxcap.errors import InputError
from jaxcap.observe.clouds import make_cloud, missing_cloud
from jaxcap.tracking.chunks.agreement import compare_frames, pose_distance
from jaxcap.tracking.chunks.division import WARM_UP, count_chunks, divide_frames, name_ranges
from jaxcap.tracking.chunks.join_chunks import join_chunks
from jaxcap.tracking.chunks.segments import StackedFrames
from jaxcap.tracking.chunks.tasks import TrackSettings, begin_chunk
from jaxcap.tracking.track import track_frames

FRAMES, BOUNDARY = 80, 40
SETTINGS = TrackSettings(sigma=0.05)


def track_in_chunks(clouds, change=None):
    """Track two chunks in this process; `change` alters the first frames of the second one."""
    begun = []
    run_all = run_here(clouds, SETTINGS, begun)

    def run(tasks):
        for number, outcome in run_all(tasks):
            if change is not None and tasks[number].warm_up:
                first, end = outcome.segment.first, outcome.segment.end
                frames = [change(frame) for frame in outcome.segment.frames(first, end)]
                outcome = outcome._replace(segment=StackedFrames(first, frames))
            yield number, outcome

    joined = join_chunks(TRACKER, divide_frames(len(clouds), 2), run, pose_of(0))
    return joined, [frame for span in joined.spans for frame in span.frames()], begun


def track_in_one(clouds, start=None, first=0):
    start = pose_of(0) if start is None else start
    return list(track_frames(TRACKER, clouds, start, sigma=SETTINGS.sigma, planes=[], first=first))


def damage(clouds, number):
    """Leave three points of one cloud, too few to be tracked."""
    points, normals = (np.asarray(leaf)[:3] for leaf in (clouds[number].points, clouds[number].normals))
    return [*clouds[:number], make_cloud(points, normals), *clouds[number + 1 :]]


def assert_same(frames, others):
    """Check that frames have the same poses, bit by bit, and the same verdicts."""
    for frame, other in zip(frames, others, strict=True):
        assert np.array_equal(joints(frame.pose), joints(other.pose))
        assert frame.verdict == other.verdict


@pytest.fixture(scope="module")
def clouds():
    return scan_frames(FRAMES)


@pytest.fixture(scope="module")
def alone(clouds):
    return track_in_one(clouds)


def test_frames_are_divided():
    chunks = divide_frames(100, 3, first=5)
    assert chunks[0].begin == 5 and chunks[-1].end == 105
    assert all(before.end == chunk.begin for before, chunk in pairwise(chunks))
    assert {chunk.end - chunk.begin for chunk in chunks} <= {33, 34}
    with pytest.raises(InputError, match="100 frames were to be divided into 13 chunks"):
        divide_frames(100, 13)


@pytest.mark.parametrize(
    ("frames", "number"), [(1, 1), (299, 1), (400, 2), (1600, 8), (3900, 8), (20_000, 40), (10**6, 2000)]
)
def test_chunks_are_neither_short_nor_long(frames, number):
    assert count_chunks(frames) == number


def test_ranges_are_named():
    assert name_ranges([(3, 9), (12, 13)]) == "3 to 8, 12"


def test_chunks_are_those_of_one_run_that_begins_again_before_each(clouds, alone):
    joined, frames, begun = track_in_chunks(clouds)
    assert [task.name for task in begun] == ["head", "chunk_0", "chunk_1"]
    (boundary,) = joined.boundaries
    assert boundary.joined and boundary.independent and boundary.num_repeated == 0
    assert not joined.failures
    # the same by hand: the eighth frame before the boundary follows the first thirty, as after a gap
    first = BOUNDARY - WARM_UP
    again = track_in_one(clouds[first:], begin_chunk(TRACKER, alone[29]), first)
    distance = pose_distance(SKELETON, alone[BOUNDARY - 1].pose, again[WARM_UP - 1].pose)
    assert boundary.distance == pytest.approx(distance)
    assert_same(frames, [*alone[:BOUNDARY], *again[WARM_UP:]])
    # and the poses are those without chunks, up to the noise of the clouds
    far = [pose_distance(SKELETON, frame.pose, one.pose) for frame, one in zip(frames, alone, strict=True)]
    assert max(far) < 5e-3


def test_nobody_at_a_boundary_is_waited_for(clouds):
    away = [missing_cloud("nobody is there.")] * 24
    hidden = [*clouds[:26], *away, *clouds[50:]]
    joined, frames, _ = track_in_chunks(hidden)
    (boundary,) = joined.boundaries
    assert boundary.joined and boundary.independent and np.isnan(boundary.distance)
    assert {frame.verdict for frame in frames[26:50]} == {"lost"}
    for number in range(50, FRAMES):
        assert frames[number].verdict == "good"
        assert pose_distance(SKELETON, frames[number].pose, pose_of(number)) < 0.02


def test_a_chunk_with_another_pose_is_tracked_again(clouds, alone):
    def translations(frame):
        return frame.pose.translations, frame.state.estimate.pose.translations, frame.trusted.translations

    def shift(frame):
        moved = frame.pose.translations.at[0, 0].add(0.2)
        return eqx.tree_at(translations, frame, (moved, moved, moved))

    joined, frames, begun = track_in_chunks(clouds, shift)
    assert [task.name for task in begun][-1] == "again_40_1"
    (boundary,) = joined.boundaries
    assert boundary.joined and not boundary.independent and boundary.num_repeated == FRAMES - BOUNDARY
    assert boundary.distance == pytest.approx(0.2, abs=0.01)
    assert_same(frames, alone)


def test_a_lost_person_is_found_before_the_next_chunk(clouds):
    """Junk hides the limb until two frames before the boundary; tracking pauses between its searches there."""
    rng = np.random.default_rng(5)

    def junk():
        points = rng.uniform([-0.4, -0.1, -0.4], [0.4, 0.6, 0.4], (300, 3))
        return make_cloud(points, rng.normal(size=points.shape))

    hard = [*clouds[:15], *(junk() for _ in range(23)), *clouds[38:]]
    joined, frames, _ = track_in_chunks(hard)
    (boundary,) = joined.boundaries
    assert boundary.joined and boundary.independent
    assert {frame.verdict for frame in frames[15:38]} != {"good"}
    assert {frame.verdict for frame in frames[BOUNDARY:]} == {"good"}
    for number in range(BOUNDARY, FRAMES):
        assert pose_distance(SKELETON, frames[number].pose, pose_of(number)) < 0.02


@pytest.mark.parametrize(
    ("bad", "failed"), [(50, [(50, FRAMES)]), (BOUNDARY - 4, [(BOUNDARY - 4, BOUNDARY), (BOUNDARY, FRAMES)])]
)
def test_a_cloud_that_cannot_be_tracked_fails_the_frames_after_it(clouds, bad, failed):
    joined, frames, _ = track_in_chunks(damage(clouds, bad))
    assert [(failure.first, failure.end) for failure in joined.failures] == failed
    assert all(f"cloud {bad}" in failure.message for failure in joined.failures)
    assert len(frames) == bad


def test_a_chunk_that_fails_does_not_fail_the_next_one(clouds):
    joined, _, _ = track_in_chunks(damage(clouds, 31))
    (failure,) = joined.failures
    assert (failure.first, failure.end) == (31, BOUNDARY)
    (boundary,) = joined.boundaries
    assert not boundary.joined
    assert joined.spans[-1].end == FRAMES


def test_no_chunk_begins_if_the_first_frames_cannot_be_tracked(clouds):
    """A resumed run would not find what was tracked from another beginning."""
    joined, frames, begun = track_in_chunks(damage(clouds, 20))
    assert [task.name for task in begun] == ["head"] and len(frames) == 20
    (failure,) = joined.failures
    assert (failure.first, failure.end) == (20, FRAMES)


@pytest.mark.parametrize(
    ("before", "own", "agree"),
    [
        ("good", "good", True),
        ("good", "doubtful", False),
        ("good", "lost", False),
        ("doubtful", "good", True),
        ("doubtful", "doubtful", False),
        ("doubtful", "lost", False),
        ("lost", "good", True),
        ("lost", "doubtful", False),
        ("lost", "lost", True),
    ],
)
def test_a_chunk_is_not_kept_if_its_own_pose_is_worse(alone, before, own, agree):
    def with_verdict(verdict):
        frame = alone[35]
        shares = np.zeros_like(frame.judgement.shares)
        # between the two limits a frame is doubtful
        middle = (float(frame.judgement.doubt) + float(frame.judgement.tolerance)) / 2
        shares = shares + (middle if verdict == "doubtful" else 0.0)
        judgement = eqx.tree_at(lambda j: j.shares, frame.judgement, shares)
        return eqx.tree_at(lambda f: (f.judgement, f.lost), frame, (judgement, verdict == "lost"))

    one, other = with_verdict(before), with_verdict(own)
    assert (one.verdict, other.verdict) == (before, own)
    assert compare_frames(SKELETON, one, other).agree == agree


def test_no_frames_are_a_segment():
    nothing = StackedFrames(4, [])
    assert (nothing.first, nothing.end, list(nothing.frames(4, 4))) == (4, 4, [])
