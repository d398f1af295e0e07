"""Shared parts of the readers of skinned, animated bodies: the bind pose, and motions relative to it."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ...body.body import Body
from ...body.pose import Motion, Pose
from ...body.skeleton import Skeleton, make_skeleton
from ...body.skin import LinearSkin
from ...errors import InputError, user_message
from ...geometry.linear import inverse
from ..text import MAX_NUMBER, check_frame_rate
from .skinned_surface import SkinnedSurface

#: largest relative error of a scale of one
_SCALE_TOLERANCE = 1e-5


class FileJoints(NamedTuple):
    """The joints of a file, in its order; a root's parent is -1."""

    names: Sequence[str]
    parents: Sequence[int]
    #: None for the default: free for a root, ball for another joint
    kinds: Sequence[str | None]
    axes: Float[np.ndarray, "J 2 3"]
    #: from the space of the surface into the frame of each joint
    inverse_bind: Float[np.ndarray, "J 4 4"]


class BindPose(NamedTuple):
    """A skeleton; the order of its joints may differ from that of the file."""

    skeleton: Skeleton
    #: the file's index of each joint of the skeleton
    order: tuple[int, ...]
    #: from the surface's space to the world at rest, and from the world at rest into each joint's frame
    surface_to_world: Float[np.ndarray, "4 4"]
    inverse_bind: Float[np.ndarray, "J 4 4"]


def make_bind_pose(path: Path, joints: FileJoints, surface_to_world: Float[np.ndarray, "4 4"]) -> BindPose:
    """Build the skeleton at rest from the bind pose; the joints' frames there are their orientations.

    **Raises:** `InputError` if joints are sheared or mirrored, or form no tree.
    """
    inverse = joints.inverse_bind @ invert_affine(path, surface_to_world)
    rest = invert_affine(path, inverse)
    size = np.cbrt(np.linalg.det(rest[:, :3, :3]))
    # uniform scales are removed, such as centimetres below a scale of 0.01
    rest[:, :3, :3] /= np.where(size == 0, 1.0, size)[:, None, None]
    check_rotations(path, rest[:, :3, :3])
    _check_positions(path, rest[:, :3, 3], "joints")
    frames = Rotation.from_matrix(rest[:, :3, :3]).as_quat(scalar_first=True)
    plain = ["free" if parent < 0 else "ball" for parent in joints.parents]
    kinds = [kind or other for kind, other in zip(joints.kinds, plain, strict=True)]
    try:
        skeleton = make_skeleton(joints.names, joints.parents, kinds, rest[:, :3, 3], frames, joints.axes)
    except ValueError as error:
        raise InputError(f"{path}: {user_message(error)}") from None
    place = {name: number for number, name in enumerate(joints.names)}
    order = tuple(place[name] for name in skeleton.names)
    return BindPose(skeleton, order, surface_to_world, inverse[list(order)])


def surface_to_world_transform(
    path: Path, above_root: Float[np.ndarray, "3 3"], root: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "4 4"]:
    """Compute the rotation and scale of a surface in the world, without the rotation of its root.

    Programs convert z up and centimetres in a node above the joints. `above_root` is the transform above the root;
    `root` is the transform from the surface to the world through the root.

    **Raises:** `InputError` if a scale is zero or mirrors, or if `above_root` is sheared.
    """
    scale, size = np.cbrt(np.linalg.det(root)), np.cbrt(np.linalg.det(above_root))
    if not (scale > 0 and size > 0):
        raise InputError(
            f"{path}: the transform above the joints has a zero scale or mirrors; export it again."
        )
    check_rotations(path, above_root[None] / size)
    placed = np.eye(4)
    placed[:3, :3] = above_root / size * (1.0 if abs(scale - 1) < _SCALE_TOLERANCE else scale)
    return placed


def make_skinned_body(path: Path, bound: BindPose, surface: SkinnedSurface) -> Body:
    """Build the body of a surface with weights for the skeleton's joints. Raises `InputError`."""
    vertices = surface.vertices @ bound.surface_to_world[:3, :3].T + bound.surface_to_world[:3, 3]
    _check_positions(path, vertices, "vertices")
    dtype = bound.skeleton.centres.dtype
    skin = LinearSkin(jnp.asarray(surface.weights, dtype))
    return Body(bound.skeleton, skin, jnp.asarray(vertices, dtype), jnp.asarray(surface.faces))


def make_skinned_motion(
    path: Path, bound: BindPose, frames: Float[np.ndarray, "F J 4 4"], rate: float
) -> Motion:
    """Build the motion from the `frames` of the joints in the world, in the skeleton's order.

    **Raises:** `InputError` if a joint is scaled or sheared individually.
    """
    # T_j, from rest to pose, is the joint's frame times its inverse bind matrix
    bones, skeleton = frames @ bound.inverse_bind, bound.skeleton
    scale = np.cbrt(np.linalg.det(bones[:, 0, :3, :3]))
    if not (scale > 0).all():
        raise InputError(
            f"{path}: in frame {int(np.argmin(scale > 0))} the joints have a zero scale or are mirrored; export it again."
        )
    bones[:, :, :3] /= scale[:, None, None, None]
    check_rotations(path, bones[:, :, :3, :3])
    check_frame_rate(rate, str(path))
    centres, count = np.array(skeleton.centres, float), len(bones)
    translations, rotations = np.zeros((count, len(centres), 3)), np.zeros((count, len(centres), 4))
    for joint, parent in enumerate(skeleton.parents):
        local = bones[:, joint] if parent < 0 else invert_affine(path, bones[:, parent]) @ bones[:, joint]
        turn = Rotation.from_matrix(local[:, :3, :3])
        rotations[:, joint] = turn.as_quat(canonical=True, scalar_first=True)
        translations[:, joint] = local[:, :3, 3] + turn.apply(centres[joint]) - centres[joint]
    _check_positions(path, translations, "joints")
    dtype = skeleton.centres.dtype
    return Motion(
        Pose(*(jnp.asarray(values, dtype) for values in (translations, rotations, scale))), float(rate)
    )


def invert_affine(path: Path, matrices: Float[np.ndarray, "*any 4 4"]) -> Float[np.ndarray, "*any 4 4"]:
    """Invert affine transforms. Raises `InputError` if one is singular."""
    flat = matrices[..., :3, :3]
    # a measure of singularity that does not depend on scale; numbers too large for it are rejected as singular ones
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        sizes = np.linalg.norm(flat, axis=-2)
        room = np.abs(np.linalg.det(flat)) / np.prod(sizes, axis=-1)
    affine = np.abs(matrices[..., 3, :] - [0.0, 0, 0, 1]).max(initial=0) < 1e-3
    if not (room > 1e-6).all() or not affine:
        raise InputError(
            f"{path}: the transform of a joint is singular and cannot be inverted; export the skin again."
        )
    return inverse(matrices)


def _check_positions(path: Path, positions: Float[np.ndarray, "*any 3"], what: str) -> None:
    """Check that positions are finite and not too large. Raises `InputError`."""
    if not (np.abs(positions) <= MAX_NUMBER).all():
        raise InputError(
            f"{path}: {what} are further than {MAX_NUMBER:g} m from the origin; check the scales of the file."
        )


def check_rotations(path: Path, matrices: Float[np.ndarray, "*any 3 3"]) -> None:
    """Check that matrices are rotations. Raises `InputError`."""
    deviation = np.abs(matrices @ np.swapaxes(matrices, -1, -2) - np.eye(3)).max()
    if not deviation < 1e-3 or not (np.linalg.det(matrices) > 0).all():
        raise InputError(
            f"{path}: a joint is scaled, sheared or mirrored; expected rotations and translations, so export it again."
        )
