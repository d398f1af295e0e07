"""Gaps of markers, and trajectories that go on under new names."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import jaxcap as jc
from jaxcap.errors import InputError
from jaxcap.markers.segments.gaps import (
    describe_problems,
    find_pieces,
    gap_statistics,
    is_static,
    join_pieces,
    never_visible,
    split_unlabelled,
)


def two_limbs(count=240, rate=60.0, noise=0.001, seed=2):
    """Places of eight markers on two rigid limbs that swing about a joint that travels."""
    rng, time = np.random.default_rng(seed), np.arange(count) / rate
    offsets = 0.2 * rng.uniform(-1, 1, size=(2, 4, 3)) + np.array([[[0, 0.3, 0]], [[0, -0.3, 0]]])
    joint = np.stack([1.2 * time, 0.05 * np.sin(9 * time), np.ones(count)], 1)
    swing = [
        Rotation.from_rotvec(np.outer(np.sin(s * time + s), axis))
        for s, axis in ((4, [1, 0.2, 0]), (5, [0, 1, 1]))
    ]
    limbs = [joint[:, None] + np.einsum("fij,mj->fmi", turn.as_matrix(), limb) for turn, limb in zip(swing, offsets, strict=True)]  # fmt: skip
    return np.concatenate(limbs, 1) + noise * rng.normal(size=(count, 8, 3))


def named(places, rate=60.0):
    return jc.make_markers(places, [f"M{i}" for i in range(places.shape[1])], rate)


def broken(places, cuts):
    """Each `(marker, begin, end)` a gap after which the marker is another one; and which pieces belong together."""
    columns, labels, truth = [], [], []
    for marker in range(places.shape[1]):
        gaps = sorted((begin, end) for which, begin, end in cuts if which == marker)
        edges = [0, *(edge for gap in gaps for edge in gap), len(places)]
        chain = []
        for number, (begin, end) in enumerate(zip(edges[::2], edges[1::2], strict=True)):
            piece = np.full((len(places), 3), np.nan)
            piece[begin:end] = places[begin:end, marker]
            chain.append(len(columns))
            labels.append(f"M{marker}" if number == 0 else f"*{len(columns)}")
            columns.append(piece)
        if len(chain) > 1:
            truth.append(tuple(chain))
    return jc.make_markers(np.stack(columns, 1), labels, 60.0), tuple(truth)


@given(st.integers(0, 10**6), st.integers(1, 30), st.floats(0, 1))
def test_statistics_are_those_of_a_slow_count(seed, count, share):
    rng = np.random.default_rng(seed)
    seen = rng.random((count, 3)) < share
    gaps = gap_statistics(named(np.where(seen[..., None], np.ones(3), np.nan)))
    for marker in range(3):
        pieces = [len(run) for run in "".join(".#"[int(x)] for x in seen[:, marker]).split("#") if run]
        assert gaps.num_gaps[marker] == len(pieces)
        assert gaps.longest_gap[marker] == max(pieces, default=0)
        assert gaps.visible_fraction[marker] == pytest.approx(seen[:, marker].mean())


def test_what_is_wrong_is_told():
    places = two_limbs(60)
    assert describe_problems(named(places)) == ()
    lost = places.copy()
    lost[:, 3] = np.nan
    lost[10:12] = np.nan
    assert never_visible(named(lost)) == ("M3",)
    told = " ".join(describe_problems(named(lost)))
    assert "Marker M3 is never visible" in told
    assert "2 of 60 frames have no visible marker" in told
    still = np.repeat(places[:1], 60, 0)
    assert is_static(named(still))
    assert not is_static(named(places))
    assert "All 60 frames are equal" in " ".join(describe_problems(named(still)))
    still[5:9, 2] = np.nan
    assert is_static(named(still))
    assert describe_problems(named(np.full((4, 2, 3), np.nan))) == ("No marker is visible in any frame.",)


CUTS = [(0, 50, 80), (0, 150, 175), (2, 100, 130), (5, 60, 62), (6, 20, 70), (7, 110, 160)]


def test_pieces_are_found_and_joined():
    """The gaps last up to 0.8 s, in which markers travel a metre and limbs swing."""
    places = two_limbs()
    frames, truth = broken(places, CUTS)
    assert find_pieces(frames) == truth
    told = describe_problems(frames)
    assert "M0, *1 and *2 look like one trajectory in 3 pieces" in told[0]
    joined = join_pieces(frames)
    assert joined.labels == tuple(f"M{i}" for i in range(8))
    expected = places.copy()
    for marker, begin, end in CUTS:
        expected[begin:end, marker] = np.nan
    np.testing.assert_array_equal(joined.visible, ~np.isnan(expected).any(2))
    np.testing.assert_array_equal(joined.positions, np.nan_to_num(expected))


def test_the_order_of_markers_does_not_matter():
    frames, truth = broken(two_limbs(), CUTS)
    order = np.random.default_rng(1).permutation(len(frames.labels))
    mixed = jc.MarkerFrames(
        frames.positions[:, order], frames.visible[:, order], tuple(frames.labels[i] for i in order), 60.0
    )
    found = {tuple(int(order[i]) for i in chain) for chain in find_pieces(mixed)}
    assert found == set(truth)


def test_markers_that_only_take_turns_are_not_joined():
    """One ends where another begins, but a hand's width away; or long after; or both are always there."""
    places = two_limbs()
    assert find_pieces(named(places)) == ()
    turns = places.copy()
    turns[100:, 0] = np.nan
    turns[:110, 1] = np.nan
    assert np.linalg.norm(places[105, 0] - places[105, 1]) > 0.1
    assert find_pieces(named(turns)) == ()
    frames, truth = broken(places, [(0, 50, 80)])
    assert find_pieces(frames, max_gap=0.6) == truth
    assert find_pieces(frames, max_gap=0.4) == ()


def test_a_marker_alone_goes_on_at_its_speed():
    time = np.arange(60) / 60.0
    line = np.stack([3.0 * time, 1 + 0 * time, 0 * time], 1)[:, None]
    frames, truth = broken(line, [(0, 30, 36)])
    assert find_pieces(frames) == truth
    line[36:, :, 1] += 0.3
    assert find_pieces(broken(line, [(0, 30, 36)])[0]) == ()


def test_names_with_a_star_say_nothing_across_a_gap():
    places = two_limbs()
    two = np.full((240, 1, 3), np.nan)
    two[:100, 0], two[120:, 0] = places[:100, 3], places[120:, 7]
    rest = places.copy()
    rest[:120, 7] = np.nan
    rest[120:, 7] = np.nan
    rest[:, 3] = np.nan
    rest[100:, 3] = places[100:, 3]
    frames = jc.make_markers(np.concatenate([rest, two], 1), [*(f"M{i}" for i in range(8)), "*32"], 60.0)
    pieces = split_unlabelled(frames)
    assert pieces.labels[-2:] == ("*32.1", "*32.2")
    joined = join_pieces(pieces)
    assert joined.labels == (*(f"M{i}" for i in range(8)), "*32.2")
    np.testing.assert_allclose(joined.positions[:, 3], places[:, 3])


def test_chains_that_cannot_be_are_refused():
    frames = named(two_limbs(20))
    with pytest.raises(ValueError, match="M0, M1 are visible in the same frame"):
        join_pieces(frames, ((0, 1),))
    pieces, _ = broken(two_limbs(), CUTS)
    with pytest.raises(ValueError, match="in two chains"):
        join_pieces(pieces, ((0, 1), (1, 2)))


@pytest.mark.parametrize(
    ("places", "labels", "rate", "sentence"),
    [
        (np.zeros((2, 3)), ["A"], 1.0, r"shape \(2, 3\); expected"),
        (np.zeros((2, 0, 3)), [], 1.0, "no markers"),
        (np.zeros((0, 2, 3)), ["A", "B"], 1.0, "no frames"),
        (np.zeros((2, 2, 3)), ["A"], 1.0, "2 markers have 1 labels"),
        (np.zeros((2, 2, 3)), ["A", "A"], 1.0, "two markers have the label 'A'"),
        (np.zeros((2, 2, 3)), ["A", ""], 1.0, "a marker has an empty label"),
        (np.zeros((2, 1, 3)), ["A"], 0.0, "`rate` is 0.0 frames per second"),
        (np.zeros((2, 1, 3)), ["A"], np.nan, "`rate` is nan frames per second"),
        (np.full((2, 1, 3), np.inf), ["A"], 1.0, "marker 'A' has an infinite coordinate"),
    ],
)
def test_markers_are_checked(places, labels, rate, sentence):
    with pytest.raises(InputError, match=sentence):
        jc.make_markers(places, labels, rate)


def test_frames_are_sliced():
    frames = named(two_limbs(20))
    assert len(frames) == 20
    assert (len(frames[5:]), frames[5:].rate, frames[::2].rate) == (15, 60.0, 30.0)
    np.testing.assert_array_equal(frames[np.array([3, 1])].positions, frames.positions[np.array([3, 1])])


@pytest.mark.shared
def test_a_real_trial_in_pieces(shared):
    """Every piece that is joined belongs where it goes; most are."""
    frames = jc.read_markers(shared / "data" / "markers" / "biobuddy_right_hip.c3d")
    assert find_pieces(frames) == ()
    rng = np.random.default_rng(0)
    places = np.asarray(frames.positions)
    cuts = [
        (m, b, b + rng.integers(1, 80))
        for m in range(73)
        for b in rng.choice(np.arange(100, 1500, 100), 2, False)
    ]
    pieces, truth = broken(places, cuts)
    pieces = jc.MarkerFrames(pieces.positions, pieces.visible, pieces.labels, frames.rate)

    def links(chains):
        return {pair for chain in chains for pair in pairwise(chain)}

    found, right = links(find_pieces(pieces)), links(truth)
    assert found <= right
    assert len(found) > 0.95 * len(right)
