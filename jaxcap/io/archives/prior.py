"""Priors of pose and shape in files: on their own, or in the file of their body."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from ...adapt.shape.shape_prior import ShapePrior, prior_edges, uniform_laplacian
from ...arguments import checked
from ...body.body import Body
from ...body.pose import Pose
from ...body.skeleton import Skeleton
from ...errors import InputError, user_message
from ...geometry.mesh import mesh_edges
from ...limits.rotation_vector_boxes import PoseBoxes, make_pose_boxes
from ...prior.pair_prior import PairPrior, describe_mismatch, make_pair_prior
from ..system.reader_errors import reader_of
from .archive import load_arrays
from .npz import (
    LIMITS_PREFIX,
    MIN_QUATERNION_NORM,
    extract_limits,
    get_array,
    load_format,
    save_arrays,
    save_body,
)

#: the format's name in a separate file
FORMAT = "jaxcap prior"


class Priors(NamedTuple):
    """The priors of a body in a file."""

    #: the probability of poses
    prior: PairPrior
    #: joint ranges; None if the file has none
    boxes: PoseBoxes | None
    #: the shape distribution of its meshes; None if there were none
    shape: ShapePrior | None


@checked
def save_prior(
    path: str | Path,
    prior: PairPrior,
    boxes: PoseBoxes | None = None,
    body: Body | None = None,
    limits: Mapping[str, np.ndarray] | None = None,
    shape: ShapePrior | None = None,
) -> None:
    """Write a pose prior, with boxes and a `shape` prior if given.

    With a body, they are written into a body file, which `load_body` reads, together with other `limits`.

    **Raises:** `InputError` if the file cannot be written, or a prior belongs to another skeleton or surface
    than the body's.
    """
    arrays = prior_arrays(prior, boxes) | ({} if shape is None else shape_prior_arrays(shape))
    if body is None:
        save_arrays(path, FORMAT, arrays)
        return
    check_prior_skeleton(prior, body.skeleton, path)
    if shape is not None:
        _check_topology(len(shape.vectors[0]), prior_edges(shape), body, path)
    save_body(path, body, {**(limits or {}), **arrays})


@checked
@reader_of("a prior")
def load_priors(path: str | Path, body: Body, *, shape: bool = True) -> Priors:
    """Read the pose and shape priors of `body` at once; without `shape`, the pose priors only.

    **Raises:** `InputError` if the file has no pose prior, is damaged or inconsistent, or belongs to another
    skeleton than the body's, or its shape to another surface.
    """
    arrays = _arrays(path)
    prior, boxes = _prior(arrays, path, body.skeleton), _boxes(arrays, path, body.skeleton)
    return Priors(prior, boxes, _shape(arrays, path, body) if shape else None)


def has_prior(path: str | Path) -> bool:
    """Check that a body file contains a pose prior. Raises `InputError` if it is no complete `.npz`."""
    name = f"{LIMITS_PREFIX}prior.weights"
    return name in load_arrays(path, lambda there: there == name)


@checked
@reader_of("a prior")
def load_prior(path: str | Path, skeleton: Skeleton | None = None) -> PairPrior:
    """Read a pose prior from a separate file or from a body file.

    **Raises:** `InputError` if the file has none, is damaged or inconsistent, or if `skeleton` is given and
    the prior belongs to another one.
    """
    return _prior(_arrays(path), path, skeleton)


@reader_of("a prior")
def load_boxes(path: str | Path, skeleton: Skeleton | None = None) -> PoseBoxes | None:
    """Read the boxes of a prior file; None if there are none. Errors as in `load_prior`."""
    return _boxes(_arrays(path), path, skeleton)


@checked
@reader_of("a prior")
def load_shape_prior(path: str | Path, body: Body) -> ShapePrior | None:
    """Read the shape prior of `body`, in the dtype of its vertices; None if there is none.

    **Raises:** `InputError` if the file is damaged, or the prior has another number of vertices or joints, or
    other triangles, than the body.
    """
    return _shape(_arrays(path), path, body)


def shape_prior_size(path: str | Path) -> tuple[int, int] | None:
    """Return the numbers of meshes and vertices of a shape prior; None if there is none.

    Errors as in `load_prior`.
    """
    arrays = _arrays(path)
    if "shape.vectors" not in arrays:
        return None
    meshes, vertices = get_array(arrays, "shape.vectors", path, (None, None, 3), row_name="mesh").shape[:2]
    return meshes, vertices


def check_prior_skeleton(prior: PairPrior, skeleton: Skeleton, path: str | Path) -> None:
    """Check that a prior belongs to a skeleton. Raises `InputError`."""
    reason = describe_mismatch(prior, skeleton)
    if reason is not None:
        raise InputError(
            f"{path}: this prior belongs to another skeleton: {reason}; learn a prior for this skeleton. "
            "`jaxcap prior learn --body` retargets motions."
        )


def prior_arrays(prior: PairPrior, boxes: PoseBoxes | None = None) -> dict[str, np.ndarray]:
    """Convert a prior to named arrays; its peaks are recomputed when it is read."""
    arrays = {"prior.pairs": np.array(prior.pairs, dtype=str)}
    arrays |= {
        f"prior.{name}": np.asarray(getattr(prior, name))
        for name in ("frames", "weights", "means", "factors")
    }
    if boxes is not None:
        arrays["boxes.joints"] = np.array(boxes.joints, dtype=str)
        arrays |= {f"boxes.{name}": np.asarray(getattr(boxes, name)) for name in ("lower", "upper")}
    return arrays


def shape_prior_arrays(shape: ShapePrior) -> dict[str, np.ndarray]:
    """Convert a shape prior to named float32 arrays.

    Its Laplacian is recomputed from the body for which it is read.
    """
    arrays = {"shape.edges": prior_edges(shape).astype(np.int32)}
    numbers = {"vectors": shape.vectors}
    numbers |= {
        name: np.asarray(getattr(shape.poses, name)) for name in ("translations", "rotations", "scale")
    }
    return arrays | {f"shape.{name}": values.astype(np.float32) for name, values in numbers.items()}


def _prior(arrays: Mapping[str, np.ndarray], path: str | Path, skeleton: Skeleton | None) -> PairPrior:
    if "prior.weights" not in arrays:
        raise InputError(f"{path}: the file contains no pose prior; learn one with `jaxcap prior learn`.")
    pairs = get_array(arrays, "prior.pairs", path, (None, 2), "text").tolist()
    weights = get_array(arrays, "prior.weights", path, (len(pairs), None))
    shape = weights.shape
    try:
        prior = make_pair_prior(
            tuple((above, below) for above, below in pairs),
            _read_quaternions(arrays, "prior.frames", path, (len(pairs), 2, 4)),
            weights,
            get_array(arrays, "prior.means", path, (*shape, 6)),
            get_array(arrays, "prior.factors", path, (*shape, 6, 6)),
        )
    except ValueError as error:
        raise InputError(f"{path}: {user_message(error)}") from None
    if skeleton is not None:
        check_prior_skeleton(prior, skeleton, path)
    return prior


def _boxes(arrays: Mapping[str, np.ndarray], path: str | Path, skeleton: Skeleton | None) -> PoseBoxes | None:
    if "boxes.joints" not in arrays:
        return None
    joints = get_array(arrays, "boxes.joints", path, (None,), "text").tolist()
    lower, upper = (get_array(arrays, f"boxes.{name}", path, (len(joints), 3)) for name in ("lower", "upper"))
    lacking = [] if skeleton is None else [name for name in joints if name not in skeleton.names]
    if skeleton is not None and lacking:
        raise InputError(
            f"{path}: these joint ranges belong to another skeleton: '{lacking[0]}' is not among the joints "
            f"{', '.join(skeleton.names)}."
        )
    try:
        return make_pose_boxes(joints, lower, upper)
    except ValueError as error:
        raise InputError(f"{path}: {user_message(error)}") from None


def _shape(arrays: Mapping[str, np.ndarray], path: str | Path, body: Body) -> ShapePrior | None:
    if "shape.vectors" not in arrays:
        return None
    vectors = get_array(arrays, "shape.vectors", path, (None, None, 3), row_name="mesh")
    meshes, vertices = vectors.shape[:2]
    _check_topology(vertices, get_array(arrays, "shape.edges", path, (None, 2), "whole"), body, path)
    joints = body.skeleton.num_joints
    if not meshes:
        raise InputError(f"{path}: the shape prior has no meshes; learn it again.")
    numbers = (
        get_array(arrays, "shape.translations", path, (meshes, joints, 3), row_name="mesh"),
        _read_quaternions(arrays, "shape.rotations", path, (meshes, joints, 4)),
        get_array(arrays, "shape.scale", path, (meshes,), row_name="mesh"),
    )
    poses = Pose(*(jnp.asarray(values, body.vertices.dtype) for values in numbers))
    return ShapePrior(uniform_laplacian(body), poses, vectors.astype(float))


def _read_quaternions(
    arrays: Mapping[str, np.ndarray], name: str, path: str | Path, shape: tuple[int, ...]
) -> np.ndarray:
    """Return an array of quaternions after a check that none is zero. Raises `InputError`."""
    turns = get_array(arrays, name, path, shape)
    if not (np.linalg.norm(turns, axis=-1) > MIN_QUATERNION_NORM).all():
        raise InputError(f"{path}: the array '{name}' contains zero quaternions; learn the prior again.")
    return turns


def _check_topology(vertices: int, edges: Int[np.ndarray, "E 2"], body: Body, path: str | Path) -> None:
    """Check that a shape prior has the vertices and edges of a body. Raises `InputError`."""
    if vertices != len(body.vertices):
        raise InputError(
            f"{path}: this shape prior has {vertices} vertices and the body has {len(body.vertices)}; learn a prior from "
            "meshes of this body."
        )
    if not np.array_equal(edges, mesh_edges(np.asarray(body.faces))):
        raise InputError(
            f"{path}: this shape prior has other triangles than the body; learn a prior from meshes of this body."
        )


def _is_prior_array(name: str) -> bool:
    return name.removeprefix(LIMITS_PREFIX).startswith(("prior.", "boxes.", "shape."))


def _arrays(path: str | Path) -> dict[str, np.ndarray]:
    """Read the arrays of priors from a separate file or from a body file."""
    arrays = load_format(path, FORMAT, "jaxcap body", select=_is_prior_array)
    return arrays if str(arrays["format"]) == FORMAT else extract_limits(arrays)
