"""Rigid segments of markers: found, weighted, corrected; exchanged labels undone."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxcap.errors import InputError
from jaxcap.io.markers.marker_corrections import read_corrections, write_corrections
from jaxcap.markers.segments.find_segments import apply_corrections, find_partition
from jaxcap.markers.segments.maximal_cliques import maximal_cliques
from jaxcap.markers.segments.pair_distances import pair_distance_ranges
from jaxcap.markers.segments.segment_sets import make_segments
from jaxcap.markers.segments.swaps import MAX_DESCRIBED, correct_swaps, describe_exchanges
from tests.markers_scene import puppet


def everything(places):
    return np.ones(places.shape[:2], bool)


def sets(segments):
    return {frozenset(members) for members in segments.members}


def truth(owner):
    return {frozenset(np.flatnonzero(owner == k).tolist()) for k in np.unique(owner)}


@pytest.mark.parametrize("noise", [0.0, 0.001])
def test_segments_are_found(rng, noise):
    scene = puppet(rng, noise=noise)
    found = find_partition(scene.places, everything(scene.places)).segments
    assert sets(found) == truth(scene.owner)
    assert found.weights.min() > 0.8


def test_order_of_markers_and_place_of_the_world_change_nothing(rng):
    scene = puppet(rng, noise=0.001)
    order = rng.permutation(len(scene.owner))
    turn = Rotation.random(random_state=3).as_matrix()
    moved = scene.places[:, order] @ turn.T + np.array([3.0, -2.0, 1.0])
    one = find_partition(scene.places, everything(scene.places))
    other = find_partition(moved, everything(moved))
    assert other.unit == pytest.approx(one.unit, rel=1e-9)
    assert {frozenset(order[list(m)].tolist()) for m in other.segments.members} == sets(one.segments)
    np.testing.assert_allclose(other.segments.weights, one.segments.weights[order], atol=1e-9)


def test_deviation_is_the_papers_over_frames_that_show_both(rng):
    places = puppet(rng, frames=60).places[:, :9]
    seen = rng.random(places.shape[:2]) > 0.3
    got = pair_distance_ranges(places, seen, trimmed_fraction=0)
    for i, j in itertools.combinations(range(9), 2):
        both = seen[:, i] & seen[:, j]
        distances = np.linalg.norm(places[both, i] - places[both, j], axis=1)
        assert got[i, j] == pytest.approx(np.ptp(distances), abs=1e-12)


def test_cover_is_all_maximal_sets(rng):
    related = rng.random((9, 9)) > 0.4
    related = related | related.T | np.eye(9, dtype=bool)
    # by trying every set
    cliques = [
        set(some)
        for size in range(1, 10)
        for some in itertools.combinations(range(9), size)
        if related[np.ix_(some, some)].all()
    ]
    maximal = {frozenset(c) for c in cliques if not any(c < other for other in cliques)}
    found = maximal_cliques(related, np.ones((9, 9)))
    assert {frozenset(c) for c in found} == maximal
    assert [len(c) for c in found] == sorted((len(c) for c in maximal), reverse=True)


def test_gaps_and_exchanged_labels_change_no_segment(rng):
    scene = puppet(rng, noise=0.001, frames=500)
    places, seen = scene.places.copy(), everything(scene.places)
    for marker in range(places.shape[1]):
        start = rng.integers(0, 450)
        seen[start : start + 50, marker] = False
    exchanged = []
    for frame in rng.choice(500, 60, replace=False):
        pair = rng.choice(places.shape[1], 2, replace=False)
        places[frame, pair] = places[frame, pair[::-1]]
        seen[frame, pair] = seen[frame, pair[::-1]]
        if seen[frame, pair].any():
            exchanged.append((int(frame), *sorted(pair.tolist())))
    places = np.where(seen[..., None], places, 0.0)
    assert sets(find_partition(places, seen).segments) == truth(scene.owner)
    labels = tuple(f"m{i}" for i in range(places.shape[1]))
    mended = correct_swaps(places, seen, labels)
    undone = {(f, min(i, j), max(i, j)) for f, i, j in mended.swaps}
    assert len(undone & set(exchanged)) >= 0.9 * len(exchanged)
    # nothing that was right is made wrong
    assert len(undone - set(exchanged)) <= 1
    frame, i, j = exchanged[0]
    if (frame, i, j) in undone:
        assert any(f"'m{i}' and 'm{j}'" in sentence for sentence in mended.messages)


def test_pairs_and_cycles_are_undone_in_one_pass_with_a_fifth_missing():
    """Exchanges between bones that last up to 30 frames of 500, with a fifth of the places missing in bursts."""
    rng = np.random.default_rng(2)
    scene = puppet(rng, noise=0.001, frames=500)
    places, seen = scene.places.copy(), everything(scene.places)
    for marker in range(24):
        while (~seen[:, marker]).mean() < 0.2:
            begin = int(rng.integers(-20, 500))
            seen[max(begin, 0) : begin + 25, marker] = False
    groups = ([6, 17], [3, 14], [13, 20], [5, 19], [2, 12, 16], [23, 9, 0])
    lengths = (1, 30, 30, 5, 30, 12)
    for start, group, length in zip((40, 110, 180, 250, 320, 390), groups, lengths, strict=True):
        span, rolled = slice(start, start + length), np.roll(group, 1)
        places[span, group], seen[span, group] = places[span, rolled], seen[span, rolled]
    places = np.where(seen[..., None], places, 0.0)
    mended = correct_swaps(places, seen, tuple(f"m{i}" for i in range(24)))
    away = np.linalg.norm(mended.positions[:, :, None] - scene.places[:, None], axis=3)
    assert (away.argmin(2) == np.arange(24))[mended.seen].all()
    assert mended.seen.sum() == seen.sum()
    assert any("in a cycle" in sentence for sentence in mended.messages)
    assert correct_swaps(mended.positions, mended.seen, tuple(map(str, range(24)))).swaps == ()


def test_a_pair_is_untangled_by_its_jumps(rng):
    scene = puppet(rng, markers=2)
    places = scene.places.copy()
    places[100:130, [2, 3]] = places[100:130, [3, 2]]
    mended = correct_swaps(places, everything(places), tuple("abcdefghijkl"))
    np.testing.assert_array_equal(mended.positions, scene.places)
    assert mended.messages == (
        "The labels 'c' and 'd' were swapped in 30 frames (100 to 129); the swap is corrected.",
    )


def test_many_exchanges_of_labels_have_one_sentence_for_the_rarest():
    labels = tuple(f"m{i}" for i in range(24))
    source = np.tile(np.arange(24), (15, 1))
    for pair in range(12):
        frames = slice(pair, pair + (3 if pair == 7 else 1))
        source[frames, 2 * pair : 2 * pair + 2] = source[frames, 2 * pair : 2 * pair + 2][:, ::-1]
    said = describe_exchanges(source, np.ones(source.shape, bool), labels)
    assert len(said) == MAX_DESCRIBED + 1
    assert "'m14' and 'm15' were swapped in 3 frames" in said[0]
    assert "2 further groups of markers, in 2 frames" in said[-1]
    (*_, last) = describe_exchanges(source[:11], np.ones((11, 24), bool), labels)
    assert "1 further group of markers, in 1 frame;" in last


def test_clean_markers_are_left_as_they_are(rng):
    scene = puppet(rng, noise=0.002)
    labels = tuple(f"m{i}" for i in range(scene.places.shape[1]))
    assert correct_swaps(scene.places, everything(scene.places), labels).swaps == ()


def test_markers_that_move_apart_are_an_error_and_a_stray_one_is_loose(rng):
    apart = rng.normal(size=(80, 5, 3))
    with pytest.raises(ValueError, match="No markers move together"):
        find_partition(apart, everything(apart), 0.02)
    scene = puppet(rng)
    places = np.concatenate([scene.places, rng.normal(size=(300, 1, 3))], 1)
    assert np.flatnonzero(find_partition(places, everything(places)).segments.is_loose).tolist() == [24]


def test_corrections(tmp_path, rng):
    segments = make_segments([(0, 1, 2), (3, 4)], 6, names=("trunk", "arm"))
    labels = ("a", "b", "c", "d", "e", "f")
    path = tmp_path / "corrections.txt"
    path.write_text("# marker segment weight\nc arm 0.5\na -\nf hand\n")
    mended = apply_corrections(segments, labels, read_corrections(path))
    assert dict(zip(mended.names, mended.members, strict=True)) == {
        "trunk": (1,),
        "arm": (3, 4, 2),
        "hand": (5,),
    }
    np.testing.assert_allclose(mended.weights, [0, 1, 0.5, 1, 1, 1])
    write_corrections(path, {"c": ("arm", 0.5), "a": ("-", 0.0)})
    assert read_corrections(path) == {"c": ("arm", 0.5), "a": ("-", 0.0)}
    with pytest.raises(ValueError, match="There is no marker 'x'"):
        apply_corrections(segments, labels, {"x": ("arm", 1.0)})


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("a\n", ":1: 'a' has 1 words"),
        ("a b 2\n", ":1: the weight of 'a' is 2"),
        ("\na b\na c\n", ":3: the marker 'a' occurs twice"),
        ("a b x", "is not a number"),
    ],
)
def test_corrections_that_are_wrong_say_where(tmp_path, text, match):
    path = tmp_path / "corrections.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=match):
        read_corrections(path)
