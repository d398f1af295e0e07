"""Exchanged legs, of people who stand, step, sit or cross their legs."""

import re

import jax.numpy as jnp
import numpy as np
import pytest

import jaxcap as jc
from jaxcap.errors import InputError
from jaxcap.markers.human.check_legs import check_legs, measure_leg_sides
from jaxcap.markers.human.human_template import make_human_template
from jaxcap.markers.marker_sets.recognise import recognise_markers

#: legs alone, with and without medial markers and the pelvis
SETS = {
    "medial": "LKNE RKNE LKNM RKNM LANK RANK LMED RMED LHEE RHEE LTOE RTOE",
    "lateral": "LKNE RKNE LTIB RTIB LANK RANK LHEE RHEE LTOE RTOE",
    "pelvis": "LASI RASI LPSI RPSI LTHI RTHI LKNE RKNE LTIB RTIB LANK RANK LHEE RHEE LTOE RTOE",
}
#: rotations of joints about x (flexion) and y (to the side), radians
POSES = {
    "standing": {},
    "stepping": {"LeftUpLeg": (-0.6, 0), "RightUpLeg": (0.5, 0), "RightLeg": (0.7, 0)},
    "sitting": {"LeftUpLeg": (-1.5, 0), "RightUpLeg": (-1.5, 0), "LeftLeg": (1.5, 0), "RightLeg": (1.4, 0)},
    "lunging": {"LeftUpLeg": (-1.2, 0.3), "LeftLeg": (1.3, 0), "RightUpLeg": (0.3, -0.2), "RightLeg": (0.9, 0)},
}  # fmt: skip
CROSSED = {"LeftUpLeg": (-1.5, -0.8), "RightUpLeg": (-1.5, 0.8), "LeftLeg": (1.5, 0), "RightLeg": (1.5, 0)}


def legs(labels, angles, turn=1.0):
    """Frames of a person in one pose who turns about the vertical."""
    subject = make_human_template(recognise_markers(labels)).subject
    skeleton, frames = subject.skeleton, []
    for yaw in (0.0, turn, 2 * turn):
        pose = jc.rest_pose(skeleton)
        rotations = np.array(pose.rotations)
        for name, (bend, aside) in angles.items():
            spin = jc.geometry.rotation.multiply(
                jc.geometry.rotation.exp(jnp.array([0.0, aside, 0.0])),
                jc.geometry.rotation.exp(jnp.array([bend, 0.0, 0.0])),
            )
            rotations[skeleton.index(name)] = np.asarray(spin)
        rotations[0] = np.asarray(jc.geometry.rotation.exp(jnp.array([0.0, yaw, 0.0])))
        moved = jc.Pose(pose.translations, jnp.asarray(rotations), pose.scale)
        frames.append(np.asarray(jc.markers.marker_positions(subject, moved)))
    return np.stack(frames), subject.labels


def exchanged(label):
    """The label of the other leg; the pelvis keeps its own."""
    return label if re.search("ASI|PSI", label) else {"L": "R", "R": "L"}[label[0]] + label[1:]


def check(places, labels):
    check_legs(recognise_markers(labels), jc.make_markers(places, labels, 50.0))


@pytest.mark.parametrize("labels", SETS.values(), ids=SETS)
@pytest.mark.parametrize("pose", POSES)
def test_exchanged_legs_are_refused_in_any_pose(labels, pose):
    places, names = legs(labels.split(), POSES[pose])
    check(places, names)
    with pytest.raises(InputError, match="Left and right of the legs are exchanged"):
        check(places, [exchanged(one) for one in names])
    with pytest.raises(InputError, match="mirrored"):
        check(places * [-1.0, 1.0, 1.0], names)


def test_crossed_legs_are_not_exchanged():
    """Each foot is on the other side of the body in all frames, but the lateral malleoli are lateral."""
    places, names = legs(SETS["lateral"].split(), CROSSED)
    known, frames = recognise_markers(names), jc.make_markers(places, names, 50.0)
    sides = measure_leg_sides(known, frames)
    assert np.median(sides.legs) < -0.1 and (sides.lateral > 0.02).all()
    check_legs(known, frames)


def test_one_leg_is_not_judged():
    places, names = legs(SETS["lateral"].split(), {})
    left = [k for k, name in enumerate(names) if name.startswith("L")]
    check(places[:, left], [names[k] for k in left])
