"""Recordings that hide bones from the technique without a template: feet on the floor, still arms, bones of one or two markers."""

from types import SimpleNamespace

import numpy as np

from jaxcap.markers.local_technique import fit_local
from jaxcap.markers.segments.computed_points import find_computed_points
from jaxcap.markers.segments.find_segments import find_partition
from jaxcap.markers.segments.segment_sets import make_segments
from jaxcap.markers.skeleton import closed_loops
from jaxcap.markers.skeleton.find_bones import find_bones
from jaxcap.observe.markers import make_markers
from tests.markers_scene import PUPPET, puppet, waves

#: four legs of two bones, a neck with a head, and a tail on a trunk
ANIMAL = (
    (-1, (0.0, 0.0, 0.6), (0.0, 0.0, 0.65)),
    *(
        bone
        for number, (x, y) in enumerate(((0.3, 0.1), (0.3, -0.1), (-0.3, 0.1), (-0.3, -0.1)))
        for bone in ((0, (x, y, 0.5), (x, y, 0.38)), (2 * number + 1, (x, y, 0.25), (x, y, 0.12)))
    ),
    (0, (0.4, 0.0, 0.75), (0.52, 0.0, 0.85)),
    (0, (-0.4, 0.0, 0.65), (-0.52, 0.0, 0.65)),
)


def everything(places):
    return np.ones(places.shape[:2], bool)


def take(places, labels=None):
    labels = labels or [f"m{i}" for i in range(places.shape[1])]
    return make_markers(places, labels, 100.0)


def sets(segments):
    return {frozenset(members) for members in segments.members}


def truth(owner):
    return {frozenset(np.flatnonzero(owner == k).tolist()) for k in np.unique(owner)}


def edges(fit, owner):
    whose = [int(owner[members[0]]) for members in fit.segments.members]
    return {frozenset((whose[k], whose[parent])) for k, parent in enumerate(fit.tree.parents) if parent >= 0}


def squat(rng, frames=240):
    """A pelvis on two legs whose feet never move, with four markers on each bone: places and owners.

    Bones are the pelvis, the left thigh, shank and foot, and the right ones. Knees bend forwards in the plane of hip and ankle.
    """
    moved = waves(rng, frames, 3, 0.05)
    moved[:, 2] = -0.25 + 1.5 * moved[:, 2].clip(-0.12, 0.12)
    shapes = 0.05 * rng.normal(size=(7, 4, 3))
    places = [moved[:, None] + [0.0, 0.0, 1.0] + shapes[0]]
    for side, bones in ((0.1, (1, 2, 3)), (-0.1, (4, 5, 6))):
        hip = moved + [0.0, side, 0.9]
        ankle = np.broadcast_to([0.0, side, 0.08], hip.shape)
        away = ankle - hip
        half = 0.5 * np.linalg.norm(away, axis=1, keepdims=True)
        along = away / (2 * half)
        forward = np.cross([0.0, 1.0, 0.0], along)
        forward *= -1 / np.linalg.norm(forward, axis=1, keepdims=True)
        knee = hip + half * along + np.sqrt(0.42**2 - half**2) * forward
        for bone, (top, bottom) in zip(bones[:2], ((hip, knee), (knee, ankle)), strict=True):
            axis = (bottom - top) / 0.42
            aside = np.cross(axis, forward)
            aside /= np.linalg.norm(aside, axis=1, keepdims=True)
            turn = np.stack([axis, aside, np.cross(axis, aside)], -1)
            places.append(np.einsum("fab,nb->fna", turn, shapes[bone] + [0.2, 0.0, 0.0]) + top[:, None])
        places.append(np.broadcast_to(shapes[bones[2]] + [0.08, side, 0.03], (frames, 4, 3)))
    moved = np.concatenate(places, 1)
    return moved + 0.0005 * rng.normal(size=moved.shape), np.repeat(np.arange(7), 4)


def test_feet_that_stand_still_are_two_bones(rng):
    places, owner = squat(rng)
    # all distances between the feet are constant
    assert frozenset((*range(12, 16), *range(24, 28))) in sets(
        find_partition(places, everything(places)).segments
    )
    assert sets(find_bones(places, everything(places))) == truth(owner)


def test_a_trunk_that_stands_still_is_one_bone(rng):
    scene = puppet(rng, noise=0.0005, bodies=((-1, (0.0, 0.0, 1.0), (0.0, 0.0, 1.1)), *PUPPET[1:]))
    owner = scene.owner
    steady = np.einsum(
        "fab,fnb->fna", scene.rotations[:, 0].swapaxes(1, 2), scene.places - scene.joints[:, :1]
    )
    assert sets(find_bones(steady, everything(steady))) == truth(owner)


def test_feet_that_step_rarely_are_two_bones(rng):
    """Both feet stand in 95 of 100 frames; the distances of the outer 4 % at both ends do not count."""
    feet = 0.05 * rng.normal(size=(8, 3)) + np.repeat([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]], 4, 0)
    places = np.repeat(feet[None], 400, 0)
    step = np.sin(np.linspace(0, np.pi, 12))[:, None, None] ** 2 * [0.1, 0.0, 0.2]
    places[100:112, :4] += step
    places += 0.0005 * rng.normal(size=places.shape)
    found = find_partition(places, everything(places), threshold=0.02).segments
    assert sets(found) == {frozenset(range(4)), frozenset(range(4, 8))}


def test_one_arm_still(rng):
    """The arm is one bone with the trunk, the other limbs are as they are, and no marker is lost."""
    scene = puppet(rng, noise=0.0005, still=(1, 2))
    fit = fit_local(take(scene.places))
    merged = np.where(np.isin(scene.owner, (1, 2)), 0, scene.owner)
    assert sets(fit.segments) == truth(merged)
    assert (fit.bones >= 0).all()


def test_bones_of_two_markers_and_of_one(rng):
    """The lower arms have two markers, the left upper arm one, and another at its elbow that is on the lower arm."""
    scene = puppet(rng, noise=0.0005, markers=4)
    elbow = (
        scene.joints[:, 2, None] + np.einsum("fab,b->fa", scene.rotations[:, 2], [0.0, 0.0, 0.01])[:, None]
    )
    keep = np.concatenate(
        [np.arange(5), np.arange(8, 10), np.arange(12, 16), np.arange(16, 18), np.arange(20, 24)]
    )
    places = np.concatenate([scene.places[:, keep], elbow], 1)
    owner = np.concatenate([scene.owner[keep], [2]])
    fit = fit_local(take(places))
    assert (fit.bones >= 0).all() and fit.skeleton.num_joints == 6
    assert edges(fit, owner) == {frozenset(pair) for pair in ((0, 1), (1, 2), (0, 3), (3, 4), (0, 5))}


def test_an_animal(rng):
    scene = puppet(rng, noise=0.001, markers=3, swing=0.4, bodies=ANIMAL)
    fit = fit_local(take(scene.places))
    assert sets(fit.segments) == truth(scene.owner)
    assert edges(fit, scene.owner) == {
        frozenset((k, parent)) for k, (parent, _, _) in enumerate(ANIMAL) if parent >= 0
    }


def test_computed_points_are_left_out(rng):
    """A midpoint between bones, a joint centre in the frame of three markers, both to a tenth of a millimetre, and a short piece."""
    scene = puppet(rng, noise=0.002, markers=3)
    places = scene.places
    middle = 0.5 * (places[:, 6] + places[:, 12])
    edge = places[:, 4] - places[:, 3]
    edge /= np.linalg.norm(edge, axis=1, keepdims=True)
    normal = np.cross(edge, places[:, 5] - places[:, 3])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    centre = places[:, 3] + 0.05 * edge - 0.02 * normal
    computed = np.round(np.stack([middle, centre], 1), 4)
    found = find_computed_points(
        np.concatenate([places, computed], 1), everything(np.zeros((300, places.shape[1] + 2)))
    )
    assert [(one.marker, set(one.sources)) for one in found] == [(18, {6, 12}), (19, {3, 4, 5})]
    piece = np.full((300, 1, 3), np.nan)
    piece[:40] = places[:40, :1]
    labels = [*(f"m{i}" for i in range(18)), "Middle", "Centre", "*7"]
    fit = fit_local(take(np.concatenate([places, computed, piece], 1), labels))
    assert sets(fit.segments) == truth(scene.owner)
    assert fit.bones[18:].tolist() == [-1, -1, -1]
    told = " ".join(fit.messages[:3])
    assert (
        "'Middle' is computed from 'm6', 'm12'" in told
        and "'Centre' is computed from" in told
        and "'*7' is" in told
    )


def test_a_computed_point_that_the_user_places_stays(rng):
    scene = puppet(rng, noise=0.002, markers=3)
    middle = 0.5 * (scene.places[:, 6] + scene.places[:, 12])
    places = np.concatenate([scene.places, np.round(middle, 4)[:, None]], 1)
    labels = [*(f"m{i}" for i in range(18)), "Middle"]
    found = find_bones(scene.places, everything(scene.places), None)
    name = found.names[found.marker_segments[6]]
    fit = fit_local(take(places, labels), corrections={"Middle": (name, 0.5)})
    assert fit.bones[18] >= 0 and "left out" not in " ".join(fit.messages)


def test_all_still_segments_are_tried(monkeypatch):
    """A squat with a bar in both hands: feet and hands stand still, the trunk does not."""
    sets = [(0, 1, 2, 3), (4, 5, 6), (7, 8, 9), (10, 11, 12, 13)]
    tried = []

    segments = make_segments(sets, 14, np.ones(14), ("feet", "leg", "trunk", "hands"))
    monkeypatch.setattr(closed_loops, "still_segments", lambda *_: [0, 3])
    star = SimpleNamespace(augmented=SimpleNamespace(frames=SimpleNamespace(local_positions=np.eye(14, 3))))

    def tree(positions, seen, segments, pairs=None):
        if pairs is not None:
            tried.append(segments.members[pairs[0][0]])
        return star

    monkeypatch.setattr(closed_loops, "find_segment_tree", tree)
    monkeypatch.setattr(closed_loops, "median_distance", lambda *_: 1.0)
    monkeypatch.setattr(
        closed_loops,
        "_centres_in",
        lambda star, segment, most: {k: np.eye(3)[n] for n, k in enumerate([1, 2])},
    )
    monkeypatch.setattr(closed_loops, "_largest_connected", lambda rest, chosen, most: chosen)
    closed_loops.open_loops(np.zeros((1, 14, 3)), np.ones((1, 14), bool), segments, 0.01)
    assert sorted(tried) == [(0, 1, 2, 3), (10, 11, 12, 13)]


def test_markers_of_no_computed_point(rng):
    """Four markers on a plate are functions of each other, as exactly as their noise."""
    scene = puppet(rng, noise=0.0003, markers=4)
    assert find_computed_points(scene.places, everything(scene.places)) == ()
    exact = puppet(rng, markers=4)
    assert find_computed_points(exact.places, everything(exact.places)) == ()


def test_markers_on_no_bone_are_named_first(rng):
    scene = puppet(rng, noise=0.001)
    stray = np.concatenate([scene.places, rng.normal(size=(300, 1, 3))], 1)
    assert fit_local(take(stray)).messages[0].startswith("'m24' is on no bone")
