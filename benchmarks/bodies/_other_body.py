"""A body model that differs from the embedded human in triangles, joints and rest pose, and has shape coefficients.

It is the model of `_made_model` in a T-pose with legs apart, decimated, and without displacements by the pose.
"""

import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

import jaxcap as jc
from benchmarks.bodies._made_model import _regress, made_arrays
from jaxcap.body.body_model import BodyModel
from jaxcap.body.decimate import reduce_model

#: turns about the axis to the front, degrees, of the left side's joints from the embedded human's rest
T_POSE = {"shoulder": 42.0, "hip": 8.0}
#: number of sampled shapes from which joints are regressed
NUM_SHAPES = 30


def t_pose_arrays(resolution: str = "full", num_betas: int = 10) -> dict[str, np.ndarray]:
    """Make the arrays of the model in SMPL's format before its decimation."""
    arrays = made_arrays(resolution=resolution, num_betas=num_betas)
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "smpl_made.npz"
        np.savez(path, **{**arrays, "posedirs": np.zeros_like(arrays["posedirs"])})
        model = jc.read_body_model(path)
    skeleton = model.template.skeleton
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (skeleton.num_joints, 1))
    for joint, degrees in T_POSE.items():
        for side, sign in (("left", 1.0), ("right", -1.0)):
            turn = Rotation.from_euler("z", sign * degrees, degrees=True)
            turns[skeleton.index(f"{side}_{joint}")] = turn.as_quat(scalar_first=True)
    rest = jc.rest_pose(skeleton)
    pose = jc.Pose(rest.translations, jnp.asarray(turns, rest.rotations.dtype), rest.scale)

    @jax.jit
    def posed(betas):
        found = jc.pose_body(jc.shape_body(model, betas), pose)
        return found.vertices, found.joints

    # rotations are fixed, so that vertices and joints are linear in the coefficients
    zero = np.zeros(num_betas)
    mean = np.asarray(posed(zero)[0], float)
    directions = [np.asarray(posed(row)[0], float) - mean for row in np.eye(num_betas)]
    sampled = np.random.default_rng(0).normal(size=(NUM_SHAPES, num_betas))
    surfaces, places = (np.array(x, float) for x in zip(*[posed(row) for row in sampled], strict=True))
    regressor = np.array([_regress(surfaces, places[:, j]) for j in range(skeleton.num_joints)])
    return {
        **arrays,
        "v_template": mean,
        "shapedirs": np.moveaxis(np.array(directions), 0, 2),
        "J_regressor": regressor,
        "posedirs": np.zeros_like(arrays["posedirs"]),
    }


def other_model(vertices: int = 6000, **options) -> BodyModel:
    """Make the model with about so many vertices."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "smpl_other.npz"
        np.savez(path, **t_pose_arrays(**options))
        return reduce_model(jc.read_body_model(path), vertices)
