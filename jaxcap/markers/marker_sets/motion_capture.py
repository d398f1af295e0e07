"""Marker sets of OptiTrack Motive, Qualisys and Xsens.

Sources: docs.optitrack.com, pages on marker sets; Qualisys' Sports and Animation marker sets; Xsens MVN's
anatomical landmarks.
"""

from .marker_table import MarkerTable

MOTIVE = MarkerTable(
    "OptiTrack Motive",
    sided={
        "head_side": "HeadSide Head?", "acromioclavicular": "ShoulderTop", "shoulder_back": "ShoulderBack",
        "upper_arm_back": "UArmHigh", "elbow_lateral": "ElbowOut", "elbow_medial": "ElbowIn",
        "wrist_radial": "WristOut", "wrist_ulnar": "WristIn", "wrist_dorsal": "WristTop", "hand_2nd_knuckle": "HandIn",
        "hand_5th_knuckle": "HandOut", "thumb": "Thumb Thumb1", "index_finger_tip": "Index", "little_finger_tip": "Pinky",
        "asis": "Waist?Front IAS", "waist_back_lateral": "Waist?Back", "hip_lateral": "Waist?", "psis": "IPS",
        "thigh_front": "Thigh ThighFront", "knee_lateral": "KneeOut", "knee_medial": "KneeIn",
        "shank_front": "Shin ShinFront", "ankle_lateral": "AnkleOut", "ankle_medial": "AnkleIn",
        "foot_5th_head": "ToeOut", "foot_1st_head": "ToeIn", "toe_tip": "ToeTip", "heel": "Heel HeelBack",
        "back_lateral": "Back?", "trochanter": "FTC", "heel_lateral": "HeelOut", "heel_medial": "HeelIn",
    },
    whole={
        "head_top": "HeadTop", "head_front": "HeadFront", "t1": "BackTop", "sternum": "Chest", "left head_side": "HeadSide",
        "sacrum": "WaistCBack WaistC", "xiphoid": "ChestLow",
    },
    loose={
        "forearm_lateral": "FArm", "thigh_lateral": "ThighSide", "shank_lateral": "ShinSide",
        "upper_arm_lateral": "UArm UArmLow Arm",
    },
)  # fmt: skip

QUALISYS = MarkerTable(
    "Qualisys Sports and Animation",
    sided={
        "head_side": "Head?", "acromioclavicular": "ShoulderTop", "shoulder_back": "ShoulderBack",
        "elbow_lateral": "ElbowOut", "elbow_medial": "ElbowIn", "wrist_radial": "WristIn", "wrist_ulnar": "WristOut",
        "hand_dorsal": "Hand2", "hand_2nd_knuckle": "HandIn", "hand_5th_knuckle": "HandOut", "asis": "Waist?Front",
        "psis": "Waist?Back Sips", "iliac_crest": "Waist?", "knee_lateral": "KneeOut", "knee_medial": "KneeIn",
        "tibial_tuberosity": "ShinFrontHigh", "ankle_lateral": "AnkleOut", "ankle_medial": "AnkleIn",
        "heel": "HeelBack", "foot_1st_head": "Forefoot1 ForefootIn", "foot_2nd_head": "Forefoot2",
        "foot_5th_head": "Forefoot5 ForefootOut", "toe_tip": "ToeTip", "back_lateral": "Back?",
    },
    whole={
        "head_front": "HeadFront", "head_top": "HeadTop", "sternum": "Chest", "xiphoid": "ChestLow",
        "t2": "SpineThoracic2 SpineTop", "t12": "SpineThoracic12", "sacrum": "WaistBack",
    },
    loose={
        "upper_arm_lateral": "Arm", "thigh_front_low": "ThighFrontLow ThighLow", "thigh_front_high": "ThighFrontHigh ThighHigh",
        "thigh_medial": "ThighMedial", "thigh_lateral": "Thigh ThighSide", "shank_front": "Shin ShinFront",
        "shank_front_low": "ShinFrontLow", "shank_lateral": "ShinSide", "forearm_lateral": "Forearm",
    },
)  # fmt: skip

XSENS = MarkerTable(
    "Xsens landmarks",
    sided={
        "asis": "p?ASI", "iliac_crest": "p?CSI", "ear": "p?Auricularis", "acromion": "p?Acromion",
        "elbow_lateral": "p?ArmLatEpicondyle", "elbow_medial": "p?ArmMedEpicondyle", "wrist_ulnar": "p?UlnarStyloid",
        "wrist_radial": "p?RadialStyloid", "olecranon": "p?Olecranon", "hand_3rd_knuckle": "p?TopOfHand",
        "hand_5th_knuckle": "p?Pinky", "trochanter": "p?GreaterTrochanter",
        "knee_lateral": "p?KneeLatEpicondyle", "knee_medial": "p?KneeMedEpicondyle",
        "patella": "p?Patella p?KneePatella p?MiddleKneeCap",
        "ankle_lateral": "p?LatMalleolus",
        "heel": "p?HeelFoot", "foot_1st_head": "p?FirstMetatarsal", "foot_5th_head": "p?FifthMetatarsal",
        "toe_tip": "p?Toe",
    },
    whole={
        "sacrum": "pSacrum", "l5": "pL5SpinalProcess", "l3": "pL3SpinalProcess", "t12": "pT12SpinalProcess",
        "jugular_notch": "pIJ", "t4": "pT4SpinalProcess", "t8": "pT8SpinalProcess",
        "c7": "pC7SpinalProcess", "head_top": "pTopOfHead", "occiput": "pBackOfHead", "nose": "pNose",
    },
    # where Xsens' model has them, which is 5 to 8 cm from where they are palpated
    loose={"ankle_medial": "p?MedMalleolus", "tibial_tuberosity": "p?TibialTub", "xiphoid": "pPX"},
)  # fmt: skip

TABLES = (MOTIVE, QUALISYS, XSENS)
