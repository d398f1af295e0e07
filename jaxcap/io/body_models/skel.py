"""SKEL (Keller et al. 2023): the skin of SMPL on the joints of an OpenSim model, from its files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial.transform import Rotation

from ...arguments import checked
from ...body.body import Body
from ...body.body_model import BodyModel
from ...body.pose import Motion, Pose
from ...body.shape_modes import ShapeModes
from ...body.skeleton import make_skeleton
from ...body.skin import CorrectedSkin, LinearSkin, RotationMatrixFeatures
from ...errors import InputError
from ...value_checks import check_at_least
from ..archives.npz import get_array
from ..archives.pickle_arrays import read_pickled_arrays
from ..skeletons.twist_axes import twist_orientations
from ..system.reader_errors import reader_of
from .skel_joints import FIRST_ANGLES, JOINTS, NAMES, NUM_ANGLES, bone_frames, joint_shifts
from .smpl import NUM_BETAS, check_sums, joint_parents

_VERSION = "1.1.1"
#: the entry that only SKEL's files have
TREE = "osim_kintree_table"
#: number of the joints of SMPL, whose pose-dependent displacements SKEL has
_SMPL_JOINTS = 24
#: the entries of a file
ARRAYS = (
    "skin_template_v", "skin_template_f", "shapedirs", "posedirs", "J_regressor_osim", "skin_weights", TREE,
    "per_joint_rot", "apose_rel_transfo", "version",
)  # fmt: skip


class _Joints(NamedTuple):
    """The joints of a file."""

    parents: list[int]
    regressor: Float[np.ndarray, "J V"]
    #: orientations of bones that were learned, and their places in the OpenSim model, relative to the parents
    learned: Float[np.ndarray, "J 3 3"]
    at_rest: Float[np.ndarray, "J 4 4"]


@checked
@reader_of("a file of SKEL")
def read_skel(
    path: str | Path,
    *,
    num_betas: int = NUM_BETAS,
    num_expression: int = 0,
    joints: Literal["full", "tracking"] = "full",
) -> BodyModel:
    """Read SKEL from `skel_male.pkl` or `skel_female.pkl`, without unpickling: its skin, and not the meshes of its bones.

    Joints rotate about the axes of the world at rest, and `read_skel_motion` makes such poses of SKEL's angles. The model has no
    expressions.

    **Arguments:** `num_betas`, the number of coefficients, all that the file has if it has fewer; `joints`: "full", all joints rotate
    freely; "tracking", knees, ankles, toes, elbows and wrists rotate about the axes that they have in the mean shape.

    **Raises:** `InputError` if the file is of another version, is damaged, or its arrays do not fit each other.
    """
    return make_skel(read_pickled_arrays(path, ARRAYS), path, num_betas, num_expression, joints)


def make_skel(
    entries: Mapping[str, Any],
    path: str | Path,
    num_betas: int = NUM_BETAS,
    num_expression: int = 0,
    joints: Literal["full", "tracking"] = "full",
) -> BodyModel:
    """Make the model of the entries of a file, with the options of `read_skel`. Raises `InputError`."""
    check_at_least("read_skel", 0, num_betas=num_betas, num_expression=num_expression)
    arrays = _latest(entries, path)
    found = _joints(arrays, path)
    vertices = get_array(arrays, "skin_template_v", path, (None, 3), row_name="vertex")
    count, num_joints = len(vertices), len(JOINTS)
    directions = get_array(arrays, "shapedirs", path, (count, 3, None), row_name="vertex")
    by_pose = get_array(arrays, "posedirs", path, (count, 3, 9 * (_SMPL_JOINTS - 1)), row_name="vertex")
    weights = get_array(arrays, "skin_weights", path, (count, num_joints), row_name="vertex")
    faces = get_array(arrays, "skin_template_f", path, (None, 3), "whole").astype(int)
    if found.regressor.shape[1] != count:
        raise InputError(
            f"{path}: 'J_regressor_osim' is for {found.regressor.shape[1]} vertices, and 'skin_template_v' has {count}."
        )
    check_sums(weights, found.regressor, path)
    size = min(num_betas, directions.shape[2])
    by_shape = np.moveaxis(directions[:, :, :size], 2, 0)
    # each joint has the displacements of its counterpart, or none
    blocks = [
        by_pose[:, :, 9 * (joint.smpl - 1) : 9 * joint.smpl] if joint.smpl else np.zeros((count, 3, 9))
        for joint in JOINTS[1:]
    ]
    centres = found.regressor @ vertices
    kinds, axes = ["free"], np.tile(np.eye(3)[:2], (num_joints, 1, 1))
    frames = _axis_frames(found, centres)
    for number, joint in enumerate(JOINTS[1:], 1):
        few = joints == "tracking" and len(joint.axes) < 3
        kinds.append(("revolute", "universal")[len(joint.axes) - 1] if few else "ball")
        for slot, axis in enumerate(joint.axes[::-1][:2]):
            axes[number, slot] = frames[number] @ (np.array(axis) / np.linalg.norm(axis))
    skeleton = make_skeleton(
        NAMES,
        found.parents,
        kinds,
        centres,
        orientations=twist_orientations(centres, found.parents),
        axes=axes,
    )
    skin = CorrectedSkin(
        LinearSkin(jnp.asarray(np.maximum(weights, 0.0))),
        RotationMatrixFeatures(),
        jnp.asarray(np.concatenate(blocks, 2)),
    )
    return BodyModel(
        template=Body(skeleton, skin, jnp.asarray(vertices), jnp.asarray(faces)),
        modes=ShapeModes(
            jnp.asarray(np.einsum("jv,kva->kja", found.regressor, by_shape)), jnp.asarray(by_shape)
        ),
        template_coefficients=jnp.zeros(size),
        groups=(("betas", size),),
        family="SKEL",
    )


@checked
@reader_of("a file of SKEL")
def read_skel_motion(
    path: str | Path,
    angles: Float[np.ndarray | Array, "F A"],
    trans: Float[np.ndarray | Array, "F 3"],
    betas: Float[np.ndarray | Array, "K"] | None = None,
    rate: float = 30.0,
) -> Motion:
    """Convert the pose parameters of SKEL over frames to poses of the body of `read_skel` with the same coefficients.

    Shoulder blades and spine also slide in their parents, as in SKEL. The axes of the joints depend on the shape.

    **Arguments:** `angles`, SKEL's 46 `poses`, radians; `trans`, metres; `betas`, the coefficients of the person, zeros by default; `rate`,
    frames per second.

    **Raises:** `InputError` as `read_skel`, and if there are other numbers of angles, frames or coefficients.
    """
    arrays = _latest(read_pickled_arrays(path, ARRAYS), path)
    found = _joints(arrays, path)
    vertices = get_array(arrays, "skin_template_v", path, (found.regressor.shape[1], 3), row_name="vertex")
    directions = get_array(arrays, "shapedirs", path, (len(vertices), 3, None), row_name="vertex")
    values, moves = np.asarray(angles, float), np.asarray(trans, float)
    z = np.zeros(0) if betas is None else np.asarray(betas, float)
    if values.shape[1] != NUM_ANGLES or not len(values) or len(moves) != len(values):
        raise InputError(
            f"{path}: {values.shape[0]} frames of {values.shape[1]} angles and {len(moves)} frames of `trans` were given; expected at "
            f"least one, of {NUM_ANGLES} angles, for both."
        )
    if len(z) > directions.shape[2] or not all(np.isfinite(some).all() for some in (values, moves, z)):
        raise InputError(
            f"{path}: {len(z)} coefficients were given; expected finite numbers, and at most {directions.shape[2]} coefficients."
        )
    centres = found.regressor @ (vertices + directions[:, :, : len(z)] @ z)
    frames = _axis_frames(found, centres)
    turns = np.tile(np.eye(3), (len(values), len(JOINTS), 1, 1))
    for number, joint in enumerate(JOINTS):
        for k, axis in enumerate(joint.axes):
            about = values[:, FIRST_ANGLES[number] + k, None] * np.array(axis)
            turns[:, number] = Rotation.from_rotvec(about).as_matrix() @ turns[:, number]
    turns = np.einsum("jab,fjbc,jdc->fjad", frames, turns, frames)
    quaternions = Rotation.from_matrix(turns.reshape(-1, 3, 3)).as_quat(scalar_first=True)
    shifts = joint_shifts(values, centres)
    shifts[:, 0] = moves
    poses = Pose(
        jnp.asarray(shifts), jnp.asarray(quaternions.reshape(*turns.shape[:2], 4)), jnp.ones(len(values))
    )
    return Motion(poses, rate)


def _latest(entries: Mapping[str, Any], path: str | Path) -> Mapping[str, np.ndarray]:
    """Return the arrays of a file of the latest version. Raises `InputError` for another one."""
    if entries.get("version") != _VERSION:
        raise InputError(
            f"{path}: the version of this file of SKEL is {entries.get('version')}; expected {_VERSION}, the latest of its authors."
        )
    return {name: np.asarray(values) for name, values in entries.items() if name != "version"}


def _joints(arrays: Mapping[str, np.ndarray], path: str | Path) -> _Joints:
    """Read the joints of a file. Raises `InputError`."""
    count = len(JOINTS)
    parents = joint_parents(arrays, path, TREE)
    if len(parents) != count:
        raise InputError(f"{path}: the model has {len(parents)} joints; expected the {count} of SKEL.")
    return _Joints(
        parents,
        get_array(arrays, "J_regressor_osim", path, (count, None), row_name="joint"),
        get_array(arrays, "per_joint_rot", path, (count, 3, 3), row_name="joint"),
        get_array(arrays, "apose_rel_transfo", path, (count, 4, 4), row_name="joint"),
    )


def _axis_frames(joints: _Joints, centres: Float[np.ndarray, "J 3"]) -> Float[np.ndarray, "J 3 3"]:
    """Compute the axes of the OpenSim model's joints in a person of these centres, at rest."""
    offsets = joints.at_rest[:, :3, 3]
    frames = bone_frames(joints.parents, centres, joints.learned, offsets)
    return frames @ np.swapaxes(joints.at_rest[:, :3, :3], 1, 2)
