"""A person from labelled markers: the prior, the fit, and what is refused or said."""

import re

import numpy as np
import pytest

import jaxcap as jc
from jaxcap.body.people.morph_targets import Traits
from jaxcap.body.pose import Motion
from jaxcap.errors import InputError
from jaxcap.markers.human.body_lengths import adult_percentile
from jaxcap.markers.human.check_person import check_recognised, check_sides, find_doubled_labels
from jaxcap.markers.human.fit_human import fit_human
from jaxcap.markers.human.further_markers import attach_further_markers
from jaxcap.markers.human.human_template import make_human_template, person_of_size
from jaxcap.markers.marker_sets.recognise import recognise_markers
from jaxcap.markers.segments.pair_distances import median_distances
from jaxcap.markers.subject import make_subject
from jaxcap.observe.markers import MarkerFrames

NAMES = (
    "C7 T10 CLAV STRN LSHO RSHO LUPA LELB LFRM LWRA LWRB LFIN LASI RASI LPSI RPSI "
    "LTHI RTHI LKNE RKNE LTIB RTIB LANK RANK LHEE RHEE LTOE RTOE"
)
LABELS = tuple(re.findall(r"\w+", NAMES))
TALL_WOMAN = Traits(0.0, 40.0, 0.4, 0.5, 0.25)


def person(labels=LABELS, traits=TALL_WOMAN, seed=0, placing=0.005):
    """Place a laboratory's markers on a person, a few millimetres off."""
    rng = np.random.default_rng(seed)
    subject = make_human_template(recognise_markers(labels), traits).subject
    return make_subject(
        subject.skeleton,
        np.asarray(subject.bones),
        np.asarray(subject.offsets) + placing * rng.normal(size=subject.offsets.shape),
        subject.labels,
        posture=subject.posture,
    )


def seen(subject, count=60, noise=0.001, seed=1):
    """Markers of smooth poses, and the joint centres."""
    poses = jc.body.sample_poses(subject.skeleton, count=count)
    motion = Motion(poses, 30.0)
    places = np.stack(
        [np.asarray(jc.markers.marker_positions(subject, motion[frame])) for frame in range(count)]
    )
    places = places + noise * np.random.default_rng(seed).normal(size=places.shape)
    frames = MarkerFrames(places, np.ones(places.shape[:2], bool), subject.labels, 30.0)
    joints = np.asarray(jc.markers.joint_frames(subject.skeleton, motion).positions)
    return frames, joints


def test_the_prior_is_the_inverse_of_the_covariance_it_describes():
    """`s` of people: traits, bones that differ nearly equally on both sides, and placements at the nearest joint."""
    template = make_human_template(recognise_markers(LABELS[:8]))
    joints = (10, 11, 20, 21)
    precision = template.prior.precision(template.subject, joints)
    free = template.prior.precision_without_traits(template.subject, joints)
    modes = template.prior.trait_modes(joints)
    np.testing.assert_allclose(
        np.linalg.inv(precision), np.linalg.inv(free) + modes @ modes.T, rtol=1e-6, atol=1e-10
    )
    # the same change on both sides, mirrored, is far more probable than one of opposite signs
    names = template.subject.skeleton.names
    assert names[10] == "LeftArm" and names[20] == "RightArm"
    same, opposite = np.zeros(len(free)), np.zeros(len(free))
    same[1::3][:4], opposite[1::3][:2], opposite[1::3][2:4] = 0.01, 0.01, -0.01
    assert opposite @ free @ opposite > 5 * (same @ free @ same)


def test_the_size_of_a_person_follows_from_markers_of_single_bones():
    """A taller person has a larger stature, whatever the pose."""
    known = recognise_markers(LABELS)

    def stature(traits):
        frames, _ = seen(person(traits=traits, placing=0.0), count=8)
        return person_of_size(
            known, median_distances(np.asarray(frames.positions), np.asarray(frames.visible))
        ).stature

    small, tall = (stature(Traits(0.5, 35.0, 0.5, 0.5, value)) for value in (-0.4, 0.4))
    assert small < -0.15 and tall > 0.15


def test_the_size_of_a_person_does_not_follow_markers_far_off_their_landmarks():
    """Wide wrist bars, a wand on the pelvis and a wrong label make no giant of a person, nor a child of an adult."""
    labels = (*LABELS, "RELB", "RWRA", "RWRB")
    known = recognise_markers(labels)
    subject = person(labels, Traits(0.5, 35.0, 0.5, 0.5), placing=0.0)
    places = np.asarray(seen(subject, count=8)[0].positions)
    at = {label: subject.labels.index(label) for label in labels}
    for push, sign in ((["LWRA", "RWRA"], 1.0), (["RHEE", "LHEE", "RWRB", "LWRB"], -1.0)):
        moved = places.copy()
        moved[:, at["C7"]] += sign * 0.15 * (places[:, at["C7"]] - places[:, at["CLAV"]])
        for label in push:
            other = {"WRA": "WRB", "WRB": "WRA", "HEE": "TOE"}[label[1:]]
            moved[:, at[label]] += sign * 0.6 * (places[:, at[label]] - places[:, at[label[0] + other]])
        size = person_of_size(known, median_distances(moved, np.ones(moved.shape[:2], bool)))
        assert abs(size.stature) < 0.12 and size.age > 20


@pytest.fixture(scope="module")
def fitted():
    truth = person()
    frames, joints = seen(truth)
    bone = truth.skeleton.index("LeftUpLeg")
    extra = make_subject(truth.skeleton, [bone], truth.skeleton.centres[bone : bone + 1] - 0.1, ["Xyzzy9"])
    places = np.concatenate([np.asarray(frames.positions), seen(extra)[0].positions], axis=1)
    more = MarkerFrames(places, np.ones(places.shape[:2], bool), (*frames.labels, "Xyzzy9"), 30.0)
    return truth, joints, fit_human(more, num_frames=24)


def test_joints_are_found_without_an_offset(fitted):
    """Where markers are, joints are within two centimetres of the person's, without an offset removed."""
    truth, joints, fit = fitted
    found = np.asarray(jc.markers.joint_frames(fit.subject.skeleton, fit.motion).positions)
    names = truth.skeleton.names
    errors = 1e3 * np.linalg.norm(found - joints, axis=2)
    # the poses are random, without a path between them, and some are not found
    off = {
        name: np.median(errors[:, names.index(name)])
        for name in ("LeftLeg", "RightLeg", "LeftFoot", "RightFoot", "LeftForeArm", "LeftHand", "LeftUpLeg")
    }
    assert max(off.values()) < 20 and np.mean(list(off.values())) < 12, off
    lengths, true = (jc.markers.bone_lengths(one) for one in (fit.subject.skeleton, truth.skeleton))
    for side in ("Left", "Right"):
        bone = (f"{side}UpLeg", f"{side}Leg")
        assert abs(lengths[bone] - true[bone]) < 0.015


def test_what_no_marker_shows_is_said(fitted):
    """No marker is on the right arm; the head has none either. An unknown marker goes to the bone it moves with."""
    _, _, fit = fitted
    text = " ".join(fit.messages)
    assert "No marker is on the right arm" in text and "No marker is on the head" in text
    assert "the left arm" not in text
    bone = fit.subject.skeleton.names[int(fit.subject.bones[fit.subject.labels.index("Xyzzy9")])]
    assert bone == "LeftUpLeg" and "Xyzzy9" in text


def test_a_subject_keeps_its_posture_in_a_file(fitted, tmp_path):
    _, _, fit = fitted
    jc.io.save_subject(tmp_path / "person.npz", fit.subject)
    again = jc.io.load_subject(tmp_path / "person.npz")
    np.testing.assert_array_equal(again.posture, fit.subject.posture)
    assert again.labels == fit.subject.labels


def test_key_points_are_at_the_centres_of_joints():
    """Points that a network sees at joints are placed there, for people of all sizes."""
    labels = ["LShoulder", "RElbow", "LWrist", "RHip", "LKnee", "RAnkle", "Nose", "LHeel", "RBigToe"]
    for traits in (TALL_WOMAN, TALL_WOMAN._replace(stature=-0.2)):
        subject = make_human_template(recognise_markers(labels), traits).subject
        at = dict(zip(subject.labels, np.asarray(subject.offsets), strict=True))
        centres = dict(zip(subject.skeleton.names, np.asarray(subject.skeleton.centres), strict=True))
        joints = {
            "LShoulder": "LeftArm",
            "RElbow": "RightForeArm",
            "LWrist": "LeftHand",
            "RHip": "RightUpLeg",
            "LKnee": "LeftLeg",
        }
        for label, joint in joints.items():
            np.testing.assert_allclose(at[label], centres[joint], atol=1e-6)
        # those on the skin are not raised by half a marker
        assert at["Nose"][2] > centres["Head"][2] + 0.08


def test_exchanged_sides_are_refused():
    subject = person()
    frames, _ = seen(subject, count=8)
    mirrored = tuple({"L": "R", "R": "L"}.get(label[0], label[0]) + label[1:] for label in LABELS)
    both = MarkerFrames(frames.positions, frames.visible, mirrored, 30.0)
    known = recognise_markers(mirrored)
    check_sides(subject, recognise_markers(LABELS), frames)
    with pytest.raises(InputError, match="Left and right are exchanged"):
        check_sides(make_human_template(known).subject, known, both)


def test_markers_of_no_person_are_refused():
    labels = tuple(f"Box{number}" for number in range(8))
    frames = MarkerFrames(np.zeros((2, 8, 3)), np.ones((2, 8), bool), labels, 30.0)
    with pytest.raises(InputError, match="0 of 8 markers have labels"):
        check_recognised(recognise_markers(labels), frames)


def test_labels_of_two_markers_of_one_joint_are_those_of_one_person():
    """Old files cut labels to four letters: both sides of a knee are `LKNE`. Markers of two people are far from each other."""
    frames, _ = seen(person(), count=8)
    places = np.asarray(frames.positions)
    labels = (*LABELS, *(f"{label}_2" for label in LABELS))
    for offset, doubled in ((0.1, []), (1.0, list(LABELS))):
        both = np.concatenate([places, places + np.array([offset, 0.0, 0.0])], axis=1)
        assert find_doubled_labels(MarkerFrames(both, np.ones(both.shape[:2], bool), labels, 30.0)) == doubled


def test_a_marker_that_follows_no_bone_is_loose():
    subject = person()
    frames, _ = seen(subject, count=20)
    poses = jc.body.sample_poses(subject.skeleton, count=20)
    rng = np.random.default_rng(2)
    places = np.concatenate([np.asarray(frames.positions), rng.uniform(-1, 1, (20, 1, 3))], axis=1)
    more = MarkerFrames(places, np.ones(places.shape[:2], bool), (*LABELS, "Fly"), 30.0)
    lost, known = np.zeros(20, bool), recognise_markers(more.labels)
    found = attach_further_markers(subject, Motion(poses, 30.0), lost, more, known)
    assert found.loose == ("Fly",) and found.added == ()


def test_percentiles_of_adults():
    assert adult_percentile("thigh", 0.2425 * 1.69) == pytest.approx(50)
    assert adult_percentile("upper arm", 0.35) > 95
    assert np.isnan(adult_percentile("hips", 0.2))
    assert adult_percentile("shank", 0.38) < 25
