"""People and props of a recording by their labels and distances, and the motion of a prop."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxcap as jc
from jaxcap.errors import InputError
from jaxcap.observe.marker_labels import label_stem

FRAMES = 120
PERSON = [
    "C7",
    "CLAV",
    "STRN",
    "LSHO",
    "RSHO",
    "LELB",
    "RELB",
    "LASI",
    "RASI",
    "LPSI",
    "RPSI",
    "LKNE",
    "RKNE",
    "LANK",
    "RANK",
    "LHEE",
    "RHEE",
    "LTOE",
    "RTOE",
]
SHAPE = np.array([[0.0, 0, 0], [0.5, 0, 0], [0.2, 0.1, 0], [0.1, 0, 0.12]])


def wave(seed, columns):
    rng = np.random.default_rng(seed)
    time = np.linspace(0, 1, FRAMES)[:, None]
    return sum(
        rng.normal(size=columns) * np.sin(6.3 * (turn * time + rng.random(columns))) for turn in (1, 2)
    )


def loose(seed, count):
    """Markers that all move against each other, by some decimetres about their places."""
    rng = np.random.default_rng(seed)
    return (
        rng.uniform([-0.3, 0, -0.3], [0.3, 1.8, 0.3], (count, 3))
        + 0.1 * wave(seed, 3 * count).reshape(-1, count, 3)
        + 0.3 * wave(seed + 1, 3)[:, None]
    )


def rigid(seed, shape=SHAPE, noise=5e-4):
    """Markers of a rigid body, with its rotations and translations."""
    turns = Rotation.from_rotvec(wave(seed, 3)).as_matrix()
    shifts = np.array([0.5, 1.0, 0.0]) + 0.5 * wave(seed + 1, 3)
    places = np.einsum("fab,mb->fma", turns, shape) + shifts[:, None]
    rng = np.random.default_rng(seed)
    return places + noise * rng.normal(size=places.shape), turns, shifts


def recording(*parts):
    places = np.concatenate([places for places, _ in parts], 1)
    return jc.make_markers(places, [label for _, labels in parts for label in labels], 100.0)


def names(split):
    return [one.name for one in split.people], [one.name for one in split.props]


@pytest.mark.parametrize("form", ["{0}:{1}", "{0}_{1}", "{1}.{0}"])
def test_people_and_a_prop_by_the_names_in_their_labels(form):
    people = [(loose(k, len(PERSON)), [form.format(n, p) for p in PERSON]) for k, n in enumerate(["Anna", "Ben"])]  # fmt: skip
    sword = rigid(9)[0], [form.format("Sword", k) for k in range(4)]
    split = jc.markers.split_subjects(recording(*people, sword))
    assert names(split) == (["Anna", "Ben"], ["Sword"]) and not split.unassigned
    assert split.people[1].frames.labels == tuple(PERSON)
    np.testing.assert_allclose(split.people[1].frames.positions, people[1][0], atol=1e-6)


def test_people_by_numbers_in_their_labels():
    people = [(loose(k, len(PERSON)), [f"{p}{k + 1}" for p in PERSON]) for k in range(2)]
    assert names(jc.markers.split_subjects(recording(*people))) == (["1", "2"], [])


def test_labels_of_one_person_are_no_names_of_several():
    """Sides, numbers of vertebrae and of plates are no people."""
    labels = ["L_ASIS", "R_ASIS", "L_Knee", "R_Knee", "L_Ankle", "R_Ankle", "L_Heel", "R_Heel", "C7", "T10"]
    labels += ["LTH1", "LTH2", "LTH3", "RTH1", "RTH2", "RTH3"]
    assert names(jc.markers.split_subjects(recording((loose(3, len(labels)), labels)))) == (["person"], [])


def test_rigid_sets_without_a_name_are_props_where_they_move_by_themselves():
    person = loose(1, len(PERSON)), PERSON
    box = rigid(5)[0], ["*1", "*2", "*3", "*4"]
    split = jc.markers.split_subjects(recording(person, box))
    assert names(split) == (["person"], ["prop1"]) and split.people[0].frames.labels == tuple(PERSON)
    # a plate on the shank keeps its distance from the ankle, and stays with the person
    ankle = person[0][:, PERSON.index("LANK"), None]
    plate = ankle + [[0.0, 0.1, 0], [0.0, 0.15, 0.02], [0.03, 0.12, 0]], ["Q1", "Q2", "Q3"]
    split = jc.markers.split_subjects(recording(person, plate))
    assert names(split) == (["person"], []) and "Q2" in split.people[0].frames.labels


def test_names_of_subjects_are_unique():
    """Sets without a name avoid the names of groups, such as `prop1`, `person` and `Sword`."""
    groups = [(rigid(20 + k)[0], [f"{name}:{i}" for i in range(4)]) for k, name in enumerate(["prop1", "person", "Sword"])]  # fmt: skip
    unnamed = [(rigid(5)[0], ["*1", "*2", "*3", "*4"]), (rigid(6)[0], [f"Sword{i}" for i in range(4)])]
    found = names(jc.markers.split_subjects(recording(*groups, (loose(1, len(PERSON)), PERSON), *unnamed)))
    assert found == (["person_2"], ["prop1", "person", "Sword", "Sword_2", "prop2"])


def test_two_people_under_one_name_are_in_no_subject():
    doubled = [f"Anna:{label}" for label in [*PERSON, *(f"{label}_2" for label in PERSON)]]
    split = jc.markers.split_subjects(recording((loose(2, len(doubled)), doubled)))
    assert names(split) == ([], []) and "two people under one name" in split.unassigned[0].reason


def test_what_is_neither_says_why():
    dog = loose(2, 6), [f"Dog:{k}" for k in range(6)]
    split = jc.markers.split_subjects(recording(dog, (rigid(4)[0], [f"Box:{k}" for k in range(4)])))
    assert names(split) == ([], ["Box"])
    assert "'Dog' is no person" in split.unassigned[0].reason and "mm" in split.unassigned[0].reason


def test_an_object_with_the_labels_of_a_person_is_no_person():
    """It moves by half a metre, and all its distances stay."""
    rng = np.random.default_rng(0)
    shape = rng.uniform([-0.3, 0, -0.3], [0.3, 1.8, 0.3], (len(PERSON), 3))
    board = recording((rigid(6, shape)[0], [f"Board:{label}" for label in PERSON]))
    assert names(jc.markers.split_subjects(board)) == ([], ["Board"])
    with pytest.raises(InputError, match="keep their distances"):
        jc.markers.fit_human(recording((rigid(6, shape)[0], PERSON)))


def test_the_motion_of_a_prop_is_that_it_moved_with():
    places, turns, _ = rigid(7)
    rng = np.random.default_rng(2)
    hidden = rng.random(places.shape[:2]) < 0.1
    hidden[10:13, :2] = True
    prop = jc.markers.fit_prop(jc.make_markers(np.where(hidden[..., None], np.nan, places), list("abcd"), 100.0), "Sword")  # fmt: skip
    assert prop.subject.skeleton.names == ("Sword",)
    np.testing.assert_array_equal(prop.lost, (~hidden).sum(1) < 3)
    found = np.asarray(jc.geometry.rotation.to_matrix(prop.motion.poses.rotations[:, 0]))
    known = ~prop.lost
    # its own frame is turned by a constant from the one it was made in
    relative = np.einsum("fba,fbc->fac", found[known], turns[known])
    away = Rotation.from_matrix(relative @ relative[0].T).magnitude()
    assert np.median(away) < np.radians(0.4)
    assert np.nanmedian(prop.residuals) < 1e-3
    assert np.isinf(prop.covariances[prop.lost]).all()


def test_frames_that_no_pose_of_a_prop_fits_are_lost():
    """Random points are lost; with one marker far off, the others still have the pose, less precisely."""
    places, _, shifts = rigid(7)
    rng = np.random.default_rng(2)
    wrong, off = np.arange(3, 103, 10), 50
    places[wrong] = shifts[wrong, None] + rng.uniform(-0.5, 0.5, (10, 4, 3))
    places[off, 0] += [0.0, 0.3, 0.0]
    prop = jc.markers.fit_prop(jc.make_markers(places, list("abcd"), 100.0))
    np.testing.assert_array_equal(np.flatnonzero(prop.lost), wrong)
    assert np.isinf(prop.covariances[wrong]).all() and np.isnan(prop.residuals[wrong]).all()
    kept = [np.asarray(leaf) for leaf in (prop.motion.poses.translations, prop.motion.poses.rotations)]
    for leaf in kept:
        np.testing.assert_array_equal(leaf[wrong], leaf[wrong - 1])
    spread = np.sqrt(np.diagonal(prop.covariances, axis1=1, axis2=2))
    assert (spread[off] > 1.05 * spread[off + 1]).all() and prop.residuals[off, 0] > 0.2


def test_covariances_of_a_prop_are_those_of_its_errors():
    """Over many noisy frames at rest, the spread of the translation and the rotation is the reported one."""
    rng = np.random.default_rng(3)
    places = SHAPE - SHAPE.mean(0) + 1e-3 * rng.normal(size=(600, 4, 3))
    prop = jc.markers.fit_prop(jc.make_markers(places, list("abcd"), 100.0))
    reported = np.sqrt(np.diagonal(prop.covariances[0]))
    turn = np.asarray(jc.geometry.rotation.to_matrix(prop.motion.poses.rotations[:, 0]), float)
    mean = Rotation.from_matrix(turn).mean().as_matrix()
    small = Rotation.from_matrix(mean.T @ turn).as_rotvec()
    shift = (np.asarray(prop.motion.poses.translations[:, 0]) - prop.motion.poses.translations[:, 0].mean(0)) @ mean  # fmt: skip
    spread = np.concatenate([shift.std(0), small.std(0)])
    np.testing.assert_allclose(reported, spread, rtol=0.35)


def test_markers_that_change_their_distances_are_no_prop():
    with pytest.raises(InputError, match="no rigid body"):
        jc.markers.fit_prop(recording((loose(2, 5), list("abcde"))))
    with pytest.raises(InputError, match="2 visible markers"):
        jc.markers.fit_prop(recording((loose(2, 2), list("ab"))))


def test_stems_of_labels():
    assert [label_stem(one) for one in ("Sword_12", "Box3", "*4", "17", "Cup")] == ["Sword", "Box", "", "", "Cup"]  # fmt: skip
