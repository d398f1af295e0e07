"""Motions as `.npz` in the format of AMASS (Mahmood et al., ICCV 2019).

`poses (F, 3 J)` are rotation vectors of joints, parents first, each in the axes of the world at rest. `trans
(F, 3)` moves the root, which rotates about its rest centre: x' = R (x - c) + c + trans for points that follow
the root only. SMPL has the same map (Loper et al., 2015), so the format holds motions of other skeletons as
well; only the set of joints, their positions, and the meaning of `betas` are specific to SMPL. A body's rest
is y up, the world z up.
"""

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial.transform import Rotation

from ...arguments import checked
from ...body.pose import Motion, Pose
from ...body.skeleton import Skeleton
from ...errors import InputError, user_message
from ..archives.archive import array_names, load_arrays, read_format_name
from ..archives.npz import get_array, skeleton_arrays
from ..kinds import kind_of_arrays
from ..skinned.skinned import check_motion
from ..system.atomic import atomic_path
from ..system.reader_errors import reader_of
from ..text import check_frame_rate
from .parameters.arrays import NAMES, RATES, find_array, is_motion, one_shape, pose_vectors, translations
from .parameters.doubts import warn_of_doubts
from .parameters.joints import (
    NUM_TRUNK,
    SKELETON_PREFIX,
    SMPL_PARENTS,
    SMPL_X_PARTS,
    describe_joints,
    find_skeleton,
)

#: verticals of a world; -y is that of a camera, whose y axis points down
MotionUp = Literal["y", "z", "-y"]
#: from a y-up to a z-up world
_Y_UP_TO_Z_UP = Rotation.from_euler("x", 90, degrees=True)
_TO_Y_UP = {"z": _Y_UP_TO_Z_UP.inv(), "-y": Rotation.from_euler("x", 180, degrees=True)}
#: names of the rate in the two generations of the data set
_RATE_KEYS = RATES[:2]
_UP_KEY = "up_axis"
#: end of the names of standard deviations
_DEVIATIONS = "_deviations"
#: values of `gender`
GENDERS = ("female", "male", "neutral")
#: groups of coefficients of a shape
SHAPE_GROUPS = ("betas", "expression")
#: the group that may change from frame to frame in a motion of one person
_VARYING = "expression"
#: the weights of shape keys, and their names, of a body of other groups of coefficients
SHAPE_KEYS, SHAPE_KEY_NAMES = "morphs", "morph_names"
#: number of shape coefficients of a motion without a shape
NUM_BETAS = 16


@checked
def write_amass(
    path: str | Path,
    skeleton: Skeleton,
    motion: Motion,
    shape: Mapping[str, Float[Array | np.ndarray, "..."]] | None = None,
    gender: str = "neutral",
    up: Literal["y", "z"] = "z",
    with_skeleton: bool = True,
    deviations: tuple[Mapping[str, Float[np.ndarray, "..."]], Float[np.ndarray, "F J"]] | None = None,
) -> None:
    """Write a motion in AMASS's format.

    Keys are `trans`, `poses`, `betas`, `gender`, `mocap_framerate` and `mocap_frame_rate`; for the joints of SMPL-X also the
    parts of the poses, `root_orient`, `pose_body`, `pose_jaw`, `pose_eye` and `pose_hand`. The skeleton, without which the
    motion cannot be drawn, is under keys that begin with `skeleton.`. A constant scale of the poses is applied to the skeleton.

    **Arguments:** `shape`, the coefficients of a body model by the names of their groups, such as `betas` and `expression`,
    for all frames or with one row for each; `betas` are zeros where not given; groups of other names are shape keys, written as
    `morphs` with their `morph_names`; `up`, the vertical of the written world: AMASS has
    z, and with y the parameters are those of the motion's own coordinates. It is written as `up_axis`;
    `with_skeleton`, write the skeleton: not for frames of different people; `deviations`, standard deviations of the coefficients by
    their groups, written as `betas_deviations` and so on, and the expected distances of the joints in each frame from the true ones,
    `joint_deviations`, metres.

    **Raises:** `InputError` if a joint other than the root is translated, there are several roots, the scale
    changes, the motion has no frames or is not finite, or the file cannot be written.
    """
    check_motion(Path(path), skeleton, motion)
    moves = np.asarray(motion.poses.translations, float)
    scales = np.asarray(motion.poses.scale, float)
    scale = float(scales[0])
    roots = [name for name, parent in zip(skeleton.names, skeleton.parents, strict=True) if parent < 0]
    if len(roots) > 1:
        raise InputError(
            f"{path}: the skeleton has {len(roots)} roots, {', '.join(roots)}; the AMASS format has one only; write it as "
            ".npz or .bvh."
        )
    if np.abs(scales - scale).max() > 1e-6 * abs(scale):
        raise InputError(
            f"{path}: the scale of the motion changes from frame to frame; the AMASS format has one scale for all."
        )
    away = np.abs(moves[:, 1:]).max((0, 2), initial=0.0)
    if away.max(initial=0.0) > 1e-6:
        raise InputError(
            f"{path}: the joint '{skeleton.names[1 + int(away.argmax())]}' is translated, and the AMASS format has "
            "rotations only; write it as .npz or .bvh."
        )
    root = scale * np.asarray(skeleton.centres, float)[0]
    frames, joints = moves.shape[:2]
    turns = Rotation.from_quat(
        np.asarray(motion.poses.rotations, float).reshape(-1, 4), scalar_first=True
    ).as_rotvec()
    turns = turns.reshape(frames, joints, 3)
    upright = _Y_UP_TO_Z_UP if up == "z" else Rotation.identity()
    turns[:, 0] = (upright * Rotation.from_rotvec(turns[:, 0])).as_rotvec()
    own = {f"{SKELETON_PREFIX}{name}": values for name, values in skeleton_arrays(skeleton).items()}
    own[f"{SKELETON_PREFIX}centres"] = scale * np.asarray(skeleton.centres, float)
    arrays = {
        "trans": upright.apply(root + scale * moves[:, 0]) - root,
        _UP_KEY: np.array(up),
        "poses": turns.reshape(frames, 3 * joints),
        "betas": np.zeros(NUM_BETAS),
        **_shape_arrays(shape or {}),
        **({} if deviations is None else _deviation_arrays(*deviations)),
        "gender": np.array(gender),
        **_parts(skeleton, turns),
        **{name: np.array(float(motion.rate)) for name in _RATE_KEYS},
        **(own if with_skeleton else {}),
    }
    with atomic_path(path) as beside, open(beside, "wb") as file:
        np.savez_compressed(file, **arrays)


def _shape_arrays(shape: Mapping[str, Float[Array | np.ndarray, "..."]]) -> dict[str, np.ndarray]:
    """Return the arrays of groups of coefficients: those of SMPL's family by their names, all others as shape keys.

    Groups without coefficients, which programs that pose the model do not expect, are left out.
    """
    arrays = {name: np.asarray(values, float) for name, values in shape.items() if np.size(values)}
    others = [name for name in arrays if name not in SHAPE_GROUPS]
    found = {name: values for name, values in arrays.items() if name in SHAPE_GROUPS}
    if others:
        found[SHAPE_KEYS] = np.concatenate([arrays[name] for name in others], axis=-1)
        found[SHAPE_KEY_NAMES] = np.repeat(others, [arrays[name].shape[-1] for name in others])
    return found


def _deviation_arrays(
    shape: Mapping[str, Float[np.ndarray, "..."]], joints: Float[np.ndarray, "F J"]
) -> dict[str, np.ndarray]:
    arrays = {name: values for name, values in _shape_arrays(shape).items() if name != SHAPE_KEY_NAMES}
    return {
        **{f"{name}{_DEVIATIONS}": values for name, values in arrays.items()},
        f"joint{_DEVIATIONS}": joints,
    }


def _up_axis(path: str | Path, arrays: Mapping[str, np.ndarray]) -> str:
    """Return the vertical that a file states, z if it states none. Raises `InputError` for another one than y and z."""
    stated = arrays.get(_UP_KEY, np.array("z"))
    axis = str(stated.reshape(-1)[0]).lower() if stated.size == 1 else ""
    if axis not in ("y", "z"):
        raise InputError(f"{path}: the array '{_UP_KEY}' is {stated.tolist()}; expected y or z.")
    return axis


def _parts(skeleton: Skeleton, turns: Float[np.ndarray, "F J 3"]) -> dict[str, np.ndarray]:
    """Split the poses of SMPL-X into their parts; nothing for other joints."""
    if skeleton.parents != SMPL_PARENTS[55]:
        return {}
    parts = {name: turns[:, first:last] for name, (first, last) in SMPL_X_PARTS.items()}
    return {
        "surface_model_type": np.array("smplx"),
        **{name: values.reshape(len(turns), -1) for name, values in parts.items()},
    }


@checked
@reader_of("an AMASS motion")
def read_amass_shape(path: str | Path) -> tuple[dict[str, Float[np.ndarray, "N"]], str]:
    """Read the shape coefficients of a motion in AMASS's format by the names of their groups, and its gender.

    Shape keys are groups of one coefficient. An expression of each frame is left out. The gender is empty if the file has none, or has it as an object.

    **Raises:** `InputError` if the file is damaged, or its frames have different shapes.
    """
    arrays = dict(load_arrays(path, lambda name: name in (*SHAPE_GROUPS, SHAPE_KEYS, SHAPE_KEY_NAMES)))
    arrays |= {name: one_shape(arrays[name]) for name in SHAPE_GROUPS if name in arrays}
    if arrays.get(_VARYING, np.zeros(0)).ndim == 2:
        warnings.warn(
            f"{path}: the expression changes from frame to frame; it is left out.",
            stacklevel=4,
        )
        del arrays[_VARYING]
    for name, values in arrays.items():
        if values.ndim == 2:
            raise InputError(
                f"{path}: the array '{name}' has the shape {values.shape}, so that every frame has a shape of its own; expected the "
                "parameters of one person."
            )
    shape = {name: get_array(arrays, name, path, (None,)) for name in SHAPE_GROUPS if name in arrays}
    if SHAPE_KEYS in arrays:
        weights = get_array(arrays, SHAPE_KEYS, path, (None,))
        names = get_array(arrays, SHAPE_KEY_NAMES, path, (len(weights),), "text")
        shape |= {str(name): weights[k : k + 1] for k, name in enumerate(names)}
    return shape, _gender(path)


@checked
@reader_of("an AMASS motion")
def read_amass_deviations(
    path: str | Path,
) -> tuple[dict[str, Float[np.ndarray, "*frames N"]], Float[np.ndarray, "F J"]] | None:
    """Read the standard deviations of a motion's coefficients, by the names of their groups, and of its joints, metres.

    Those of coefficients have one row for each frame if these have different shapes. Shape keys are one group, `morphs`. The result
    is None if the file has no deviations.

    **Raises:** `InputError` if the file is damaged, or only a part of them is in it.
    """
    arrays = load_arrays(path, lambda name: name.endswith(_DEVIATIONS))
    if not arrays:
        return None
    joints = arrays.get(f"joint{_DEVIATIONS}")
    if joints is None or joints.ndim != 2 or joints.dtype.kind != "f":
        raise InputError(
            f"{path}: the array 'joint{_DEVIATIONS}' is missing or damaged; write the file again."
        )
    groups = {
        name.removesuffix(_DEVIATIONS): values.astype(float)
        for name, values in arrays.items()
        if name.removesuffix(_DEVIATIONS) in (*SHAPE_GROUPS, SHAPE_KEYS)
    }
    for name, values in groups.items():
        if values.ndim not in (1, 2) or (values.ndim == 2 and len(values) != len(joints)):
            raise InputError(
                f"{path}: the array '{name}{_DEVIATIONS}' has the shape {values.shape}; expected one row, or one for each of "
                f"{len(joints)} frames."
            )
    return groups, joints


def has_other_shape(path: str | Path) -> bool:
    """Test if a file is a motion in AMASS's format with a shape, whose joints are not in the file, so that they depend on it."""
    if not is_amass(path) or f"{SKELETON_PREFIX}names" in array_names(path):
        return False
    try:
        return any(np.any(values) for values in read_amass_shape(path)[0].values())
    except InputError:
        # frames with different shapes
        return True


def _gender(path: str | Path) -> str:
    try:
        gender = load_arrays(path, lambda name: name == "gender").get("gender", np.array(""))
    except InputError:
        # an object, which is never unpickled; poses and shape do not need it
        return ""
    text = gender.reshape(-1)[0] if gender.size == 1 and gender.dtype.kind in "US" else ""
    return text.decode("latin-1") if isinstance(text, bytes) else str(text)


def is_amass(path: str | Path) -> bool:
    """Check that a file is an `.npz` with the parameters of SMPL's family; false if it does not exist or is damaged."""
    try:
        names = array_names(path)
        return is_motion(names) and kind_of_arrays(names, read_format_name(path)) == "amass"
    except InputError:
        return False


@checked
@reader_of("an AMASS motion")
def read_amass(
    path: str | Path,
    skeleton: Skeleton | None = None,
    up: MotionUp | None = None,
    rate: float | None = None,
) -> tuple[Skeleton, Motion]:
    """Read a motion in AMASS's format; the world's `up` becomes y. By default it is that of the file, z if it states none.

    Files of AMASS itself have no joint positions: `skeleton` gives them, with the same joints in the same
    order, as SMPL's own; 22 joints are those of a body whose hands are at rest. The shape (`betas`, `dmpls`, `gender`) is not read,
    and need not be readable. The arrays may have the names and shapes of other programs (`parameters.arrays`), such as
    `global_orient`, `body_pose` and `transl`. `rate`, frames per second, is for files that state none.

    **Raises:** `InputError` if the file has another format, is damaged, has pickled numbers or no rate, or if
    its joints are not the skeleton's.
    """
    arrays = load_arrays(
        path, lambda name: name in NAMES or name == _UP_KEY or name.startswith(SKELETON_PREFIX)
    )
    poses, trans = read_parameters(arrays, path)
    found = find_skeleton(path, arrays, poses.shape[1] // 3, skeleton)
    per_second = _rate(path, arrays, rate)
    axis = up or _up_axis(path, arrays)
    if f"{SKELETON_PREFIX}names" not in arrays:
        warn_of_doubts(path, poses, trans, per_second, axis, known=up is not None or _UP_KEY in arrays)
    return found, _motion(found, poses, trans, per_second, axis)


@reader_of("an AMASS motion")
def describe_parameters(path: str | Path) -> str:
    """Describe a motion without a skeleton: frames, rate, joints, coefficients and gender. Raises `InputError`."""
    arrays = load_arrays(path, NAMES.__contains__)
    poses, _ = read_parameters(arrays, path)
    rate = (
        f" at {_rate(path, arrays, None):g} frames per second" if find_array(arrays, RATES) else ", no rate"
    )
    try:
        shape, gender = read_amass_shape(path)
        parts = [f"{len(values)} {name}" for name, values in shape.items()] or ["no betas"]
    except InputError as error:
        parts, gender = [_describe_other_shape(path, error)], _gender(path)
    whose = f", {gender}" if gender else ""
    return (
        f"motion in AMASS format: {len(poses)} frame{'' if len(poses) == 1 else 's'}{rate}, {describe_joints(poses.shape[1] // 3)}, "
        f"{', '.join(parts)}{whose}; the positions of the joints follow from its body model"
    )


def _describe_other_shape(path: str | Path, error: InputError) -> str:
    """Describe a shape that is not that of one person, or that an error keeps from being read."""
    try:
        betas = load_arrays(path, lambda name: name == SHAPE_GROUPS[0]).get(SHAPE_GROUPS[0])
    except InputError:
        # a pickled object
        betas = None
    if betas is not None and one_shape(betas).ndim == 2:
        return "a shape for each frame"
    reason = user_message(error).removeprefix(f"{path}: ").rstrip(".")
    return f"a shape that cannot be read: {reason}"


def read_parameters(
    arrays: Mapping[str, np.ndarray], path: str | Path
) -> tuple[Float[np.ndarray, "F D"], Float[np.ndarray, "F 3"]]:
    """Return `poses` and `trans` of the arrays of a motion. Raises `InputError`."""
    poses = pose_vectors(arrays, path)
    if not len(poses):
        raise InputError(f"{path}: the file has no frames; expected at least one.")
    found = {"poses": poses, "trans": translations(arrays, len(poses), path)}
    return (
        get_array(found, "poses", path, (None, None), row_name="frame"),
        get_array(found, "trans", path, (None, 3), row_name="frame"),
    )


def _motion(
    skeleton: Skeleton, poses: np.ndarray, trans: Float[np.ndarray, "F 3"], rate: float, up: str
) -> Motion:
    frames, joints = len(poses), skeleton.num_joints
    turns = np.zeros((frames, joints, 3))
    # joints that the file does not have are at rest
    known = NUM_TRUNK if poses.shape[1] != 3 * joints else joints
    turns[:, :known] = poses.reshape(frames, -1, 3)[:, :known]
    rotations = Rotation.from_rotvec(turns.reshape(-1, 3)).as_quat(canonical=True, scalar_first=True)
    rotations = rotations.reshape(frames, joints, 4)
    moves, root = np.zeros((frames, joints, 3)), np.asarray(skeleton.centres, float)[0]
    moves[:, 0] = trans
    if up != "y":
        upright = _TO_Y_UP[up] * Rotation.from_rotvec(turns[:, 0])
        rotations[:, 0] = upright.as_quat(canonical=True, scalar_first=True)
        moves[:, 0] = _TO_Y_UP[up].apply(root + trans) - root
    return Motion(Pose(jnp.asarray(moves), jnp.asarray(rotations), jnp.ones(frames)), rate)


def _rate(path: str | Path, arrays: Mapping[str, np.ndarray], given: float | None) -> float:
    """Return the rate of a file, or the given one if it states none. Raises `InputError`."""
    name = find_array(arrays, RATES)
    if name is None and given is not None:
        return check_frame_rate(given, str(path))
    if name is None:
        raise InputError(
            f"{path}: the array '{_RATE_KEYS[0]}', or 'fps', is missing, so the rate is unknown; add it, or give --rate in `jaxcap convert`, or rate= "
            "in Python."
        )
    found = arrays[name]
    if (
        given is not None
        and found.size == 1
        and found.dtype.kind in "iuf"
        and float(found.reshape(-1)[0]) != given
    ):
        raise InputError(
            f"{path}: the file states {float(found.reshape(-1)[0]):g} frames per second in '{name}', and {given:g} were given; leave out "
            "the rate, or resample the motion with `jaxcap edit resample`."
        )
    if found.size != 1 or found.dtype.kind not in "iuf":
        raise InputError(
            f"{path}: the frame rate has the shape {found.shape} and the type {found.dtype}; expected a number above zero."
        )
    return check_frame_rate(float(found.reshape(-1)[0]), str(path))
