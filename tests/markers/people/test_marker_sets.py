"""Labels of laboratories and the landmarks of the human that they name."""

import numpy as np
import pytest

from jaxcap.body.people.human import human, human_from_traits
from jaxcap.body.people.morph_targets import Traits
from jaxcap.geometry.attachment import attached_positions
from jaxcap.io.registry import read_markers
from jaxcap.markers.marker_sets import clinical, isb, laboratories, motion_capture, opensim, vicon
from jaxcap.markers.marker_sets.joints_by_landmarks import hip_centres, joints_by_landmarks
from jaxcap.markers.marker_sets.landmarks import landmark_attachment, landmarks, mirror_name
from jaxcap.markers.marker_sets.marker_table import expand_table
from jaxcap.markers.marker_sets.recognise import recognise_markers

TABLES = [
    table
    for module in (vicon, clinical, opensim, motion_capture, isb, laboratories)
    for table in module.TABLES
]
#: labels of published sets, and what some of them are (the sources are in the modules of the tables)
PUBLISHED = {
    "Plug-in Gait": (
        "LFHD RFHD LBHD RBHD C7 T10 CLAV STRN RBAK LSHO LUPA LELB LFRM LWRA LWRB LFIN RSHO RUPA RELB RFRM RWRA RWRB RFIN "
        "LASI RASI LPSI RPSI LTHI LKNE LTIB LANK LHEE LTOE RTHI RKNE RTIB RANK RHEE RTOE",
        {"RBAK": "right scapula", "LTHI": "left thigh_lateral_low", "RTOE": "right foot_2nd_head", "C7": "c7"},
    ),
    "CMU": (
        "LFHD RFHD LBHD RBHD C7 T10 CLAV STRN RBAC LSHO LUPA LELB LFRM LWRA LWRB LFIN RSHO RUPA RELB RFRM RWRA RWRB RFIN "
        "LFWT RFWT LBWT RBWT LTHI LKNE LSHN LANK LHEE LMT5 LTOE RTHI RKNE RSHN RANK RHEE RMT5 RTOE",
        {"LFWT": "left asis", "RBWT": "right psis", "LTHI": "left thigh_lateral", "RMT5": "right foot_5th_head"},
    ),
    "Conventional Gait Model 2.4 and 2.5": (
        "LASI RASI LPSI RPSI LTHI LKNE LKNM LTHAP LTHAD LTIB LANK LMED LTIAP LTIAD LHEE LTOE LSMH LFMH LVMH RTHI RKNE RKNM "
        "RTHAP RTHAD RTIB RANK RMED RTIAP RTIAD RHEE RTOE RSMH RFMH RVMH C7 T10 CLAV STRN",
        {"LKNM": "left knee_medial", "LTOE": "left foot_2nd_base", "RSMH": "right foot_2nd_head"},
    ),
    "OpenSim Rajagopal": (
        "RACR LACR C7 CLAV RASH RPSH LASH LPSH RLEL RMEL RFAsuperior RFAradius RFAulna LLEL LMEL LFAsuperior LFAradius LFAulna "
        "RASI LASI RPSI LPSI RLFC RMFC RLMAL RMMAL RCAL RTOE RMT5 LLFC LMFC LLMAL LMMAL LCAL LTOE LMT5 RTH1 RTH2 RTH3 RTB1 "
        "RTB2 RTB3 LTH1 LTH2 LTH3 LTB1 LTB2 LTB3 RUA1 RUA2 RUA3 LUA1 LUA2 LUA3",
        {"LLFC": "left knee_lateral", "RLEL": "right elbow_lateral", "LLMAL": "left ankle_lateral", "LLEL": "left elbow_lateral"},
    ),
    "OpenSim gait2392": (
        "Top.Head Sternum V.Sacral R.Acromium L.Acromium R.ASIS L.ASIS R.Thigh.Upper R.Thigh.Front R.Thigh.Rear R.Knee.Lat "
        "R.Knee.Med R.Shank.Upper R.Shank.Front R.Shank.Rear R.Ankle.Lat R.Ankle.Med R.Heel R.Midfoot.Sup R.Midfoot.Lat "
        "R.Toe.Lat R.Toe.Med R.Toe.Tip L.Thigh.Upper L.Thigh.Front L.Thigh.Rear L.Knee.Lat L.Knee.Med L.Shank.Upper",
        {"R.Knee.Lat": "right knee_lateral", "R.Toe.Med": "right foot_1st_head", "V.Sacral": "sacrum", "L.Acromium": "left acromion"},
    ),
    "OptiTrack Motive": (
        "HeadTop HeadFront HeadSide BackTop Chest BackLeft BackRight WaistLFront WaistRFront WaistLBack WaistRBack LShoulderBack "
        "RShoulderBack LShoulderTop RShoulderTop LElbowOut RElbowOut LUArmHigh RUArmHigh LWristOut RWristOut LWristIn RWristIn "
        "LHandOut RHandOut LThigh RThigh LKneeOut RKneeOut LShin RShin LAnkleOut RAnkleOut LToeOut RToeOut LToeIn RToeIn "
        "LHeel RHeel LToeTip RToeTip",
        {"WaistLFront": "left asis", "RToeIn": "right foot_1st_head", "BackLeft": "left back_lateral", "LKneeOut": "left knee_lateral"},
    ),
    "Qualisys Sports and Animation": (
        "Q_HeadL Q_HeadR Q_HeadFront Q_Chest Q_SpineThoracic2 Q_SpineThoracic12 Q_WaistBack Q_WaistL Q_WaistR Q_WaistLFront "
        "Q_WaistRFront Q_LShoulderTop Q_LElbowOut Q_LElbowIn Q_LWristIn Q_LWristOut Q_LHand2 Q_LThighFrontLow Q_LKneeOut Q_LKneeIn "
        "Q_LShinFrontHigh Q_LAnkleOut Q_LHeelBack Q_LForefoot2 Q_LForefoot5 Q_RKneeOut Q_RKneeIn",
        {"Q_WaistRFront": "right asis", "Q_SpineThoracic2": "t2", "Q_LForefoot5": "left foot_5th_head", "Q_HeadL": "left head_side"},
    ),
    "CAST and Rizzoli, skeletal landmarks": (
        "CV7 TV2 TV7 LV1 LV3 LV5 SJN SXS LCAJ RCAJ L_IAS R_IAS L_IPS R_IPS L_FTC R_FTC L_FLE R_FLE L_FME R_FME L_FAX R_FAX L_TTC "
        "R_TTC L_FAL R_FAL L_TAM R_TAM L_FCC R_FCC L_FM1 R_FM1 L_FM2 R_FM2 L_FM5 R_FM5 L_SAE L_HLE L_HME L_RSP L_USP L_HM2",
        {"L_FLE": "left knee_lateral", "R_TAM": "right ankle_medial", "LV5": "l5", "L_HLE": "left elbow_lateral", "RCAJ": "right acromioclavicular"},
    ),
    "Helen Hayes": (
        "Top.Head Front.Head Rear.Head V.Sacral R.Shoulder L.Shoulder R.Elbow L.Elbow R.Wrist L.Wrist R.ASIS L.ASIS R.Thigh L.Thigh "
        "R.Knee L.Knee R.Shank L.Shank R.Ankle L.Ankle R.Heel L.Heel R.Toe L.Toe R.Knee.Medial L.Knee.Medial R.Ankle.Medial",
        {"R.Thigh": "right thigh_lateral", "L.Knee": "left knee_lateral", "R.Toe": "right foot_2nd_head"},
    ),
    "Helen Hayes, four letters": (
        "THEA FHEA RHEA RSHO ROFF RELB RWRI LSHO LELB LWRI RASI LASI VSAC RTHI RKNE RSHA RANK RHEE RTOE LTHI LKNE LSHA LANK LHEE LTOE",
        {"RSHA": "right shank_lateral", "LTHI": "left thigh_lateral", "VSAC": "sacrum", "RWRI": "right wrist_dorsal"},
    ),
    "sprinting": (
        "C7 RSH LSH MAN T7 LARM LELB LFOREARM LWR RARM RELB RFOREARM RWR RASI LASI SACR LTHLP LTHAP LTHLD LTHAD LLEPI LPAT LTIAP LTILAT LTIAD "
        "LLMAL LHEEL LMFS LMFL LP1MT LTOE LP5MT RLEPI RMEPI RLMAL RMMAL RHEEL RMFS RMFL RP1MT RTOE RP5MT",
        {"LP5MT": "left foot_5th_head", "RMFL": "right foot_5th_base", "LTHLD": "left thigh_lateral_low"},
    ),
    "Xsens landmarks": (
        "pRightASI pLeftASI pRightAcromion pLeftArmLatEpicondyle pC7SpinalProcess pT8SpinalProcess pTopOfHead pRightPatella "
        "pLeftKneeMedEpicondyle pRightHeelFoot pRightFirstMetatarsal pSacrum pIJ",
        {"pRightPatella": "right patella", "pLeftArmLatEpicondyle": "left elbow_lateral", "pIJ": "jugular_notch"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", PUBLISHED)
def test_every_label_of_a_published_set_is_recognised(name):
    labels, some = PUBLISHED[name]
    found = recognise_markers(labels.split())
    assert found.name == name
    assert None not in found.names and None not in found.bones
    assert not found.virtual.any()
    assert {label: found.names[found.labels.index(label)] for label in some} == some
    # a palpated bone is known better than a plate on a thigh
    assert 0.009 < found.deviations.min() <= 0.015 and found.deviations.max() <= 0.08


@pytest.mark.parametrize("form", ["Anna:{}", "Anna_{}", "251112_KUO_{}", "{}_study", "{}"])
def test_the_persons_name_and_common_endings_do_not_count(form):
    labels = PUBLISHED["Plug-in Gait"][0].split()
    plain = recognise_markers(labels)
    assert recognise_markers([form.format(label) for label in labels]).names == plain.names
    assert recognise_markers([form.format(label.lower()) for label in labels]).names == plain.names


@pytest.mark.parametrize(
    "left",
    ["LKneeLat", "L_knee_lat", "L.Knee.Lat", "Left Knee Lateral", "knee_lat_L", "KneeLatLeft", "l-knee-lat"],
)
def test_sides_may_be_written_in_many_ways(left):
    right = (
        left.replace("Left", "Right")
        .replace("L_", "R_")
        .replace("_L", "_R")
        .replace("L.K", "R.K")
        .replace("LK", "RK")
    )
    right = "r-knee-lat" if left == "l-knee-lat" else right
    names = recognise_markers([left, right, "C7", "sacrum"]).names
    assert names == ("left knee_lateral", "right knee_lateral", "c7", "sacrum")


def test_the_same_label_has_the_place_of_the_takes_set():
    labels = PUBLISHED["Plug-in Gait"][0].split()
    gait, film = recognise_markers(labels), recognise_markers(PUBLISHED["CMU"][0].split())
    assert gait.names[labels.index("LTHI")] != film.names[film.labels.index("LTHI")]
    # what is left is looked up elsewhere
    more = recognise_markers([*labels, "LKNM", "L.Toe.Tip", "LUA1"])
    assert more.names[-3:] == ("left knee_medial", "left toe_tip", "left upper_arm_lateral")
    assert more.deviations[-1] > 0.05


@pytest.mark.parametrize(
    "labels",
    [
        ["segment1", "segment2", "segment3"],
        ["Rope1", "Rope2", "Racket:1", "Racket:2", "Ball"],
        ["box_front_left", "table1", "Drone:1", "*12", "Unlabeled 4", "U_3", "M017"],
        ["asdf", "qwertz", "xyzzy", ""],
    ],
)  # fmt: skip
def test_nothing_is_recognised_where_there_is_no_person(labels):
    found = recognise_markers(labels)
    assert found.names == (None,) * len(labels) and found.name is None
    assert np.isnan(found.deviations).all() and np.isnan(found.heights).all()


def test_computed_points_are_told_and_left_out():
    computed = [
        "LHJC", "RKJC", "R_HJC_reg", "LFEO", "LFEA", "LFEL", "LFEP", "PELO", "PELA", "PELP", "CentreOfMass", "CentreOfMassFloor", "LKneeAngles", "RHipMoment",
        "V_Mid_ASIS", "midASIS", "LGroundReactionForce", "COM", "FP1", "VRKN", "VPEL", "midHJC", "R_toe_proj", "o_Trunk", "x_Trunk", "y_Trunk",
        "z_Trunk", "AXISXPelvis", "ORIGINPelvis", "ULEGY", "ULEGZ", "LLEGY", "LLEGZ", "HANDY", "HANDZ",
    ]  # fmt: skip
    found = recognise_markers([*PUBLISHED["Plug-in Gait"][0].split(), "ULEG", "LLEG", "HAND", *computed])
    assert found.virtual[-len(computed) :].all() and not found.virtual[: -len(computed)].any()
    assert set(found.names[-len(computed) :]) == {None}
    # the same label is a joint in one set, and a marker in another one
    davis = "r should/l should/c7/sacrum/r asis/l asis/r bar 1/l bar 1/r knee 1/l knee 1/r knee/l knee/r hip/l hip/r mall/l mall"
    found = recognise_markers(davis.split("/"))
    assert found.name == "Davis"
    assert [name for name, one in zip(found.labels, found.virtual, strict=True) if one] == [
        "r knee",
        "l knee",
        "r hip",
        "l hip",
    ]


def names_of(labels):
    found = recognise_markers(labels)
    return dict(zip(found.labels, found.names, strict=True))


def test_sides_of_french_labels_are_at_the_end():
    """Gauche and droite, of labels that come in pairs."""
    stems = "EAS EPS CL CM ML MM CAL EL EM PSR PSU AC"
    french = [f"{stem}{side}" for stem in stems.split() for side in "GD"]
    found = names_of([*french, "MAN", "XYP"])
    assert found["EASG"] == "left asis" and found["EASD"] == "right asis"
    assert (
        found["ELD"] == "right elbow_lateral"
        and found["PSUG"] == "left wrist_ulnar"
        and found["MLD"] == "right ankle_lateral"
    )
    assert None not in found.values()
    # a single letter is no side
    assert names_of([*PUBLISHED["Plug-in Gait"][0].split(), "PEG"])["PEG"] is None


def test_numbered_markers_of_one_plate_stay_together():
    """`FT3` is the tip of a finger in one set; next to `FT1` and `FT2` it is on the foot."""
    plates = [f"{side}{stem}{number}" for side in "LR" for stem in ("TH", "SK", "FT") for number in (1, 2, 3)]
    found = recognise_markers(plates)
    assert {found.bones[found.labels.index(f"LFT{number}")] for number in (1, 2, 3)} == {"LeftFoot"}


def test_the_second_of_two_equal_labels_is_unknown():
    """Readers number it, and the number is no part of the label: a second `MET` is not on the second metatarsal."""
    found = names_of([*PUBLISHED["Plug-in Gait"][0].split(), "LMET", "LMET_2", "LTHI_2", "SACR", "SACR_2"])
    assert found["LMET_2"] is None and found["LTHI_2"] is None and found["SACR_2"] is None
    assert found["LTHI"] == "left thigh_lateral_low" and found["SACR"] == "sacrum"


KEY_POINTS = "Nose LShoulder RShoulder LElbow RElbow LWrist RWrist LHip RHip LKnee RKnee LAnkle RAnkle LBigToe RBigToe LHeel RHeel"


def test_points_in_images_are_at_joints_if_there_are_no_markers():
    found = recognise_markers(KEY_POINTS.split())
    names = dict(zip(found.labels, found.names, strict=True))
    assert (
        names["LKnee"] == "left knee_centre"
        and names["RShoulder"] == "right shoulder_centre"
        and names["LBigToe"] == "left big_toe"
    )
    assert not found.virtual.any() and (found.deviations == 0.03).all() and (found.heights == 0).all()
    # those of a body that a program fits, with points on the axes of some of its bones
    body = "PELV PELVY PELVZ NECK HEAD HEADY HEADZ LSHO RSHO LUAR RUAR LLAR RLAR LHAN LHANY LHANZ RHAN LULE RULE LLLE RLLE LFOO RFOO"
    found = names_of(body.split())
    assert (
        found["LLAR"] == "left elbow_centre" and found["RULE"] == "right hip_centre" and found["LSHO"] is None
    )
    # MediaPipe's names
    assert (
        names_of(
            ["nose", "left_heel", "right_heel", "left_hip", "right_hip", "left_elbow", "left_foot_index"]
        )["left_hip"]
        == "left hip_centre"
    )


def test_points_in_images_are_left_out_next_to_the_markers_that_are_computed_from_them():
    """OpenCap's files have both: `RKnee`, and `r_knee_study` on the skin."""
    study = "r.ASIS L.ASIS r.PSIS L.PSIS r_knee L_knee r_mknee L_mknee r_ankle L_ankle r_toe L_toe r_calc L_calc r_shoulder L_shoulder C7 r_lelbow L_lelbow"
    found = recognise_markers(
        [*KEY_POINTS.split(), "Neck", "midHip", *(f"{label}_study" for label in study.split())]
    )
    names = dict(zip(found.labels, found.names, strict=True))
    assert found.name == "OpenCap"
    assert names["r_knee_study"] == "right knee_lateral" and names["C7_study"] == "c7"
    assert all(names[label] is None for label in KEY_POINTS.split())
    assert found.virtual[:19].all() and not found.virtual[19:].any()


def test_no_two_labels_are_at_one_landmark():
    """A label that another set reads otherwise is there; else both are only near the landmark."""
    rest = "LASI RASI LPSI RPSI LKNE RKNE LANK RANK LHEE RHEE LTOE RTOE C7"
    alone, both = (names_of([*rest.split(), *more]) for more in (["STRN"], ["STRN", "XIPH"]))
    assert alone["STRN"] == "xiphoid"
    assert both["STRN"] == "jugular_notch" and both["XIPH"] == "xiphoid"
    found = recognise_markers(["R.Heel", "R.PosteriorFoot", *PUBLISHED["Helen Hayes"][0].split()])
    heels = [found.labels.index(label) for label in ("R.Heel", "R.PosteriorFoot")]
    assert [found.names[k] for k in heels] == ["right heel"] * 2
    assert (found.deviations[heels] == 0.05).all()


def test_labels_that_differ_in_the_side_only_are_mirrored():
    """`LMAL` alone could be the `LMA` of the left; next to `RMAL` the first letter is the side."""
    found = names_of(["LASI", "RASI", "LKNE", "RKNE", "LANK", "RANK", "LMAL", "RMAL", "LCalL", "RCalL"])
    assert found["LMAL"] is None and found["RMAL"] is None
    assert found["LCalL"] == "left heel_lateral" and found["RCalL"] == "right heel_lateral"


def test_rare_sets_do_not_overrule_words():
    """`Hip` is on the thigh in a marker set for films. A gait take has no other label of that set."""
    gait = "R.Shoulder L.Shoulder R.Elbow L.Elbow R.Wrist L.Wrist R.ASIS L.ASIS Sacrum R.Thigh L.Thigh R.Knee L.Knee R.Heel L.Heel R.Toe L.Toe"
    assert names_of([*gait.split(), "R.Hip", "L.Hip"])["R.Hip"] == "right trochanter"
    assert (
        names_of(["LHIP", "RHIP", "ARIEL", "LFWT", "RFWT", "LMWT", "RMWT", "LKNI", "RKNI"])["LHIP"]
        == "left thigh_lateral"
    )


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.name)
def test_tables_name_landmarks_and_mirror(table):
    places, known = expand_table(table, landmarks()), landmarks()
    assert places
    for placement in filter(None, places.values()):
        assert placement.landmark in known
    left = {form: one.landmark for form, one in places.items() if one and one.landmark.startswith("left")}
    right = {one.landmark for one in places.values() if one and one.landmark.startswith("right")}
    if table is not isb.UPPER_LIMB:
        assert {name.replace("left", "right") for name in left.values()} <= right


def test_left_and_right_are_mirrored():
    table = landmarks()
    for name, mark in table.items():
        if name.startswith("left "):
            other = table[name.replace("left ", "right ")]
            assert other.bone == mirror_name(mark.bone) and other.deviation == mark.deviation
            np.testing.assert_array_equal(other.offset, np.array(mark.offset) * [-1, 1, 1])
    names, hold = landmark_attachment("full")
    body = human(resolution="full", joints="tracking")
    places = dict(zip(names, attached_positions(hold, np.asarray(body.vertices, float)), strict=True))
    for name, place in places.items():
        if name.startswith("left "):
            np.testing.assert_allclose(places[name.replace("left", "right")] * [-1, 1, 1], place, atol=0.004)


@pytest.mark.parametrize("traits", [Traits(1.0, 25.0, 0.5, 0.5), Traits(0.0, 40.0, 0.8, 0.3)])
@pytest.mark.parametrize("resolution", ["low", "full"])
def test_landmarks_lie_where_the_anatomy_has_them(traits, resolution):
    body = human_from_traits(traits, resolution, "tracking")
    names, hold = landmark_attachment(resolution)
    at = dict(zip(names, attached_positions(hold, np.asarray(body.vertices, float)), strict=True))
    joints = dict(zip(body.skeleton.names, np.asarray(body.skeleton.centres, float), strict=True))
    for side, joint in (("left", "Left"), ("right", "Right")):
        sign = 1 if side == "left" else -1
        # the joint is between the epicondyles, and between the malleoli (Wu et al. 2002)
        for what, bone in (("knee", "Leg"), ("ankle", "Foot"), ("elbow", "ForeArm")):
            lateral, medial = at[f"{side} {what}_lateral"], at[f"{side} {what}_medial"]
            assert np.linalg.norm((lateral + medial) / 2 - joints[joint + bone]) < 0.02
            assert 0.04 < np.linalg.norm(lateral - medial) < 0.16
        # the acromion is on top of the shoulder, the styloids beside the wrist
        above = at[f"{side} acromion"] - joints[joint + "Arm"]
        assert above[1] > 0.03 and np.linalg.norm(above[[0, 2]]) < 0.03
        wrist = (at[f"{side} wrist_radial"] + at[f"{side} wrist_ulnar"]) / 2
        assert np.linalg.norm(wrist - joints[joint + "Hand"]) < 0.025
        # the spines of the pelvis are above the hips, in front and behind (Harrington et al. 2007)
        front, back, hip = at[f"{side} asis"], at[f"{side} psis"], joints[joint + "UpLeg"]
        assert 0.05 < front[1] - hip[1] < 0.13 and front[2] - hip[2] > 0.03 and back[2] < hip[2] - 0.02
        assert sign * front[0] > 0.08 and 0.02 < sign * back[0] < 0.08
        assert abs(at[f"{side} trochanter"][1] - hip[1]) < 0.05
        assert (
            at[f"{side} heel"][2]
            < joints[joint + "Foot"][2]
            < at[f"{side} foot_5th_head"][2]
            < at[f"{side} toe_tip"][2]
        )
        assert sign * at[f"{side} foot_1st_head"][0] < sign * at[f"{side} foot_5th_head"][0]
    heights = [at[level][1] for level in ("c7", "t2", "t4", "t8", "t10", "t12", "l1", "l3", "l5", "sacrum")]
    assert heights == sorted(heights, reverse=True)
    assert at["jugular_notch"][1] > at["sternum"][1] > at["xiphoid"][1] > at["navel"][1]
    assert at["c7"][2] < joints["Spine1"][2] + 0.05 < at["jugular_notch"][2]


@pytest.mark.parametrize("traits", [Traits(1.0, 25.0, 0.5, 0.5), Traits(0.0, 40.0, 0.8, 0.3)])
def test_hips_are_where_images_of_pelvises_have_them(traits):
    body = human_from_traits(traits, "low", "tracking")
    vertices, names = np.asarray(body.vertices, float), body.skeleton.names
    joints = joints_by_landmarks(vertices, np.asarray(body.skeleton.centres, float), "low")
    places, hold = landmark_attachment("low")
    at = dict(zip(places, attached_positions(hold, vertices), strict=True))
    hips = np.array([joints[names.index(f"{side}UpLeg")] for side in ("Left", "Right")])
    front = (at["left asis"] + at["right asis"]) / 2
    width = np.linalg.norm(at["left asis"] - at["right asis"])
    across, along, below = (hips[0] - hips[1])[0], (front - hips.mean(0))[2], (front - hips.mean(0))[1]
    # shares of the distance of the spines in front (Bell et al. 1990): 0.72 between the hips, 0.22 behind and 0.30 below
    assert 0.65 < across / width < 0.79
    assert 0.15 < along / width < 0.29
    assert 0.23 < below / width < 0.41


def test_hips_follow_the_regression():
    spines = {"left asis": [0.12, 0, 0.2], "right asis": [-0.12, 0, 0.2], "left psis": [0.05, 0, 0.05]}
    at = {name: np.array(place) for name, place in spines.items()} | {
        "right psis": np.array([-0.05, 0, 0.05])
    }
    # Harrington and others (2007), millimetres: 0.33 240 + 7.3 to the side, 0.30 240 + 10.9 below, 0.24 150 + 9.9 behind
    place = np.array([0.0865, -0.0829, 0.2 - 0.0459])
    hips = hip_centres(at)
    np.testing.assert_allclose(hips["LeftUpLeg"], place)
    np.testing.assert_allclose(hips["RightUpLeg"], place * [-1, 1, 1])


def test_bones_of_landmarks_are_joints_of_the_human():
    skeleton = human(resolution="low", joints="tracking").skeleton
    for name, mark in landmarks().items():
        assert mark.bone in skeleton.names and mark.joint in skeleton.names
        # the bone is at the joint or ends there
        assert np.linalg.norm(mark.offset) < 0.35, name


@pytest.mark.shared
@pytest.mark.parametrize(
    ("file", "person", "known"),
    [
        ("biobuddy_static.c3d", None, 66),
        ("cmu_02_05.c3d", None, 41),
        ("pyomeca_upper_limb.c3d", "Daphnee", 42),
    ],
)
def test_labels_of_recordings(shared, file, person, known):
    frames = read_markers(shared / "data" / "markers" / file, subject=person)
    found = recognise_markers(list(frames.labels))
    assert sum(name is not None for name in found.names) >= known
