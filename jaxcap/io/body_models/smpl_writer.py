"""Bodies as body models in SMPL's format, without coefficients of shape."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...arguments import checked
from ...body.body import Body
from ...body.skin import AbstractSkin, CorrectedSkin, LinearSkin, QuaternionFeatures, RotationMatrixFeatures
from ...errors import InputError
from ...geometry.linear import least_squares
from ..system.atomic import atomic_path
from .smpl import JOINT_NAMES

#: number of shape directions, all zero, as readers expect some
NUM_SHAPES = 10
#: vertices nearest to a joint from which its centre is regressed
NUM_REGRESSED = 100
#: number of the root's parent in SMPL's files
NO_PARENT = 2**32 - 1


@checked
def write_body_model(path: str | Path, body: Body) -> None:
    """Write a body as a model in SMPL's format, `.npz`: its weights, and displacements by the pose as `posedirs`.

    The displacements are those of a `CorrectedSkin` that is linear in rotation matrices, as in SMPL, or in quaternions, as in
    STAR. The model has no coefficients of shape: its shape directions are zero. The rotations of poses are those of the body.
    The names of the joints are in the array `joint_names`, which `read_body_model` reads and other programs ignore.

    **Raises:** `InputError` if the skin is not linear blending, displacements are not linear in such features, there are several
    roots, joints other than the root translate, or the file cannot be written.
    """
    path = Path(path)
    skin, directions = _split_skin(path, body.skin)
    skeleton, vertices = body.skeleton, np.asarray(body.vertices, float)
    parents = np.array(skeleton.parents)
    if parents[0] >= 0 or (parents[1:] < 0).any() or (parents >= np.arange(len(parents))).any():
        raise InputError(
            f"{path}: a model in SMPL's format has one root, and each parent comes before its children; this body has not."
        )
    moving = [
        name
        for name, kind in zip(skeleton.names[1:], skeleton.kinds[1:], strict=True)
        if kind in ("free", "translate")
    ]
    if moving:
        raise InputError(
            f"{path}: the joint '{moving[0]}' translates; in a model in SMPL's format only the root does."
        )
    table = np.stack([np.where(parents < 0, NO_PARENT, parents), np.arange(len(parents))])
    arrays = {
        "v_template": vertices,
        "shapedirs": np.zeros((len(vertices), 3, NUM_SHAPES)),
        **({} if directions is None else {"posedirs": directions}),
        "J_regressor": _joint_regressor(vertices, np.asarray(skeleton.centres, float)),
        "weights": np.asarray(skin.bone_weights(len(parents)), float),
        "kintree_table": table.astype(np.int64),
        "f": np.asarray(body.faces).astype(np.uint32),
        JOINT_NAMES: np.array(skeleton.names, dtype=str),
    }
    with atomic_path(path) as part, part.open("wb") as stream:
        np.savez_compressed(stream, **arrays)


def _split_skin(path: Path, skin: AbstractSkin) -> tuple[AbstractSkin, Float[np.ndarray, "V 3 P"] | None]:
    """Split a skin into linear blending and the directions of its displacements. Raises `InputError`."""
    directions = None
    if isinstance(skin, CorrectedSkin):
        linear = skin.layer is None or not skin.rectified
        if not linear or not isinstance(skin.features, (RotationMatrixFeatures, QuaternionFeatures)):
            raise InputError(
                f"{path}: the displacements of this body are not linear in rotations, as those of a model in SMPL's format are; write "
                "it as .npz without --as smpl."
            )
        directions = np.asarray(skin.directions, float)
        if skin.layer is not None:
            directions = directions @ np.asarray(skin.layer, float)
        skin = skin.skin
    if not isinstance(skin, LinearSkin):
        raise InputError(
            f"{path}: a model in SMPL's format has linear blend skinning, and this body has a {type(skin).__name__}; learn the body "
            "with --skin lbs."
        )
    return skin, directions


def _joint_regressor(
    vertices: Float[np.ndarray, "V 3"], centres: Float[np.ndarray, "J 3"]
) -> Float[np.ndarray, "J V"]:
    """Compute the joint centres as affine combinations of the vertices around them, with the least squared weights."""
    regressor = np.zeros((len(centres), len(vertices)))
    for joint, centre in enumerate(centres):
        near = np.argsort(np.linalg.norm(vertices - centre, axis=1))[:NUM_REGRESSED]
        rows = np.concatenate([(vertices[near] - centre).T, np.ones((1, len(near)))])
        regressor[joint, near] = least_squares(rows, np.array([0.0, 0.0, 0.0, 1.0]))
    return regressor
