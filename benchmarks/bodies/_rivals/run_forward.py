"""Pose a body model in SMPL's format by `smplx` and `body-models`: `python run_forward.py POSES.npz MODEL.npz OUTPUT.npz`.

It runs in the environment of these packages, and writes vertices, joints and seconds.
"""

import sys
import time
from collections.abc import Callable

import numpy as np
import torch
from smplx.lbs import lbs

NAMES = ("v_template", "shapedirs", "posedirs", "J_regressor", "weights")


def median_seconds(function: Callable, repeats: int) -> float:
    function()
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds))


def smplx_forward(model: dict, betas: np.ndarray, poses: np.ndarray, dtype: torch.dtype) -> Callable:
    """Return a function of the number of poses."""
    template, directions, displacements, regressor, weights = (
        torch.tensor(model[name], dtype=dtype) for name in NAMES
    )
    displacements = displacements.reshape(-1, displacements.shape[2]).T.contiguous()
    parents = torch.tensor(model["kintree_table"][0].astype(np.int64))
    parents[0] = -1
    z, turns = torch.tensor(betas, dtype=dtype), torch.tensor(poses, dtype=dtype)
    return lambda n: lbs(z[:n], turns[:n], template, directions, displacements, regressor, parents, weights)


def other_forward(path: str, betas: np.ndarray, poses: np.ndarray) -> Callable:
    """Return a function of the number of poses, by `body-models`."""
    from body_models.smpl.torch import SMPL

    body = SMPL(model_path=path)
    z, turns = (torch.tensor(x, dtype=torch.float32) for x in (betas, poses.reshape(len(poses), -1, 3)))
    return lambda n: body.forward_vertices(turns[:n, 1:], pelvis_rotation=turns[:n, 0], shape=z[:n])


def main() -> None:
    poses_path, path, out = sys.argv[1:]
    given, model = np.load(poses_path), dict(np.load(path))
    torch.set_num_threads(int(given["threads"]))
    betas, poses = given["betas"], given["poses"]
    with torch.inference_mode():
        vertices, joints = smplx_forward(model, betas, poses, torch.float64)(len(poses))
        found = {"vertices": vertices.numpy(), "joints": joints.numpy()}
        forwards = {"smplx": smplx_forward(model, betas, poses, torch.float32)}
        if len(model["kintree_table"][0]) == 24:
            forwards["body_models"] = other_forward(path, betas, poses)
        for name, forward in forwards.items():
            found[f"{name}_1"] = median_seconds(lambda forward=forward: forward(1), 50)
            found[f"{name}_64"] = median_seconds(lambda forward=forward: forward(64), 10) / 64
    np.savez(out, **found)


if __name__ == "__main__":
    main()
