"""Rigs of other programs: the names of their joints, and how their joints differ."""

import numpy as np

from benchmarks.editing._rigs import (
    Z_UP,
    Rig,
    on_both_sides,
    remove_joints,
    reparent,
    with_half_twist,
    with_joint,
    with_leaf,
    with_root,
    with_twist,
)

LEFT_RIGHT, LONG = ("L", "R"), ("Left", "Right")
A_POSE = {"humerus": 45.0, "radius": 50.0, "wrist": 50.0}


def _table(sided: str, trunk: str) -> dict[str, str]:
    """Map ASF names to the names of a rig, given in the same order; `-` is no joint."""
    bones = ["clavicle", "humerus", "radius", "wrist", "femur", "tibia", "foot", "toes", "hand"]
    middle = ["root", "lowerback", "upperback", "thorax", "lowerneck", "upperneck", "head"]
    pairs = [*zip(bones, sided.split(), strict=True), *zip(middle, trunk.split(), strict=True)]
    return {own: name.replace("~", " ") for own, name in pairs if name != "-"}


#: those that the matching was made with
TUNED = (
    Rig(
        "mixamo",
        _table(
            "mixamorig:{s}Shoulder mixamorig:{s}Arm mixamorig:{s}ForeArm mixamorig:{s}Hand mixamorig:{s}UpLeg mixamorig:{s}Leg "
            "mixamorig:{s}Foot mixamorig:{s}ToeBase mixamorig:{s}HandMiddle1",
            "mixamorig:Hips mixamorig:Spine mixamorig:Spine1 mixamorig:Spine2 mixamorig:Neck - mixamorig:Head",
        ),
        LONG,
        (),
        size=0.9,
    ),
    Rig(
        "unreal",
        {
            **_table(
                "clavicle_{s} upperarm_{s} lowerarm_{s} hand_{s} thigh_{s} calf_{s} foot_{s} ball_{s} middle_01_{s}",
                "pelvis spine_01 spine_02 spine_03 neck_01 - head",
            ),
            "ground": "root",
            "humerus_leaf": "upperarm_twist_01_{s}",
            "radius_leaf": "lowerarm_twist_01_{s}",
        },
        ("l", "r"),
        (
            with_root("ground"),
            *on_both_sides(with_leaf, "{s}humerus_leaf", "{s}humerus", "{s}radius"),
            *on_both_sides(with_leaf, "{s}radius_leaf", "{s}radius", "{s}wrist"),
        ),
        has_joint_frames=True,
        axes=Z_UP,
    ),
    Rig(
        "bandai",
        {
            **_table(
                "Shoulder_{s} UpperArm_{s} LowerArm_{s} Hand_{s} UpperLeg_{s} LowerLeg_{s} Foot_{s} Toes_{s} -",
                "Hips - Spine Chest Neck - Head",
            ),
            "ground": "joint_Root",
        },
        LEFT_RIGHT,
        (with_root("ground"),),
        has_joint_frames=True,
        size=0.93,
    ),
    Rig(
        "vrm",
        _table(
            "J_Bip_{s}_Shoulder J_Bip_{s}_UpperArm J_Bip_{s}_LowerArm J_Bip_{s}_Hand J_Bip_{s}_UpperLeg J_Bip_{s}_LowerLeg J_Bip_{s}_Foot "
            "J_Bip_{s}_ToeBase J_Bip_{s}_Middle1",
            "J_Bip_C_Hips J_Bip_C_Spine J_Bip_C_Chest J_Bip_C_UpperChest J_Bip_C_Neck - J_Bip_C_Head",
        ),
        LEFT_RIGHT,
        (),
        bone_angles=A_POSE,
        size=0.8,
        unit="m",
    ),
    Rig(
        "rigify",
        {
            **_table(
                "DEF-shoulder.{s} DEF-upper_arm.{s} DEF-forearm.{s} DEF-hand.{s} DEF-thigh.{s} DEF-shin.{s} DEF-foot.{s} DEF-toe.{s} DEF-f_middle.01.{s}",
                "DEF-spine DEF-spine.001 DEF-spine.002 DEF-spine.003 DEF-spine.004 DEF-spine.005 DEF-spine.006",
            ),
            "humerus_twist": "DEF-upper_arm.{s}.001",
            "radius_twist": "DEF-forearm.{s}.001",
            "femur_twist": "DEF-thigh.{s}.001",
        },
        LEFT_RIGHT,
        (
            *on_both_sides(with_twist, "{s}humerus_twist", "{s}humerus", "{s}radius"),
            *on_both_sides(with_half_twist, "{s}radius_twist", "{s}radius", "{s}wrist"),
            *on_both_sides(with_twist, "{s}femur_twist", "{s}femur", "{s}tibia"),
        ),
        bone_angles={"humerus": 30.0, "radius": 30.0, "wrist": 30.0},
        axes=np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
        unit="m",
    ),
    Rig(
        "unity",
        {
            **_table(
                "{s}Shoulder {s}UpperArm {s}LowerArm {s}Hand {s}UpperLeg {s}LowerLeg {s}Foot {s}Toes {s}MiddleProximal",
                "Hips Spine Chest UpperChest Neck - Head",
            ),
            "Extra": "Extra",
        },
        LONG,
        (with_joint("Extra", "lowerback", "upperback"),),
        bone_angles=A_POSE,
        size=1.2,
    ),
    Rig(
        "kinect",
        _table(
            "- Shoulder{s} Elbow{s} Wrist{s} Hip{s} Knee{s} Ankle{s} Foot{s} Hand{s}",
            "SpineBase - SpineMid SpineShoulder Neck - Head",
        ),
        LONG,
        (),
        has_joint_frames=True,
        unit="m",
    ),
    Rig(
        "smpl",
        _table(
            "{s}_Collar {s}_Shoulder {s}_Elbow {s}_Wrist {s}_Hip {s}_Knee {s}_Ankle {s}_Foot {s}_Hand",
            "Pelvis Spine1 Spine2 Spine3 Neck - Head",
        ),
        LEFT_RIGHT,
        (),
        size=1.05,
        unit="m",
    ),
)
#: those that were added when the others were right
HELD_OUT = (
    Rig(
        "motive",
        _table(
            "Actor_1:{s}Shoulder Actor_1:{s}UArm Actor_1:{s}FArm Actor_1:{s}Hand Actor_1:{s}Thigh Actor_1:{s}Shin Actor_1:{s}Foot Actor_1:{s}Toe -",
            "Actor_1:Hip Actor_1:Ab - Actor_1:Chest Actor_1:Neck - Actor_1:Head",
        ),
        LEFT_RIGHT,
        (),
        unit="mm",
    ),
    Rig(
        "xsens",
        {
            **_table(
                "{s}~Shoulder {s}~Upper~Arm {s}~Forearm {s}~Hand {s}~Upper~Leg {s}~Lower~Leg {s}~Foot {s}~Toe -",
                "Pelvis L5 L3 T8 Neck - Head",
            ),
            "t12": "T12",
        },
        LONG,
        (with_joint("t12", "upperback", "thorax"),),
        bone_angles={"humerus": 80.0, "radius": 80.0, "wrist": 80.0},
        axes=Z_UP,
    ),
    Rig(
        "vicon",
        _table(
            "{s}Collar {s}Humerus {s}Radius {s}Hand {s}Femur {s}Tibia {s}Foot {s}Toes {s}Fingers",
            "Pelvis LowerBack - Thorax Neck - Head",
        ),
        LEFT_RIGHT,
        (),
        unit="mm",
        size=1.1,
    ),
    Rig(
        "biovision",
        _table(
            "{s}Collar {s}Shoulder {s}Elbow {s}Wrist {s}Hip {s}Knee {s}Ankle {s}Toe -",
            "Hips Chest Chest2 Chest3 Neck - Head",
        ),
        LONG,
        (),
        bone_angles={"humerus": 88.0, "radius": 88.0, "wrist": 88.0},
    ),
    Rig(
        "biped",
        {
            **_table(
                "Bip01~{s}~Clavicle Bip01~{s}~UpperArm Bip01~{s}~Forearm Bip01~{s}~Hand Bip01~{s}~Thigh Bip01~{s}~Calf Bip01~{s}~Foot Bip01~{s}~Toe0 Bip01~{s}~Finger2",
                "Bip01~Pelvis Bip01~Spine Bip01~Spine1 Bip01~Spine2 Bip01~Neck - Bip01~Head",
            ),
            "ground": "Bip01",
        },
        LEFT_RIGHT,
        (
            with_root("ground"),
            *on_both_sides(reparent, "{s}clavicle", "lowerneck"),
        ),
        has_joint_frames=True,
        axes=Z_UP,
    ),
    Rig(
        "source",
        _table(
            "ValveBiped.Bip01_{s}_Clavicle ValveBiped.Bip01_{s}_UpperArm ValveBiped.Bip01_{s}_Forearm ValveBiped.Bip01_{s}_Hand "
            "ValveBiped.Bip01_{s}_Thigh ValveBiped.Bip01_{s}_Calf ValveBiped.Bip01_{s}_Foot ValveBiped.Bip01_{s}_Toe0 ValveBiped.Bip01_{s}_Finger2",
            "ValveBiped.Bip01_Pelvis ValveBiped.Bip01_Spine ValveBiped.Bip01_Spine1 ValveBiped.Bip01_Spine2 ValveBiped.Bip01_Neck1 - "
            "ValveBiped.Bip01_Head1",
        ),
        LEFT_RIGHT,
        (),
        has_joint_frames=True,
        unit="in",
    ),
    Rig(
        "daz",
        {
            **_table(
                "{s}Collar {s}ShldrBend {s}ForearmBend {s}Hand {s}ThighBend {s}Shin {s}Foot {s}Toe {s}Mid1",
                "hip abdomenLower abdomenUpper chestLower neckLower neckUpper head",
            ),
            "humerus_twist": "{s}ShldrTwist",
            "radius_twist": "{s}ForearmTwist",
            "femur_twist": "{s}ThighTwist",
        },
        ("l", "r"),
        (
            *on_both_sides(with_twist, "{s}humerus_twist", "{s}humerus", "{s}radius"),
            *on_both_sides(with_half_twist, "{s}radius_twist", "{s}radius", "{s}wrist"),
            *on_both_sides(with_twist, "{s}femur_twist", "{s}femur", "{s}tibia"),
        ),
        bone_angles=A_POSE,
    ),
    Rig(
        "makehuman",
        {
            **_table(
                "clavicle.{s} upperarm01.{s} lowerarm01.{s} wrist.{s} upperleg01.{s} lowerleg01.{s} foot.{s} toe1-1.{s} finger3-1.{s}",
                "root spine05 spine03 spine01 neck01 neck02 head",
            ),
            "humerus_twist": "upperarm02.{s}",
            "radius_twist": "lowerarm02.{s}",
            "femur_twist": "upperleg02.{s}",
        },
        LEFT_RIGHT,
        (
            *on_both_sides(with_twist, "{s}humerus_twist", "{s}humerus", "{s}radius"),
            *on_both_sides(with_half_twist, "{s}radius_twist", "{s}radius", "{s}wrist"),
            *on_both_sides(with_twist, "{s}femur_twist", "{s}femur", "{s}tibia"),
        ),
        bone_angles=A_POSE,
        unit="dm",
    ),
    Rig(
        "french",
        _table(
            "Clavicule_{s} Bras_{s} AvantBras_{s} Main_{s} Cuisse_{s} Tibia_{s} Pied_{s} Orteils_{s} Doigts_{s}",
            "Bassin Lombaires Dos Thorax Cou - Tete",
        ),
        ("G", "D"),
        (),
        bone_angles=A_POSE,
    ),
    Rig(
        "nameless",
        {
            **_table("a{s} b{s} c{s} d{s} e{s} f{s} g{s} h{s} q{s}", "i j k m n o p"),
        },
        ("13", "42"),
        (),
        bone_angles=A_POSE,
        size=1.3,
    ),
    Rig(
        "one_arm",
        _table(
            "{s}Shoulder {s}Arm {s}ForeArm {s}Hand {s}UpLeg {s}Leg {s}Foot {s}ToeBase -",
            "Hips LowerBack Spine Spine1 Neck Neck1 Head",
        ),
        LONG,
        (remove_joints("lclavicle", "lhumerus", "lradius", "lwrist"),),
    ),
    Rig(
        "no_arms",
        _table(
            "{s}Shoulder {s}Arm {s}ForeArm {s}Hand {s}UpLeg {s}Leg {s}Foot {s}ToeBase -",
            "Hips LowerBack Spine Spine1 Neck Neck1 Head",
        ),
        LONG,
        (
            remove_joints(
                *(side + bone for side in "lr" for bone in ("clavicle", "humerus", "radius", "wrist"))
            ),
        ),
    ),
)
#: of these rigs limbs are missing: they have to be refused, or warned of
LACKING = {"one_arm": "warned", "no_arms": "refused"}
