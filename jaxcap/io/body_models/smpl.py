"""Body models of SMPL's family, as their authors distribute them (`.npz` and `.pkl`)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...arguments import checked
from ...body.body import Body
from ...body.body_model import BodyModel
from ...body.shape_modes import ShapeModes
from ...body.skeleton import Skeleton, make_skeleton
from ...body.skin import (
    AbstractPoseFeatures,
    CorrectedSkin,
    LinearSkin,
    QuaternionFeatures,
    RotationMatrixFeatures,
)
from ...errors import InputError
from ...value_checks import check_at_least
from ..archives.archive import load_arrays
from ..archives.npz import get_array
from ..archives.pickle_arrays import read_pickled_arrays
from ..kinds import kind_of_arrays
from ..skeletons.twist_axes import twist_orientations
from ..system.reader_errors import reader_of
from .families import FAMILIES, PARENTS, STAR, Family, family_in_name, split_directions
from .learned import is_own_model, read_own_model

#: the arrays of a model
ARRAYS = ("v_template", "shapedirs", "posedirs", "J_regressor", "weights", "kintree_table", "f")
#: names of the joints of a model of no known family, as `write_body_model` writes them
JOINT_NAMES = "joint_names"
#: numbers of coefficients that are read by default, as by the package `smplx`
NUM_BETAS, NUM_EXPRESSION = 10, 10
#: largest error of the sum of the weights of a vertex, and of a row of the joint regressor
WEIGHT_SUM_TOLERANCE, REGRESSOR_SUM_TOLERANCE = 1e-3, 0.02


@checked
@reader_of("a body model")
def read_body_model(
    path: str | Path,
    *,
    num_betas: int = NUM_BETAS,
    num_expression: int = NUM_EXPRESSION,
    joints: Literal["full", "tracking"] = "full",
) -> BodyModel:
    """Read a body model of SMPL's family: SMPL, SMPL-H, SMPL-X, MANO, FLAME or STAR, `.npz` or `.pkl`, or one that
    `save_body_model` wrote.

    The joints have the names of the package `smplx`, in the order of the file. A pickle is not unpickled: its arrays are read,
    and anything else in it is refused (`read_pickled_arrays`). The model is y up, in metres, as the file has it. The rotations
    of a `Pose` of the template are those of the model's pose parameters, and the translation of its first joint is `trans`.

    **Arguments:** `num_betas` and `num_expression`, numbers of shape and of expression coefficients, all that the file has if
    it has fewer; `joints`: "full", all joints rotate; "tracking", those of hands and face are fixed, because a scan of a whole
    body does not show them.

    **Raises:** `InputError` if the file has another format or family than its name states, is damaged, or its arrays do not
    fit each other.
    """
    if is_own_model(path):
        return read_own_model(path, num_betas)
    return make_smpl(_load(Path(path)), path, num_betas, num_expression, joints)


def make_smpl(
    arrays: Mapping[str, np.ndarray],
    path: str | Path,
    num_betas: int = NUM_BETAS,
    num_expression: int = NUM_EXPRESSION,
    joints: Literal["full", "tracking"] = "full",
) -> BodyModel:
    """Make a body model of the arrays of a file, with the options of `read_body_model`. Raises `InputError`."""
    check_at_least("read_body_model", 0, num_betas=num_betas, num_expression=num_expression)
    if kind_of_arrays(arrays) != "body model":
        raise InputError(
            f"{path}: this is no body model; expected the arrays {', '.join(ARRAYS)} of a model of SMPL's family. Poses of a person are "
            "read from .npz files, with poses, trans, betas and fps; write them with numpy.savez."
        )
    vertices = get_array(arrays, "v_template", path, (None, 3), row_name="vertex")
    parents = joint_parents(arrays, path)
    count, num_joints = len(vertices), len(parents)
    directions = get_array(arrays, "shapedirs", path, (count, 3, None), row_name="vertex")
    regressor = get_array(arrays, "J_regressor", path, (num_joints, count), row_name="joint")
    weights = get_array(arrays, "weights", path, (count, num_joints), row_name="vertex")
    faces = get_array(arrays, "f", path, (None, 3), "whole").astype(int)
    check_sums(weights, regressor, path)
    correctives = _correctives(arrays, path, count, num_joints)
    family = (
        _own_family(arrays, path, num_joints)
        if JOINT_NAMES in arrays
        else _family(path, parents, correctives)
    )
    groups = split_directions(family.name, directions.shape[2])
    wanted = {"betas": num_betas, "expression": num_expression}
    kept = {name: min(wanted[name], size) for name, (_, size) in groups.items()}
    columns = [groups[name][0] + k for name, size in kept.items() for k in range(size)]
    by_shape = np.moveaxis(directions[:, :, columns], 2, 0)
    skeleton = _skeleton(family, parents, regressor @ vertices, joints)
    skin = LinearSkin(jnp.asarray(np.maximum(weights, 0.0)))
    modes_centres = np.einsum("jv,kva->kja", regressor, by_shape)
    if correctives is not None:
        features, by_pose = correctives
        width = features.num_features(num_joints)
        # STAR's last direction depends on the second shape coefficient; the joints do not depend on it
        if by_pose.shape[2] > width and kept["betas"] > 1:
            by_shape[1] += by_pose[:, :, width]
        skin = CorrectedSkin(skin, features, jnp.asarray(by_pose[:, :, :width]))
    body = Body(skeleton, skin, jnp.asarray(vertices), jnp.asarray(faces))
    return BodyModel(
        template=body,
        modes=ShapeModes(jnp.asarray(modes_centres), jnp.asarray(by_shape)),
        template_coefficients=jnp.zeros(len(columns)),
        groups=tuple(kept.items()),
        family=family.name,
    )


def _load(path: Path) -> Mapping[str, np.ndarray]:
    """Read the arrays of a model from a pickle or an `.npz` file."""
    if path.suffix.lower() == ".pkl":
        return filled_arrays(read_pickled_arrays(path, ARRAYS))
    return load_arrays(path, lambda name: name in (*ARRAYS, JOINT_NAMES))


def filled_arrays(found: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Return the entries of a pickle as arrays, without those that are None."""
    return {name: np.asarray(values) for name, values in found.items() if values is not None}


def joint_parents(
    arrays: Mapping[str, np.ndarray], path: str | Path, name: str = "kintree_table"
) -> list[int]:
    """Return the parents of the joints; the root's is any number that is no joint. Raises `InputError`."""
    table = get_array(arrays, name, path, (2, None), "whole").astype(np.int64)
    parents = table[0].copy()
    parents[0] = -1
    joints = np.arange(len(parents))
    if (table[1] != joints).any():
        raise InputError(
            f"{path}: the joints of '{name}' are numbered {table[1].tolist()}; expected 0 to {len(parents) - 1} in order."
        )
    if (parents[1:] < 0).any() or (parents >= joints).any():
        wrong = int(np.argmax((parents >= joints) | ((parents < 0) & (joints > 0))))
        raise InputError(
            f"{path}: joint {wrong} has the parent {parents[wrong]} in '{name}'; expected a joint before it."
        )
    return parents.tolist()


def check_sums(weights: Float[np.ndarray, "V J"], regressor: Float[np.ndarray, "J V"], path) -> None:
    """Check that weights are at least zero, and that they and the rows of the joint regressor sum to one. Raises `InputError`."""
    if weights.min() < -WEIGHT_SUM_TOLERANCE:
        vertex, joint = np.unravel_index(int(weights.argmin()), weights.shape)
        raise InputError(
            f"{path}: the weight of joint {joint} for vertex {vertex} is {weights.min():.3g}; expected weights of at least 0."
        )
    for name, rows, tolerance, what in (
        ("weights", weights, WEIGHT_SUM_TOLERANCE, "vertex"),
        ("J_regressor", regressor, REGRESSOR_SUM_TOLERANCE, "joint"),
    ):
        sums = rows.sum(1)
        wrong = int(np.argmax(np.abs(sums - 1.0)))
        if abs(sums[wrong] - 1.0) > tolerance:
            raise InputError(
                f"{path}: the array '{name}' sums to {sums[wrong]:.3g} for {what} {wrong}; expected one. The file is no model of "
                "SMPL's family, or it is damaged."
            )


def _correctives(
    arrays: Mapping[str, np.ndarray], path: str | Path, count: int, num_joints: int
) -> tuple[AbstractPoseFeatures, Float[np.ndarray, "V 3 P"]] | None:
    """Return the pose-dependent displacements with their features; None if the model has none."""
    if "posedirs" not in arrays:
        return None
    directions = get_array(arrays, "posedirs", path, (count, 3, None), row_name="vertex")
    by_matrix, by_quaternion = (each.num_features(num_joints) for each in (_MATRICES, _QUATERNIONS))
    if directions.shape[2] == by_matrix:
        return _MATRICES, directions
    if directions.shape[2] in (by_quaternion, by_quaternion + 1):
        return _QUATERNIONS, directions
    raise InputError(
        f"{path}: the array 'posedirs' has {directions.shape[2]} directions for {num_joints} joints; expected {by_matrix} as in "
        f"SMPL, or {by_quaternion + 1} as in STAR."
    )


_MATRICES, _QUATERNIONS = RotationMatrixFeatures(), QuaternionFeatures()


def _own_family(arrays: Mapping[str, np.ndarray], path: str | Path, num_joints: int) -> Family:
    """Make a family without a name of the joints that a file names. Raises `InputError`."""
    names = tuple(str(name) for name in get_array(arrays, JOINT_NAMES, path, (num_joints,), "text"))
    if len(set(names)) < num_joints or not all(names):
        raise InputError(f"{path}: the array '{JOINT_NAMES}' has empty names or duplicates.")
    return Family("", names, (), ())


def _family(path: str | Path, parents: list[int], correctives: tuple | None) -> Family:
    """Find the family by the joints, and check that the file's name states no other one."""
    num_joints = len(parents)
    if num_joints not in FAMILIES:
        known = ", ".join(f"{family.name} {number}" for number, family in FAMILIES.items())
        raise InputError(
            f"{path}: the model has {num_joints} joints, which no known family has ({known} joints)."
        )
    family, stated = FAMILIES[num_joints], family_in_name(Path(path).name)
    wrong = [joint for joint in range(num_joints) if parents[joint] != PARENTS[num_joints][joint]]
    if wrong:
        raise InputError(
            f"{path}: the model has {num_joints} joints as in {family.name}, but joint {wrong[0]} has the parent {parents[wrong[0]]}; "
            f"expected {PARENTS[num_joints][wrong[0]]}."
        )
    if correctives is not None and isinstance(correctives[0], QuaternionFeatures):
        family = family._replace(name=STAR)
    # SMPL is also the name of the whole family
    if stated not in (None, family.name, FAMILIES[24].name):
        raise InputError(
            f"{path}: the name of the file states {stated}, but the model has {num_joints} joints"
            f"{' and displacements' if family.name == STAR else ''} as in {family.name}; rename the file, or give the right one."
        )
    return family


def _skeleton(family: Family, parents: list[int], centres: Float[np.ndarray, "J 3"], joints: str) -> Skeleton:
    fixed = family.small_joints if joints == "tracking" else ()
    kinds = ["free", *("fixed" if name in fixed else "ball" for name in family.joints[1:])]
    return make_skeleton(
        family.joints, parents, kinds, centres, orientations=twist_orientations(centres, parents)
    )
