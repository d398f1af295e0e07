"""Compare learning with Dem-Bones on the same meshes, with as many bones: `python -m benchmarks.learn_vs_dembones`.

    python -m benchmarks.learn_vs_dembones --scenes bone --bones 5 10 20
    python -m benchmarks.learn_vs_dembones --scenes lbs --resolution low --meshes 12 --rounds 2

On Dem-Bones' own sample and on crane (every second mesh), a body that holds together in a skeleton, with
the skin and the symmetry that are the default, and one of free bones under linear blend skinning, as
Dem-Bones' are. Then meshes that linear blend skinning makes exactly: the embedded human, 60 poses, with as many
bones as learning finds. All figures
are root mean squares over vertices and meshes of the distance of a vertex from its place. Dem-Bones' is
the least of one run, on the way to where it stops; the seconds are until it has done its default number
of iterations (the sooner end). It is given the first mesh for a rest shape, and the true one for the human.
"""

import argparse

from benchmarks._scenes import shared_folder
from benchmarks.learning._dembones import dem_bones
from benchmarks.learning._learning import (
    bone_meshes,
    crane_meshes,
    fitted_vertices,
    joint_errors,
    learn,
    make_synthetic_meshes,
    posed_vertices,
    root_mean_square,
    vertex_errors_mm,
    without_cache,
)
from benchmarks.report import finish, progress
from jaxcap.observe.meshes import MeshSequence

#: a middle one of the numbers that Dem-Bones' own sample is run with (5, 10, 20)
SAMPLE_BONES = (10,)
#: 18 joints and the root
CRANE_BONES = 19
#: how much more than free bones a skeleton may leave
MAX_RMSE_RATIO = 1.15

Figures = dict[str, float]
Limits = dict[str, tuple[str, float]]


def compare(name: str, meshes: MeshSequence, bones: int, extra: dict) -> tuple[Figures, Limits]:
    """Compare a skeleton and free bones with Dem-Bones, with as many bones as it found, which may be fewer than asked."""
    progress(f"{name}: {len(meshes)} meshes, {meshes.vertices.shape[1]} vertices, {bones} bones")
    rival = dem_bones(meshes, bones)
    figures: Figures = {
        f"{name}_dembones_mm": rival.least,
        f"{name}_dembones_default_mm": rival.rmse,
        f"{name}_dembones_bones": rival.bones,
        f"{name}_dembones_seconds": rival.seconds,
        f"{name}_dembones_seconds_until_it_stops": rival.seconds_until_it_stops,
    }
    for kind, mode in (("skeleton", {}), ("free", {"free_bones": True, "skin": "lbs"})):
        run = learn(meshes, joints=rival.bones - 1, **mode, **extra)
        rms = root_mean_square(vertex_errors_mm(posed_vertices(run.body, run.motion), meshes.vertices))
        progress(f"  {kind}: {rms:.3f} mm, {rms / rival.least:.3f} of Dem-Bones'")
        figures |= {
            f"{name}_{kind}_mm": rms,
            f"{name}_{kind}_share": rms / rival.least,
            f"{name}_{kind}_seconds": run.seconds["total"],
        }
    return figures, {f"{name}_skeleton_share": ("<=", MAX_RMSE_RATIO), f"{name}_free_share": ("<", 1.0)}


def compare_exact(options, extra: dict) -> tuple[Figures, Limits, list[int]]:
    """Learn a body with linear blend skinning from its own meshes; also return the numbers of meshes, vertices and bones."""
    truth = make_synthetic_meshes(
        shared_folder(),
        "lbs",
        training=options.meshes,
        poses=options.poses,
        resolution=options.resolution,
        seed=options.seed,
    )
    progress(f"lbs: {len(truth.training)} meshes, {truth.clean.shape[1]} vertices")
    # the meshes can be fitted exactly, so a weight on shape gains nothing
    run = learn(truth.training, skin="lbs", alpha=0.0, skeleton="none", **extra)
    bones = run.body.skeleton.num_joints
    rival = dem_bones(truth.training, bones, truth.body.vertices)
    errors = vertex_errors_mm(posed_vertices(run.body, run.motion), truth.clean)
    held_out = vertex_errors_mm(fitted_vertices(run.body, truth.held_out), truth.clean_held_out)
    joints = joint_errors(truth, run.body, run.motion, truth.scored_joints)
    joints.say(truth.turns[truth.scored_joints])
    rms = root_mean_square(errors)
    progress(f"  learned: {rms:.4f} mm, {root_mean_square(held_out):.4f} held out")
    figures = {
        "lbs_mm": rms,
        "lbs_worst_vertex_mm": errors.max(),
        "lbs_held_out_mm": root_mean_square(held_out),
        "lbs_worst_joint_mm": joints.determined.max(),
        "lbs_worst_joint_with_hinges_mm": joints.centres.max(),
        "lbs_seconds": run.seconds["total"],
        "lbs_dembones_mm": rival.least,
        "lbs_dembones_default_mm": rival.rmse,
        "lbs_dembones_seconds": rival.seconds,
        "lbs_dembones_seconds_until_it_stops": rival.seconds_until_it_stops,
        "lbs_time_share": run.seconds["total"] / rival.seconds,
    }
    limits: Limits = {
        "lbs_mm": ("<=", 0.1),
        "lbs_worst_joint_mm": ("<=", 1.0),
        "lbs_time_share": ("<=", 1.0),
    }
    return figures, limits, [*truth.clean.shape[:2], bones]


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.learn_vs_dembones", description=__doc__.splitlines()[0]
    )
    parser.add_argument(
        "--scenes", nargs="*", choices=("bone", "crane", "lbs"), default=["bone", "crane", "lbs"]
    )
    parser.add_argument(
        "--bones", type=int, nargs="*", default=SAMPLE_BONES, help="numbers of bones for Dem-Bones' sample"
    )
    parser.add_argument("--every", type=int, default=1, help="use every n-th mesh of bone and crane only")
    parser.add_argument("--meshes", type=int, default=60, help="number of meshes of the embedded human")
    parser.add_argument("--resolution", choices=("full", "medium", "low"), default="full")
    parser.add_argument(
        "--poses", choices=("farthest", "random"), default="farthest", help="selection of the poses"
    )
    parser.add_argument("--rounds", type=int, help="maximum number of learning rounds")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    extra = {} if options.rounds is None else {"rounds": options.rounds}

    without_cache()
    figures, limits = {}, {}
    parts = []
    if "bone" in options.scenes:
        sample = bone_meshes(shared_folder())[:: options.every]
        parts += [(f"bone_{bones}", sample, bones) for bones in options.bones]
    if "crane" in options.scenes:
        parts.append(("crane", crane_meshes(shared_folder())[0][:: options.every], CRANE_BONES))
    for name, meshes, bones in parts:
        reached, asked = compare(name, meshes, bones, extra)
        figures, limits = figures | reached, limits | asked
    sizes = {name: [*meshes.vertices.shape[:2], bones] for name, meshes, bones in parts}
    if "lbs" in options.scenes:
        reached, asked, sizes["lbs"] = compare_exact(options, extra)
        figures, limits = figures | reached, limits | asked
    finish("learn_vs_dembones", figures, limits, sizes)


if __name__ == "__main__":
    main()
