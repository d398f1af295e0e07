"""Marker sets of Vicon's users: Plug-in Gait, Conventional Gait Model 2, CMU, and 53 markers for film.

Sources: Vicon's Plug-in Gait reference guide; pyCGM2's settings; the placement guide of CMU's motion capture
database.
"""

from .marker_table import MarkerTable

_TRUNK = {"c7": "C7", "t10": "T10", "jugular_notch": "CLAV", "xiphoid": "STRN"}
_HEAD = {"head_front_lateral": "FHD", "head_back_lateral": "BHD"}
_ARM = {
    "acromioclavicular": "SHO", "elbow_lateral": "ELB", "wrist_radial": "WRA", "wrist_ulnar": "WRB",
    "hand_2nd_knuckle": "FIN",
}  # fmt: skip
_LEG = {
    "asis": "ASI",
    "psis": "PSI",
    "knee_lateral": "KNE",
    "ankle_lateral": "ANK",
    "heel": "HEE",
    "foot_2nd_head": "TOE",
}

PLUG_IN_GAIT = MarkerTable(
    "Plug-in Gait",
    sided={**_HEAD, **_ARM, **_LEG, "knee_medial": "KNM MKNE", "ankle_medial": "MED MANK"},
    whole={**_TRUNK, "sacrum": "SACR", "right scapula": "RBAK", "left scapula": "LBAK"},
    loose={
        "upper_arm_lateral": "UPA", "forearm_lateral": "FRA FRM", "thigh_lateral_low": "THI",
        "shank_lateral_low": "TIB",
    },
    # the knee alignment device
    wands={"knee_lateral": "KAX KD1 KD2"},
)  # fmt: skip

_CGM2_LOOSE = {
    "upper_arm_lateral": "UPA", "forearm_lateral": "FRM", "thigh_lateral_low": "THI", "shank_lateral_low": "TIB",
    "thigh_front": "THAP THIAP", "thigh_front_low": "THAD THIAD", "shank_front_high": "TIAP TIBAP",
    "shank_front_low": "TIAD TIBAD",
}  # fmt: skip

CONVENTIONAL_GAIT_2 = MarkerTable(
    "Conventional Gait Model 2.1 to 2.3",
    sided={**_HEAD, **_ARM, **_LEG, "knee_medial": "KNM", "ankle_medial": "MED"},
    whole={**_TRUNK, "sacrum": "SACR", "right scapula": "RBAK"},
    loose=_CGM2_LOOSE,
)

#: the toe's marker is on the base of the metatarsal here
CONVENTIONAL_GAIT_24 = MarkerTable(
    "Conventional Gait Model 2.4 and 2.5",
    sided={
        **_HEAD, **_ARM, **_LEG, "knee_medial": "KNM", "ankle_medial": "MED", "foot_1st_head": "FMH",
        "foot_2nd_head": "SMH", "foot_5th_head": "VMH", "foot_2nd_base": "TOE",
    },
    whole={**_TRUNK, "sacrum": "SACR", "right scapula": "RBAK"},
    loose=_CGM2_LOOSE,
)  # fmt: skip

CMU = MarkerTable(
    "CMU",
    sided={
        **_HEAD, **_ARM, "hand_dorsal": "FIN", "asis": "FWT", "psis": "BWT", "knee_lateral": "KNE",
        "ankle_lateral": "ANK", "heel": "HEE", "foot_5th_head": "MT5", "foot_1st_head": "MT1",
        "foot_2nd_head": "TOE", "thumb": "THM", "acromioclavicular": "SHO",
    },
    whole={**_TRUNK, "right scapula": "RBAC"},
    loose={
        "upper_arm_lateral": "UPA", "forearm_lateral": "FRM", "thigh_lateral": "THI", "shank_lateral": "SHN",
    },
)  # fmt: skip

VICON_53 = MarkerTable(
    "Vicon, 53 markers",
    sided={
        **_HEAD, "shoulder_front": "FSH", "shoulder_back": "BSH", "elbow_lateral": "ELB",
        "elbow_medial": "IEL", "wrist_radial": "IWR", "wrist_ulnar": "OWR", "hand_2nd_knuckle": "IHAND IHA",
        "hand_5th_knuckle": "OHAND OHA", "asis": "FWT", "psis": "BWT", "hip_lateral": "MWT",
        "knee_lateral": "KNE", "knee_medial": "KNI", "ankle_lateral": "ANK",
        "heel": "HEL HEE", "foot_1st_head": "MT1", "foot_5th_head": "MT5", "toe_tip": "TOE",
        "scapula": "BAC BAK", "thumb": "THMB THM", "acromioclavicular": "SHO",
    },
    whole={**_TRUNK, "head_top": "ARIEL", "sacrum": "MBWT", "navel": "MFWT"},
    loose={
        "upper_arm_lateral": "UPA", "forearm_lateral": "FRM FRA", "thigh_lateral": "THI HIP",
        "shank_lateral": "SHN TIB",
    },
)  # fmt: skip

TABLES = (PLUG_IN_GAIT, CONVENTIONAL_GAIT_2, CONVENTIONAL_GAIT_24, CMU, VICON_53)
