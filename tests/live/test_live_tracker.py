"""Tracking of frames as they arrive: the newest one wins, no frame waits for a search, and nothing is lost in counting."""

import threading
import time

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body

from jaxcap.body.body import pose_body
from jaxcap.body.pose import Pose, rest_pose
from jaxcap.body.retraction import retract
from jaxcap.errors import InputError
from jaxcap.geometry.mesh import sample_surface
from jaxcap.live.live_tracker import SEARCH_EVERY, LiveTracker
from jaxcap.live.load import FIRST_PAUSE, LAST_PAUSE, WINDOW, Load
from jaxcap.live.mailbox import Mailbox
from jaxcap.live.statistics import StatisticsCounter
from jaxcap.observe.clouds import Cloud, make_cloud
from jaxcap.observe.planes import Plane
from jaxcap.tracking import advance, online
from jaxcap.tracking.online import OnlineTracker
from jaxcap.tracking.track import track_frames
from jaxcap.tracking.track_frame import make_tracker

BODY = chain_body("linear", rings=8, sides=8)
TRACKER = make_tracker(BODY, iterations=2)
_pose = eqx.filter_jit(pose_body)


def pose_at(step: float) -> Pose:
    return retract(BODY.skeleton, rest_pose(BODY.skeleton), jnp.full(BODY.skeleton.num_dofs, 0.01 * step))


def cloud_at(step: float, number: int) -> Cloud:
    """The surface in a pose that bends more with every step."""
    vertices = np.asarray(_pose(BODY, pose_at(step)).vertices, float)
    points, normals = sample_surface(vertices, np.asarray(BODY.faces), 200, np.random.default_rng(number))
    return make_cloud(points, normals)


CLOUDS = [cloud_at(float(k), k) for k in range(8)]


def rotations(pose: Pose) -> np.ndarray:
    return np.asarray(pose.rotations)


def test_a_mailbox_keeps_the_newest_and_hands_over():
    box = Mailbox[int]()
    assert box.replace(1) is None
    assert box.replace(2) == 1
    assert box.take() == 2
    assert box.put(3)
    taken = []
    thread = threading.Thread(target=lambda: taken.append(box.put(4)))
    thread.start()
    thread.join(0.05)
    # the place is taken
    assert thread.is_alive()
    assert box.take() == 3
    thread.join()
    assert taken == [True] and box.take() == 4
    box.close()
    assert box.take() is None and not box.put(5) and box.replace(6) == 6


def test_frames_that_arrive_slowly_are_tracked_as_a_recording(monkeypatch):
    monkeypatch.setattr(advance, "needs_search", lambda frame: False)
    expected = [rotations(frame.pose) for frame in track_frames(TRACKER, CLOUDS, search=False)]
    found, frames = [], []
    with LiveTracker(TRACKER, on_frame=frames.append, search=False, judge_every=1) as live:
        assert live.warm_up(CLOUDS[0]) > 0
        assert live.newest is None and live.statistics.tracked == 0
        for number, cloud in enumerate(CLOUDS):
            live.push(cloud, number / 30)
            assert live.wait(60)
            assert live.newest is not None
            found.append(rotations(live.newest.tracked.pose))
        statistics, latencies = live.statistics, live.latencies
    np.testing.assert_array_equal(found, expected)
    assert [frame.number for frame in frames] == list(range(8))
    assert [frame.seconds for frame in frames] == [number / 30 for number in range(8)]
    assert (statistics.tracked, statistics.dropped, statistics.failed) == (8, 0, 0)
    assert len(latencies) == 8 and statistics.latency_median <= statistics.latency_p99 == np.percentile(
        latencies, 99
    )
    assert "8 tracked, 0 dropped" in statistics.sentence()


def test_of_a_burst_the_newest_is_tracked_and_dropped_frames_are_never_read():
    read = []

    def reader(number):
        def load():
            read.append(number)
            return CLOUDS[number % len(CLOUDS)]

        return load

    with LiveTracker(TRACKER, search=False) as live:
        for number in range(200):
            live.push(reader(number))
        assert live.wait(60)
        statistics, newest = live.statistics, live.newest
    assert newest is not None and newest.number == 199
    assert statistics.tracked + statistics.dropped == 200
    assert len(read) == statistics.tracked < 150


def overload(load: Load) -> None:
    """Drop every second frame until images are reduced."""
    dropped = True
    while not load.is_high:
        load.count(dropped)
        dropped = not dropped


def test_images_are_reduced_while_frames_are_dropped_and_whole_ones_tried_again():
    load = Load()
    for _ in range(1000):
        load.count(False)
    # one dropped frame in twenty is no reason, nor is one pause of ten frames
    for number in range(100):
        load.count(number % WINDOW == 0)
    for number in range(100):
        load.count(number % (2 * WINDOW) < 10)
    assert not load.is_high
    # of the slowest computers nearly all frames are dropped
    slowest = Load()
    for number in range(100):
        slowest.count(number % 12 != 0)
    assert slowest.is_high
    pauses = []
    for _ in range(8):
        overload(load)
        frames = 0
        while load.is_high:
            load.count(False)
            frames += 1
        pauses.append(frames)
    # each attempt that fails doubles the pause before the next
    assert pauses == [min(FIRST_PAUSE * 2**number, LAST_PAUSE) for number in range(8)]
    # one that lasts makes the pause short again
    for _ in range(LAST_PAUSE):
        load.count(False)
    overload(load)
    for _ in range(FIRST_PAUSE):
        load.count(False)
    assert not load.is_high


def test_latency_counts_from_the_arrival():
    with LiveTracker(TRACKER, search=False) as live:
        live.push(CLOUDS[0], arrived=time.monotonic() - 1.5)
        live.wait(60)
        assert live.latencies[0] > 1.5


def test_frames_that_arrive_during_compilation_are_counted_and_have_no_latency():
    with LiveTracker(TRACKER, search=False) as live:
        before = time.monotonic()
        live._load.is_high = True
        live.push(CLOUDS[0])
        assert live.wait(60) and len(live.latencies) == 1
        live.warm_up(CLOUDS[0])
        assert not live._load.is_high and not len(live.latencies)
        for number in range(50):
            live.push(CLOUDS[number % len(CLOUDS)], arrived=before)
        assert live.wait(60)
        statistics = live.statistics
        assert not len(live.latencies)
        live.push(CLOUDS[0])
        assert live.wait(60) and len(live.latencies) == 1
    assert statistics.tracked + statistics.dropped == 51
    assert statistics.dropped_before_ready == statistics.dropped > 0
    assert statistics.sentence().endswith(
        f"tracked, {statistics.dropped} dropped ({statistics.dropped} during compilation)"
    )
    assert "latency" not in statistics.sentence()


def test_a_rate_is_stated_only_if_it_is_known(monkeypatch):
    times = iter(np.concatenate([[0.0], np.arange(1, 101) / 30, [60.0]]))
    monkeypatch.setattr(time, "monotonic", lambda: next(times))
    counter = StatisticsCounter()
    counter.add(0.05)
    assert counter.summary().sentence() == "latency 50 ms; 1 tracked, 0 dropped"
    counter.add(0.05)
    # one interval of a thirtieth of a second is no rate
    assert counter.summary().sentence() == "latency 50 ms; 2 tracked, 0 dropped"
    for _ in range(99):
        counter.add(0.05)
    # also if the run ends long after its last frame
    expected = "30.0 frames per second, latency 50 ms, 99 % within 50 ms; 101 tracked, 0 dropped"
    assert counter.summary().sentence() == expected
    # a minute in which nothing could be tracked
    counter.add(None, failure="x.png: the image cannot be read.")
    assert counter.summary().rate == pytest.approx(1 / (60.0 - 99 / 30), rel=1e-3)


def test_a_frame_that_cannot_be_read_is_counted_and_the_next_one_tracked():
    def damaged():
        raise InputError("frame.png: the image cannot be read.")

    with LiveTracker(TRACKER, search=False) as live:
        for frame in (CLOUDS[0], damaged, [np.zeros((9, 9))], CLOUDS[1]):
            live.push(frame)
            live.wait(60)
        statistics = live.statistics
    assert (statistics.tracked, statistics.failed) == (2, 2)
    assert "no camera is known" in statistics.last_failure


def test_an_error_of_a_thread_reaches_the_caller():
    def fault():
        raise ZeroDivisionError("a fault of the program")

    with LiveTracker(TRACKER, search=False) as live:
        live.push(fault)
        with pytest.raises(ZeroDivisionError):
            live.wait(60)
        with pytest.raises(ZeroDivisionError):
            live.push(CLOUDS[0])


def test_no_frame_waits_for_a_search(monkeypatch):
    """The first search lasts until the event, and finds the right pose."""
    go, started = threading.Event(), threading.Event()

    def slow(tracker, cloud, **options):
        started.set()
        assert go.wait(60)
        return pose_at(5.0), jnp.asarray(0.0)

    monkeypatch.setattr(advance, "initialise", slow)
    monkeypatch.setattr(advance, "coarse_tracker", lambda tracker: tracker)
    away = retract(BODY.skeleton, pose_at(5.0), jnp.zeros(BODY.skeleton.num_dofs).at[:3].set(0.9))
    tracking = OnlineTracker(TRACKER, away, sigma=0.01)
    cloud = cloud_at(5.0, 5)
    first = tracking.track(cloud)
    assert first.verdict != "good" and started.wait(10) and tracking.is_searching
    for _ in range(3):
        frame = tracking.track(cloud)
    assert frame.verdict != "good" and tracking.is_searching
    go.set()
    while tracking.is_searching:
        time.sleep(0.01)
    frame = tracking.track(cloud)
    assert frame.verdict == "good"
    joints = [np.asarray(_pose(BODY, pose).joints) for pose in (frame.pose, pose_at(5.0))]
    assert np.abs(joints[0] - joints[1]).max() < 0.05
    tracking.close()


@pytest.mark.parametrize("search", [True, False])
def test_tracking_begins_where_a_search_finds_the_body_before_it(monkeypatch, search):
    monkeypatch.setattr(advance, "initialise", lambda *_, **__: (pose_at(5.0), jnp.asarray(0.0)))
    monkeypatch.setattr(advance, "coarse_tracker", lambda tracker: tracker)
    away = retract(BODY.skeleton, pose_at(5.0), jnp.zeros(BODY.skeleton.num_dofs).at[:3].set(0.9))
    tracking = OnlineTracker(TRACKER, away, search=search, sigma=0.01)
    tracking.warm_up(cloud_at(5.0, 5))
    assert tracking.count == 0 and tracking.frame is None
    assert (tracking.track(cloud_at(5.0, 6)).verdict == "good") == search
    tracking.close()


def test_a_lost_body_is_looked_for_near_the_points_of_the_last_image():
    with LiveTracker(TRACKER, search=False) as live:
        live.push(CLOUDS[0])
        assert live.wait(60) and live.newest is not None
        tracked = live.newest.tracked
        lost = eqx.tree_at(lambda f: f.lost, tracked, True)
        points = np.asarray(CLOUDS[1].points)[np.asarray(CLOUDS[1].weights) > 0]
        for number in range(1, 2 * SEARCH_EVERY + 1):
            near = live._followed_surface(lost, CLOUDS[1])
            if number % SEARCH_EVERY == 0:
                assert near is None
            else:
                np.testing.assert_array_equal(near, points)
        found = live._followed_surface(eqx.tree_at(lambda f: f.lost, tracked, False), CLOUDS[1])
    np.testing.assert_allclose(found, _pose(BODY, tracked.pose).vertices, atol=1e-6)


def test_a_search_knows_the_clothes_that_the_frames_have_shown(monkeypatch):
    given = []

    def caught(tracker, surface, coarse, frame, *rest):
        given.extend(float(one.clothes.frames) for one in (tracker, coarse))
        return frame

    monkeypatch.setattr(online, "catch_up", caught)
    monkeypatch.setattr(online, "needs_search", lambda frame: True)
    monkeypatch.setattr(advance, "coarse_tracker", lambda tracker: tracker)
    tracking = OnlineTracker(make_tracker(BODY, iterations=2, clothes=True))
    counts = []
    for cloud in CLOUDS[:3]:
        counts.append(float(tracking.track(cloud).state.estimate.clothes.frames))
        while tracking.is_searching:
            time.sleep(0.01)
    # a frame after the first one teaches at most once, also where the pose of a search is taken
    assert np.all(np.diff(counts) <= 1.0)
    assert given[:2] == [counts[0]] * 2
    tracking.close()


def test_a_floor_is_used_from_the_first_frame_or_not_at_all():
    plane = Plane(np.array([0.0, 1.0, 0.0]), -2.0)
    with LiveTracker(TRACKER, search=False) as live:
        live._use_floor(plane)
        assert live.floor is plane and len(live._online.tracker.terms) == 1
    with LiveTracker(TRACKER, search=False) as live:
        live.push(CLOUDS[0])
        assert live.wait(60)
        live._use_floor(plane)
        assert live.floor is None and live._online.frame is not None
    with pytest.raises(InputError, match="`find_floor` is for depth images"):
        LiveTracker(TRACKER, find_floor=True)
