"""Fit the human to the marker sets of laboratories, from nothing: `python -m benchmarks.markers.markers_laboratories`.

Builds of the embedded human, whose bones have lengths that its traits do not contain, wear the marker sets of eight
laboratories: labels as theirs, placed near the landmarks with 10 mm of error, with soft tissue, noise, gaps and
swapped labels, under CMU's motions. Joints are compared with the person's in every frame, without removing an offset.
The quick default has 2 builds and takes minutes; `--builds 10` is the whole.
"""

import argparse
import time

import jax
import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from benchmarks._scenes import shared_folder
from benchmarks.markers._laboratories import LABORATORIES, TAKES, LaboratoryScene, make_laboratory_scene
from benchmarks.markers._markers import pose_all
from benchmarks.report import finish, progress

#: joints that are judged, and bones by both ends
LIMBS = ("UpLeg", "Leg", "Foot", "Arm", "ForeArm", "Hand")
JOINTS = (*(side + limb for side in ("Left", "Right") for limb in LIMBS), "Neck")
BONES = (("UpLeg", "Leg"), ("Leg", "Foot"), ("Arm", "ForeArm"), ("ForeArm", "Hand"))
#: bones that must have markers, or a message that they have none
CARRIERS = ("UpLeg", "Leg", "Foot", "Arm", "ForeArm")


def fit_errors(scene: LaboratoryScene, fit) -> dict[str, float]:
    """Compute the errors of a fit: joints in every frame, lengths, left against right, and limbs."""
    skeleton, truth = fit.subject.skeleton, scene.truth.skeleton
    missing = [name for name in JOINTS if name not in skeleton.names]
    if missing:
        return {
            "joints_mm": float("inf"),
            "worst_mm": float("inf"),
            "length_mm": float("inf"),
            "asymmetry_percent": float("inf"),
            "limbs": 0.0,
        }
    _, found = pose_all(
        fit.subject, fit.motion.poses, jnp.zeros((scene.joints.shape[0], fit.subject.num_markers, 3))
    )
    columns = [skeleton.index(name) for name in JOINTS]
    away = np.asarray(found, float)[:, columns] - scene.joints[:, [truth.index(name) for name in JOINTS]]
    errors = 1000 * np.linalg.norm(away, axis=-1).mean(0)
    lengths, true = (
        np.array([[_length(one, side + a, side + b) for side in ("Left", "Right")] for a, b in BONES])
        for one in (skeleton, truth)
    )
    asymmetry = np.abs(lengths[:, 0] - lengths[:, 1]) / lengths.mean(1)
    marked = {
        skeleton.names[bone] for bone in np.asarray(fit.subject.bones)[np.asarray(fit.subject.weights) > 0]
    }
    told = " ".join(fit.messages)
    limbs = [side + name for side in ("Left", "Right") for name in CARRIERS]
    return {
        "joints_mm": float(errors.mean()),
        "worst_mm": float(errors.max()),
        "length_mm": float(1000 * np.abs(lengths - true).mean()),
        "asymmetry_percent": float(100 * asymmetry.max()),
        "limbs": float(np.mean([limb in marked or limb in told for limb in limbs])),
        **{f"{limb}_mm": float(np.mean([e for e, name in zip(errors, JOINTS, strict=True) if name.removeprefix("Left").removeprefix("Right") == limb])) for limb in (*LIMBS, "Neck")},
    }  # fmt: skip


def _length(skeleton: jc.Skeleton, start: str, end: str) -> float:
    centres = np.asarray(skeleton.centres, float)
    return float(np.linalg.norm(centres[skeleton.index(end)] - centres[skeleton.index(start)]))


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.markers.markers_laboratories", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--builds", type=int, default=2, help="number of people (10 are the whole)")
    parser.add_argument("--laboratories", nargs="+", choices=list(LABORATORIES), default=list(LABORATORIES))
    parser.add_argument(
        "--frames", type=int, default=300, help="number of frames of each take, at 60 a second"
    )
    parser.add_argument("--static", action="store_true", help="give a static trial: a second of standing")
    options = parser.parse_args()
    shared, seconds = shared_folder(), {}
    rows: dict[str, list[dict[str, float]]] = {laboratory: [] for laboratory in options.laboratories}
    for build in range(options.builds):
        for number, laboratory in enumerate(options.laboratories):
            take = TAKES[(build + number) % len(TAKES)]
            scene = make_laboratory_scene(shared, laboratory, build, take, options.frames, options.static)
            start = time.perf_counter()
            fit = jc.markers.fit_human(scene.frames, static=scene.static)
            taken = time.perf_counter() - start
            row = fit_errors(scene, fit)
            # each set has shapes of its own, and a process can hold only so many programs
            jax.clear_caches()
            rows[laboratory].append(row)
            seconds.setdefault(laboratory, []).append(taken)
            progress(
                f"build {build} {laboratory} {take}: joints {row['joints_mm']:.1f} mm (worst {row['worst_mm']:.1f}), lengths "
                f"{row['length_mm']:.1f} mm, left against right {row['asymmetry_percent']:.1f} %, limbs {row['limbs']:.2f}, "
                f"{taken:.0f} s; {len(fit.messages)} messages"
            )
    every = [row for some in rows.values() for row in some]
    figures = {name: float(np.mean([row[name] for row in every if name in row])) for name in every[0]}
    figures["limbs"] = min(row["limbs"] for row in every)
    figures |= {
        f"{name}_joints_mm": float(np.mean([row["joints_mm"] for row in some])) for name, some in rows.items()
    }
    limits = {
        "joints_mm": ("<=", 5.0 if options.static else 8.0), "length_mm": ("<=", 4.0), "asymmetry_percent": ("<=", 2.0),
        "limbs": (">=", 1.0),
    }  # fmt: skip
    settings = {"builds": options.builds, "frames": options.frames, "static": options.static}
    finish("markers_laboratories", figures, limits, settings, seconds)


if __name__ == "__main__":
    main()
