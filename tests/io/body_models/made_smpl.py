"""Body models in SMPL's format with random numbers, and their forward map in NumPy, one vertex at a time."""

import numpy as np
from scipy.spatial.transform import Rotation

from jaxcap.io.skeletons.parameters.joints import SMPL_PARENTS

#: parents of the joints of FLAME and MANO
PARENTS = {**SMPL_PARENTS, 5: (-1, 0, 1, 1, 1), 16: (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14)}


def smpl_arrays(
    joints: int = 24, vertices: int = 60, directions: int = 6, quaternions: bool = False, seed: int = 0
) -> dict[str, np.ndarray]:
    """The arrays of a model; with `quaternions` those of STAR."""
    rng = np.random.default_rng(seed)
    regressor = rng.random((joints, vertices)) ** 6
    weights = rng.random((vertices, joints)) ** 6
    features = 4 * (joints - 1) + 1 if quaternions else 9 * (joints - 1)
    return {
        "v_template": 0.5 * rng.normal(size=(vertices, 3)),
        "shapedirs": 0.05 * rng.normal(size=(vertices, 3, directions)),
        "posedirs": 0.01 * rng.normal(size=(vertices, 3, features)),
        "J_regressor": regressor / regressor.sum(1, keepdims=True),
        "weights": weights / weights.sum(1, keepdims=True),
        "kintree_table": np.array([[2**32 - 1, *PARENTS[joints][1:]], range(joints)], dtype=np.uint32),
        "f": rng.permuted(np.tile(np.arange(vertices), (2 * vertices, 1)), axis=1)[:, :3].astype(np.uint32),
    }


def smpl_forward(arrays, betas, poses, trans) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and joints by the equations of SMPL (Loper et al. 2015) and STAR (Osman et al. 2020), step by step."""
    shaped = arrays["v_template"] + arrays["shapedirs"][:, :, : len(betas)] @ betas
    centres = arrays["J_regressor"] @ shaped
    turns = Rotation.from_rotvec(np.reshape(poses, (-1, 3)))
    matrices = turns.as_matrix()
    joints = len(matrices)
    if arrays["posedirs"].shape[2] == 9 * (joints - 1):
        features = (matrices[1:] - np.eye(3)).reshape(-1)
    else:
        # x, y, z, w - 1 of each joint, and the second shape coefficient
        quaternions = turns.as_quat(canonical=True)[1:]
        features = np.append((quaternions - [0, 0, 0, 1]).reshape(-1), betas[1])
    moved = shaped + arrays["posedirs"] @ features
    world = []
    for joint, parent in enumerate(PARENTS[joints]):
        local = np.eye(4)
        local[:3, :3] = matrices[joint]
        local[:3, 3] = centres[joint] - (centres[parent] if parent >= 0 else 0)
        world.append(local if parent < 0 else world[parent] @ local)
    posed = np.zeros_like(moved)
    for vertex, place in enumerate(moved):
        for joint in range(joints):
            arm = world[joint][:3, :3] @ (place - centres[joint]) + world[joint][:3, 3]
            posed[vertex] += arrays["weights"][vertex, joint] * arm
    return posed + trans, np.array(world)[:, :3, 3] + trans
