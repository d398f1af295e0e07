"""A file of SKEL's layout with random numbers, and its vertices by homogeneous transforms, as the paper has them."""

import numpy as np
from scipy.spatial.transform import Rotation

PARENTS = (-1, 0, 1, 2, 3, 4, 0, 6, 7, 8, 9, 0, 11, 12, 12, 14, 15, 16, 17, 12, 19, 20, 21, 22)
#: (joint of SKEL, joint of SMPL) of the pose-dependent displacements
SMPL = (
    (1, 2), (2, 5), (4, 8), (5, 11), (6, 1), (7, 4), (9, 7), (10, 10), (11, 3), (12, 6), (13, 15), (14, 14), (15, 17), (16, 19),
    (18, 21), (19, 13), (20, 16), (21, 18), (23, 20),
)  # fmt: skip


def skel_arrays(rng, vertices=60):
    """Make the arrays of a file."""
    count = len(PARENTS)

    def shares(rows, columns):
        values = rng.random((rows, columns)) * (rng.random((rows, columns)) < 0.2) + 1e-3
        return values / values.sum(1, keepdims=True)

    at_rest = np.tile(np.eye(4), (count, 1, 1))
    at_rest[:, :3, :3] = Rotation.random(count, random_state=1).as_matrix()
    at_rest[:, :3, 3] = 0.2 * rng.normal(size=(count, 3))
    return {
        "version": "1.1.1",
        "skin_template_v": rng.normal(size=(vertices, 3)),
        "skin_template_f": np.array([[k, k + 1, k + 2] for k in range(vertices - 2)]),
        "shapedirs": 0.05 * rng.normal(size=(vertices, 3, 10)),
        "posedirs": 0.02 * rng.normal(size=(vertices, 3, 207)),
        "J_regressor_osim": shares(count, vertices),
        "skin_weights": shares(vertices, count),
        "osim_kintree_table": np.array([PARENTS, range(count)]),
        "per_joint_rot": Rotation.from_rotvec(0.2 * rng.normal(size=(count, 3))).as_matrix(),
        "apose_rel_transfo": at_rest,
    }


def rotate(axis, angle):
    return Rotation.from_rotvec(angle * np.asarray(axis, float)).as_matrix()


def own_rotations(q):
    """Compute the rotation of each joint by its angles, the later ones outside."""
    x, y, z = np.eye(3)
    ankle = Rotation.from_euler("XYZ", [0.175895, -0.105208, 0.0186622]).apply(z)
    heel = Rotation.from_euler("XYZ", [-1.76818999, 0.906223, 1.8196]).apply(z)
    left_heel = Rotation.from_euler("XYZ", [1.768189999, -0.906223, 1.8196]).apply(z)
    toes = Rotation.from_euler("XYZ", [-3.141589999, 0.619901, 0]).apply(z)
    left_toes = Rotation.from_euler("XYZ", [-3.141589999, -0.619901, 0]).apply(z)
    spine, elbow, forearm = (x, z, y), (0.0494, 0.0366, 0.99810825), (-0.01716099, 0.99266564, -0.11966796)
    left_elbow, left_forearm = (-0.0494, -0.0366, 0.99810825), (0.01716099, -0.99266564, -0.11966796)
    axes = [
        (z, x, y), (z, x, y), (-z,), (ankle,), (heel,), (toes,), (z, -x, -y), (-z,), (ankle,), (left_heel,), (left_toes,),
        spine, spine, spine, (y, -z, -x), (x, y, z), (elbow,), (forearm,), (x, -z), (y, z, x), (x, y, z), (left_elbow,),
        (left_forearm,), (-x, -z),
    ]  # fmt: skip
    turns, first = [], 0
    for own in axes:
        turn = np.eye(3)
        for k, axis in enumerate(own):
            turn = rotate(axis, q[first + k]) @ turn
        first += len(own)
        turns.append(turn)
    assert first == len(q) == 46
    return turns


def slides(q, centres):
    """Compute how far shoulder blades and spine slide."""
    found = np.zeros((24, 3))
    width = np.linalg.norm(centres[19] - centres[14])
    height = np.linalg.norm(centres[12] - centres[11])

    def right(a, e):
        return np.array(
            [
                -width / 4 * np.cos(e - np.pi / 4) * np.cos(a),
                -height / 2 * np.sin(e - np.pi / 4),
                width / 4 * np.sin(a),
            ]
        )

    found[14] = right(q[26], q[27]) - right(0, 0)
    found[19] = (right(-q[36], -q[37]) - right(0, 0)) * [-1, 1, 1]
    for joint, below, first in ((11, 0, 17), (12, 11, 20), (13, 12, 23)):
        length = abs(centres[joint, 1] - centres[below, 1])
        for angle, axis in ((q[first], 0), (q[first + 1], 2)):
            if angle:
                found[joint, axis] -= length / angle * (1 - np.cos(angle))
                found[joint, 1] += length / angle * np.sin(angle) - length
    return found


def skel_forward(arrays, q, trans, betas):
    """Compute vertices and joints of a pose, metres."""
    shaped = arrays["skin_template_v"] + arrays["shapedirs"] @ betas
    centres = arrays["J_regressor_osim"] @ shaped
    steps = np.array([c if p < 0 else c - centres[p] for c, p in zip(centres, PARENTS, strict=True)])
    child = [PARENTS.index(j) if j in PARENTS else 0 for j in range(24)]
    places = arrays["apose_rel_transfo"][:, :3, 3]
    along = np.array([steps[c] for c in child])
    before = np.array([places[c] for c in child])
    for ulna in (16, 21):
        along[ulna], before[ulna] = along[ulna] + along[ulna + 1], before[ulna] + before[ulna + 1]
    along[12] = along[11]
    own, moved, pose_steps = own_rotations(q), slides(q, centres), np.zeros(207)
    bones = []
    for joint in range(24):
        frame = arrays["per_joint_rot"][joint]
        if joint not in (0, 5, 10, 13, 18, 23):
            a, b = frame @ before[joint], along[joint]
            cross = np.cross(a, b)
            angle = np.arctan2(np.linalg.norm(cross), a @ b)
            frame = rotate(cross / np.linalg.norm(cross), angle) @ frame
        frame = frame @ arrays["apose_rel_transfo"][joint, :3, :3].T
        local = np.eye(4)
        local[:3, :3] = frame @ own[joint] @ frame.T
        local[:3, 3] = steps[joint] + moved[joint]
        for skel, smpl in SMPL:
            if skel == joint:
                pose_steps[9 * (smpl - 1) : 9 * smpl] = (local[:3, :3] - np.eye(3)).ravel()
        bones.append(local if joint == 0 else bones[PARENTS[joint]] @ local)
    posed = np.array([bone[:3, 3] for bone in bones])
    rest = shaped + arrays["posedirs"] @ pose_steps
    vertices = np.zeros_like(rest)
    for joint, bone in enumerate(bones):
        at = (rest - centres[joint]) @ bone[:3, :3].T + posed[joint]
        vertices += arrays["skin_weights"][:, joint, None] * at
    return vertices + trans, posed + trans
