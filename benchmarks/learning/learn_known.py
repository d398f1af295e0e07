"""Learn a known body from its meshes alone: `python -m benchmarks.learn_known`.

    python -m benchmarks.learn_known --resolution low --training 12 --held-out 4 --rounds 2

The truth is the embedded human under swing-twist skinning, posed by CMU's takes of subject 02, its
vertices in a random order. Learning gets the meshes alone, and finds the joints from the motion (`--skeleton none`). The error of a vertex is its distance from its true place, means over vertices and meshes; held-out
meshes are fitted with the learned body (`jaxcap.fit.fit_meshes.fit_meshes`). A second run learns
from meshes with Gaussian noise along each axis, and is measured against the meshes without.
"""

import argparse

from benchmarks._scenes import shared_folder
from benchmarks.learning._learning import (
    MIN_SCORED_ANGLE,
    Run,
    SyntheticMeshes,
    fitted_vertices,
    joint_errors,
    learn,
    make_synthetic_meshes,
    posed_vertices,
    vertex_errors_mm,
    without_cache,
)
from benchmarks.report import finish, progress

NOISE = 0.002


def mean_errors(scene: SyntheticMeshes, run: Run) -> dict[str, float]:
    """Compute the mean errors to the clean training and held-out meshes."""
    training = vertex_errors_mm(posed_vertices(run.body, run.motion), scene.clean)
    held_out = vertex_errors_mm(fitted_vertices(run.body, scene.held_out), scene.clean_held_out)
    progress(f"  {training.mean():.3f} mm in training, {held_out.mean():.3f} mm held out")
    return {
        "training_mm": training.mean(),
        "training_worst_vertex_mm": training.mean(0).max(),
        "held_out_mm": held_out.mean(),
        "held_out_worst_mesh_mm": held_out.mean(1).max(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.learn_known", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--resolution", choices=("full", "medium", "low"), default="full")
    parser.add_argument("--training", type=int, default=60, help="number of meshes to learn from")
    parser.add_argument("--held-out", type=int, default=20, help="number of meshes to fit afterwards")
    parser.add_argument(
        "--poses", choices=("farthest", "random"), default="farthest", help="selection of the poses"
    )
    parser.add_argument("--joints", type=int, help="number of joints; determined from the meshes by default")
    parser.add_argument(
        "--skeleton",
        choices=("none", "human"),
        default="none",
        help="joints found from the motion, or those of a person, to begin with",
    )
    parser.add_argument("--rounds", type=int, help="maximum number of learning rounds")
    parser.add_argument(
        "--noise",
        type=float,
        nargs="*",
        default=[0.0, NOISE],
        help="noise deviations along each axis, metres",
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="seed of the poses, the vertex order and the noise"
    )
    options = parser.parse_args()
    extra = {} if options.rounds is None else {"rounds": options.rounds}

    without_cache()
    figures, seconds, sizes, limits = {}, {}, {}, {}
    for noise in options.noise:
        progress(f"noise of {1000 * noise:g} mm")
        scene = make_synthetic_meshes(
            shared_folder(),
            training=options.training,
            held_out=options.held_out,
            noise=noise,
            poses=options.poses,
            resolution=options.resolution,
            seed=options.seed,
        )
        run = learn(scene.training, joints=options.joints, skeleton=options.skeleton, **extra)
        prefix = "noisy_" if noise else ""
        figures |= {prefix + name: value for name, value in mean_errors(scene, run).items()}
        joints = joint_errors(scene, run.body, run.motion, scene.scored_joints)
        joints.say(scene.turns[scene.scored_joints])
        figures[prefix + "worst_joint_mm"] = joints.centres.max()
        figures[prefix + "worst_joint_off_axis_mm"] = joints.determined.max()
        figures[prefix + "mean_joint_mm"] = joints.centres.mean()
        figures[prefix + "joints_mm"] = dict(zip(joints.names, joints.centres, strict=True))
        seconds |= {prefix + name: value for name, value in run.seconds.items()}
        limits |= {
            prefix + "training_mm": ("<=", 1.5 if noise else 1.0),
            prefix + "held_out_mm": ("<=", 2.5 if noise else 2.0),
        }
        if not noise:
            # along a hinge's axis no mesh tells where the centre is
            limits["worst_joint_off_axis_mm"] = ("<=", 10.0)
        sizes = {
            "meshes": len(scene.training),
            "held_out": len(scene.held_out),
            "vertices": scene.clean.shape[1],
            "joints": len(scene.moving_joints),
            "joints_learned": run.body.skeleton.num_joints - 1,
            f"joints_over_{MIN_SCORED_ANGLE:g}_degrees": len(scene.scored_joints),
        }
    finish("learn_known", figures, limits, sizes, seconds)


if __name__ == "__main__":
    main()
