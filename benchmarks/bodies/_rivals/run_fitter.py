"""Fit a body model in SMPL's format to registered meshes by `smplfitter`: `python run_fitter.py MESHES.npz MODEL.npz OUTPUT.npz`.

It runs in the environment of this package, with 1 to 8 iterations, and writes the vertices of each fit and its seconds.
"""

import os
import pickle
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import scipy.sparse
import torch

ITERATIONS = (1, 2, 4, 8)


def main() -> None:
    meshes, path, out = sys.argv[1:]
    given, model = np.load(meshes), dict(np.load(path))
    torch.set_num_threads(int(given["threads"]))
    with tempfile.TemporaryDirectory() as folder:
        # the package reads a pickle of this name, and a template of children in the same folder
        arrays = {**model, "J_regressor": scipy.sparse.csc_matrix(model["J_regressor"])}
        with open(Path(folder) / "basicmodel_neutral_lbs_10_207_0_v1.1.0.pkl", "wb") as file:
            pickle.dump(arrays, file)
        np.save(Path(folder) / "kid_template.npy", model["v_template"])
        os.environ["DATA_ROOT"] = folder
        import smplfitter.pt as fitter

        body = fitter.BodyModel("smpl", "neutral", model_root=folder, num_betas=model["shapedirs"].shape[2])
    targets = torch.tensor(given["vertices"], dtype=torch.float32)
    fit = fitter.BodyFitter(body)
    found = {}
    with torch.inference_mode():
        for iterations in ITERATIONS:
            options = {"num_iter": iterations, "beta_regularizer": 0.0}
            keys = ["pose_rotvecs", "shape_betas", "trans"]
            seconds = []
            for _ in range(3):
                start = time.perf_counter()
                fitted = fit.fit(targets, requested_keys=keys, **options)
                seconds.append(time.perf_counter() - start)
            posed = body(**{key: fitted[key] for key in keys})
            found[f"vertices_{iterations}"] = posed["vertices"].numpy()
            found[f"seconds_{iterations}"] = min(seconds)
    np.savez(out, **found)


if __name__ == "__main__":
    main()
