"""Marker sets of gait laboratories: Helen Hayes, Cleveland Clinic, Istituto Ortopedico Rizzoli, CAST.

Sources: Kadaba et al. 1990; OrthoTrak's manual; Leardini et al. 2007, 2011; Cappozzo et al. 1995; van Sint Jan,
Color atlas of skeletal landmark definitions, 2007, whose abbreviations Qualisys and Visual3D use.
"""

from .marker_table import MarkerTable

HELEN_HAYES = MarkerTable(
    "Helen Hayes",
    sided={
        "acromion": "Shoulder Acromion", "elbow_lateral": "Elbow", "elbow_medial": "Elbow.Medial",
        "wrist_dorsal": "Wrist", "wrist_radial": "Wrist.Lat Wrist.Rad", "wrist_ulnar": "Wrist.Med Wrist.Uln",
        "asis": "ASIS", "psis": "PSIS", "knee_lateral": "Knee Knee.Lat", "knee_medial": "Knee.Medial Knee.Med",
        "ankle_lateral": "Ankle Ankle.Lat", "ankle_medial": "Ankle.Medial Ankle.Med", "heel": "Heel",
        "foot_2nd_head": "Toe TO", "trochanter": "Troch",
    },
    whole={
        "sacrum": "V.Sacral Sacral Sacrum VSAC", "head_top": "Top.Head THEA", "head_front": "Front.Head FHEA",
        "head_back": "Rear.Head Back.Head RHEA", "right scapula": "R.Scapula R.Offset ROFF",
        "left scapula": "L.Scapula L.Offset", "sternum": "Sternum",
    },
    loose={"upper_arm_lateral": "Bicep Biceps", "forearm_lateral": "Forearm"},
    wands={"thigh_lateral": "Thigh", "shank_lateral": "Shank"},
)  # fmt: skip

#: the same in four letters, to which old programs cut labels
HELEN_HAYES_SHORT = MarkerTable(
    "Helen Hayes, four letters",
    sided={
        "acromion": "SHO", "elbow_lateral": "ELB", "wrist_dorsal": "WRI", "asis": "ASI", "psis": "PSI", "knee_lateral": "KNE",
        "ankle_lateral": "ANK", "heel": "HEE", "foot_2nd_head": "TOE TO",
    },
    whole={
        "sacrum": "VSAC", "head_top": "THEA TOPH", "head_front": "FHEA FRON", "head_back": "RHEA REAR", "right scapula": "ROFF RSCA", "left scapula": "LSCA",
    },
    wands={"thigh_lateral": "THI", "shank_lateral": "SHA"},
)  # fmt: skip

CLEVELAND_CLINIC = MarkerTable(
    "Cleveland Clinic",
    sided={
        "acromion": "Shoulder", "elbow_lateral": "Elbow", "wrist_dorsal": "Wrist", "asis": "ASIS", "psis": "PSIS",
        "knee_lateral": "Knee.Lat KNL", "knee_medial": "Knee.Med Knee.Medial KNM", "ankle_lateral": "Ankle.Lat ANL",
        "ankle_medial": "Ankle.Med Ankle.Medial ANM", "heel": "Heel", "foot_2nd_head": "Toe",
    },
    whole={"sacrum": "V.Sacral Sacral", "right scapula": "R.Scapula", "head_top": "Top.Head"},
    plates={
        "thigh_lateral": "Thigh.Upper Thigh.Front Thigh.Rear Thigh.Lower Thigh.Top",
        "shank_lateral": "Shank.Upper Shank.Front Shank.Rear Shank.Lower Shank.Top",
    },
)  # fmt: skip

RIZZOLI = MarkerTable(
    "Rizzoli (IOR)",
    sided={
        "acromion": "A AC SH", "asis": "AS ASIS", "psis": "PS PSIS", "trochanter": "GT", "knee_lateral": "LE",
        "knee_medial": "ME", "fibula_head": "HF FH", "tibial_tuberosity": "TT", "ankle_lateral": "LM",
        "ankle_medial": "MM", "heel": "CA", "foot_5th_head": "VM", "foot_1st_head": "FM", "foot_2nd_head": "SM",
        "foot_1st_base": "FMB", "foot_2nd_base": "SMB", "foot_5th_base": "VMB", "navicular": "TN",
        "heel_medial": "ST", "heel_lateral": "PT", "patella": "PA", "big_toe": "PM",
    },
    whole={"c7": "C7", "t2": "T2", "t7": "MAI T7", "l1": "L1", "l3": "L3", "l5": "L5", "jugular_notch": "IJ", "xiphoid": "PX"},
)  # fmt: skip

#: van Sint Jan's abbreviations
SKELETAL_LANDMARKS = MarkerTable(
    "CAST and Rizzoli, skeletal landmarks",
    sided={
        "acromioclavicular": "CAJ SAJ", "acromion": "SAE ACR", "acromial_angle": "SAA", "scapula_inferior_angle": "SIA",
        "scapula_spine_root": "SRS", "coracoid": "SCT", "elbow_lateral": "HLE", "elbow_medial": "HME",
        "olecranon": "UOA", "wrist_radial": "RSP", "scapula": "SCAP", "wrist_ulnar": "USP UHE", "hand_2nd_knuckle": "HM2",
        "hand_3rd_knuckle": "HM3", "hand_5th_knuckle": "HM5", "asis": "IAS", "psis": "IPS", "iliac_crest": "ICT",
        "trochanter": "FTC", "knee_lateral": "FLE", "knee_medial": "FME", "fibula_head": "FAX", "patella": "PAS FPA PAX",
        "tibial_tuberosity": "TTC", "ankle_lateral": "FAL", "ankle_medial": "TAM", "heel": "FCC",
        "foot_1st_head": "FM1", "foot_2nd_head": "FM2", "foot_3rd_head": "FM3", "foot_5th_head": "FM5",
        "foot_1st_base": "FMT1 FB1", "foot_2nd_base": "FB2", "foot_5th_base": "FMT FB5", "navicular": "FNT",
        "heel_lateral": "FPT", "heel_medial": "FST", "head_side": "HEAD", "head_front_lateral": "HDF", "head_back_lateral": "HDB", "sternoclavicular": "CSJ",
        "tibia_condyle_medial": "TMC TMR", "big_toe": "FH1 PM6",
    },
    whole={
        "jugular_notch": "SJN SNJ SME", "xiphoid": "SXS", "c7": "CV7", "t1": "TV1", "t2": "TV2", "t7": "TV7 MAI",
        "t8": "TV8", "t10": "TV10", "t12": "TV12", "l1": "LV1", "l3": "LV3", "l4": "LV4", "l5": "LV5", "sacrum": "SACR MPS",
        "head_front": "SGL", "sternum": "STM", "t4": "TV4",
    },
    loose={"deltoid": "HUM", "upper_arm_lateral": "ARM"},
)  # fmt: skip

TABLES = (HELEN_HAYES, HELEN_HAYES_SHORT, CLEVELAND_CLINIC, RIZZOLI, SKELETAL_LANDMARKS)
