"""Landmarks of markers without labels, from their positions in a few frames."""

import functools

import jax.numpy as jnp
import numpy as np
import pytest

import jaxcap as jc
from jaxcap.body.people.morph_targets import Traits
from jaxcap.errors import InputError
from jaxcap.geometry import rotation
from jaxcap.markers.human.human_template import make_human_template
from jaxcap.markers.marker_sets.landmarks import landmarks
from jaxcap.markers.marker_sets.recognise import recognise_markers
from jaxcap.markers.recognition.all_landmarks import all_landmarks, landmark_costs, mirrored_landmarks
from jaxcap.markers.recognition.recognise_by_geometry import assign

LABELS = [
    "LFHD",
    "RFHD",
    "LBHD",
    "RBHD",
    "C7",
    "T10",
    "CLAV",
    "STRN",
    "LSHO",
    "RSHO",
    "LELB",
    "RELB",
    "LWRA",
    "RWRA",
    "LWRB",
    "RWRB",
    "LFIN",
    "RFIN",
    "LASI",
    "RASI",
    "LPSI",
    "RPSI",
    "LTHI",
    "RTHI",
    "LKNE",
    "RKNE",
    "LTIB",
    "RTIB",
    "LANK",
    "RANK",
    "LHEE",
    "RHEE",
    "LTOE",
    "RTOE",
]


@functools.cache
def person():
    return make_human_template(recognise_markers(LABELS), Traits(0.0, 30.0, 0.5, 0.5, 0.05)).subject


def walking(seed, count=8):
    """Unlabelled markers of a person who walks, arms down; the first frame is upright. Returns the true names too."""
    subject, rng = person(), np.random.default_rng(seed)
    skeleton, places = subject.skeleton, []
    offset = 0.005 * rng.normal(size=subject.offsets.shape)
    for frame in range(count):
        step = 0.5 * np.sin(1.1 * frame)
        pose = jc.rest_pose(skeleton)
        turns = np.array(pose.rotations)
        angles = {
            "LeftUpLeg": [step, 0, 0], "RightUpLeg": [-step, 0, 0], "LeftLeg": [abs(step), 0, 0], "RightLeg": [abs(step), 0, 0],
            "LeftArm": [-step, 0, -0.6], "RightArm": [step, 0, 0.6], "LeftForeArm": [-0.3, 0, 0], "RightForeArm": [-0.3, 0, 0],
            "LeftFoot": [0.3 * step, 0, 0], "RightFoot": [-0.3 * step, 0, 0],
        }  # fmt: skip
        for name, angle in angles.items():
            turns[skeleton.index(name)] = np.asarray(rotation.exp(jnp.asarray(angle, float)))
        turns[0] = np.asarray(rotation.exp(jnp.asarray([0.0, 0.7 + seed, 0.0])))
        moved = jc.Pose(pose.translations, jnp.asarray(turns), pose.scale)
        places.append(np.asarray(jc.markers.marker_positions(subject, moved)) + offset)
    order = rng.permutation(len(LABELS))
    names = recognise_markers(subject.labels).names
    frames = jc.make_markers(np.stack(places)[:, order], [f"*{k}" for k in range(len(order))], 10.0)
    return frames, [names[k] for k in order]


def test_markers_without_labels_get_the_bones_they_are_on():
    """Every decided marker is on its bone and side, and most are decided."""
    frames, truth = walking(3)
    found = jc.markers.recognise_by_geometry(frames)
    table = landmarks()
    decided = [k for k, name in enumerate(found.marker_set.names) if name is not None]
    wrong = [(truth[k], found.marker_set.names[k]) for k in decided if table[found.marker_set.names[k]].bone != table[truth[k]].bone]  # fmt: skip
    assert not wrong
    assert len(decided) > 0.85 * len(truth) and found.margin > 25
    assert np.mean([found.marker_set.names[k] == truth[k] for k in decided]) > 0.7


def test_points_of_no_person_are_refused(rng):
    cloud = rng.uniform([-0.4, 0, -0.4], [0.4, 1.8, 0.4], (1, 34, 3)).repeat(8, 0)
    cloud = cloud + 0.1 * rng.normal(size=cloud.shape)
    with pytest.raises(InputError, match="No standing person|not decided"):
        jc.markers.recognise_by_geometry(jc.make_markers(cloud, [str(k) for k in range(34)], 10.0))
    with pytest.raises(InputError, match="3 points are visible"):
        jc.markers.recognise_by_geometry(jc.make_markers(cloud[:, :3], ["a", "b", "c"], 10.0))


def test_assignment_has_the_least_cost_and_leaves_far_points_out():
    cost = np.array([[1.0, 2.0, 30.0], [1.5, 9.0, 30.0], [20.0, 25.0, 40.0]])
    np.testing.assert_array_equal(assign(cost), [1, 0, -1])


def test_landmarks_of_many_sets_cost_less():
    names = all_landmarks().labels
    costs = dict(zip(names, landmark_costs(), strict=True))
    assert costs["left knee_lateral"] < 1.0 < costs["left scapula_spine_root"]
    other = mirrored_landmarks()
    assert names[other[names.index("left asis")]] == "right asis"
    assert other[names.index("c7")] == names.index("c7")
    np.testing.assert_array_equal(other[other], np.arange(len(names)))
