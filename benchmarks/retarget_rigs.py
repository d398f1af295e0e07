"""CMU takes on rigs of other programs, carried to the embedded human, against the takes themselves carried to it.

    python -m benchmarks.retarget_rigs
    python -m benchmarks.retarget_rigs --takes 02_05 --frames 40 --rigs unreal nameless

Each rig has the names of one program, and what its files bring with them: joints more or fewer, twist joints, another rest pose, joint frames of its own, another
size, unit and vertical. The take is written on it as BVH, read again, and retargeted by names and tree alone. Rotations of shoulders, elbows, wrists,
hips, knees and ankles are compared with the direct retarget of the same take in every frame. A rig is right where all limbs match and the worst is within
two degrees; wrists and ankles whose rest pose the rig's file does not show are reported separately (`ends`); it is refused where `UnmatchedJoints` says so; anything else is wrong. Rigs of `HELD_OUT` were added when those before them were right.
Run it from the root of the checkout.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import jaxcap as jc
from benchmarks._rigs import (
    Z_UP,
    Rig,
    acting,
    both,
    hung_on,
    make_rig,
    with_half,
    with_joint,
    with_leaf,
    with_root,
    with_twist,
    without,
)
from benchmarks._scenes import CAPTURED, RATE, cmu_motion, shared_folder
from benchmarks.report import finish, progress
from jaxcap.edit.matching.reference import posed
from jaxcap.io.registry import read_motion

TAKES = ("02_01", "02_05", "01_01")
LEFT_RIGHT, LONG = ("L", "R"), ("Left", "Right")
A_POSE = {"humerus": 45.0, "radius": 50.0, "wrist": 50.0}
LIMBS = tuple(
    f"{side}{bone}"
    for side in ("Left", "Right")
    for bone in ("Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot")
)


def _table(sided: str, trunk: str) -> dict[str, str]:
    """Names in the order of the ASF's, `-` for one that the rig does not have."""
    bones = ["clavicle", "humerus", "radius", "wrist", "femur", "tibia", "foot", "toes", "hand"]
    middle = ["root", "lowerback", "upperback", "thorax", "lowerneck", "upperneck", "head"]
    pairs = [*zip(bones, sided.split(), strict=True), *zip(middle, trunk.split(), strict=True)]
    return {own: name.replace("~", " ") for own, name in pairs if name != "-"}


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
            *both(with_leaf, "{s}humerus_leaf", "{s}humerus", "{s}radius"),
            *both(with_leaf, "{s}radius_leaf", "{s}radius", "{s}wrist"),
        ),
        framed=True,
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
        framed=True,
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
        hangs=A_POSE,
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
            *both(with_twist, "{s}humerus_twist", "{s}humerus", "{s}radius"),
            *both(with_half, "{s}radius_twist", "{s}radius", "{s}wrist"),
            *both(with_twist, "{s}femur_twist", "{s}femur", "{s}tibia"),
        ),
        hangs={"humerus": 30.0, "radius": 30.0, "wrist": 30.0},
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
        hangs=A_POSE,
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
        framed=True,
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
        hangs={"humerus": 80.0, "radius": 80.0, "wrist": 80.0},
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
        hangs={"humerus": 88.0, "radius": 88.0, "wrist": 88.0},
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
            *both(hung_on, "{s}clavicle", "lowerneck"),
        ),
        framed=True,
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
        framed=True,
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
            *both(with_twist, "{s}humerus_twist", "{s}humerus", "{s}radius"),
            *both(with_half, "{s}radius_twist", "{s}radius", "{s}wrist"),
            *both(with_twist, "{s}femur_twist", "{s}femur", "{s}tibia"),
        ),
        hangs=A_POSE,
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
            *both(with_twist, "{s}humerus_twist", "{s}humerus", "{s}radius"),
            *both(with_half, "{s}radius_twist", "{s}radius", "{s}wrist"),
            *both(with_twist, "{s}femur_twist", "{s}femur", "{s}tibia"),
        ),
        hangs=A_POSE,
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
        hangs=A_POSE,
    ),
    Rig(
        "nameless",
        {
            **_table("a{s} b{s} c{s} d{s} e{s} f{s} g{s} h{s} q{s}", "i j k m n o p"),
        },
        ("13", "42"),
        (),
        hangs=A_POSE,
        size=1.3,
    ),
    Rig(
        "one_arm",
        _table(
            "{s}Shoulder {s}Arm {s}ForeArm {s}Hand {s}UpLeg {s}Leg {s}Foot {s}ToeBase -",
            "Hips LowerBack Spine Spine1 Neck Neck1 Head",
        ),
        LONG,
        (without("lclavicle", "lhumerus", "lradius", "lwrist"),),
    ),
    Rig(
        "no_arms",
        _table(
            "{s}Shoulder {s}Arm {s}ForeArm {s}Hand {s}UpLeg {s}Leg {s}Foot {s}ToeBase -",
            "Hips LowerBack Spine Spine1 Neck Neck1 Head",
        ),
        LONG,
        (without(*(side + bone for side in "lr" for bone in ("clavicle", "humerus", "radius", "wrist"))),),
    ),
)
#: of these rigs limbs are missing: they have to be refused, or warned of
LACKING = {"one_arm": "warned", "no_arms": "refused"}


def bone_rotations(skeleton: jc.Skeleton, motion: jc.Motion) -> dict[str, Rotation]:
    """Rotations of limbs: of upper arms and thighs in the world, of the others against the bone above."""
    _, turns = posed(skeleton, motion.poses)
    whole = {name: Rotation.from_quat(turns[:, skeleton.index(name)][:, [1, 2, 3, 0]]) for name in LIMBS}
    above = {"ForeArm": "Arm", "Hand": "ForeArm", "Leg": "UpLeg", "Foot": "Leg"}
    found = {}
    for name in LIMBS:
        side = "Left" if name.startswith("Left") else "Right"
        bone = name.removeprefix(side)
        found[name] = whole[side + above[bone]].inv() * whole[name] if bone in above else whole[name]
    return found


def silent(matches: jc.edit.JointMatches, motion: jc.Motion) -> list[str]:
    """Joints of the source that turn, and whose fate the report does not say."""
    said = " ".join(matches.lines())
    rotations = np.asarray(motion.poses.rotations, float)
    turning = np.abs(rotations - rotations[:1]).max(axis=(0, 2)) > 0.01
    told = {matches.source.names[joint] for joint in matches.pairs.values()} | set(matches.unmatched_source)
    known = {name for name in matches.unmatched_source if name not in said}
    return [
        name for row, name in enumerate(matches.source.names) if turning[row] and name not in told
    ] + sorted(known)


def measure(
    rig: Rig, take: str, acted, direct: jc.Motion, ratio: float, human: jc.Body, folder: Path
) -> dict[str, object]:
    """One rig: right, refused or wrong, and by how much."""
    skeleton, motion = make_rig(acted, rig)
    path = folder / f"{take}_{rig.name}.bvh"
    jc.write_bvh(path, skeleton, motion, unit=rig.unit)
    skeleton, motion = read_motion(path, rig.unit)
    try:
        plan = jc.edit.plan_retarget(skeleton, human.skeleton, None, motion)
    except jc.edit.UnmatchedJoints as error:
        return {"outcome": "refused", "said": str(error)}
    moved = jc.retarget(motion, skeleton, human.skeleton, plan=plan)
    wanted, found = bone_rotations(human.skeleton, direct), bone_rotations(human.skeleton, moved)
    axes = Rotation.from_matrix(rig.axes)
    worst = {}
    for name in LIMBS:
        here = found[name]
        if name.endswith(("UpLeg", "Arm")) and not name.endswith("ForeArm"):
            here = axes.inv() * here
        worst[name] = float(np.degrees((wanted[name].inv() * here).magnitude()).max())
    # rest poses of files with joint frames of their own show no hand and no foot at rest, nor do hands that end at the wrist
    hidden = {"Hand", "Foot"} if rig.framed else set() if "hand" in rig.names else {"Hand"}
    shown = [name for name in LIMBS if name.removeprefix("Left").removeprefix("Right") not in hidden]
    joints = [human.skeleton.index(name) for name in ("LeftFoot", "RightFoot", "LeftToeBase", "RightToeBase")]
    heights = [
        posed(human.skeleton, poses)[0][:, joints] @ up
        for poses, up in ((direct.poses, np.array([0, 1.0, 0])), (moved.poses, plan.up))
    ]
    return {
        "outcome": "matched",
        "degrees": max(worst[name] for name in shown),
        "joint": max(shown, key=lambda name: worst[name]),
        "ends_degrees": max((worst[name] for name in LIMBS if name not in shown), default=0.0),
        "ratio_percent": 100 * abs(plan.ratio * rig.size / ratio - 1),
        "feet_mm": 1000
        * float(np.abs((heights[1] - heights[1].min()) - (heights[0] - heights[0].min())).max()),
        "silent": silent(plan.matches, motion),
        "warnings": list(plan.matches.warnings),
        "limbs": {name: round(value, 2) for name, value in worst.items()},
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.retarget_rigs", description=str(__doc__).splitlines()[0]
    )
    rigs = {rig.name: rig for rig in (*TUNED, *HELD_OUT)}
    parser.add_argument("--takes", nargs="+", default=TAKES)
    parser.add_argument("--frames", type=int, help="only so many frames of each take")
    parser.add_argument("--rigs", nargs="+", choices=rigs, default=list(rigs))
    options = parser.parse_args()
    shared, human = shared_folder(), jc.human(resolution="low")
    start, rows = time.perf_counter(), {}
    for take in options.takes:
        motion, skeleton = cmu_motion(shared, take)
        motion = motion.slice(slice(None, None, round(CAPTURED / RATE))).slice(slice(options.frames))
        plan = jc.edit.plan_retarget(skeleton, human.skeleton, None, motion)
        direct = jc.retarget(motion, skeleton, human.skeleton, plan=plan)
        acted = acting(skeleton, motion)
        with tempfile.TemporaryDirectory() as folder:
            for name in options.rigs:
                row = rows[take, name] = measure(
                    rigs[name], take, acted, direct, plan.ratio, human, Path(folder)
                )
                progress(f"{take} {name}: " + ", ".join(f"{key} {value}" for key, value in row.items()))
    right, refused, wrong = [], [], []
    for (take, name), row in rows.items():
        lacks = LACKING.get(name)
        if row["outcome"] == "refused":
            # a rig that is whole may be refused, and has to be told from one that is matched
            refused.append(f"{take} {name}")
            continue
        good = float(str(row["degrees"])) <= 2.0 and not lacks
        (right if good or (lacks == "warned" and row["warnings"]) else wrong).append(f"{take} {name}")
    matched = [row for (_, name), row in rows.items() if row["outcome"] == "matched" and name not in LACKING]
    held = {rig.name for rig in HELD_OUT} - set(LACKING)
    figures = {
        "right": len(right),
        "refused": len(refused),
        "refused_rigs": sorted({name.split()[1] for name in refused}),
        "wrong": len(wrong),
        "wrong_rigs": wrong,
        "worst_degrees": max((row["degrees"] for row in matched), default=0.0),
        "worst_ends_degrees": max((row["ends_degrees"] for row in matched), default=0.0),
        "worst_ratio_percent": max((row["ratio_percent"] for row in matched), default=0.0),
        "worst_feet_mm": max((row["feet_mm"] for row in matched), default=0.0),
        "silent": sum(len(row["silent"]) for row in matched),  # pyright: ignore[reportArgumentType]
        "schemes_right": len({name.split()[1] for name in right} - set(LACKING)),
        "held_out_right": len({name.split()[1] for name in right} & held),
        "degrees": {f"{take} {name}": row.get("degrees", "refused") for (take, name), row in rows.items()},
    }
    limits = {
        "wrong": ("==", 0),
        "silent": ("==", 0),
        "worst_degrees": ("<=", 2.0),
        "worst_ratio_percent": ("<=", 0.5),
        "schemes_right": (">=", min(6, len(set(options.rigs) - set(LACKING)))),
    }
    sizes = {"takes": list(options.takes), "rigs": len(options.rigs), "frames": options.frames or "all"}
    finish("retarget_rigs", figures, limits, sizes, {"run": time.perf_counter() - start})


if __name__ == "__main__":
    main()
