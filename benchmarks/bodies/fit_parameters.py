"""Parameters of a body model from registered meshes: `python -m benchmarks.fit_parameters --venvs FOLDER`.

20 people in 10 poses each of CMU's motions, made by a model in SMPL's format (`_made_model`): every mesh is fitted alone, without
a start, by `fit_model` here, and by `smplfitter` in an environment that is created under FOLDER, with 1 to 8 iterations; its best
result counts. Errors are root mean square distances of vertices. The same with 2 mm of noise on every coordinate, in which errors
are those from the meshes without noise; and all poses of one person together.
"""

import argparse
import os
import subprocess
import tempfile
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from benchmarks._scenes import cmu_motion, shared_folder
from benchmarks.bodies._made_model import made_arrays
from benchmarks.markers._rivals.environments import Rival, install
from benchmarks.report import finish, progress
from jaxcap.body.body_model import BodyModel
from jaxcap.body.pose import take_poses
from jaxcap.edit.retargeting.retarget import retarget
from jaxcap.geometry.sampling import even_indices

PACKAGES = Rival(("3.11",), ("torch==2.8.*", "smplfitter==0.6.0", "numpy", "scipy"))
PEOPLE, POSES, NOISE = 20, 10, 0.002
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
        vertices.append(np.asarray(jc.body.body.posed_vertices(body, poses)))
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
    script = Path(__file__).parent / "_rivals" / "run_fitter.py"
    surroundings = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    command = [str(python), str(script), str(given), str(model), str(found)]
    outcome = subprocess.run(command, env=surroundings, capture_output=True, text=True)
    if outcome.returncode:
        progress(outcome.stderr[-500:])
        outcome.check_returncode()
    with np.load(found) as file:
        numbers = [int(name.removeprefix("seconds_")) for name in file.files if name.startswith("seconds_")]
        return {n: (file[f"vertices_{n}"], float(file[f"seconds_{n}"])) for n in numbers}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--venvs", type=Path, default=Path.home() / ".cache" / "jaxcap" / "rivals")
    parser.add_argument(
        "--python", type=Path, help="a Python that has the package, in place of an environment"
    )
    parser.add_argument("--people", type=int, default=PEOPLE)
    options = parser.parse_args()
    python = options.python or install("fitter", PACKAGES, options.venvs)
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
    limits = {
        "exact_rms_mm": ("<=", 0.1),
        "exact_worst_mm": ("<=", 0.1),
        "together_rms_mm": ("<=", 0.1),
        "exact_error_ratio": ("<=", 1 / 3),
        "exact_time_ratio": ("<=", 1.0),
        "noisy_error_ratio": ("<=", 1 / 3),
    }
    limits = {name: limit for name, limit in limits.items() if name in figures}
    finish("fit_parameters", figures, limits, {"people": options.people, "poses": POSES}, seconds)


if __name__ == "__main__":
    main()
