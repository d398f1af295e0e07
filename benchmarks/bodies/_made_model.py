"""A body model in the format of SMPL, made from the embedded human: SMPL's own files have a licence that forbids to share them.

The 24 joints are at the places of SMPL's, with the embedded human's skinning weights summed to them. The shape directions are
the principal components of sampled humans. Each joint is a weighted mean of vertices near it. The displacements by the pose are
regressed on the difference between linear and dual quaternion blending in sampled poses, so they resemble those of a learned
model.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import nnls

import jaxcap as jc
from jaxcap.body.people.random_humans import sample_humans
from jaxcap.geometry import rotation
from jaxcap.io.body_models.families import FAMILIES
from jaxcap.io.skeletons.parameters.joints import SMPL_PARENTS

#: the embedded human's joint at the place of each joint of SMPL
_PLACES = (
    "Hips", "LeftUpLeg", "RightUpLeg", "LowerBack", "LeftLeg", "RightLeg", "Spine", "LeftFoot", "RightFoot", "Spine1",
    "LeftToeBase", "RightToeBase", "Neck", "LeftShoulder", "RightShoulder", "Head", "LeftArm", "RightArm", "LeftForeArm",
    "RightForeArm", "LeftHand", "RightHand", "LeftFingerBase", "RightFingerBase",
)  # fmt: skip
#: joints whose weights are added to one of `_PLACES`
_MERGED = {
    "LHipJoint": "Hips", "RHipJoint": "Hips", "Neck1": "Neck", "LThumb": "LeftHand", "RThumb": "RightHand",
    "LeftHandFinger1": "LeftFingerBase", "RightHandFinger1": "RightFingerBase",
}  # fmt: skip
#: numbers of people, of vertices that determine a joint, and of poses for the displacements
NUM_PEOPLE, NUM_NEAR, NUM_POSES = 200, 150, 300
#: ridge of the displacements, relative to the mean squared feature
RIDGE = 0.3


def made_arrays(resolution: str = "medium", num_betas: int = 10, seed: int = 0) -> dict[str, np.ndarray]:
    """Make the arrays of a model in SMPL's format, y up, metres."""
    people = sample_humans(NUM_PEOPLE, resolution=resolution, joints="tracking")
    template = jc.human(resolution=resolution, joints="tracking")
    surfaces = np.array([np.asarray(body.vertices, float) for body in people])
    mean = surfaces.mean(0)
    _, sizes, axes = np.linalg.svd((surfaces - mean).reshape(len(surfaces), -1), full_matrices=False)
    scaled = axes[:num_betas] * (sizes[:num_betas, None] / np.sqrt(len(surfaces) - 1))
    directions = np.moveaxis(scaled.reshape(num_betas, -1, 3), 0, 2)
    numbers = [template.skeleton.index(name) for name in _PLACES]
    places = np.array([np.asarray(body.skeleton.centres, float)[numbers] for body in people])
    regressor = np.array([_regress(surfaces, places[:, j]) for j in range(len(numbers))])
    weights = _merge_weights(template)
    parents = SMPL_PARENTS[24]
    arrays = {
        "v_template": mean,
        "shapedirs": directions,
        "J_regressor": regressor,
        "weights": weights,
        "kintree_table": np.array([[2**32 - 1, *parents[1:]], range(24)], dtype=np.uint32),
        "f": np.asarray(template.faces).astype(np.uint32),
    }
    return {**arrays, "posedirs": _displacements(arrays, seed)}


def write_made_model(path: Path, **options) -> Path:
    """Write a made model as an `.npz` file."""
    np.savez(path, **made_arrays(**options))
    return path


def _regress(surfaces: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Find weights of at least zero with sum one, of vertices near a joint, whose means are the joint of all people."""
    near = np.argsort(np.linalg.norm(surfaces - places[:, None], axis=2).mean(0))[:NUM_NEAR]
    scale = 100.0
    rows = np.concatenate(
        [
            (surfaces[:, near] - places[:, None]).transpose(0, 2, 1).reshape(-1, NUM_NEAR),
            scale * np.ones((1, NUM_NEAR)),
        ]
    )
    found, _ = nnls(rows, np.append(np.zeros(len(rows) - 1), scale))
    weights = np.zeros(surfaces.shape[1])
    weights[near] = found / found.sum()
    return weights


def _merge_weights(template: jc.Body) -> np.ndarray:
    own = np.asarray(template.skin.bone_weights(template.skeleton.num_joints), float)
    weights = np.zeros((len(own), len(_PLACES)))
    for joint, name in enumerate(template.skeleton.names):
        weights[:, _PLACES.index(_MERGED.get(name, name))] += own[:, joint]
    return weights / weights.sum(1, keepdims=True)


def _displacements(arrays: dict[str, np.ndarray], seed: int) -> np.ndarray:
    """Regress displacements at rest that move linear blending to dual quaternion blending, on rotation matrices."""
    centres = arrays["J_regressor"] @ arrays["v_template"]
    kinds = ["free", *["ball"] * 23]
    skeleton = jc.make_skeleton(FAMILIES[24].joints, SMPL_PARENTS[24], kinds, centres)
    weights, vertices = jnp.asarray(arrays["weights"]), jnp.asarray(arrays["v_template"])
    linear = jc.Body(skeleton, jc.LinearSkin(weights), vertices, jnp.asarray(arrays["f"].astype(int)))
    rng = np.random.default_rng(seed)
    turns = 0.5 * rng.normal(size=(NUM_POSES, 24, 3))

    @jax.jit
    def of_pose(turns):
        pose = jc.Pose(jnp.zeros((24, 3)), jax.vmap(rotation.exp)(turns), jnp.ones(()))
        posed = jc.pose_body(linear, pose)
        dual = jc.DualQuaternionSkin(weights).deform(vertices, skeleton, pose, posed.transforms)
        blended = jnp.einsum("vj,jab->vab", weights, posed.transforms.rotations)
        gap = jnp.linalg.solve(blended, (dual - posed.vertices)[..., None])[..., 0]
        matrices = jax.vmap(rotation.to_matrix)(pose.rotations[1:])
        return gap, (matrices - jnp.eye(3)).reshape(-1)

    gaps, features = (np.array(x, float) for x in zip(*[of_pose(jnp.asarray(t)) for t in turns], strict=True))
    matrix = features.T @ features
    matrix += RIDGE * NUM_POSES * np.mean(features**2) * np.eye(len(matrix))
    found = np.linalg.solve(matrix, features.T @ gaps.reshape(len(gaps), -1))
    return np.moveaxis(found.reshape(-1, *gaps.shape[1:]), 0, 2)
