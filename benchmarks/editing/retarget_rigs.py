"""Retarget CMU takes on rigs of other programs to the embedded human, and compare with direct retargeting.

    python -m benchmarks.retarget_rigs
    python -m benchmarks.retarget_rigs --takes 02_05 --frames 40 --rigs unreal nameless

Each rig has the names of one program, and what its files bring with them: joints more or fewer, twist joints, another rest pose, joint frames of its own, another
size, unit and vertical. The take is written on it as BVH, read again, and retargeted by names and tree alone. Rotations of shoulders, elbows, wrists,
hips, knees and ankles are compared with the direct retarget of the same take in every frame. A rig is right where all limbs match and the worst is within
two degrees; wrists and ankles whose rest pose the rig's file does not show are reported separately (`ends`); it is refused where
`UnmatchedJoints` says so; anything else is wrong. Rigs of `HELD_OUT` were added when those before them were right. The limbs of every rig are
found once more without names, by the tree alone.
Run it from the root of the checkout.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import jaxcap as jc
from benchmarks._scenes import CAPTURE_RATE, RATE, cmu_motion, shared_folder
from benchmarks.editing._foreign_rigs import HELD_OUT, LACKING, TUNED
from benchmarks.editing._rigs import Rig, make_rig, world_motion
from benchmarks.report import finish, progress
from jaxcap.body.matching.limbs import find_limbs
from jaxcap.body.matching.names import parse_joint_name
from jaxcap.body.matching.upright_pose import joint_transforms
from jaxcap.io.registry import read_motion

TAKES = ("02_01", "02_05", "01_01")
LIMBS = tuple(
    f"{side}{bone}"
    for side in ("Left", "Right")
    for bone in ("Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot")
)


def bone_rotations(skeleton: jc.Skeleton, motion: jc.Motion) -> dict[str, Rotation]:
    """Compute rotations of limbs: of upper arms and thighs in the world, of the others relative to the parent bone."""
    _, turns = joint_transforms(skeleton, motion.poses)
    whole = {name: Rotation.from_quat(turns[:, skeleton.index(name)][:, [1, 2, 3, 0]]) for name in LIMBS}
    above = {"ForeArm": "Arm", "Hand": "ForeArm", "Leg": "UpLeg", "Foot": "Leg"}
    found = {}
    for name in LIMBS:
        side = "Left" if name.startswith("Left") else "Right"
        bone = name.removeprefix(side)
        found[name] = whole[side + above[bone]].inv() * whole[name] if bone in above else whole[name]
    return found


def unreported_joints(matches: jc.edit.JointMatches, motion: jc.Motion) -> list[str]:
    """List rotating source joints that the report does not mention."""
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
    """Measure one rig: right, refused or wrong, and its errors."""
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
    hidden = {"Hand", "Foot"} if rig.has_joint_frames else set() if "hand" in rig.names else {"Hand"}
    shown = [name for name in LIMBS if name.removeprefix("Left").removeprefix("Right") not in hidden]
    joints = [human.skeleton.index(name) for name in ("LeftFoot", "RightFoot", "LeftToeBase", "RightToeBase")]
    heights = [
        joint_transforms(human.skeleton, poses)[0][:, joints] @ up
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
        "silent": unreported_joints(plan.matches, motion),
        "warnings": list(plan.matches.warnings),
        "limbs": {name: round(value, 2) for name, value in worst.items()},
    }


def match_without_names(skeleton: jc.Skeleton) -> str:
    """Match the limbs of a skeleton without names: right, refused or wrong, compared with matches by names."""
    named = find_limbs(skeleton, [parse_joint_name(name) for name in skeleton.names])
    alone = find_limbs(skeleton, [parse_joint_name(f"joint{row}") for row in range(skeleton.num_joints)])
    wanted, found = ([{limb.joints for limb in kind} for kind in limbs] for limbs in (named, alone))
    if found == wanted:
        return "right"
    return (
        "refused"
        if all(not here or here == there for here, there in zip(found, wanted, strict=True))
        else "wrong"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.retarget_rigs", description=str(__doc__).splitlines()[0]
    )
    rigs = {rig.name: rig for rig in (*TUNED, *HELD_OUT)}
    parser.add_argument("--takes", nargs="+", default=TAKES)
    parser.add_argument("--frames", type=int, help="number of frames of each take")
    parser.add_argument("--rigs", nargs="+", choices=rigs, default=list(rigs))
    options = parser.parse_args()
    shared, human = shared_folder(), jc.human(resolution="low")
    start, rows = time.perf_counter(), {}
    alone: list[str] = []
    for take in options.takes:
        motion, skeleton = cmu_motion(shared, take)
        motion = motion.slice(slice(None, None, round(CAPTURE_RATE / RATE))).slice(slice(options.frames))
        plan = jc.edit.plan_retarget(skeleton, human.skeleton, None, motion)
        direct = jc.retarget(motion, skeleton, human.skeleton, plan=plan)
        acted = world_motion(skeleton, motion)
        alone.append(match_without_names(skeleton))
        with tempfile.TemporaryDirectory() as folder:
            for name in options.rigs:
                alone.append(match_without_names(make_rig(acted, rigs[name])[0]))
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
        **{f"without_names_{outcome}": alone.count(outcome) for outcome in ("right", "refused", "wrong")},
        "degrees": {f"{take} {name}": row.get("degrees", "refused") for (take, name), row in rows.items()},
    }
    limits = {
        "wrong": ("==", 0),
        "silent": ("==", 0),
        "without_names_wrong": ("==", 0),
        "worst_degrees": ("<=", 2.0),
        "worst_ratio_percent": ("<=", 0.5),
        "schemes_right": (">=", min(6, len(set(options.rigs) - set(LACKING)))),
    }
    sizes = {"takes": list(options.takes), "rigs": len(options.rigs), "frames": options.frames or "all"}
    finish("retarget_rigs", figures, limits, sizes, {"run": time.perf_counter() - start})


if __name__ == "__main__":
    main()
