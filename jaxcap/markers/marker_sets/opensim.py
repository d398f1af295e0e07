"""Marker sets of OpenSim's models and of programs around it: gait2392, Rajagopal, OpenCap, Human Body Model.

Sources: the models' marker files; van den Bogert et al. 2013 for the Human Body Model.
"""

from .marker_table import MarkerTable

GAIT_2392 = MarkerTable(
    "OpenSim gait2392",
    sided={
        "acromion": "Acromium Acromion", "asis": "ASIS", "psis": "PSIS", "knee_lateral": "Knee.Lat",
        "knee_medial": "Knee.Med", "ankle_lateral": "Ankle.Lat", "ankle_medial": "Ankle.Med", "heel": "Heel",
        "foot_2nd_base": "Midfoot.Sup", "foot_5th_base": "Midfoot.Lat", "foot_5th_head": "Toe.Lat MT5",
        "foot_1st_head": "Toe.Med MT1", "toe_tip": "Toe.Tip", "elbow_lateral": "Elbow", "wrist_ulnar": "Wrist.Med",
        "wrist_radial": "Wrist.Lat",
    },
    whole={"head_top": "Top.Head", "sternum": "Sternum", "sacrum": "V.Sacral"},
    loose={"upper_arm_lateral": "Bicep Biceps", "forearm_lateral": "Forearm"},
    plates={
        "thigh_lateral": "Thigh Thigh.Upper Thigh.Front Thigh.Rear", "shank_lateral": "Shank Shank.Upper Shank.Front Shank.Rear",
    },
)  # fmt: skip

RAJAGOPAL = MarkerTable(
    "OpenSim Rajagopal",
    sided={
        "acromion": "ACR", "shoulder_front": "ASH", "shoulder_back": "PSH", "elbow_lateral": "LEL", "elbow_medial": "MEL",
        "wrist_radial": "FAradius", "wrist_ulnar": "FAulna", "forearm_lateral": "FAsuperior", "asis": "ASI", "psis": "PSI",
        "knee_lateral": "LFC", "knee_medial": "MFC", "ankle_lateral": "LMAL", "ankle_medial": "MMAL", "heel": "CAL",
        "foot_5th_head": "MT5", "foot_1st_head": "MT1", "toe_tip": "TOE", "clavicle": "CLAV",
    },
    whole={
        "c7": "C7", "jugular_notch": "CLAV", "t10": "T10", "xiphoid": "STRN", "right scapula": "RBACK",
        "left acromion": "LACR1", "right acromion": "RACR1",
    },
    plates={
        "upper_arm_lateral": "UA1 UA2 UA3", "thigh_lateral": "TH1 TH2 TH3 TH4", "shank_lateral": "TB1 TB2 TB3 TB4",
    },
)  # fmt: skip

OPENCAP = MarkerTable(
    "OpenCap",
    sided={
        "acromion": "shoulder", "elbow_lateral": "lelbow", "elbow_medial": "melbow", "wrist_radial": "lwrist",
        "wrist_ulnar": "mwrist", "asis": "ASIS", "psis": "PSIS", "knee_lateral": "knee", "knee_medial": "mknee",
        "ankle_lateral": "ankle", "ankle_medial": "mankle", "foot_2nd_head": "toe", "foot_5th_head": "5meta",
        "heel": "calc",
    },
    whole={"c7": "C7"},
    loose={"sternoclavicular": "Sternum", "shank_front_high": "shank_antsup", "upper_arm_lateral": "humerus"},
    plates={"thigh_lateral": "thigh1 thigh2 thigh3 thigh4", "shank_lateral": "sh1 sh2 sh3 sh4"},
)  # fmt: skip

HUMAN_BODY_MODEL = MarkerTable(
    "Human Body Model",
    sided={
        "asis": "ASIS", "psis": "PSIS", "trochanter": "GTRO", "knee_lateral": "LEK", "knee_medial": "MEK",
        "ankle_lateral": "LM", "ankle_medial": "MM", "toe_tip": "TOE", "acromion": "SHO", "elbow_lateral": "LEE",
        "elbow_medial": "MEE", "wrist_radial": "LW", "wrist_ulnar": "MW", "deltoid": "DELT", "hand_3rd_knuckle": "FIN",
        "heel": "HEE", "foot_5th_head": "MT5", "head_side": "HEAD",
    },
    whole={
        "xiphoid": "XYPH XIPH", "c7": "C7", "head_top": "THEAD", "head_front": "FHEAD", "sacrum": "SACR", "t10": "T10",
        "navel": "NAVE", "jugular_notch": "STRN JN", "t8": "BBAC",
        "left thigh_front": "FLTHI", "right thigh_front": "FRTHI",
    },
    loose={"forearm_lateral": "FRM", "thigh_lateral": "THI LTHI", "shank_front": "ATI"},
)  # fmt: skip

TABLES = (GAIT_2392, RAJAGOPAL, OPENCAP, HUMAN_BODY_MODEL)
