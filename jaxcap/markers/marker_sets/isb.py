"""The abbreviations of the International Society of Biomechanics, and sets that extend them.

Sources: Wu et al. 2002 and 2005; BioBuddy's and pyomeca's samples.
"""

from .marker_table import MarkerTable

ISB = MarkerTable(
    "ISB",
    sided={
        "temple": "TEMP", "acromion": "A AC", "elbow_lateral": "LHE EL", "elbow_medial": "MHE EM", "wrist_radial": "RS",
        "wrist_ulnar": "US", "hand_5th_knuckle": "HMH5", "hand_2nd_knuckle": "HMH2", "middle_finger_tip": "FT3",
        "asis": "ASIS", "psis": "PSIS", "trochanter": "GT", "knee_lateral": "LFE FLE", "knee_medial": "MFE FME",
        "ankle_lateral": "LM", "ankle_medial": "SPH MM", "heel": "CAL", "foot_5th_head": "MFH5",
        "foot_1st_head": "MFH1", "toe_tip": "TT2", "tibial_tuberosity": "ATT TT", "fibula_head": "HF",
        "acromioclavicular": "ACJ", "sternoclavicular": "SCJ", "scapula_inferior_angle": "AI IA",
        "scapula_spine_root": "TS", "acromial_angle": "AA", "coracoid": "PC",
    },
    whole={
        "head_top": "HV", "nose_bridge": "SEL", "occiput": "OCC", "c7": "C7", "t10": "T10", "t8": "T8",
        "jugular_notch": "SUP IJ", "xiphoid": "STR PX",
    },
    plates={
        "upper_arm_lateral": "ARM1 ARM2 ARM3 AMR1", "forearm_lateral": "FARM1 FARM2 FARM3",
        "thigh_lateral": "THI1 THI2 THI3", "shank_lateral": "LEG1 LEG2 LEG3",
    },
)  # fmt: skip

#: Université de Montréal's set for the right arm
UPPER_LIMB = MarkerTable(
    "S2M upper limb",
    sided={"asis": "ASIS", "psis": "PSIS", "sternoclavicular": "STER"},
    whole={
        "jugular_notch": "STER", "xiphoid": "XIPH", "t1": "T1", "t10": "T10", "right sternoclavicular": "CLAV_SC",
        "right clavicle": "CLAVm CLAV_ant CLAV_post", "right acromioclavicular": "CLAVl CLAV_AC",
        "right acromion": "ACRO_tip", "right acromial_angle": "SCAP_AA", "right coracoid": "SCAP_CP",
        "right scapula_spine_root": "SCAP_RS SCAP_SA", "right scapula_inferior_angle": "SCAP_IA", "right scapula": "SCAPm SCAPl",
        "right deltoid": "DELT", "right upper_arm_lateral": "ARMl", "right upper_arm_front": "ARMm",
        "right upper_arm_back": "ARMp_up ARMp_do", "right elbow_lateral": "EPICl", "right elbow_medial": "EPICm",
        "right forearm_lateral": "LARM_ant LARMl LARMm", "right olecranon": "LARM_elb",
        "right wrist_radial": "STYLr STYLr_up", "right wrist_ulnar": "STYLu", "right wrist_dorsal": "WRIST",
        "right hand_2nd_knuckle": "INDEX", "right hand_5th_knuckle": "LASTC", "right hand_dorsal": "MEDH LATH",
    },
)  # fmt: skip

TABLES = (ISB, UPPER_LIMB)
