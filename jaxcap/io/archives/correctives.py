"""Pose-dependent displacements as arrays of a body file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from ...body.skin import (
    AbstractPoseFeatures,
    AbstractSkin,
    CorrectedSkin,
    QuaternionFeatures,
    RotationMatrixFeatures,
)
from ...errors import InputError
from ..text import shortened

#: features by their name in files
FEATURES: dict[str, AbstractPoseFeatures] = {
    "rotation matrices": RotationMatrixFeatures(),
    "quaternions": QuaternionFeatures(),
}
_FEATURES, _DIRECTIONS = "correctives.features", "correctives.directions"
#: weights of a rectified layer between the features and the directions, and of a linear one
_LAYER, _LINEAR_LAYER = "correctives.layer", "correctives.linear_layer"


def corrective_arrays(skin: CorrectedSkin, path: str | Path) -> dict[str, Any]:
    """Convert displacements to named arrays. Raises `InputError` for features that have no name."""
    kind = next((name for name, each in FEATURES.items() if type(each) is type(skin.features)), None)
    if kind is None:
        raise InputError(
            f"{path}: the displacements of this body depend on {type(skin.features).__name__}, which cannot be written; use "
            f"{' or '.join(FEATURES)}."
        )
    layer = {} if skin.layer is None else {_LAYER if skin.rectified else _LINEAR_LAYER: skin.layer}
    return {_FEATURES: np.array(kind), _DIRECTIONS: skin.directions, **layer}


def add_correctives(
    skin: AbstractSkin, arrays: Mapping[str, np.ndarray], num_joints: int, path: str | Path
) -> AbstractSkin:
    """Add the displacements among the arrays of a body file to its skin; return it unchanged if there are none.

    **Raises:** `InputError` if they do not fit the skin or the number of joints.
    """
    if _FEATURES not in arrays or _DIRECTIONS not in arrays:
        return skin
    kind, directions = str(arrays[_FEATURES]), arrays[_DIRECTIONS]
    if kind not in FEATURES:
        raise InputError(
            f"{path}: the displacements depend on '{shortened(kind)}', which is unknown; expected {' or '.join(FEATURES)}."
        )
    count = skin.dominant_bones().shape[0]
    if directions.ndim != 3 or directions.shape[:2] != (count, 3) or directions.dtype.kind != "f":
        raise InputError(
            f"{path}: the array '{_DIRECTIONS}' has the shape {directions.shape} and the type {directions.dtype}; expected "
            f"numbers of shape ({count}, 3, features)."
        )
    given, expected = directions.shape[2], FEATURES[kind].num_features(num_joints)
    rectified = _LINEAR_LAYER not in arrays
    name = _LAYER if rectified else _LINEAR_LAYER
    layer = arrays.get(name)
    if layer is not None:
        if layer.shape != (given, expected) or layer.dtype.kind != "f" or not np.isfinite(layer).all():
            raise InputError(
                f"{path}: the array '{name}' has the shape {layer.shape} and the type {layer.dtype}; expected finite numbers of "
                f"shape ({given}, {expected})."
            )
        expected = given
    if given != expected:
        raise InputError(
            f"{path}: the array '{_DIRECTIONS}' has {given} features; expected {expected} for {num_joints} joints."
        )
    if not np.isfinite(directions).all():
        raise InputError(
            f"{path}: the array '{_DIRECTIONS}' has numbers that are not finite; write it again."
        )
    return CorrectedSkin(
        skin,
        FEATURES[kind],
        jnp.asarray(directions),
        None if layer is None else jnp.asarray(layer),
        rectified,
    )
