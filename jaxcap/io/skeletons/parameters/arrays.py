"""Parameters of SMPL's family under the names and in the shapes of many programs, as the arrays of AMASS.

AMASS has `poses (F, 3 J)`, `trans (F, 3)`, `betas (N)` and a rate. The package `smplx` and the programs that use it have `transl` and
the parts of a pose, such as `global_orient` and `body_pose`; others have `fullpose`, a row of joints, rotation matrices, a batch of
one, or the coefficients in every frame.
"""

from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ....errors import InputError
from ...archives.archive import load_arrays

#: names of each array of a motion, that of AMASS first
POSES = ("poses", "fullpose", "full_pose", "smpl_poses")
TRANS = ("trans", "transl", "translation", "smpl_trans")
RATES = ("mocap_framerate", "mocap_frame_rate", "fps", "framerate", "frame_rate")
#: parts of a pose: names, and numbers of joints, the first one if the part is missing
_ROOT = (("global_orient", "root_orient"), (1,))
_BODY = (("body_pose", "pose_body"), (21, 23))
_FACE = ((("jaw_pose", "pose_jaw"), (1,)), (("leye_pose",), (1,)), (("reye_pose",), (1,)))
_EYES = (("pose_eye",), (2,))
_HANDS = ((("left_hand_pose",), (15,)), (("right_hand_pose",), (15,)))
_BOTH_HANDS = (("pose_hand",), (30,))
_PARTS = (_ROOT, _BODY, *_FACE, _EYES, *_HANDS, _BOTH_HANDS)
#: names of all arrays that are read
NAMES = frozenset((*POSES, *TRANS, *RATES, *(name for names, _ in _PARTS for name in names)))
#: names that files of depth, clouds and meshes do not have, with the poses of cameras and a rate
BODY_KEYS = frozenset((TRANS[0], *RATES[:2], *POSES[1:], *_BODY[0]))
#: largest difference of coefficients that are those of one person
SAME_SHAPE = 1e-4


def is_motion(names: Collection[str]) -> bool:
    """Test if the names of arrays are those of a motion: poses, or their parts, and a translation or a rate."""
    found = set(names)
    split = all(found & set(part[0]) for part in (_ROOT, _BODY))
    return (split or bool(found & set(POSES))) and bool(found & {*TRANS, *RATES})


def find_array(arrays: Collection[str], names: Collection[str]) -> str | None:
    """Find the first of some names that a file has."""
    return next((name for name in names if name in arrays), None)


def pose_vectors(arrays: Mapping[str, np.ndarray], path: str | Path) -> np.ndarray:
    """Return the rotation vectors of all joints, (F, 3 J), in AMASS's order. Raises `InputError`."""
    name = find_array(arrays, POSES)
    if name is not None:
        return _vectors(arrays[name], name, path)
    if not all(_find(arrays, part) for part in (_ROOT, _BODY)):
        raise InputError(
            f"{path}: the array '{POSES[0]}' is missing; expected it, or its parts, such as '{_ROOT[0][0]}' and '{_BODY[0][0]}'."
        )
    face = any(_find(arrays, part) for part in (*_FACE, _EYES))
    hands = any(_find(arrays, part) for part in (*_HANDS, _BOTH_HANDS))
    eyes = (_EYES,) if _find(arrays, _EYES) else _FACE[1:]
    fingers = (_BOTH_HANDS,) if _find(arrays, _BOTH_HANDS) else _HANDS
    parts = [_ROOT, _BODY, *((_FACE[0], *eyes) if face else ()), *(fingers if face or hands else ())]
    found = [_part(arrays, part, path) for part in parts]
    frames = max(len(each) for each in found if each is not None)
    columns = []
    for values, (names, counts) in zip(found, parts, strict=True):
        if values is not None and len(values) != frames:
            raise InputError(
                f"{path}: the array '{_find(arrays, (names, counts))}' has {len(values)} frames, and other parts of the poses have "
                f"{frames}; write the file again."
            )
        columns.append(np.zeros((frames, 3 * counts[0])) if values is None else values)
    if columns[1].shape[1] == 3 * 23 and len(columns) > 2:
        # the hands of SMPL are joints of their own in the other models
        columns[1] = columns[1][:, : 3 * 21]
    return np.concatenate(columns, axis=1)


def count_joints(path: str | Path) -> int:
    """Count the joints of the poses in a file. Raises `InputError`."""
    return pose_vectors(load_arrays(path, NAMES.__contains__), path).shape[1] // 3


def translations(arrays: Mapping[str, np.ndarray], frames: int, path: str | Path) -> np.ndarray:
    """Return the translations, (F, 3), where their shape is unambiguous. Raises `InputError` if there are none."""
    name = find_array(arrays, TRANS)
    if name is None:
        raise InputError(
            f"{path}: the array '{TRANS[0]}' (or '{TRANS[1]}') of the translation is missing; add it, or zeros if the translation is "
            "not known."
        )
    values = arrays[name]
    if values.size == 3 * frames and values.shape[-1:] == (3,):
        return values.reshape(frames, 3)
    raise InputError(
        f"{path}: the array '{name}' has the shape {values.shape}; expected ({frames}, 3), as there are {frames} frames."
    )


def one_shape(values: np.ndarray) -> np.ndarray:
    """Return coefficients as one row, if all rows are those of one person; unchanged if they are not."""
    if values.ndim < 2 or values.dtype.kind not in "biuf" or not values.size:
        return values
    rows = values.reshape(-1, values.shape[-1]).astype(float)
    return rows[0] if np.abs(rows - rows[0]).max() <= SAME_SHAPE else rows


def _find(arrays: Mapping[str, np.ndarray], part: tuple[tuple[str, ...], tuple[int, ...]]) -> str | None:
    return find_array(arrays, part[0])


def _part(
    arrays: Mapping[str, np.ndarray], part: tuple[tuple[str, ...], tuple[int, ...]], path: str | Path
) -> Float[np.ndarray, "F D"] | None:
    """Return the rotation vectors of a part, None if it is missing. Raises `InputError`."""
    name = _find(arrays, part)
    if name is None:
        return None
    counts = part[1]
    values = _vectors(arrays[name], name, path, counts)
    if values.shape[1] not in [3 * count for count in counts]:
        wanted = " or ".join(str(3 * count) for count in counts)
        components = "hand" in name and values.shape[1] < 3 * counts[0]
        raise InputError(
            f"{path}: the array '{name}' has {values.shape[1]} numbers for each frame; expected {wanted}"
            + (
                ". Principal components of hands are not read: convert them to rotations, by use_pca=False in smplx."
                if components
                else ", a rotation vector for each joint."
            )
        )
    return values


def _vectors(values: np.ndarray, name: str, path: str | Path, counts: tuple[int, ...] = ()) -> np.ndarray:
    """Return rotations as rows of rotation vectors: of vectors, of matrices, with or without axes of joints and of a batch of one.

    `counts` are the numbers of joints that a part may have. Raises `InputError`.
    """
    if values.dtype.kind not in "biuf":
        raise InputError(f"{path}: the array '{name}' has the type {values.dtype}; expected numbers.")
    if not values.size and values.ndim != 2:
        raise InputError(
            f"{path}: the array '{name}' has the shape {values.shape}, so it is empty; give at least one frame."
        )
    if values.ndim >= 3 and values.shape[-2:] == (3, 3) and (values.ndim > 3 or 1 in counts):
        return _of_matrices(values, name, path, counts)
    if 1 in counts and values.ndim == 3 and values.shape[0] == 1 and values.shape[2] == 3:
        # the second axis is that of frames, as there is one joint
        return values[0]
    if values.ndim >= 3 and values.shape[-1] == 3:
        # joints have an axis of their own
        values = values.reshape(*values.shape[:-2], -1)
    if values.ndim == 3 and 1 in values.shape[:2]:
        values = values.reshape(-1, values.shape[-1])
    values = values[None] if values.ndim == 1 else values
    if values.ndim != 2 or values.shape[1] % 3 or not values.shape[1]:
        raise InputError(
            f"{path}: the array '{name}' has the shape {values.shape}; expected (frames, 3 * joints)."
        )
    return values


def _of_matrices(
    values: np.ndarray, name: str, path: str | Path, counts: tuple[int, ...]
) -> Float[np.ndarray, "F D"]:
    """Convert rotation matrices to rows of rotation vectors. Raises `InputError` for other matrices."""
    joints = 1 if 1 in counts else values.shape[-3]
    matrices = values.reshape(-1, 3, 3).astype(float)
    wrong = np.abs(np.einsum("nab,ncb->nac", matrices, matrices) - np.eye(3)).max((1, 2), initial=0.0)
    if not (wrong < 0.01).all() or (np.linalg.det(matrices) < 0).any():
        raise InputError(
            f"{path}: the array '{name}' has the shape {values.shape} of rotation matrices, but some are no rotations; write it again."
        )
    return Rotation.from_matrix(matrices).as_rotvec().reshape(-1, 3 * joints)
