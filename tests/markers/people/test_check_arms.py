"""Exchanged arms, of people who let them hang, raise, fold or swing them."""

import re

import jax.numpy as jnp
import numpy as np
import pytest

import jaxcap as jc
from jaxcap.errors import InputError
from jaxcap.markers.human.check_arms import check_arms, exchanged_levels, measure_arm_sides
from jaxcap.markers.human.human_template import make_human_template
from jaxcap.markers.marker_sets.recognise import recognise_markers

ARMS = "LSHO RSHO LELB RELB LWRA RWRA LWRB RWRB LFIN RFIN"
#: arms with a trunk, with a pelvis only, and joints that a network sees in images
SETS = {
    "trunk": f"C7 T10 CLAV STRN LASI RASI LPSI RPSI {ARMS}",
    "pelvis": f"LASI RASI SACR {ARMS}",
    "images": "LHip RHip LKnee RKnee LAnkle RAnkle LHeel RHeel LBigToe RBigToe LShoulder RShoulder LElbow RElbow LWrist RWrist Nose",
}  # fmt: skip
#: rotations of joints about x, y and z, radians; arms hang or are raised about z
HANGING = {"LeftArm": (0, 0, -0.7), "RightArm": (0, 0, 0.7)}
POSES = {
    "rest": {},
    "hanging": HANGING,
    "swinging": {"LeftArm": (-0.6, 0, -0.6), "RightArm": (0.6, 0, 0.6), "LeftForeArm": (-0.8, 0, 0), "Spine": (0, 0.4, 0)},
    "raised": {"LeftArm": (0, 0, 1.0), "RightArm": (0, 0, -1.0)},
    "folded": {"LeftArm": (-0.6, -0.8, -0.5), "RightArm": (-0.6, 0.8, 0.5), "LeftForeArm": (0, -1.6, 0), "RightForeArm": (0, 1.6, 0)},
}  # fmt: skip
LEVELS = ("SHO|Shoulder", "ELB|Elbow", "WR|Wrist", "FIN")


def person(labels, angles):
    """Frames of a person in one pose who turns about the vertical, and the person."""
    subject = make_human_template(recognise_markers(labels)).subject
    skeleton, exp = subject.skeleton, jc.geometry.rotation.exp
    pose = jc.rest_pose(skeleton)
    places = []
    for yaw in (0.0, 1.0, 2.5):
        rotations = np.array(pose.rotations)
        for name, angle in angles.items():
            rotations[skeleton.index(name)] = np.asarray(exp(jnp.array(angle, float)))
        rotations[0] = np.asarray(exp(jnp.array([0.0, yaw, 0.0])))
        moved = jc.Pose(pose.translations, jnp.asarray(rotations), pose.scale)
        places.append(np.asarray(jc.markers.marker_positions(subject, moved)))
    return np.stack(places), subject.labels


def exchanged(label, first):
    """The label of the other arm, from a level on; all others keep their own."""
    if not re.search("|".join(LEVELS[first:]), label):
        return label
    return {"L": "R", "R": "L"}[label[0]] + label[1:]


def sides(places, labels):
    known = recognise_markers(labels)
    template = make_human_template(known).subject
    frames = jc.make_markers(places, labels, 50.0)
    return template, known, frames


@pytest.mark.parametrize(
    ("markers", "pose"),
    [
        *(("trunk", pose) for pose in POSES),
        ("pelvis", "swinging"),
        ("images", "hanging"),
        ("images", "folded"),
    ],
)
def test_exchanged_arms_are_refused_in_any_pose(markers, pose):
    places, names = person(SETS[markers].split(), POSES[pose])
    check_arms(*sides(places, names))
    for first, level in enumerate(("shoulders", "elbows", "wrists")):
        wrong = sides(places, [exchanged(name, first) for name in names])
        with pytest.raises(
            InputError,
            match=f"Left and right of the {level}(,| and) .*are exchanged|Left and right of the {level} are exchanged",
        ):
            check_arms(*wrong)


def test_all_levels_below_are_named_until_one_is_right_again():
    """Only the elbows have each other's labels: wrists and hands are right."""
    places, names = person(SETS["trunk"].split(), HANGING)
    wrong = [exchanged(name, 0) if "ELB" in name else name for name in names]
    assert exchanged_levels(measure_arm_sides(*sides(places, wrong))) == ("elbows",)
    with pytest.raises(InputError, match=re.escape("(RELB, LELB)")):
        check_arms(*sides(places, wrong))


def test_shoulders_alone_are_found():
    """Elbows are right, so only the shoulders are named."""
    places, names = person(SETS["trunk"].split(), HANGING)
    wrong = [exchanged(name, 0) if "SHO" in name else name for name in names]
    with pytest.raises(
        InputError, match="Left and right of the shoulders are exchanged: seen from the trunk"
    ):
        check_arms(*sides(places, wrong))


def test_a_fit_refuses_exchanged_arms():
    places = [person(SETS["trunk"].split(), POSES[pose])[0] for pose in ("hanging", "swinging", "raised")]
    names = [exchanged(name, 1) for name in person(SETS["trunk"].split(), {})[1]]
    with pytest.raises(InputError, match="Left and right of the elbows, wrists and hands are exchanged"):
        jc.markers.fit_human(jc.make_markers(np.concatenate(places), names, 50.0))


def test_one_arm_is_not_judged():
    places, names = person(SETS["trunk"].split(), HANGING)
    left = [k for k, name in enumerate(names) if not re.match("R(SHO|ELB|WR|FIN)", name)]
    check_arms(*sides(places[:, left], [names[k] for k in left]))


def test_a_trunk_without_depth_does_not_show_sides():
    """Markers in one plane have no front: without a pelvis the shoulders are not judged."""
    places, names = person(["C7", "STRN", *ARMS.split()], HANGING)
    assert not np.isfinite(measure_arm_sides(*sides(places, names)).shoulders).any()


def test_exchanged_wrists_of_folded_arms_are_found():
    """On the median each wrist is as far from the other elbow as from its own, but only on its own arm it keeps this distance."""
    poses = []
    for close, bend in ((0.2, 1.2), (0.2, 1.6), (0.2, 2.0), (0.5, 1.2), (0.5, 1.6)):
        arms = {"LeftArm": (-0.6, -close, -0.5), "RightArm": (-0.6, close, 0.5)}
        poses.append({**arms, "LeftForeArm": (0, -bend, 0), "RightForeArm": (0, bend, 0)})
    places = np.concatenate([person(SETS["trunk"].split(), pose)[0] for pose in poses])
    names = person(SETS["trunk"].split(), {})[1]
    found = measure_arm_sides(*sides(places, names))
    assert exchanged_levels(found) == ()
    wrong = measure_arm_sides(*sides(places, [exchanged(name, 2) for name in names]))
    own, other = wrong.chain[1]
    assert own < 0.05 or other > 0.5 * own
    assert exchanged_levels(wrong) == ("wrists", "hands")


def test_shoulders_without_trunk_are_judged_by_the_head():
    labels = [*ARMS.split(), "LFHD", "RFHD", "LBHD", "RBHD"]
    places, names = person(labels, HANGING)
    check_arms(*sides(places, names))
    with pytest.raises(
        InputError, match="Left and right of the shoulders, elbows, wrists and hands are exchanged"
    ):
        check_arms(*sides(places, [exchanged(name, 0) for name in names]))
