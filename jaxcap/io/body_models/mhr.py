"""The Momentum Human Rig (MHR, Ferguson et al. 2025) from the TorchScript file of its authors, without PyTorch."""

from pathlib import Path
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.spatial.transform import Rotation

from ...arguments import checked
from ...body.body import Body
from ...body.body_model import BodyModel
from ...body.pose import Motion, Pose
from ...body.shape_modes import ShapeModes
from ...body.skeleton import Skeleton, make_skeleton
from ...body.skin import AbstractSkin, CorrectedSkin, LinearSkin, RotationMatrixFeatures, StretchedSkin
from ...errors import InputError
from ...value_checks import check_at_least
from ..archives.npz import get_array
from ..archives.torch_archive import read_torch_arrays
from ..skeletons.twist_axes import twist_orientations
from ..system.reader_errors import reader_of
from .mhr_joints import SMALL_PARTS, names_of

Parameters = Float[np.ndarray | Array, "P"]

#: number of coefficients of a person's surface; those behind them are of expressions
NUM_IDENTITY = 45
#: metres of a unit of the file
UNIT = 0.01
#: largest distance of the bind pose from the skeleton at rest, in units of the file
BIND_TOLERANCE = 1e-2
#: the tensors, by the last two parts of their names
_RIG = (
    "skeleton.joint_translation_offsets",
    "skeleton.joint_prerotations",
    "skeleton.joint_parents",
    "parameter_transform.parameter_transform",
    "parameter_transform.scaling_parameters",
    "linear_blend_skinning.inverse_bind_pose",
    "linear_blend_skinning.skin_indices",
    "linear_blend_skinning.skin_weights",
)
_SURFACE = ("mesh.faces", "blend_shape.base_shape", "blend_shape.shape_vectors")
_NETWORK = ("0.sparse_indices", "0.sparse_weight", "2.weight")


class _Rig(NamedTuple):
    """The joints and parameters of a file, in its units."""

    parents: tuple[int, ...]
    offsets: Float[np.ndarray, "J 3"]
    #: rotations of the joints at rest
    frames: Float[np.ndarray, "J 3 3"]
    #: joint parameters of each model parameter: three translations, three angles and a logarithm of the size
    transform: Float[np.ndarray, "J 7 P"]
    #: true for parameters of proportions
    scaling: Bool[np.ndarray, "P"]
    weights: Float[np.ndarray, "V J"]
    #: the first joint is the root's place in the world, and the second one has its motion
    has_world: bool


class _Proportions(NamedTuple):
    """Sizes and centres of the joints at rest."""

    sizes: Float[np.ndarray, "J"]
    centres: Float[np.ndarray, "J 3"]


@checked
@reader_of("a TorchScript file of MHR")
def read_mhr(
    path: str | Path,
    proportions: Parameters | None = None,
    *,
    num_betas: int = NUM_IDENTITY,
    num_expression: int = 72,
    joints: Literal["full", "tracking"] = "full",
    correctives: bool = True,
) -> BodyModel:
    """Read the Momentum Human Rig from `mhr_model.pt`, in metres, y up.

    `betas` are the coefficients of identity, which move the surface and no joints. Lengths and sizes of bones are parameters of
    their own in MHR: `proportions` are model parameters, of which those of scaling are used. The pose-dependent displacements are
    the file's network. Joints rotate about the axes of the world at rest, and `read_mhr_motion` makes such poses of model parameters.
    Every joint moves by itself, also where MHR moves several by one parameter.

    **Arguments:** `proportions`, the model parameters of a person, zeros by default; `num_betas` and `num_expression`, numbers of
    coefficients, all that the file has if it has fewer; `joints`: "full", all that MHR moves; "tracking", fingers, face and twists
    of limbs are fixed; `correctives`, false without displacements, which take 0.7 GB.

    **Raises:** `InputError` if the file is no TorchScript file of MHR, is damaged, or its rig is of another kind.
    """
    check_at_least("read_mhr", 0, num_betas=num_betas, num_expression=num_expression)
    arrays = _load(path, (*_RIG, *_SURFACE, *(_NETWORK if correctives else ())))
    rig = _rig(arrays, path)
    count, num_joints = rig.weights.shape
    base = get_array(arrays, "blend_shape.base_shape", path, (count, 3), row_name="vertex")
    directions = get_array(arrays, "blend_shape.shape_vectors", path, (None, count, 3), row_name="direction")
    faces = get_array(arrays, "mesh.faces", path, (None, 3), "whole").astype(int)
    given = None if proportions is None else np.asarray(proportions, float)[None]
    rest = _place(rig, np.zeros(len(rig.scaling)))
    place = rest if given is None else _place(rig, _padded(rig, given, path)[0])
    shifts = place.centres - place.sizes[:, None] * rest.centres
    size = (rig.weights @ place.sizes)[:, None]
    skin: AbstractSkin = LinearSkin(jnp.asarray(rig.weights))
    if np.any(shifts) or np.any(place.sizes != 1.0):
        skin = StretchedSkin(skin, jnp.asarray(place.sizes), jnp.asarray(UNIT * shifts))
    if correctives and _NETWORK[-1] in arrays:
        skin = _with_network(skin, arrays, path, rig, UNIT * size)
    first = min(num_betas, NUM_IDENTITY, len(directions))
    behind = max(0, min(num_expression, len(directions) - NUM_IDENTITY))
    columns = [*range(first), *range(NUM_IDENTITY, NUM_IDENTITY + behind)]
    modes = UNIT * size * directions[columns]
    body = Body(
        _skeleton(rig, UNIT * place.centres, joints),
        skin,
        jnp.asarray(UNIT * (size * base + rig.weights @ shifts)),
        jnp.asarray(faces),
    )
    return BodyModel(
        template=body,
        modes=ShapeModes(jnp.zeros((len(columns), num_joints, 3)), jnp.asarray(modes)),
        template_coefficients=jnp.zeros(len(columns)),
        groups=(("betas", first), ("expression", behind)),
        family="MHR",
    )


@checked
@reader_of("a TorchScript file of MHR")
def read_mhr_motion(
    path: str | Path, parameters: Float[np.ndarray | Array, "F P"], rate: float = 30.0
) -> Motion:
    """Convert model parameters of MHR over frames to poses of the body of `read_mhr` with the same proportions.

    **Arguments:** `parameters` as MHR's own, `mhr_model_params` of SAM 3D Body, in centimetres and radians; `rate`, frames per second.

    **Raises:** `InputError` as `read_mhr`, and if the parameters are not as many as the file's, or proportions change over frames.
    """
    rig = _rig(_load(path, _RIG), path)
    values = _padded(rig, np.asarray(parameters, float), path)
    scales = values[:, rig.scaling]
    if np.ptp(scales, axis=0).max(initial=0.0) > 1e-3:
        raise InputError(
            f"{path}: the proportions change from frame to frame, by {np.ptp(scales, axis=0).max():.3g}; give all frames the scaling "
            "parameters of one person."
        )
    place = _place(rig, values[0])
    moves = np.einsum("jkp,fp->fjk", rig.transform, np.where(rig.scaling, 0.0, values))
    turns = (
        Rotation.from_euler("xyz", moves[:, :, 3:6].reshape(-1, 3))
        .as_matrix()
        .reshape(*moves.shape[:2], 3, 3)
    )
    turns = np.einsum("jab,fjbc,jdc->fjad", rig.frames, turns, rig.frames)
    above = np.maximum(rig.parents, 0)
    shifts = np.einsum("jab,fjb->fja", place.sizes[above, None, None] * rig.frames[above], moves[:, :, :3])
    shifts[:, np.array(rig.parents) < 0] = moves[:, np.array(rig.parents) < 0, :3]
    if rig.has_world:
        # the same rigid motion, about the centre of the first joint
        arm = place.centres[1] - place.centres[0]
        shifts[:, 0] = arm + shifts[:, 1] - turns[:, 1] @ arm
        turns[:, 0] = turns[:, 1]
        shifts[:, 1], turns[:, 1] = 0.0, np.eye(3)
    quaternions = Rotation.from_matrix(turns.reshape(-1, 3, 3)).as_quat(scalar_first=True)
    frames = len(values)
    poses = Pose(
        jnp.asarray(UNIT * shifts), jnp.asarray(quaternions.reshape(frames, -1, 4)), jnp.ones(frames)
    )
    return Motion(poses, rate)


def _load(path: str | Path, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Read tensors by the last two parts of their names. Raises `InputError` for a file without them."""
    found = read_torch_arrays(path, lambda name: ".".join(name.split(".")[-2:]) in names)
    arrays = {".".join(name.split(".")[-2:]): values for name, values in found.items()}
    missing = [name for name in names if name not in arrays and name not in _NETWORK]
    if missing:
        raise InputError(f"{path}: there is no tensor '{missing[0]}'; expected `mhr_model.pt` of MHR.")
    return arrays


def _rig(arrays: dict[str, np.ndarray], path: str | Path) -> _Rig:
    """Make the rig from its tensors. Raises `InputError` if it is damaged, or of another kind than MHR's."""
    parents = get_array(arrays, "skeleton.joint_parents", path, (None,), "whole").astype(int)
    count = len(parents)
    if (parents >= np.arange(count)).any() or (parents[1:] < 0).any() or not count or parents[0] >= 0:
        raise InputError(
            f"{path}: the parents of the joints are not before them; expected one tree of joints."
        )
    offsets = get_array(arrays, "skeleton.joint_translation_offsets", path, (count, 3), row_name="joint")
    turns = get_array(arrays, "skeleton.joint_prerotations", path, (count, 4), row_name="joint")
    # unit vectors only; a zero is no rotation
    local = Rotation.from_quat(turns).as_matrix()
    frames = np.zeros((count, 3, 3))
    for joint, parent in enumerate(parents):
        frames[joint] = local[joint] if parent < 0 else frames[parent] @ local[joint]
    scaling = arrays["parameter_transform.scaling_parameters"].reshape(-1) != 0
    transform = get_array(arrays, "parameter_transform.parameter_transform", path, (7 * count, len(scaling)))
    transform = transform.reshape(count, 7, -1)
    for what, some in (
        ("the size of a joint depends on a parameter of the pose", transform[:, 6:][..., ~scaling]),
        ("the angle of a joint depends on a parameter of proportions", transform[:, 3:6][..., scaling]),
    ):
        if np.any(some):
            raise InputError(f"{path}: {what}, which is not read; expected the parameters of MHR.")
    indices = get_array(arrays, "linear_blend_skinning.skin_indices", path, (None, None), "whole").astype(int)
    shares = get_array(arrays, "linear_blend_skinning.skin_weights", path, indices.shape, row_name="vertex")
    if indices.size and not 0 <= indices.min() <= indices.max() < count:
        raise InputError(f"{path}: a vertex follows the joint {indices.max()}; expected 0 to {count - 1}.")
    weights = np.zeros((len(indices), count))
    np.add.at(weights, (np.arange(len(indices))[:, None], indices), shares)
    if shares.min(initial=0.0) < 0 or np.abs(weights.sum(1) - 1.0).max(initial=0.0) > 1e-3:
        raise InputError(
            f"{path}: the weights of a vertex are below zero, or their sum is not one; the file is damaged."
        )
    moved = np.any(transform[:, :6][..., ~scaling], axis=(1, 2))
    has_world = count > 1 and not weights[:, 0].any() and not moved[0] and (parents == 0).sum() == 1
    rig = _Rig(tuple(parents.tolist()), offsets, frames, transform, scaling, weights, has_world)
    _check_bind(rig, arrays, path)
    return rig


def _check_bind(rig: _Rig, arrays: dict[str, np.ndarray], path: str | Path) -> None:
    """Check that the surface is bound to the skeleton at rest. Raises `InputError`."""
    name = "linear_blend_skinning.inverse_bind_pose"
    bind = get_array(arrays, name, path, (len(rig.parents), 8), row_name="joint")
    centres = _place(rig, np.zeros(len(rig.scaling))).centres
    turns = Rotation.from_quat(bind[:, 3:7]).as_matrix()
    away = np.linalg.norm(np.einsum("jab,jb->ja", turns, centres) + bind[:, :3], axis=1)
    turned = np.abs(turns @ rig.frames - np.eye(3)).max((1, 2))
    wrong = int(np.argmax(np.maximum(away, turned)))
    if max(away.max(), turned.max(), np.abs(bind[:, 7] - 1.0).max()) > BIND_TOLERANCE:
        raise InputError(
            f"{path}: the surface is bound to another pose than that of the skeleton at rest, at joint {wrong} first; such a rig is not "
            "read."
        )


def _padded(rig: _Rig, values: Float[np.ndarray, "F P"], path: str | Path) -> Float[np.ndarray, "F Q"]:
    """Add zeros for the file's last parameters, the coefficients of the surface, which move no joint. Raises `InputError`."""
    used = np.flatnonzero(rig.transform.any((0, 1))).max(initial=-1) + 1
    most = len(rig.scaling)
    if not used <= values.shape[1] <= most or not len(values) or not np.isfinite(values).all():
        raise InputError(
            f"{path}: {values.shape[0]} frames of {values.shape[1]} parameters were given; expected at least one, of {used} to {most} "
            "finite model parameters."
        )
    return np.pad(values, ((0, 0), (0, most - values.shape[1])))


def _place(rig: _Rig, values: Float[np.ndarray, "P"]) -> _Proportions:
    """Compute sizes and centres of the joints at rest from the parameters of proportions."""
    moves = rig.transform @ np.where(rig.scaling, values, 0.0)
    count = len(rig.parents)
    sizes, centres = np.ones(count), np.zeros((count, 3))
    for joint, parent in enumerate(rig.parents):
        step = rig.offsets[joint] + moves[joint, :3]
        sizes[joint] = 2.0 ** moves[joint, 6]
        centres[joint] = step
        if parent >= 0:
            sizes[joint] *= sizes[parent]
            centres[joint] = centres[parent] + sizes[parent] * (rig.frames[parent] @ step)
    return _Proportions(sizes, centres)


def _skeleton(rig: _Rig, centres: Float[np.ndarray, "J 3"], joints: str) -> Skeleton:
    """Make the skeleton, with the degrees of freedom that parameters of the pose have."""
    names = names_of(rig.parents)
    moved = np.any(rig.transform[..., ~rig.scaling], axis=2)
    kinds, axes = [], np.tile(np.eye(3)[:2], (len(names), 1, 1))
    for joint, name in enumerate(names):
        turning = np.flatnonzero(moved[joint, 3:6])
        kind = ("fixed", "revolute", "universal", "ball")[len(turning)]
        if moved[joint, :3].any():
            kind = "free" if len(turning) else "translate"
        if joint == 0:
            kind = "free"
        elif (joint == 1 and rig.has_world) or (
            joints == "tracking" and any(part in name for part in SMALL_PARTS)
        ):
            kind = "fixed"
        # angles are about x, then y, then z; a universal joint rotates about its second axis first
        for slot, axis in enumerate(turning[::-1][:2]):
            axes[joint, slot] = rig.frames[joint][:, axis]
        kinds.append(kind)
    orientations = twist_orientations(centres, list(rig.parents))
    return make_skeleton(names, rig.parents, kinds, centres, orientations=orientations, axes=axes)


def _with_network(
    skin: AbstractSkin,
    arrays: dict[str, np.ndarray],
    path: str | Path,
    rig: _Rig,
    size: Float[np.ndarray, "V 1"],
) -> CorrectedSkin:
    """Add the displacements by the network, whose inputs are two columns of each rotation, without those of the first two joints."""
    count, num_joints = rig.weights.shape
    directions = get_array(arrays, "2.weight", path, (3 * count, None))
    units = directions.shape[1]
    places = get_array(arrays, "0.sparse_indices", path, (2, None), "whole").astype(int)
    values = get_array(arrays, "0.sparse_weight", path, (places.shape[1],))
    inputs = 6 * (num_joints - 2)
    if places.size and (places.min() < 0 or places[0].max() >= units or places[1].max() >= inputs):
        raise InputError(
            f"{path}: the first layer of the network does not fit {inputs} inputs and {units} units."
        )
    first = np.zeros((units, inputs))
    first[places[0], places[1]] = values
    # entries of E - 1 = A^T (R - 1) A, with the frame A of a joint: columns 0 and 1, each from the top
    frames = rig.frames[2:]
    entries = np.einsum("jia,jkb->jbaik", frames, frames)[:, :2]
    by_joint = np.einsum("ujn,jnm->ujm", first.reshape(units, -1, 6), entries.reshape(-1, 6, 9))
    layer = np.concatenate([np.zeros((units, 9)), by_joint.reshape(units, -1)], 1)
    dtype = np.result_type(directions.dtype)
    moves = (directions.reshape(count, 3, units) * size[:, :, None].astype(dtype)).astype(dtype)
    return CorrectedSkin(skin, RotationMatrixFeatures(), jnp.asarray(moves), jnp.asarray(layer.astype(dtype)))
