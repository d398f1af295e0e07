"""Marker sets of single laboratories and of toolboxes.

Sources: Davis et al. 1991; Stebbins et al. 2006 for the Oxford Foot Model; the documentation of BTS, Codamotion and
the MoCap Toolbox (Burger and Toiviainen 2013); labels of public recordings.
"""

from .marker_table import MarkerTable

DAVIS = MarkerTable(
    "Davis",
    sided={
        "acromion": "should shoulder", "asis": "asis asi", "trochanter": "thigh thi", "knee_lateral": "knee1",
        "fibula_head": "knee2", "ankle_lateral": "mall", "foot_5th_head": "met", "heel": "heel",
    },
    whole={"c7": "c7", "sacrum": "sacrum"},
    wands={"thigh_lateral": "bar1", "shank_lateral": "bar2"},
    computed="hip knee ankle hip2 MIDASIS",
)  # fmt: skip

OXFORD_FOOT = MarkerTable(
    "Oxford Foot Model",
    sided={
        "asis": "ASI", "psis": "PSI", "knee_lateral": "KNE", "ankle_lateral": "ANK", "fibula_head": "HFB", "tibial_tuberosity": "TUB",
        "ankle_medial": "MMA", "heel": "HEE", "heel_high": "PCA", "heel_lateral": "LCA", "heel_medial": "STL",
        "foot_1st_base": "P1M", "foot_5th_base": "P5M", "foot_1st_head": "D1M", "foot_5th_head": "D5M", "foot_2nd_head": "TOE",
        "big_toe": "HLX",
    },
    whole={"sacrum": "SACR"},
    loose={"thigh_lateral_low": "THI", "shank_front": "SHN", "shank_lateral_low": "TIB"},
    wands={"heel": "CPG", "knee_lateral": "KAX KD1 KD2"},
    computed=(
        "ArchHeight ArchHeightIndex PROXFF HFplantar D1M0 HE1 "
        + " ".join(f"{segment}{number}" for segment in ("FOF", "HDF", "HLX", "TBA", "FFT", "TIB") for number in range(4))
        + " PEL0 projKAX projTIB"
    ),
)  # fmt: skip

#: the pelvis has a frame with markers on both sides of it, off the skin
CODAMOTION = MarkerTable(
    "Codamotion",
    sided={"knee_lateral": "Knee", "ankle_lateral": "Ankle", "heel": "Heel", "foot_5th_head": "Toe"},
    wands={
        "asis": "ASIS", "waist_back_lateral": "PSIS", "thigh_back": "Post.Fem", "thigh_front": "Ant.Fem", "calf": "Post.Tib",
        "shank_front": "Ant.Tib",
    },
    computed="Hip",
)  # fmt: skip

#: French names; the sides are G (gauche) and D (droite)
BIOGESTA = MarkerTable(
    "Biogesta",
    sided={
        "foot_1st_head": "MT1", "foot_5th_head": "MT5", "heel": "TLN", "tibial_tuberosity": "TB", "knee_medial": "CDI",
        "knee_lateral": "CDE", "trochanter": "GT", "wrist_dorsal": "PGT", "elbow_lateral": "CD", "acromion": "EPL",
        "hand_dorsal": "MN", "temple": "TMP",
    },
    whole={"chin": "MNTN"},
    letters="GD",
)  # fmt: skip

#: French names: épines iliaques, condyles, malléoles, coude, tête; plates on fémur, tibia, bras and avant-bras, high (haut) or low (bas)
FRENCH = MarkerTable(
    "French",
    sided={
        "head_side": "TET", "asis": "EAS EIAS", "psis": "EPS EIPS", "knee_lateral": "CL", "knee_medial": "CM", "ankle_lateral": "ML",
        "ankle_medial": "MM", "elbow_lateral": "COU EL", "elbow_medial": "EM", "acromion": "ACR AC", "heel": "TAL CAL", "hand_dorsal": "MAI",
        "temple": "TMP TEMP", "head_back_lateral": "OCC", "fibula_head": "TFIB", "patella": "PAT", "wrist_radial": "PSR",
        "wrist_ulnar": "PSU", "hand_2nd_knuckle": "MC2", "hand_5th_knuckle": "MC5", "foot_1st_head": "MT1", "foot_5th_head": "MT5",
        "clavicle": "CLAV",
    },
    whole={"c7": "C7", "t8": "T8", "t12": "T12", "l5": "L5", "jugular_notch": "MAN", "xiphoid": "XYP"},
    plates={
        "thigh_lateral": "FHA FHP FBA FBP", "shank_lateral": "THA THP TBA TBP", "forearm_lateral": "MTR MTAB", "foot_2nd_base": "MTP MTCAL",
        "upper_arm_lateral": "BHA BHP BBA BBP MTBHA MTBHP MTBBA MTBBP",
    },
)  # fmt: skip

MOCAP_TOOLBOX = MarkerTable(
    "MoCap Toolbox",
    sided={
        "head_front_lateral": "Head_F?", "head_back_lateral": "Head_B?", "acromion": "Shoulder", "asis": "Hip_F?", "psis": "Hip_B?",
        "elbow_lateral": "Elbow", "wrist_dorsal": "Wrist", "middle_finger_tip": "Finger", "knee_lateral": "Knee",
        "ankle_lateral": "Ankle", "heel": "Heel", "toe_tip": "Toe", "little_finger_tip": "Pinkie",
    },
    whole={"sternum": "Sternum", "c7": "Neck"},
)  # fmt: skip

#: points that a network sees in images, some of them at joints inside the body
KEYPOINTS = MarkerTable(
    "key points in images",
    sided={
        "big_toe": "BigToe foot.index", "heel": "Heel", "foot_5th_head": "SmallToe", "ear": "Ear",
    },
    whole={"nose": "Nose"},
    computed="Hip Knee Ankle Shoulder Elbow Wrist Eye Neck Head Hip MidHip CHip Pelvis",
)  # fmt: skip
#: the bones of a body that ART's software fits, at their first joint
ART_HUMAN = MarkerTable(
    "ART-Human", computed="PELV LLSP ULSP LTSP UTSP NECK HEAD SHO UAR LAR HAN ULE LLE FOO"
)
#: points of these at joints, which are landmarks where there is nothing else
POINTS_AT_JOINTS = {
    KEYPOINTS.name: {
        f"{joint}_centre": joint for joint in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
    },
    ART_HUMAN.name: {
        "hip_centre": "ULE", "knee_centre": "LLE", "ankle_centre": "FOO", "shoulder_centre": "UAR", "elbow_centre": "LAR",
        "wrist_centre": "HAN",
    },
}  # fmt: skip

QUALISYS_LOWER = MarkerTable(
    "Qualisys lower body",
    sided={
        "asis": "asis", "patella": "suppat", "knee_lateral": "knjntln knee", "tibial_tuberosity": "tubtib", "ankle_lateral": "ank ankle",
        "heel": "heel", "foot_5th_head": "toe", "trochanter": "troch",
    },
    whole={"sacrum": "sacrum"},
)  # fmt: skip

#: markers in threes on the front and the side of thigh and shank
SPRINT = MarkerTable(
    "sprinting",
    sided={
        "acromion": "SH", "elbow_lateral": "ELB", "wrist_dorsal": "WR", "asis": "ASI", "knee_lateral": "LEPI", "knee_medial": "MEPI",
        "patella": "PAT", "ankle_lateral": "LMAL", "ankle_medial": "MMAL", "heel": "HEEL", "foot_2nd_base": "MFS", "foot_5th_base": "MFL",
        "foot_1st_head": "P1MT", "foot_2nd_head": "TOE", "foot_5th_head": "P5MT",
    },
    whole={"c7": "C7", "jugular_notch": "MAN", "t7": "T7", "sacrum": "SACR"},
    loose={
        "upper_arm_lateral": "ARM", "forearm_lateral": "FOREARM", "thigh_lateral": "THLP", "thigh_lateral_low": "THLD", "thigh_front": "THAP",
        "thigh_front_low": "THAD", "shank_front_high": "TIAP", "shank_front_low": "TIAD", "shank_lateral": "TILAT",
    },
)  # fmt: skip

#: joints and parts in words
PLAIN = MarkerTable(
    "tibial tubercle and shank",
    sided={
        "tibial_tuberosity": "TibTubercle", "ankle_medial": "MedialAnkle", "foot_5th_base": "LateralFoot LatFoot",
        "heel": "PosteriorFoot", "trochanter": "Hip", "knee_medial": "MedialKnee", "elbow_lateral": "LELB", "wrist_dorsal": "WR",
    },
    loose={"shank_lateral": "MidShank", "shank_lateral_low": "DistalShank"},
)  # fmt: skip

#: plates with a marker at their origin
PLATES_WITH_ORIGIN = MarkerTable(
    "plates with an origin",
    sided={"elbow_lateral": "CUBL", "elbow_medial": "CUBM", "wrist_radial": "WRR", "wrist_ulnar": "WRU", "knee_lateral": "KNEL", "knee_medial": "KNEM"},
    plates={
        "thigh_lateral": "THOL TH2 TH3", "shank_lateral": "SHAOL SHA2 SHA3", "upper_arm_lateral": "UAOL UA2 UA3",
        "forearm_lateral": "LAOL LA2 LA3", "t10": "SPINMOL SPINM2 SPINM3", "sacrum": "SACROL SACR2 SACR3",
    },
)  # fmt: skip

TABLES = (
    DAVIS, OXFORD_FOOT, CODAMOTION, BIOGESTA, FRENCH, MOCAP_TOOLBOX, KEYPOINTS, ART_HUMAN, QUALISYS_LOWER, SPRINT, PLAIN, PLATES_WITH_ORIGIN,
)  # fmt: skip
