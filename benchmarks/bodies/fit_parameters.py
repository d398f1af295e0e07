"""Parameters of a body model from registered meshes and from scans: `python -m benchmarks.fit_parameters --venvs FOLDER`.

20 people in 10 poses each of CMU's motions, made by a model in SMPL's format (`_made_model`): every mesh is fitted alone, without
a start, by `fit_model` here, and by `smplfitter` in an environment that is created under FOLDER, with 1 to 8 iterations; its best
result counts. Errors are root mean square distances of vertices. The same with 2 mm of noise on every coordinate, in which errors
are those from the meshes without noise; and all poses of one person together.

People of Anny, whose data belong to its package, in poses of the same motions: meshes made by `anny` are fitted with all
coefficients, and by its `AnnyInverter`.

Scans: people of the model perform CMU's motions, seen by 8 depth cameras with 2 mm of noise. Coefficients are estimated from the
first frames (`estimate_shape`) and all frames are tracked, as `jaxcap track MODEL CLOUDS --fit-shape` does, without landmarks and
without a first pose. Errors are distances of the true vertices from the surface, and of joints.
"""

import argparse
import os
import tempfile
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from benchmarks._scenes import cmu_motion, shared_folder
from benchmarks.bodies._anny_fits import fit_anny_meshes
from benchmarks.bodies._made_model import made_arrays
from benchmarks.markers._rivals.environments import Rival, install, run_script
from benchmarks.report import finish, progress
from jaxcap.body.body_model import BodyModel, body_coefficients
from jaxcap.body.pose import take_poses
from jaxcap.edit.retargeting.retarget import retarget
from jaxcap.geometry.camera import ring_of_cameras
from jaxcap.geometry.sampling import even_indices
from jaxcap.tracking.track import track_frames
from jaxcap.tracking.track_frame import replace_body

PACKAGES = Rival(("3.11",), ("torch==2.8.*", "smplfitter==0.6.0", "anny==0.6.2", "numpy", "scipy"))
PEOPLE, POSES, NOISE = 20, 10, 0.002
#: people of Anny, which is slow to fit
ANNY_PEOPLE = 5
#: people who are scanned, and frames of each
SCANNED, SCANS = 5, 30
TAKES = ("02_05", "02_07", "01_01", "02_01", "02_08")


def sample_meshes(model: BodyModel, people: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Sample people and poses: vertices (P * N, V, 3), metres, and coefficients (P, K)."""
    rng = np.random.default_rng(seed)
    z = np.clip(rng.normal(size=(people, len(model.template_coefficients))), -2.5, 2.5)
    skeleton, vertices = model.template.skeleton, []
    for person in range(people):
        motion, source = cmu_motion(shared_folder(), TAKES[person % len(TAKES)])
        motion = retarget(motion, source, skeleton)
        poses = take_poses(motion.poses, rng.choice(even_indices(len(motion), 200), POSES, replace=False))
        body = jc.shape_body(model, jnp.asarray(z[person], jnp.float32))
        vertices.append(np.asarray(jc.body.posed_vertices(body, poses)))
    return np.concatenate(vertices), z


def errors(vertices: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Compute the root mean square distance of the vertices of each mesh, millimetres."""
    return 1000 * np.sqrt(np.mean(np.sum((vertices - truth) ** 2, 2), 1))


def fit_ours(
    model: BodyModel, vertices: np.ndarray, same_person: bool
) -> tuple[np.ndarray, np.ndarray, float]:
    """Fit meshes twice; return vertices, coefficients and the seconds of the second fit."""
    sequence = jc.MeshSequence(jnp.asarray(vertices, jnp.float32), model.template.faces, 30.0)
    jax.block_until_ready(jc.fit_model(model, sequence, same_person=same_person))
    start = time.perf_counter()
    fit = jax.block_until_ready(jc.fit_model(model, sequence, same_person=same_person))
    seconds = time.perf_counter() - start
    posed = [
        np.asarray(
            jc.pose_body(jc.shape_body(model, fit.coefficients[k]), take_poses(fit.motion.poses, k)).vertices
        )
        for k in range(len(vertices))
    ]
    return np.array(posed), np.asarray(fit.coefficients), seconds


def fit_others(
    python: Path, folder: Path, model: Path, vertices: np.ndarray
) -> dict[int, tuple[np.ndarray, float]]:
    """Fit meshes by `smplfitter`: vertices and seconds by the number of iterations."""
    given, found = folder / "meshes.npz", folder / "fits.npz"
    np.savez(given, vertices=vertices, threads=os.cpu_count() or 1)
    run_script(python, Path(__file__).parent / "_rivals" / "run_fitter.py", given, model, found)
    with np.load(found) as file:
        numbers = [int(name.removeprefix("seconds_")) for name in file.files if name.startswith("seconds_")]
        return {n: (file[f"vertices_{n}"], float(file[f"seconds_{n}"])) for n in numbers}


def fit_scans(model: BodyModel, person: int, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Track one person in scans; return distances of surfaces and joints, metres, errors of coefficients, and frames not good."""
    body = jc.shape_body(model, jnp.asarray(z, jnp.float32))
    motion, source = cmu_motion(shared_folder(), TAKES[person % len(TAKES)])
    motion = retarget(motion, source, model.template.skeleton)
    motion = motion.slice(slice(40, 40 + 2 * SCANS, 2))
    cameras = ring_of_cameras(8, 360, 2.8, 0.4, np.zeros(3), (320, 240), 60.0)
    vertices = np.asarray(jc.body.posed_vertices(body, motion.poses))
    scanner, faces, clouds = jc.scanner.Scanner(noise=NOISE, points=5000), np.asarray(body.faces), []
    for frame, shown in enumerate(vertices):
        middle = shown.mean(0)
        scan = jc.scanner.scan_frame(scanner, cameras, shown.astype(float) - middle, faces, frame=frame)
        clouds.append(jc.make_cloud(scan.points + middle, scan.normals))
    tracker = jc.make_tracker(model.template)
    found = jc.adapt.estimate_shape(tracker, clouds, model)
    frames = list(track_frames(replace_body(tracker, found), clouds))
    surface, joints = [], []
    for number, (frame, shown) in enumerate(zip(frames, vertices, strict=True)):
        posed = jc.pose_body(found, frame.pose)
        surface.append(
            jc.metrics.scan_to_surface(shown.astype(float), np.asarray(posed.vertices, float), faces)
        )
        there = jc.pose_body(body, take_poses(motion.poses, number)).joints
        joints.append(np.linalg.norm(np.asarray(posed.joints - there), axis=1))
    off = np.asarray(body_coefficients(model, found)) - z
    return np.array(surface), np.array(joints), off, sum(frame.verdict != "good" for frame in frames)


def run_scans(model: BodyModel, z: np.ndarray) -> dict[str, float]:
    """Track all people in scans, and collect the figures."""
    surfaces, joints, lost = [], [], 0
    for person, own in enumerate(z):
        surface, joint, off, bad = fit_scans(model, person, own)
        progress(
            f"scans of person {person}: surface {1000 * np.median(surface):.2f} mm (median), joints {1000 * joint.mean():.1f} mm, "
            f"worst frame {1000 * joint.mean(1).max():.1f} mm, coefficients off by {np.abs(off).mean():.2f}, {bad} frames not good"
        )
        surfaces.append(surface)
        joints.append(joint)
        lost += bad
    return {
        "scans_surface_median_mm": 1000 * float(np.median(surfaces)),
        "scans_joints_mean_mm": 1000 * float(np.mean(joints)),
        "scans_joints_worst_frame_mm": 1000 * float(np.max(np.mean(joints, 2))),
        "scans_not_good": float(lost),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--venvs", type=Path, default=Path.home() / ".cache" / "jaxcap" / "rivals")
    parser.add_argument(
        "--python", type=Path, help="a Python that has the package, in place of an environment"
    )
    parser.add_argument("--alone", action="store_true", help="without the other package")
    parser.add_argument("--people", type=int, default=PEOPLE, help="number of people with registered meshes")
    parser.add_argument("--scanned", type=int, default=SCANNED, help="number of people who are scanned")
    parser.add_argument(
        "--anny", type=int, default=ANNY_PEOPLE, help="number of people of Anny with registered meshes"
    )
    options = parser.parse_args()
    python = None if options.alone else options.python or install("fit_parameters", PACKAGES, options.venvs)
    figures, seconds = {}, {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = folder / "smpl_made.npz"
        np.savez(path, **made_arrays())
        model = jc.read_body_model(path)
        truth, z = sample_meshes(model, options.people)
        noisy = truth + NOISE * np.random.default_rng(1).normal(size=truth.shape)
        for label, meshes in (("exact", truth), ("noisy", noisy)):
            vertices, found, taken = fit_ours(model, meshes, same_person=False)
            ours = errors(vertices, truth)
            off = np.abs(found - np.repeat(z, POSES, 0)).max(1)
            each = 1000 * taken / len(meshes)
            progress(
                f"{label}: {ours.mean():.4f} mm, worst {ours.max():.4f}; coefficients off by {off.max():.4f}; {each:.1f} ms a mesh"
            )
            figures |= {f"{label}_rms_mm": float(ours.mean()), f"{label}_worst_mm": float(ours.max())}
            figures[f"{label}_coefficients"] = float(off.max())
            seconds[f"{label}_mesh"] = each / 1000
            if python is None:
                continue
            theirs = fit_others(python, folder, path, meshes)
            for number, (there, took) in theirs.items():
                wrong = errors(there, truth)
                progress(
                    f"{label}, smplfitter with {number} iterations: {wrong.mean():.3f} mm, worst {wrong.max():.2f}; "
                    f"{1000 * took / len(meshes):.1f} ms a mesh"
                )
            best = min(theirs, key=lambda n: errors(theirs[n][0], truth).mean())
            figures[f"{label}_error_ratio"] = float(ours.mean() / errors(theirs[best][0], truth).mean())
            figures[f"{label}_time_ratio"] = taken / theirs[best][1]
        one = truth[:POSES]
        vertices, found, taken = fit_ours(model, one, same_person=True)
        figures["together_rms_mm"] = float(errors(vertices, one).mean())
        seconds["together_mesh"] = taken / POSES
        if python is not None and options.anny:
            figures |= fit_anny_meshes(python, folder, TAKES, options.anny, POSES)
            seconds["anny_mesh"] = figures.pop("anny_mesh_seconds")
        if options.scanned:
            figures |= run_scans(jc.read_body_model(path, joints="tracking"), z[: options.scanned])
    limits = {
        "exact_rms_mm": ("<=", 0.1),
        "exact_worst_mm": ("<=", 0.1),
        "together_rms_mm": ("<=", 0.1),
        "exact_error_ratio": ("<=", 1 / 3),
        "exact_time_ratio": ("<=", 1.0),
        "noisy_error_ratio": ("<=", 1 / 3),
        "anny_rms_mm": ("<=", 0.1),
        "anny_error_ratio": ("<=", 1 / 3),
        "anny_time_ratio": ("<=", 1.0),
        "scans_surface_median_mm": ("<=", 1.2),
        "scans_joints_mean_mm": ("<=", 6.0),
    }
    limits = {name: limit for name, limit in limits.items() if name in figures}
    finish("fit_parameters", figures, limits, {"people": options.people, "poses": POSES}, seconds)


if __name__ == "__main__":
    main()
