"""A TorchScript file of the layout of MHR's with random numbers, and its vertices by Momentum's equations, bone by bone."""

import struct
import zipfile

import numpy as np

NUM_SHAPES = 45 + 72


def mhr_arrays(rng, joints=9, vertices=40):
    """Make the tensors of a rig: a world, a root with its motion, and joints below it, with proportions of bones."""
    parents = np.array([-1, 0, *(int(rng.integers(1, joint)) for joint in range(2, joints))], np.int32)
    offsets = np.array(10 * rng.normal(size=(joints, 3)), np.float32)
    turns = rng.normal(size=(joints, 4))
    turns = np.array(turns / np.linalg.norm(turns, axis=1, keepdims=True), np.float32)
    # (joint, row, weight) of each parameter; the last ones are proportions
    entries = [[(1, row, 10.0 if row < 3 else 1.0)] for row in range(6)]
    for joint in range(2, joints):
        entries += [[(joint, 3 + axis, 1.0)] for axis in range(3 if joint % 3 else 1)]
    entries += [[(2, 4, 0.5), (3, 4, 0.7)]]
    pose = len(entries)
    entries += [[(joint, 0, 3.0), (joint, 1, 1.0)] for joint in range(2, joints, 2)]
    entries += [[(1, 6, 1.0)], [(joints - 1, 6, 0.5)]]
    transform = np.zeros((joints, 7, len(entries) + NUM_SHAPES), np.float32)
    for number, some in enumerate(entries):
        for joint, row, weight in some:
            transform[joint, row, number] += weight
    scaling = np.zeros(transform.shape[2], bool)
    scaling[pose : len(entries)] = True
    rest = momentum_states(parents, offsets, turns, np.zeros((joints, 7)))
    inverse = np.linalg.inv(rest)
    weights = rng.random((vertices, 3)).astype(np.float32)
    units = 4 * (joints - 2)
    places = np.argwhere(rng.random((units, 6 * (joints - 2))) < 0.3).T.astype(np.int64)
    return {
        "character_torch.skeleton.joint_parents": parents,
        "character_torch.skeleton.joint_translation_offsets": offsets,
        "character_torch.skeleton.joint_prerotations": turns,
        "character_torch.parameter_transform.parameter_transform": transform.reshape(7 * joints, -1),
        "character_torch.parameter_transform.scaling_parameters": scaling,
        "character_torch.linear_blend_skinning.inverse_bind_pose": states_of(inverse),
        "character_torch.linear_blend_skinning.skin_indices": np.array(
            [1 + rng.choice(joints - 1, 3, replace=False) for _ in range(vertices)], np.int32
        ),
        "character_torch.linear_blend_skinning.skin_weights": weights / weights.sum(1, keepdims=True),
        "character_torch.mesh.faces": np.array([[k, k + 1, k + 2] for k in range(vertices - 2)], np.int32),
        "character_torch.blend_shape.base_shape": np.array(20 * rng.normal(size=(vertices, 3)), np.float32),
        "character_torch.blend_shape.shape_vectors": np.array(
            rng.normal(size=(NUM_SHAPES, vertices, 3)), np.float32
        ),
        "pose_correctives_model.pose_dirs_predictor.0.sparse_indices": places,
        "pose_correctives_model.pose_dirs_predictor.0.sparse_weight": np.array(
            rng.normal(size=places.shape[1]), np.float32
        ),
        "pose_correctives_model.pose_dirs_predictor.2.weight": np.array(
            rng.normal(size=(3 * vertices, units)), np.float32
        ),
    }


def states_of(matrices):
    """Convert similarity transforms to Momentum's rows: translation, quaternion with w last, size."""
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_matrix(matrices[:, :3, :3]).as_quat()
    return np.concatenate([matrices[:, :3, 3], turns, np.ones((len(matrices), 1))], 1).astype(np.float32)


def about(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    turn = np.eye(3)
    turn[i, i], turn[j, j], turn[i, j], turn[j, i] = c, c, -s, s
    return turn


def euler(angles):
    return about(2, angles[2]) @ about(1, angles[1]) @ about(0, angles[0])


def momentum_states(parents, offsets, turns, amounts):
    """Multiply the transforms of the joints from the root on: offset, rotation at rest, angles, size."""
    states = []
    for joint, parent in enumerate(parents):
        x, y, z, w = turns[joint].astype(float)
        turn = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        own = np.eye(4)
        own[:3, :3] = 2.0 ** amounts[joint, 6] * turn @ euler(amounts[joint, 3:6])
        own[:3, 3] = offsets[joint] + amounts[joint, :3]
        states.append(own if parent < 0 else states[parent] @ own)
    return np.array(states)


def mhr_forward(arrays, parameters, coefficients):
    """Compute the vertices in centimetres."""
    own = {".".join(name.split(".")[-2:]): values for name, values in arrays.items()}
    parents, offsets = own["skeleton.joint_parents"], own["skeleton.joint_translation_offsets"]
    full = np.pad(parameters, (0, NUM_SHAPES))
    amounts = (own["parameter_transform.parameter_transform"] @ full).reshape(len(parents), 7)
    turns = own["skeleton.joint_prerotations"]
    states = momentum_states(parents, offsets, turns, amounts)
    rest = momentum_states(parents, offsets, turns, np.zeros_like(amounts))
    features = []
    for joint in range(2, len(parents)):
        e = euler(amounts[joint, 3:6]) - np.eye(3)
        features += [*e[:, 0], *e[:, 1]]
    units = np.zeros(own["2.weight"].shape[1])
    for (unit, column), weight in zip(own["0.sparse_indices"].T, own["0.sparse_weight"], strict=True):
        units[unit] += weight * features[column]
    surface = own["blend_shape.base_shape"] + np.einsum(
        "k,kva->va", coefficients, own["blend_shape.shape_vectors"]
    )
    surface = surface + (own["2.weight"] @ np.maximum(units, 0)).reshape(-1, 3)
    found = np.zeros_like(surface, float)
    for vertex, (joints, shares) in enumerate(
        zip(own["linear_blend_skinning.skin_indices"], own["linear_blend_skinning.skin_weights"], strict=True)
    ):
        for joint, share in zip(joints, shares, strict=True):
            moved = states[joint] @ np.linalg.inv(rest[joint]) @ [*surface[vertex], 1.0]
            found[vertex] += share * moved[:3]
    return found


STORAGES = {
    "f4": "FloatStorage",
    "f8": "DoubleStorage",
    "i8": "LongStorage",
    "i4": "IntStorage",
    "b1": "BoolStorage",
}


def write_torch(path, arrays):
    """Write tensors as `torch.jit.save` does: modules of modules in a pickle, and raw numbers beside it."""
    tree: dict = {}
    for name, values in arrays.items():
        *above, last = name.split(".")
        inner = tree
        for each in above:
            inner = inner.setdefault(each, {})
        inner[last] = values
    stored: list[bytes] = []
    pickled = b"\x80\x02" + _module(tree, stored) + b"."
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as file:
        file.writestr("mhr_model/data.pkl", pickled)
        file.writestr("mhr_model/byteorder", "little")
        for number, data in enumerate(stored):
            file.writestr(f"mhr_model/data/{number}", data)
    return path


def _text(text):
    return b"X" + struct.pack("<I", len(text)) + text.encode()


def _integers(numbers):
    return b"(" + b"".join(b"J" + struct.pack("<i", number) for number in numbers) + b"t"


def _tensor(values, stored):
    kind = STORAGES[values.dtype.str[1:]]
    key = str(len(stored))
    stored.append(values.tobytes())
    storage = b"(" + _text("storage") + f"ctorch\n{kind}\n".encode() + _text(key) + _text("cpu")
    storage += b"J" + struct.pack("<i", values.size) + b"tQ"
    steps = [step // values.itemsize for step in values.strides]
    hooks = b"\x89ccollections\nOrderedDict\n)R"
    return (
        b"ctorch._utils\n_rebuild_tensor_v2\n(" + storage + b"J\x00\x00\x00\x00" + _integers(values.shape)
        + _integers(steps) + hooks + b"tR"
    )  # fmt: skip


def _module(tree, stored):
    state = b"}("
    for name, each in tree.items():
        state += _text(name) + (_module(each, stored) if isinstance(each, dict) else _tensor(each, stored))
    return b"c__torch__.made\nModule\n)\x81" + state + _text("training") + b"\x89ub"
