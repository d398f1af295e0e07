"""A person from labelled markers: the prior, the fit, and what is refused or said."""

import math
import re

import numpy as np
import pytest

import jaxcap as jc
from jaxcap.body.people.morph_targets import Traits
from jaxcap.body.pose import Motion
from jaxcap.errors import InputError
from jaxcap.markers.human.body_lengths import SegmentLength, adult_percentile, describe_lengths
from jaxcap.markers.human.body_size import estimate_size, person_of_size
from jaxcap.markers.human.check_person import (
    check_explained,
    check_recognised,
    check_sides,
    find_doubled_labels,
)
from jaxcap.markers.human.fit_human import fit_human
from jaxcap.markers.human.further_markers import attach_further_markers
from jaxcap.markers.human.human_template import make_human_template
from jaxcap.markers.human.population import (
    covariance_of_logarithms,
    differences_of_means,
    human_means,
)
from jaxcap.markers.human.rest_positions import bone_ends, limb_lengths, rest_positions, stretch_fields
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


def test_markers_at_a_side_of_the_pelvis_show_its_hip():
    skeleton = jc.human(resolution="low").skeleton
    names = ["left asis", "left psis", "right psis", "sacrum"]
    places, centres = rest_positions(names, np.zeros(4), TALL_WOMAN)
    ends = bone_ends(skeleton, centres, np.full(4, skeleton.index("Hips")), places)
    found = [skeleton.names[end] for end in ends]
    assert found[:3] == ["LeftUpLeg", "LeftUpLeg", "RightUpLeg"]
    assert found[3] in ("Hips", "LowerBack")


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
        ).traits.stature

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
        size = person_of_size(known, median_distances(moved, np.ones(moved.shape[:2], bool))).traits
        assert abs(size.stature) < 0.12 and size.age > 20


def test_long_arms_do_not_make_legs_long():
    """The arms of people are longer than the embedded human's, by as much as surveys say; their legs stay as observed."""
    labels = "LSHO RSHO LELB RELB LWRA LWRB RWRA RWRB LASI RASI LKNE RKNE LANK RANK"
    known = recognise_markers(re.findall(r"\w+", labels))
    mean = Traits(0.5, 35.0, 0.5, 0.5)
    subject = make_human_template(known, mean).subject
    own, offsets = subject.skeleton, np.asarray(subject.offsets, float)
    centres = np.asarray(own.centres, float)
    lengths = limb_lengths(own, centres)
    fields, by_joint = stretch_fields(own, centres, np.asarray(subject.bones), offsets)
    longer = np.array([0.15, 0.09, 0.0, 0.0])
    # stretched limbs have these lengths
    people = limb_lengths(own, centres + np.tensordot(longer, by_joint, 1))
    np.testing.assert_allclose(people, lengths * (1 + longer), rtol=1e-4)
    # of a smaller person
    places, people = 0.9 * (offsets + np.tensordot(longer, fields, 1)), 0.9 * people
    found = person_of_size(known, np.linalg.norm(places[:, None] - places, axis=2))
    np.testing.assert_allclose(found.lengths[2:], people[2:], rtol=0.03)
    assert (found.lengths[:2] / lengths[:2] > 0.9 * 1.04).all()
    # so are the legs of the person that the fit begins with
    start = make_human_template(known, found.traits).subject.skeleton
    np.testing.assert_allclose(
        limb_lengths(start, np.asarray(start.centres, float))[2:], people[2:], rtol=0.03
    )


def test_a_limb_that_is_far_from_the_others_does_not_count():
    """Sizes are those of the joint normal distribution, of SciPy's or any other; one wrong limb is left out."""
    mean, covariance = human_means(), covariance_of_logarithms()
    observed, errors = mean[1:] + 0.05, np.full(4, 1e-4)
    height, deviation, lengths = estimate_size(observed, errors)
    wide = covariance + 0.15**2 + np.diag(differences_of_means() ** 2)
    gain = np.linalg.solve(wide[1:, 1:] + 1e-4 * np.eye(4), wide[1:, :])
    np.testing.assert_allclose(np.log([height, *lengths]), mean + gain.T @ np.full(4, 0.05), atol=1e-9)
    assert deviation / height == pytest.approx(np.sqrt(wide[0, 0] - wide[0, 1:] @ gain[:, 0]))
    observed[3] += np.log(1.5)
    assert estimate_size(observed, errors)[0] == pytest.approx(height, rel=0.02)


def lengths_of(**limbs):
    return [SegmentLength(name.replace("_", " "), one, one, 0.01, math.nan) for name, one in limbs.items()]


def test_a_thigh_that_is_too_long_for_the_other_limbs_is_named():
    """487 mm, while the others are those of an adult of 1.70 m; the same person with a thigh of 412 mm is usual."""
    others = {"upper_arm": 0.272, "forearm": 0.260, "shank": 0.413}
    said = describe_lengths(lengths_of(**others, thigh=0.487))
    assert (
        len(said) == 1
        and said[0].startswith("The thighs are improbably long: 487 mm")
        and re.search("about 1.7[0-4] m tall", said[0])
    )
    assert "pelvis and knees" in said[0]
    assert describe_lengths(lengths_of(**others, thigh=0.412)) == []
    # nobody knows a thigh that only anatomy places, nor which one of two limbs is wrong
    unknown = [*lengths_of(**others), SegmentLength("thigh", 0.487, 0.487, math.nan, math.nan)]
    assert describe_lengths(unknown) == []
    assert "or else the shanks" in describe_lengths(lengths_of(thigh=0.5, shank=0.35))[0]


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


def test_frames_without_markers_are_no_evidence_against_a_person():
    """A file may have markers in a part of its frames only."""
    visible = np.zeros((100, 12), bool)
    visible[:30] = True
    frames = MarkerFrames(np.zeros((100, 12, 3)), visible, tuple(map(str, range(12))), 100.0)
    lost = ~visible[:, 0]
    check_explained(lost, frames)
    lost[10:] = True
    with pytest.raises(InputError, match="explains 67 % of the frames"):
        check_explained(lost, frames)


def test_markers_of_two_people_under_one_name_are_refused():
    frames, _ = seen(person(), count=24)
    places = np.array(frames.positions)
    places[:, ::2] += [1.5, 0.0, 0.0]
    with pytest.raises(InputError, match="markers of two people"):
        fit_human(MarkerFrames(places, frames.visible, frames.labels, frames.rate), num_frames=24)


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
