"""Chunks of a sequence, joined: the poses of one run, also where a boundary is in a passage that no search resolves."""

from itertools import pairwise

import numpy as np
import pytest
from limb_scene import SKELETON, TRACKER, joints, pose_of, run_here, scan, scan_frames

from jaxcap.errors import InputError
from jaxcap.observe.clouds import make_cloud, missing_cloud
from jaxcap.tracking.chunks.division import count_chunks, divide_frames, name_ranges
from jaxcap.tracking.chunks.join_chunks import join_chunks
from jaxcap.tracking.chunks.segments import StackedFrames
from jaxcap.tracking.chunks.tasks import TrackSettings
from jaxcap.tracking.track import track_frames

FRAMES, OVERLAP = 80, 30
SETTINGS = TrackSettings(sigma=0.05)


def track_in_chunks(clouds, chunks=2, overlap=OVERLAP):
    divided, begun = divide_frames(len(clouds), chunks, overlap), []
    joined = join_chunks(SKELETON, divided, run_here(clouds, SETTINGS, begun), pose_of(0))
    frames = []
    for chunk, segment in zip(divided, joined.chunks, strict=True):
        frames += [] if segment is None else list(segment.frames(chunk.begin, chunk.end))
    return joined, frames, begun


def track_in_one(clouds):
    return list(track_frames(TRACKER, clouds, pose_of(0), sigma=SETTINGS.sigma, planes=[]))


def distances(frames, others) -> np.ndarray:
    """Largest distance of a joint in each frame, metres."""
    pairs = zip(frames, others, strict=True)
    return np.array([np.linalg.norm(joints(a.pose) - joints(b.pose), axis=1).max() for a, b in pairs])


@pytest.fixture(scope="module")
def clouds():
    return scan_frames(FRAMES)


def test_frames_are_divided_with_overlap():
    chunks = divide_frames(100, 3, 10, first=5)
    assert chunks[0].first == chunks[0].begin == 5
    assert chunks[-1].end == 105
    for before, chunk in pairwise(chunks):
        assert chunk.begin == before.end
        assert chunk.begin - chunk.first == 10
    with pytest.raises(InputError, match="4 chunks with an overlap of 30 frames"):
        divide_frames(100, 4, 30)
    with pytest.raises(InputError, match="must be above 5"):
        divide_frames(100, 2, 5)


@pytest.mark.parametrize(("frames", "workers"), [(20_000, 2), (1000, 2), (50, 4), (10**6, 100)])
def test_every_worker_has_a_chunk_and_little_is_tracked_twice(frames, workers):
    count = count_chunks(frames, workers)
    chunks = divide_frames(frames, count)
    twice = sum(chunk.begin - chunk.first for chunk in chunks)
    assert count >= min(workers, frames // 120)
    assert twice <= 0.1 * frames or count == workers


def test_ranges_are_named():
    assert name_ranges([(3, 9), (12, 13)]) == "3 to 8, 12"


def test_chunks_that_agree_are_those_of_one_run(clouds):
    joined, frames, begun = track_in_chunks(clouds)
    alone = track_in_one(clouds)
    assert [task.name for task in begun] == ["head", "start_1", "chunk_0", "chunk_1"]
    (boundary,) = joined.boundaries
    assert boundary.joined and boundary.num_repeated == 0 and boundary.distance < 1e-4
    assert distances(frames, alone).max() < 1e-4
    assert [frame.verdict for frame in frames] == [frame.verdict for frame in alone]
    assert not joined.failures


def test_a_boundary_without_a_person_is_tracked_again(clouds):
    """Nobody is there from before the boundary on: the second chunk begins when the limb comes back."""
    away = [missing_cloud("nobody is there.")] * 24
    hidden = [*clouds[:26], *away, *clouds[50:]]
    joined, frames, begun = track_in_chunks(hidden)
    alone = track_in_one(hidden)
    (boundary,) = joined.boundaries
    assert begun[-1].name == "again_1_0"
    assert boundary.joined and 10 < boundary.num_repeated < 40
    assert [frame.verdict for frame in frames] == [frame.verdict for frame in alone]
    assert distances(frames, alone).max() < 1e-4


def test_a_chunk_that_begins_lost_is_tracked_again(clouds):
    """Junk hides the limb in the whole overlap and after it."""
    rng = np.random.default_rng(5)

    def junk():
        points = rng.uniform([-0.4, -0.1, -0.4], [0.4, 0.6, 0.4], (300, 3))
        return make_cloud(points, rng.normal(size=points.shape))

    hard = [*clouds[:15], *(junk() for _ in range(30)), *clouds[45:]]
    joined, frames, begun = track_in_chunks(hard)
    alone = track_in_one(hard)
    (boundary,) = joined.boundaries
    assert begun[-1].name == "again_1_0"
    assert boundary.joined and boundary.num_repeated > 5
    assert {frame.verdict for frame in frames[15:45]} != {"good"}
    assert distances(frames, alone).max() < 1e-4


def test_a_cloud_that_cannot_be_tracked_fails_its_chunk_alone(clouds):
    few = scan(pose_of(50), 50)
    bad = [*clouds[:50], make_cloud(np.asarray(few.points)[:3], np.asarray(few.normals)[:3]), *clouds[51:]]
    joined, _, _ = track_in_chunks(bad)
    (failure,) = joined.failures
    assert (failure.first, failure.end) == (50, FRAMES)
    assert "cloud 50" in failure.message
    first, second = joined.chunks
    assert first is not None and first.end == 40
    assert second is not None and second.end == 50


def test_frames_that_are_none_are_a_segment():
    nothing = StackedFrames(4, [])
    assert (nothing.first, nothing.end, list(nothing.frames(4, 4))) == (4, 4, [])
